"""Move the tip of an arm along a path with a limited contact force, using the fusion.

There is one actuator, so the tip goes to the reachable point nearest to each target. The arm
presses an obstacle with the requested force, which is estimated without a force sensor.

    python examples/tip_controller.py --ros-args -p path:="[0.1038, 0.0363, 0.0896, 0.0572]"
    python examples/tip_controller.py --ros-args -p press:=0.005

The path holds x, y, x, y, ... in m in the base frame; `press` is a force in N. Without
estimates, or if the force is not determined, the command is held at first, and then the arm is
vented.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
import signal
import struct
import time

from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure, PointCloud2

RATE = 50.0  # Hz, of commands
SMALL_PART = 0.3  # of a direction, up to which an unknown component of the force is neglected
Point = tuple[float, float]


@dataclass(kw_only=True)
class TipController:
    """Descends the distance to a target; all times are in s of one steady clock."""

    path: list[Point]  # m in the base frame
    press: float = 0.01  # N, force against an obstacle
    gain: float = 3.0  # 1/s, share of the remaining distance that is corrected per second
    tolerance: float = 0.0015  # m, along the direction in which the tip can move
    dwell: float = 0.7  # s within the tolerance before going on to the next target
    max_pressure: float = 55e3  # Pa
    max_rate: float = 20e3  # Pa/s
    hold_after: float = 0.3  # s without an estimate until the command is held
    vent_after: float = 1.5  # s without an estimate until the arm is vented

    command: float = 0.0  # Pa
    mode: str = 'waiting'
    target: int = 0
    reached: list[float] = field(default_factory=list)  # m, distance left at every target
    tip: Point = (math.nan, math.nan)
    slope: Point = (0.0, 0.0)  # m/Pa, of the tip with the pressure
    compliance: tuple[Point, Point] = ((0.0, 0.0), (0.0, 0.0))  # m/N, of x and y with F1 and F2
    force: Point = (math.nan, math.nan)  # N, on the tip
    seen: float = -math.inf
    felt: float = -math.inf
    arrived: float | None = None
    last: float | None = None

    def take_state(
        self, tip: Point, slope: Point, compliance: tuple[Point, Point], now: float
    ) -> None:
        """Take an estimate of the tip, and its derivatives by pressure and force.

        Within a dead band of the pressure, the last slope remains valid.
        """
        if all(map(math.isfinite, (*tip, *slope, *compliance[0], *compliance[1]))):
            self.tip, self.compliance, self.seen = tip, compliance, now
            if slope != (0.0, 0.0):
                self.slope = slope

    def take_force(self, force_x: float, force_y: float, now: float) -> None:
        """Take an estimate of the tip force; NaN in undetermined components."""
        self.force = force_x, force_y
        if math.isfinite(self.resistance):
            self.felt = now

    @property
    def way(self) -> Point:
        """The direction in which the tip moves as the pressure rises."""
        length = math.hypot(*self.slope)
        return (self.slope[0] / length, self.slope[1] / length) if length else (0.0, 0.0)

    @property
    def resistance(self) -> float:
        """The force against this direction (N), NaN if unknown."""
        parts = zip(self.way, self.force, strict=True)
        return -sum(
            part * force for part, force in parts if math.isfinite(force) or abs(part) > SMALL_PART
        )

    def silence(self, now: float) -> float:
        """Return the time (s) since tip and force were both known."""
        return now - min(self.seen, self.felt)

    def valid(self, now: float) -> bool:
        """Whether tip, Jacobian and force are recent enough for control."""
        return self.silence(now) <= self.hold_after and self.slope != (0.0, 0.0)

    def step(self, now: float) -> float:
        """Return the pressure to command (Pa)."""
        elapsed = 0.0 if self.last is None else now - self.last
        self.last = now
        if self.valid(now):
            self.drive(now, elapsed)
        elif self.silence(now) > self.vent_after or self.slope == (0.0, 0.0):
            self.mode = 'waiting' if self.command == 0.0 else 'venting'
            self.command = max(self.command - self.max_rate * elapsed, 0.0)
        else:
            self.mode = 'holding'
        return self.command

    def drive(self, now: float, elapsed: float) -> None:
        """Move towards the target with a limited force; then to the next target."""
        (x, y), (dx, dy), goal = self.tip, self.slope, self.path[self.target]
        # The pressure (Pa) that brings the tip nearest to its target, to first order.
        missing = (dx * (goal[0] - x) + dy * (goal[1] - y)) / (dx * dx + dy * dy)
        # The pressure that brings the force to the requested one, if the tip is blocked.
        onwards = math.copysign(1.0, missing)
        (ux, uy), ((cxx, cxy), (cyx, cyy)) = self.way, self.compliance
        give = ux * (cxx * ux + cxy * uy) + uy * (cyx * ux + cyy * uy)
        spare = (self.press - onwards * self.resistance) * give / math.hypot(dx, dy)
        self.mode = 'pressing' if 2.0 * onwards * self.resistance > self.press else 'driving'
        most = self.max_rate * elapsed
        wanted = onwards * min(abs(missing), spare)
        change = min(max(self.gain * wanted * elapsed, -most), most)
        self.command = min(max(self.command + change, 0.0), self.max_pressure)

        if abs(missing) * math.hypot(dx, dy) > self.tolerance:
            self.arrived = None
        elif self.arrived is None:
            self.arrived = now
        elif now - self.arrived > self.dwell and len(self.reached) < len(self.path):
            self.reached.append(math.dist(self.tip, goal))
            self.target = min(self.target + 1, len(self.path) - 1)
            self.arrived = None


class TipControllerNode(Node):
    """Turns estimates into commands."""

    def __init__(self) -> None:
        super().__init__('tip_controller', namespace='/pneunet')
        default = [0.1038, 0.0363, 0.0896, 0.0572, 0.0697, 0.0728, 0.0896, 0.0572]
        path = self.declare_parameter('path', default).value
        press = self.declare_parameter('press', TipController.press).value
        points = list(zip(path[::2], path[1::2], strict=True))
        self.controller = TipController(path=points, press=press)
        self.mode, self.logged = '', 0
        self.commands = self.create_publisher(FluidPressure, 'pressure_command', 10)
        for kind, topic, take in (
            (PointCloud2, 'fused/state', self.take_state),
            (WrenchStamped, 'fused/end_wrench', self.take_force),
        ):
            self.create_subscription(kind, topic, take, 10)
        # The steady clock detects silence even if simulated time stands still.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / RATE, self.step, clock=clock)

    def take_state(self, message: PointCloud2) -> None:
        # One point. Its Jacobian is 3 x 4, row by row: d(x, y, theta) / d(pressure, F1, F2, M).
        places = {item.name: item.offset for item in message.fields}
        tip = struct.unpack_from('<2f', message.data, places['x'])
        rows = struct.unpack_from('<12d', message.data, places['tip_jacobian'])
        x, y = rows[0:3], rows[4:7]
        compliance = (x[1], x[2]), (y[1], y[2])
        self.controller.take_state(tip, (x[0], y[0]), compliance, time.monotonic())

    def take_force(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        self.controller.take_force(force.x, force.y, time.monotonic())

    def step(self) -> None:
        self.send(self.controller.step(time.monotonic()))
        self.log_changes()

    def send(self, pressure: float) -> None:
        message = FluidPressure(fluid_pressure=pressure)
        message.header.stamp = self.get_clock().now().to_msg()
        self.commands.publish(message)

    def log_changes(self) -> None:
        """Log a new mode, and targets that were reached."""
        controller, log = self.controller, self.get_logger()
        if controller.mode != self.mode:
            self.mode = controller.mode
            sentence = f'{self.mode} at {controller.command / 1000.0:.1f} kPa'
            if self.mode in ('holding', 'venting'):
                log.warning(f'{sentence}: no estimates of the tip and its force')
            else:
                log.info(sentence)
        for left in controller.reached[self.logged :]:
            self.logged += 1
            log.info(
                f'target {self.logged} of {len(controller.path)} reached: the tip is '
                f'{1000.0 * left:.1f} mm away at {controller.command / 1000.0:.1f} kPa'
            )


def main() -> None:
    # ROS must still run after the signal, to vent the arm.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # The handler raises nothing, because an exception within a call of ROS is no clean end.
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    node = TipControllerNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopped:
            executor.spin_once(timeout_sec=0.1)
    finally:
        # A valve holds the last command, so the arm is vented before exiting. If this process is
        # killed, only a watchdog in the valve helps.
        node.send(0.0)
        node.commands.wait_for_all_acked(Duration(seconds=1.0))
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
