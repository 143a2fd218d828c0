"""The node `tracker`: camera images -> targets and centerline of the arm, measured.

`pneunet_ros.vision.tracker` does all the processing; this module has the topics, parameters,
services, diagnostics and the log.
"""

from __future__ import annotations

import time
from typing import ClassVar

from pneunet_ros.core.image import Image
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.stamps import AHEAD
from pneunet_ros.messages import builders
from pneunet_ros.messages.builders import header, IMAGE_TYPE
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.messages.targets import TARGETS_OUTPUT
from pneunet_ros.messages.tracker import outputs_of, TRACKER_OUTPUTS
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.node_options import DEFAULT_OPTIONS, NodeOptions
from pneunet_ros.nodes.ros_types import RCLPY_TYPES, serialize
from pneunet_ros.nodes.topics import output_qos, publisher
from pneunet_ros.nodes.tracker.camera import camera_of
from pneunet_ros.nodes.tracker.configuration import (
    configured_tracker,
    PARAMETERS,
    TrackerConfiguration,
)
from pneunet_ros.nodes.tracker.health import IMAGE_TIMEOUT, TrackerHealth
from pneunet_ros.nodes.tracker.warm_up import warm_up
from pneunet_ros.vision.camera.camera_settings import RestPlane
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.vision.tracker import TrackerState, Tracking

USAGE = """usage: pneunet-tracker [--ros-args ...]

Measures the targets on a pneu-net arm, and its centerline, in the images of a camera. All settings
are ROS parameters, as in

  pneunet-tracker --ros-args -p camera_file:=/path/to/camera.yaml -p image_transport:=compressed
  pneunet-tracker --ros-args --params-file config/tracker.yaml
"""


class TrackerNode(ConfiguredNode[TrackerConfiguration]):
    """Passes images to a `Tracker` and publishes its results in the same callback."""

    PATIENCE: ClassVar[float] = 0.02  # images take longest

    def __init__(self, node_options: NodeOptions = DEFAULT_OPTIONS) -> None:
        """Declare all parameters, warm up, and only then open the topics."""
        super().__init__('tracker', PARAMETERS, configured_tracker, node_options)
        self.state = TrackerState()
        self.serializer = MessageSerializer(
            types=RCLPY_TYPES, serialize=serialize, frame_id=self.configuration.node.frame_id
        )
        trouble = ''
        if not jit.is_waiting():
            trouble = warm_up(self.configuration.tracker, self.serializer)
        if trouble:
            self.get_logger().warning(f'the self-test on a drawn arm failed: {trouble}')

        self.outputs = {
            output.name: publisher(self, output.type, output.name, output_qos())
            for output in TRACKER_OUTPUTS
        }
        self.annotated = publisher(self, IMAGE_TYPE, 'image_annotated', output_qos())
        self.open_services()
        self.camera = camera_of(self)
        straight = isinstance(self.configuration.tracker.settings.plane, RestPlane)
        self.health = TrackerHealth(self.camera.topic, time.monotonic(), straight)
        self.log_ready()

    def take_step(
        self,
        image: Image,
        state: TrackerState,
        outcome: Tracking | Refusal | None,
        info: dict[str, int],
    ) -> None:
        """Process the outcome of an image, and publish its targets; info: that of the message."""
        has_reset, self.state = state.resets > self.state.resets, state
        if has_reset:
            sentence = 'time jumped back: the tracker was reset'
            self.log.warn('reset', sentence, time.monotonic())
        assert outcome is not None
        if isinstance(outcome, Tracking):
            if outcome.warning:
                warning = drop(image.stamp_ns, AHEAD, outcome.warning)
                self.health.note_refusal(warning)
                self.log_refusal(warning)
            self.publish(outcome)
            self.health.published(1e-9 * (time.time_ns() - info['received_timestamp']))
            if self.annotated.get_subscription_count():
                self.annotate(image, outcome)
        else:
            self.log_refusal(outcome)
        self.health.record_image(outcome, time.monotonic())

    def publish(self, tracking: Tracking) -> None:
        """Publish the targets of a frame, and its curve on topics that have subscribers."""
        for output, result in outputs_of(tracking):
            out = self.outputs[output.name]
            if output is TARGETS_OUTPUT or out.get_subscription_count():
                out.publish(self.serializer.bytes_of(output, result))

    def annotate(self, image: Image, tracking: Tracking) -> None:
        """Publish the image with the tracking result drawn in it."""
        curve, plane, lens = None, self.state.plane, self.state.lens
        if tracking.curve is not None and plane is not None and lens is not None:
            curve = curve_in_image(tracking.curve, plane, lens)
        picture = draw(image, tracking, curve)
        heading = header(image.stamp_ns, image.frame_id, RCLPY_TYPES)
        self.annotated.publish(builders.image(picture, heading, RCLPY_TYPES))

    def refuse(self, refusal: Refusal) -> None:
        """Count a message that could not be decoded."""
        self.state = self.state.count_rejected(refusal.reason)
        self.health.note_refusal(refusal)
        self.log_refusal(refusal)

    def diagnose(self) -> None:
        """Publish the diagnostics of the tracker."""
        now = time.monotonic()
        report = self.health.report(self.state, now)
        self.publish_report('targets', report)
        if self.health.silence(now) > IMAGE_TIMEOUT:
            self.log.warn('silence', report.message, now)

    def forget(self) -> str:
        """Reset the tracking, but keep the camera."""
        self.state = self.configuration.tracker.reset(self.state)
        return 'the tracker was reset'

    def reconfigure(self, configuration: TrackerConfiguration) -> None:
        """Restart if the configuration has changed; camera information remains valid."""
        if configuration.tracker is not self.configuration.tracker:
            self.state = configuration.tracker.reset(self.state)
