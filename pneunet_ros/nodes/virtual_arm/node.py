"""The node `virtual_arm`: simulates sensor readings for commands, with the virtual lab.

`pneunet_ros.lab.live` simulates the arm; this module has the topics, parameters, services,
diagnostics and the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import math
import time
from typing import Any, ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError, RequestError
from pneunet_ros.core.frames import heading_quaternion
from pneunet_ros.core.health import count_texts, Level, Report, texts
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.lab.chain import ChainShape
from pneunet_ros.lab.live import Film, LiveLab, Load, SCENE
from pneunet_ros.lab.moving_arm import MovingShape
from pneunet_ros.messages.base_frames import imu_message
from pneunet_ros.messages.builders import header, image, IMAGE_TYPE, UNREADABLE
from pneunet_ros.messages.readings import BASE_IMU, END_WRENCH, PRESSURE, TARGETS, targets_message
from pneunet_ros.messages.tracker import camera_info_message, CAMERA_INFO_TYPE
from pneunet_ros.nodes.configured_node import ConfiguredNode
from pneunet_ros.nodes.node_options import DEFAULT_OPTIONS, NodeOptions
from pneunet_ros.nodes.ros_types import RCLPY_TYPES
from pneunet_ros.nodes.topics import input_qos, output_qos, publisher, subscription
from pneunet_ros.nodes.virtual_arm.configuration import (
    configured_virtual_arm,
    PARAMETERS,
    VirtualArmConfiguration,
)

USAGE = """usage: pneunet-virtual-arm [--ros-args ...]

Simulates a pneu-net arm with its valve, sensors and camera, to try the whole stack without
hardware. The pressure is commanded on the topic pressure_command. All settings are ROS
parameters, as in

  pneunet-virtual-arm --ros-args -p camera:=images
  pneunet-virtual-arm --ros-args -p effects:="hysteresis.width=4000 gravity.weight_y=-1.0"
