"""Topics of the node `gripper`: the grasp, and commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import math
import time
from typing import Any

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.health import Report
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.fusion.closing import Closing, GripCommand, is_reached, Reach, reach_of
from pneunet_ros.fusion.grasp import Grasp, Gripper, is_unknown, seen_arm, SeenArm
from pneunet_ros.messages.base_frames import TRANSFORM_TYPE
from pneunet_ros.messages.builders import header
from pneunet_ros.messages.gripper import GRIPPER_STATE, mount_transforms
from pneunet_ros.messages.readings import PRESSURE_TYPE
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.nodes.gripper.configuration import GripperSettings
from pneunet_ros.nodes.gripper.health import GraspHealth
from pneunet_ros.nodes.ros_types import has_message, message_class, RCLPY_TYPES, serialize
from pneunet_ros.nodes.topics import latched_qos, output_qos, publisher, subscription

COMMAND_TYPE = 'sensor_msgs/msg/JointState'


class Grasping:
    """Publishes the grasp of a gripper, and executes commands.

    A grasp is computed from the last frames of the arms, once all of them have a new one. fusions:
    the nodes, by the name of their arm. Without a subscriber or a command, nothing is computed.
    """

    def __init__(
        self, node: Any, settings: GripperSettings, gripper: Gripper, fusions: Mapping[str, Any]
    ) -> None:
        self.node, self.settings, self.gripper, self.fusions = node, settings, gripper, fusions
        self.seen: dict[str, SeenArm] = {}
        self.new: set[str] = set()
        self.grasp: Grasp | None = None
        self.command: GripCommand | None = None
        self.pressures: dict[str, float] = {}
        self.commanded_at = -math.inf  # s of a steady clock
        self.health = GraspHealth(fusions)
        self.reaches: dict[tuple[str, Any], Reach] = {}
        self.serializer = MessageSerializer(
            types=RCLPY_TYPES, serialize=serialize, frame_id=settings.frame_id
        )
        self.states = publisher(node, GRIPPER_STATE.type, GRIPPER_STATE.name, output_qos())
        self.commands = {
            arm: publisher(node, PRESSURE_TYPE, f'{arm}/pressure_command', output_qos())
            for arm in fusions
        }
        self.controller()  # computes the reaches before the first command
        subscription(node, COMMAND_TYPE, 'gripper/command', self.take_command, output_qos())
        self.publish_mounts()
        for arm, fusion in fusions.items():
            fusion.take_frame = partial(self.take_frame, arm)

    def publish_mounts(self) -> None:
        """Publish the poses of the bases, each of which has its own frame."""
        mounts = {
            fusion.configuration.fusion.sensors.frame_id: self.gripper.mounts[arm]
            for arm, fusion in self.fusions.items()
        }
        if has_message(TRANSFORM_TYPE):
            self.transforms = publisher(self.node, TRANSFORM_TYPE, '/tf_static', latched_qos())
            self.transforms.publish(mount_transforms(mounts, self.settings.frame_id, RCLPY_TYPES))

    @property
    def is_wanted(self) -> bool:
        """Whether there is a command or a subscriber."""
        return self.command is not None or self.states.get_subscription_count() > 0

    def take_frame(self, arm: str) -> None:
        """Process a frame used by the fusion of an arm."""
        if not self.is_wanted:
            self.forget_frames()
            return
        fusion = self.fusions[arm]
        seen = seen_arm(fusion.configuration.fusion, fusion.state)
        if seen is None:
            self.seen.pop(arm, None)
            return
        self.take_seen(arm, seen, time.monotonic())

    def take_seen(self, arm: str, seen: SeenArm, now: float) -> None:
        """Compute the grasp once all arms have a new frame, unless these are too far apart."""
        self.seen[arm] = seen
        self.new.add(arm)
        self.health.take_frame(arm, now)
        if not self.new == self.fusions.keys() == self.seen.keys():
            return
        self.new.clear()
        stamps = {arm: one.fused.stamp_ns for arm, one in self.seen.items()}
        first, last = min(stamps, key=stamps.__getitem__), max(stamps, key=stamps.__getitem__)
        apart = (stamps[last] - stamps[first]) / NANOSECONDS_PER_SECOND
        if apart > self.settings.hold_after:
            self.health.note(
                f'no grasp, because the frames of {first} are {apart:.2f} s older than those of '
                f'{last}: more than {self.settings.hold_after:g} s (hold_after)'
            )
            return
        self.grasp = self.gripper.grasp(self.seen)
        self.health.grasps += 1
        self.states.publish(self.serializer.bytes_of(GRIPPER_STATE, self.grasp))
        self.follow(now)

    def forget_frames(self) -> None:
        """Restart with the next frame of every arm."""
        self.seen.clear()
        self.new.clear()
        self.health.forget_frames()

    def take_command(self, message: Any) -> None:
        """Take a command; position: the width (m), effort: the largest force (N) of an arm."""
        try:
            if len(message.position) != 1 or len(message.effort) > 1:
                raise RequestError(
                    'position must be one width (m), and effort one force (N) or empty',
                    reason='wrong_shape',
                )
            self.order(message.position[0], message.effort[0] if message.effort else 0.0)
        except RequestError as error:
            sentence = f'gripper command rejected: {error}'
            self.health.reject(sentence)
            self.node.log.warn('command', sentence, time.monotonic())

    def order(self, width: float, force: float) -> GripCommand:
        """Start executing a command; force: 0 or less means the largest allowed force."""
        command = GripCommand(
            width=width, force=self.settings.max_force if force <= 0.0 else force
        )
        if self.command is None:
            self.pressures, self.commanded_at = {}, -math.inf
            self.forget_frames()  # the arms may have moved since
        self.command = command
        return command

    @property
    def allowed(self) -> GripCommand | None:
        """The command, with the force limited to the currently allowed value."""
        if self.command is None:
            return None
        force = min(self.command.force, self.settings.max_force)
        return GripCommand(width=self.command.width, force=force)

    def hold(self) -> None:
        """Stop executing commands; the valves hold the last pressure."""
        self.command = None

    def follow(self, now: float) -> None:
        """Command the next pressures from the latest readings."""
        elapsed, self.commanded_at = now - self.commanded_at, now
        command = self.allowed
        if command is None:
            return
        if not self.pressures or elapsed > self.settings.hold_after:
            fused = {arm: seen.fused.estimate for arm, seen in self.seen.items()}
            self.pressures = {arm: one.shape.pressure for arm, one in fused.items()}
            return
        for arm, touch in self.gripper.touches(self.seen).items():
            if is_unknown(touch.force):
                self.health.note(
                    f'{arm} closes no further: its targets do not determine its force'
                )
        self.pressures = self.controller().step(self.seen, self.pressures, command, elapsed)
        kind = message_class(PRESSURE_TYPE)
        stamp_ns = self.node.get_clock().now().nanoseconds
        for arm, pressure in self.pressures.items():
            heading = header(stamp_ns, '', RCLPY_TYPES)
            self.commands[arm].publish(kind(header=heading, fluid_pressure=pressure))

    def controller(self) -> Closing:
        """Return the controller of the pressures for the models in use."""
        reaches = {}
        for arm, fusion in self.fusions.items():
            model = fusion.configuration.fusion.arm
            key = arm, model
            if key not in self.reaches:
                mount, inward = self.gripper.mounts[arm], self.gripper.inward(arm)
                self.reaches[key] = reach_of(model, mount, inward)
            reaches[arm] = self.reaches[key]
        return Closing(
            gripper=self.gripper,
            reaches=reaches,
            rate=self.settings.closing_rate,
            gain=self.settings.closing_gain,
        )

    def is_reached(self) -> bool:
        """Whether the commanded width is reached."""
        return (
            self.grasp is not None
            and self.command is not None
            and is_reached(self.grasp, self.command, self.settings.width_tolerance)
        )

    def is_stalled(self) -> bool:
        """Whether the grip is at its force limit or cannot close any further."""
        return self.holds_for_grasp(Closing.is_stalled)

    def is_blind(self) -> bool:
        """Whether the grip cannot close any further until the force is known again."""
        return self.holds_for_grasp(Closing.is_blind)

    def holds_for_grasp(self, question: Callable[..., bool]) -> bool:
        """Evaluate a condition of the controller on the last grasp; False without a grasp."""
        command = self.allowed
        if command is None or self.grasp is None or self.seen.keys() != self.fusions.keys():
            return False
        return question(self.controller(), self.seen, self.pressures, command, self.grasp.width)

    def forget(self) -> None:
        """Discard all frames and the command."""
        self.forget_frames()
        self.grasp = self.command = None

    def report(self, now: float) -> Report:
        """Summarize the time since the last report, with values of a grasp if there was one."""
        numbers: dict[str, float] = {'commands_rejected': self.health.rejected}
        if self.health.grasps and self.grasp is not None:
            grasp = self.grasp
            numbers |= {
                'touching': grasp.touching,
                'width_m': grasp.width,
                'width_std_m': grasp.std_width,
                'force_n': grasp.force,
                'force_std_n': grasp.std_force,
            }
        command = self.allowed
        if command is not None:
            numbers |= {'commanded_width_m': command.width, 'commanded_force_n': command.force}
        level, message = self.health.report(
            self.settings.hold_after, now, is_wanted=self.is_wanted
        )
        values = {name: f'{value:.6g}' for name, value in numbers.items()}
        return Report(level=level, message=message, values=values)
