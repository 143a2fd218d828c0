"""The node `fusion`: pressure, targets and end wrench -> one estimate of shape and tip force.

`pneunet_ros.fusion.fusion` does all the processing; this module has the topics, parameters,
services, diagnostics and the log.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time
from typing import Any, ClassVar

from pneunet_ros.core.health import Level
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.health import FusionHealth
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.builders import Input
from pneunet_ros.messages.fusion import fuse_message, FUSION_OUTPUTS
from pneunet_ros.messages.readings import END_WRENCH, gravity_inputs, OF_FUSION, PRESSURE, TARGETS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.arm import Arm
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.fusion.configuration import (
    configured_fusion,
    FusionConfiguration,
    PARAMETERS,
)
from pneunet_ros.nodes.fusion.warm_up import warm_up
from pneunet_ros.nodes.node_options import DEFAULT_OPTIONS, NodeOptions
from pneunet_ros.nodes.parameters import check_source
from pneunet_ros.nodes.pressure_zero import PressureZero
from pneunet_ros.nodes.publisher import EstimatePublisher
from pneunet_ros.nodes.ros_types import has_message, RCLPY_TYPES, serialize
from pneunet_ros.nodes.topics import subscribe_in_order

USAGE = """usage: pneunet-fusion [--ros-args ...]

Fuses the topics pressure, targets and, if there is one, end_wrench into one estimate of the
shape of a pneu-net arm and of the force at its tip, on the topics fused/*. All settings are ROS
parameters, as in

  pneunet-fusion --ros-args -p model_file:=/path/to/model.yaml -p use_wrench:=false
  pneunet-fusion --ros-args --params-file config/fusion.yaml
"""


class FusionNode(ConfiguredNode[FusionConfiguration]):
    """Passes messages to a `Fusion` and publishes its results in the same callback."""

    PATIENCE: ClassVar[float] = 0.01  # a frame takes longer than ten estimates by an estimator

    def __init__(self, node_options: NodeOptions = DEFAULT_OPTIONS) -> None:
        """Declare all parameters, warm up, and only then open the topics."""
        super().__init__('fusion', PARAMETERS, configured_fusion, node_options)
        self.state = FusionState()
        self.gravity_at_start = self.configuration.fusion.gravity
        self.is_unsettled = False
        self.take_frame: Callable[[], None] | None = None  # of a gripper: called per frame
        self.frame_ns = 0
        node, fusion = self.configuration.node, self.configuration.fusion
        serializer = MessageSerializer(
            types=RCLPY_TYPES, serialize=serialize, frame_id=fusion.sensors.frame_id
        )
        trouble = warm_up(fusion, serializer)
        if trouble:
            self.get_logger().warning(f'the model has no solution at startup: {trouble}')
        self.outputs = EstimatePublisher(self, serializer, node.centerline_rate, FUSION_OUTPUTS)
        self.open_services()
        self.zero = PressureZero(self, self.in_use)

        topics = {sensor.name: self.resolve_topic_name(sensor.topic) for sensor in OF_FUSION}
        self.health = FusionHealth(topics[PRESSURE.name], topics[TARGETS.name], time.monotonic())
        wrench = node.use_wrench and not node.free_tip
        gravity = [
            one
            for one in gravity_inputs(fusion.gravity)
            if fusion.gravity.frame or has_message(one.type)
        ]
        inputs = [*gravity, *([END_WRENCH] if wrench else []), TARGETS, PRESSURE]
        subscribe_in_order(
            self, {sensor: partial(self.take, sensor, topics[sensor.name]) for sensor in inputs}
        )
        self.log_ready()

    def check_inputs(self, new: FusionConfiguration) -> None:
        """Reject another source of gravity, whose topics were not subscribed to."""
        check_source(new.fusion.gravity, self.gravity_at_start)

    def take(self, sensor: Input[Any], topic: str, message: Any, info: dict[str, int]) -> None:
        """Process a message, and publish its estimate if there is one."""
        self.note_message(topic, info)
        self.settle()
        resets, start = self.state.readings.resets, time.monotonic()
        self.state, outcome = fuse_message(self.configuration.fusion, self.state, sensor, message)
        end = time.monotonic()
        if isinstance(outcome, FusedEstimate):
            self.outputs.publish(outcome, end)
            self.health.published(1e-9 * (time.time_ns() - info['received_timestamp']))
        elif isinstance(outcome, Refusal):
            self.log_refusal(outcome)
        if sensor is PRESSURE and not (isinstance(outcome, Refusal) and not outcome.error):
            self.zero.take(PRESSURE.decode(message))
        self.is_unsettled = True
        self.health.record(sensor.name, outcome, end, end - start)
        if self.state.readings.resets > resets:
            self.zero.forget()
            sentence = 'time jumped back: the fusion was reset'
            self.log.warn('reset', sentence, time.monotonic())

    def settle(self) -> None:
        """Do deferred work; the executor calls this when no message is waiting."""
        if not self.is_unsettled:
            return
        self.is_unsettled = False
        self.state = self.configuration.fusion.settle(self.state)
        belief = self.state.belief
        if self.take_frame is not None and belief is not None:
            previous_ns, self.frame_ns = self.frame_ns, belief.stamp_ns
            if belief.stamp_ns != previous_ns:
                self.take_frame()

    def diagnose(self) -> None:
        """Publish the diagnostics of the fusion."""
        self.settle()
        now, configuration = time.monotonic(), self.configuration
        report = self.health.report(
            self.state, configuration.fusion, now, left_out=configuration.left_out
        )
        self.publish_report('shape and force', report)
        if self.health.silent(configuration.fusion, now):
            self.log.warn('silence', report.message, now)
        elif report.level is Level.WARN:
            self.log.warn('limited', report.message, now)

    def in_use(self) -> tuple[Arm, EstimatorSettings]:
        """Return the arm and its sensor settings."""
        fusion = self.configuration.fusion
        return fusion.arm, fusion.sensors

    def forget(self) -> str:
        """Discard all readings and frames."""
        self.settle()
        self.state = self.state.restarted()
        self.zero.forget()
        return 'the fusion was reset'

    def reconfigure(self, configuration: FusionConfiguration) -> None:
        """Keep the part of the state that remains valid, and use the new rate."""
        self.settle()
        self.state = configuration.carry_over(self.state, self.configuration)
        self.outputs.centerline_rate = configuration.node.centerline_rate
