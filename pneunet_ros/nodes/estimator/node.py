"""The node `estimator`: pressure and end wrench -> shape of the arm, with its uncertainty.

`pneunet_ros.estimation.estimator` does all the processing; this module has the topics, parameters,
services, diagnostics and the log.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time
from typing import Any

from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.estimation.consistency import ConsistencyState, take_estimate
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.health import EstimatorHealth
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.messages.builders import Input, ReadingType, UNREADABLE
from pneunet_ros.messages.consistency import take_targets_message
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import (
    END_WRENCH,
    gravity_inputs,
    OF_ESTIMATOR,
    PRESSURE,
    TARGETS,
)
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.arm import Arm
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.estimator.configuration import (
    configured_estimator,
    EstimatorConfiguration,
    PARAMETERS,
    share_arm_and_settings,
)
from pneunet_ros.nodes.estimator.warm_up import warm_up
from pneunet_ros.nodes.node_options import DEFAULT_OPTIONS, NodeOptions
from pneunet_ros.nodes.parameters import check_source
from pneunet_ros.nodes.pressure_zero import PressureZero
from pneunet_ros.nodes.publisher import EstimatePublisher
from pneunet_ros.nodes.ros_types import has_message, RCLPY_TYPES, serialize
from pneunet_ros.nodes.topics import subscribe_in_order

USAGE = """usage: pneunet-estimator [--ros-args ...]

Estimates the shape of a pneu-net arm from the topics pressure and end_wrench. All settings are
ROS parameters, as in

  pneunet-estimator --ros-args -p model_file:=/path/to/model.yaml
  pneunet-estimator --ros-args --params-file config/estimator.yaml