"""
OF_IMU = BASE_IMU.type, BASE_IMU.name
TIP_TYPE = 'geometry_msgs/msg/PoseStamped'
PRESSURE_FRAME, CAMERA_FRAME = 'pressure_sensor', 'camera'
SWING = 0.8  # of the largest pressure
NOT_FINITE, WRONG_FRAME = 'not_finite', 'wrong_frame'


class VirtualArmNode(ConfiguredNode[VirtualArmConfiguration]):
    """Runs a `LiveLab` in real time: steady clock for the lab, ROS time for stamps."""

    INFO_TOPIC: ClassVar[str] = 'lab_info'
    SHARED_INPUTS: ClassVar[tuple[str, ...]] = ('pressure_command', 'force_command')

    def __init__(self, node_options: NodeOptions = DEFAULT_OPTIONS) -> None:
        """Declare all parameters, warm up, and only then open the topics."""
        super().__init__('virtual_arm', PARAMETERS, configured_virtual_arm, node_options)
        settings = self.configuration.node
        self.random = np.random.default_rng(settings.seed)
        self.command: float | None = None
        self.load = Load()
        self.started_at = time.monotonic()
        self.film = self.camera(self.configuration.lab)
        self.warm_up()
        self.state = self.configuration.lab.begin(self.now())
        self.rejected: Counter[str] = Counter()
        self.refused = ''  # the last command without effect since the last report
        self.trouble: Refusal | None = None
        self.readings, self.reported = 0, time.monotonic()
        self.stamp_ns = self.frame_ns = 0  # of the last reading and the last frame
        self.clock_stopped = False  # the time of ROS

        self.pressures = publisher(self, PRESSURE.type, PRESSURE.name, output_qos())
        self.wrenches = publisher(self, END_WRENCH.type, END_WRENCH.name, output_qos())
        with_imu = self.configuration.lab.scenario.rates.imu > 0.0
        self.imus = publisher(self, *OF_IMU, output_qos()) if with_imu else None
        self.tips = publisher(self, TIP_TYPE, 'true_tip', output_qos())
        self.call_every(1.0 / settings.rate, self.measure)
        if settings.camera == 'targets':
            self.targets = publisher(self, TARGETS.type, TARGETS.name, output_qos())
            self.call_every(1.0 / settings.frame_rate, self.show_targets)
        elif settings.camera == 'images':
            self.infos = publisher(self, CAMERA_INFO_TYPE, 'camera_info', output_qos())
            self.images = publisher(self, IMAGE_TYPE, 'image_raw', output_qos())
            self.call_every(1.0 / settings.frame_rate, self.show_image)
        self.open_services()
        for kind, topic, take in (
            (PRESSURE.type, 'pressure_command', self.take_command),
            (END_WRENCH.type, 'force_command', self.take_load),
        ):
            subscription(self, kind, topic, take, input_qos())
        self.log_ready()

    def now(self) -> float:
        """Return the time of the lab (s)."""
        return time.monotonic() - self.started_at

    def warm_up(self) -> None:
        """Run every kernel once, before a subscriber waits."""
        lab = self.configuration.lab
        load = Load(force_x=0.1 * lab.scenario.arm.weight)
        state, shape = lab.shape(lab.step(lab.begin(), 0.01, 1e3, load))
        _, shape = lab.shape(lab.step(state, 0.02, 1e3))
        lab.reading(state, self.random)
        lab.tracked_points(shape, self.random)
        if self.film is not None:
            self.film.image(shape, self.random)

    def camera(self, lab: LiveLab) -> Film | None:
        """Return the camera, if images are published."""
        return Film(lab) if self.configuration.node.camera == 'images' else None

    def take_command(self, message: Any) -> None:
        """Process a commanded pressure; its stamp is ignored."""
        try:
            command = PRESSURE.decode(message).pressure
        except MessageError as error:
            self.refuse(UNREADABLE, str(error))
            return
        if not math.isfinite(command):
            self.refuse(NOT_FINITE, f'a commanded pressure of {command} was rejected')
            return
        low, high = self.configuration.lab.scenario.arm.pressure_range
        limited = min(max(command, low), high)
        self.command = limited
        if limited != command:
            sentence = (
                f'a commanded pressure of {command:g} Pa is outside the range of the valve, '
                f'{low:g} to {high:g} Pa'
            )
            self.log.warn('range', sentence, time.monotonic())

    def take_load(self, message: Any) -> None:
        """Apply a load to the free end."""
        try:
            wrench = END_WRENCH.decode(message)
        except MessageError as error:
            self.refuse(UNREADABLE, str(error))
            return
        frame_id = self.configuration.node.frame_id
        if wrench.frame_id not in ('', frame_id):
            self.refuse(WRONG_FRAME, f'a force in {wrench.frame_id!r} must be in {frame_id!r}')
            return
        try:
            self.load = Load(force_x=wrench.force_x, force_y=wrench.force_y, moment=wrench.moment)
        except RequestError as error:
            self.refuse(NOT_FINITE, str(error))

    def refuse(self, reason: str, sentence: str) -> None:
        """Count a rejected command."""
        self.rejected[reason] += 1
        self.refused = sentence
        self.log_refusal(drop(0, reason, sentence))

    def commanded(self) -> float:
        """Return the target pressure (Pa) of the valve: commanded, or from the automatic cycle."""
        if self.command is not None:
            return self.command
        period = self.configuration.node.swing_period
        turns = self.now() / period % 2.0 if period > 0.0 else 0.0
        high: float = self.configuration.lab.scenario.arm.pressure_range[1]
        return 0.5 * SWING * high * (1.0 - math.cos(2.0 * math.pi * max(turns - 1.0, 0.0)))

    def advance(self) -> int:
        """Advance the arm to the current time; return its stamp (ns), 0 before time starts."""
        lab = self.configuration.lab
        self.state = lab.step(self.state, self.now(), self.commanded(), self.load)
        stamp_ns: int = self.get_clock().now().nanoseconds
        return stamp_ns

    def measure(self) -> None:
        """Publish the readings of wrench and pressure, and the truth if it has subscribers.

        There is one reading per instant of ROS time, and none while /clock stands still.
        """
        stamp_ns = self.advance()
        self.clock_stopped = stamp_ns in (0, self.stamp_ns)
        if self.clock_stopped:
            return
        self.stamp_ns = stamp_ns
        reading = self.configuration.lab.reading(self.state, self.random)
        load, frame_id = reading.load, self.configuration.node.frame_id
        wrench = np.array([load.force_x, load.force_y, load.moment])
        pressure = np.array([reading.pressure])
        # The pressure comes last, because it triggers the estimate.
        if reading.imu is not None and self.imus is not None:
            std = self.configuration.lab.scenario.noise.imu_std
            self.imus.publish(imu_message(stamp_ns, reading.imu, frame_id, RCLPY_TYPES, std))
        self.wrenches.publish(END_WRENCH.message(stamp_ns, wrench, frame_id, RCLPY_TYPES))
        self.pressures.publish(PRESSURE.message(stamp_ns, pressure, PRESSURE_FRAME, RCLPY_TYPES))
        self.readings += 1
        if self.tips.get_subscription_count():
            self.with_shape(lambda shape: self.tips.publish(self.tip(shape, stamp_ns)))

    def with_shape(self, use: Callable[[ChainShape | MovingShape], None]) -> None:
        """Call a function with the shape of the arm, if it has one."""
        try:
            self.state, shape = self.configuration.lab.shape(self.state)
        except RequestError as error:
            self.trouble = Refusal(
                stamp_ns=0, reason='no_equilibrium', sentence=str(error), error=True
            )
            self.log_refusal(self.trouble)
        else:
            use(shape)

    def tip_now(self) -> Array | None:
        """Advance the arm to the current time; return its tip (2,) m, None without a shape."""
        tips: list[Array] = []
        reach = [self.configuration.lab.scenario.arm.reach]
        self.advance()
        self.with_shape(lambda shape: tips.append(np.array(shape.points(reach)[:2])[:, 0, 0]))
        return tips[0] if tips else None

    def tip_compliance(self, along: Array) -> float:
        """Return the compliance (m/N) of the tip along a direction (2,); 0 without a shape."""
        try:
            return max(self.configuration.lab.tip_compliance(self.state, along), 0.0)
        except RequestError:
            return 0.0

    def tip(self, shape: ChainShape | MovingShape, stamp_ns: int) -> Any:
        """Return the pose of the true free end."""
        tip = self.configuration.lab.scenario.arm.reach
        x, y, theta = (float(rows[0, 0]) for rows in shape.points([tip]))
        tip = RCLPY_TYPES(TIP_TYPE)(
            header=header(stamp_ns, self.configuration.node.frame_id, RCLPY_TYPES)
        )
        tip.pose.position.x, tip.pose.position.y = x, y
        tip.pose.orientation.z, tip.pose.orientation.w = heading_quaternion(theta)
        return tip

    def frame_stamp(self) -> int | None:
        """Advance the arm to the current time; return the stamp (ns) of its camera.

        None before time starts, or if no time has passed since the last frame.
        """
        now_ns, before_ns = self.advance(), self.frame_ns
        self.frame_ns = now_ns
        delay = self.configuration.lab.frame_delay
        passed = now_ns not in (0, before_ns)
        return now_ns + round(delay * NANOSECONDS_PER_SECOND) if passed else None

    def show_targets(self) -> None:
        """Publish the targets as measured by a tracker."""
        stamp_ns = self.frame_stamp()
        if stamp_ns is None:
            return
        lab, frame_id = self.configuration.lab, self.configuration.node.frame_id

        def show(shape: ChainShape | MovingShape) -> None:
            x, y = lab.tracked_points(shape, self.random).T
            std = lab.scenario.noise.target_std
            self.targets.publish(targets_message(stamp_ns, x, y, frame_id, RCLPY_TYPES, std))

        self.with_shape(show)

    def show_image(self) -> None:
        """Publish an image of the arm, after its camera_info."""
        stamp_ns = self.frame_stamp()
        if stamp_ns is None:
            return

        def show(shape: ChainShape | MovingShape) -> None:
            assert self.film is not None
            grey = self.film.image(shape, self.random)
            info = camera_info_message(SCENE.camera, stamp_ns, CAMERA_FRAME, RCLPY_TYPES)
            self.infos.publish(info)
            self.images.publish(image(grey, info.header, RCLPY_TYPES))

        self.with_shape(show)

    def diagnose(self) -> None:
        """Publish the diagnostics of the arm."""
        now = time.monotonic()
        rate = self.readings / max(now - self.reported, 1e-9)
        values = {
            'rate_hz': rate,
            'command_pa': self.commanded(),
            'pressure_pa': self.state.pressure,
            'force_x_n': self.load.force_x,
            'force_y_n': self.load.force_y,
            'moment_nm': self.load.moment,
        }
        level, message = Level.OK, f'a virtual arm at {rate:.3g} Hz'
        if self.refused:
            level, message = Level.WARN, self.refused
        if self.clock_stopped:
            level = Level.WARN
            message = (
                'no readings, because the clock is not running. Start the publisher of /clock, '
                'or set use_sim_time to false'
            )
            self.log.warn('still', message, now)
        if self.trouble is not None:
            level, message = Level.ERROR, self.trouble.sentence
        self.readings, self.reported, self.trouble, self.refused = 0, now, None, ''
        entries = texts(values) | count_texts('rejected', self.rejected)
        self.publish_report('arm', Report(level=level, message=message, values=entries))

    def forget(self) -> str:
        """Replace the arm by an unconditioned one (no prior loading), vented and unloaded."""
        self.command, self.load = None, Load()
        self.state = self.configuration.lab.begin(self.now())
        return 'an unconditioned arm (no prior loading), vented and without a load'

    def reconfigure(self, configuration: VirtualArmConfiguration) -> None:
        """Continue with other effects, or with another, unconditioned arm."""
        lab = configuration.lab
        self.film = self.camera(lab)
        if lab.scenario.arm is self.configuration.lab.scenario.arm:
            self.state = lab.reconfigure(self.state)
        else:
            self.state = lab.begin(self.now())