"""


class EstimatorNode(ConfiguredNode[EstimatorConfiguration]):
    """Passes readings to an `Estimator` and publishes the estimate in the same callback."""

    def __init__(self, node_options: NodeOptions = DEFAULT_OPTIONS) -> None:
        """Declare all parameters, warm up, and only then open the topics."""
        super().__init__('estimator', PARAMETERS, configured_estimator, node_options)
        self.gravity_at_start = self.configuration.estimator.gravity
        self.state = EstimatorState()
        self.consistency = ConsistencyState()

        settings = self.configuration.estimator.settings
        serializer = MessageSerializer(
            types=RCLPY_TYPES, serialize=serialize, frame_id=settings.frame_id
        )
        trouble = warm_up(self.configuration.estimator, serializer)
        if trouble:
            self.get_logger().warning(f'the model has no solution at startup: {trouble}')

        node = self.configuration.node
        markers = node.markers(lambda: self.configuration.estimator.arm)
        self.outputs = EstimatePublisher(
            self, serializer, node.centerline_rate, (*OUTPUTS, *markers)
        )
        self.open_services()
        self.zero = PressureZero(self, self.in_use)

        self.topics = {
            sensor.name: self.resolve_topic_name(sensor.topic) for sensor in OF_ESTIMATOR
        }
        self.health = EstimatorHealth(self.topics[PRESSURE.name], time.monotonic())
        source = self.gravity_at_start
        takes: dict[Input[Any], Callable[..., None]] = {
            one: partial(self.take_gravity, one)
            for one in gravity_inputs(source)
            # If the frame of the Imu is known, /tf is not needed; its type is missing in some
            # installations.
            if source.frame or has_message(one.type)
        }
        for sensor, take in (
            (END_WRENCH, self.take_wrench),
            (PRESSURE, self.take_pressure),
            (TARGETS, self.take_targets),
        ):
            if sensor.needed(settings):
                takes[sensor] = take
        subscribe_in_order(self, takes)
        self.log_ready()

    def check_inputs(self, new: EstimatorConfiguration) -> None:
        """Reject another source of gravity, whose topics were not subscribed to."""
        check_source(new.estimator.gravity, self.gravity_at_start)

    def take_gravity(self, sensor: Input[Any], message: Any, info: dict[str, int]) -> None:
        """Take a message with the direction of gravity."""
        reading = self.decoded(sensor, message, info)
        if reading is None:
            return
        self.state, refusal = self.configuration.estimator.step(self.state, reading)
        if isinstance(refusal, Refusal):
            self.health.note_refusal(refusal)
            self.log_refusal(refusal)

    def take_wrench(self, message: Any, info: dict[str, int]) -> None:
        """Take a wrench message."""
        reading = self.decoded(END_WRENCH, message, info)
        if reading is None:
            return
        resets = self.state.resets
        self.state, refusal = self.configuration.estimator.step(self.state, reading)
        self.note_reset(resets)
        assert not isinstance(refusal, ShapeEstimate)
        self.health.record_wrench(refusal, time.monotonic())
        if refusal is not None:
            self.log_refusal(refusal)

    def take_pressure(self, message: Any, info: dict[str, int]) -> None:
        """Process a pressure message and publish the resulting shape."""
        reading = self.decoded(PRESSURE, message, info)
        if reading is None:
            return
        resets = self.state.resets
        start = time.monotonic()
        self.state, outcome = self.configuration.estimator.step(self.state, reading)
        end = time.monotonic()
        assert outcome is not None
        if isinstance(outcome, ShapeEstimate):
            self.outputs.publish(outcome, end)
            self.health.published(1e-9 * (time.time_ns() - info['received_timestamp']))
        self.health.record_pressure(outcome, end, end - start)
        estimator = self.configuration.estimator
        if estimator.settings.watch_targets:
            self.note_consistency(take_estimate(self.consistency, estimator, outcome))
        self.note_reset(resets)
        if isinstance(outcome, Refusal):
            self.log_refusal(outcome)
            if not outcome.error:
                return
        self.zero.take(reading)

    def take_targets(self, message: Any, info: dict[str, int]) -> None:
        """Process a frame of measured targets and compare it with the estimates."""
        self.note_message(self.topics[TARGETS.name], info)
        consistency, refusal = take_targets_message(
            self.consistency, self.configuration.estimator, message
        )
        self.note_consistency(consistency)
        if refusal is not None:
            self.health.note_refusal(refusal)
            self.log_refusal(refusal)

    def note_consistency(self, consistency: ConsistencyState) -> None:
        """Store the consistency state and the time of the last compared frame."""
        if consistency.running is not self.consistency.running:
            self.health.note_comparison(time.monotonic())
        self.consistency = consistency

    def decoded(
        self, sensor: Input[ReadingType], message: Any, info: dict[str, int]
    ) -> ReadingType | None:
        """Return the reading of a message; None if it cannot be decoded, which is counted."""
        self.note_message(self.topics[sensor.name], info)
        try:
            return sensor.decode(message)
        except MessageError as error:
            refusal = drop(0, UNREADABLE, str(error))
            self.state = self.state.count_rejected(UNREADABLE)
            self.health.note_refusal(refusal)
            self.log_refusal(refusal)
            return None

    def note_reset(self, resets: int) -> None:
        """Log a restart of the estimator after a jump back in time."""
        if self.state.resets > resets:
            self.zero.forget()
            sentence = 'time jumped back: the estimator was reset'
            self.log.warn('reset', sentence, time.monotonic())

    def diagnose(self) -> None:
        """Publish the diagnostics of the estimator."""
        now = time.monotonic()
        settings = self.configuration.estimator.settings
        left_out = self.configuration.left_out
        report = self.health.report(self.state, settings, now, self.consistency, left_out)
        self.publish_report('shape', report)
        found = self.health.disagreement(settings, self.consistency, now)
        if found is not None and found.beyond:
            self.log.warn('disagreement', found.sentence, now)
        if self.health.silence(now) > settings.input_timeout:
            self.log.warn('silence', report.message, now)

    def in_use(self) -> tuple[Arm, EstimatorSettings]:
        """Return the arm and sensor settings in use."""
        estimator = self.configuration.estimator
        return estimator.arm, estimator.settings

    def forget(self) -> str:
        """Discard all readings."""
        self.state, self.consistency = self.state.fresh(), self.consistency.fresh()
        self.zero.forget()
        return 'the estimator was reset'

    def reconfigure(self, configuration: EstimatorConfiguration) -> None:
        """Keep the part of the state that remains valid, and use the new rate."""
        self.state = configuration.carry_over(self.state, self.configuration)
        if not share_arm_and_settings(configuration, self.configuration):
            self.consistency = self.consistency.fresh()
        self.outputs.centerline_rate = configuration.node.centerline_rate
