"""Drive the tip of an arm along a path by commanding its pressure: how to use the estimator.

There is one actuator, so of every target the tip goes to the nearest point it can reach.

    python examples/tip_controller.py --ros-args -p path:="[0.1038, 0.0363, 0.0896, 0.0572]"

The path holds x, y, x, y, ... in m in the base frame. Without estimates the command is held at
first, and then the arm is vented.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
import signal
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64MultiArray

RATE = 50.0  # Hz, of commands
Point = tuple[float, float]


@dataclass(kw_only=True)
class TipController:
    """Follows the gradient of the distance to a target; all times are s of one steady clock."""

    path: list[Point]  # m in the base frame
    gain: float = 3.0  # 1/s, part of the way that is made good in a second
    tolerance: float = 0.0015  # m, along the way that the tip can go
    dwell: float = 0.7  # s within the tolerance, after which the next target is next
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
    seen: float = -math.inf
    arrived: float | None = None
    last: float | None = None

    def take_tip(self, x: float, y: float, now: float) -> None:
        """Take an estimate of the tip."""
        if math.isfinite(x) and math.isfinite(y):
            self.tip, self.seen = (x, y), now

    def take_slope(self, dx: float, dy: float) -> None:
        """Take the first column of the Jacobian; in a play gap it is zero: the last one holds."""
        if 0.0 < math.hypot(dx, dy) < math.inf:
            self.slope = dx, dy

    def step(self, now: float) -> float:
        """Return the pressure to command (Pa)."""
        elapsed = 0.0 if self.last is None else now - self.last
        self.last = now
        silence = now - self.seen
        if silence > self.vent_after or self.slope == (0.0, 0.0):
            self.mode = 'waiting' if self.command == 0.0 else 'venting'
            self.command = max(self.command - self.max_rate * elapsed, 0.0)
        elif silence > self.hold_after:
            self.mode = 'holding'
        else:
            self.mode = 'driving'
            self.drive(now, elapsed)
        return self.command

    def drive(self, now: float, elapsed: float) -> None:
        """Go towards the target, and on to the next one when this one is reached."""
        (x, y), (dx, dy), goal = self.tip, self.slope, self.path[self.target]
        # The pressure (Pa) that brings the tip nearest to its target, to first order.
        missing = (dx * (goal[0] - x) + dy * (goal[1] - y)) / (dx * dx + dy * dy)
        most = self.max_rate * elapsed
        change = min(max(self.gain * missing * elapsed, -most), most)
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
    """Estimates in, commands out."""

    def __init__(self) -> None:
        super().__init__('tip_controller', namespace='/pneunet')
        default = [0.1038, 0.0363, 0.0896, 0.0572, 0.0697, 0.0728, 0.0896, 0.0572]
        path = self.declare_parameter('path', default).value
        points = list(zip(path[::2], path[1::2], strict=True))
        self.controller = TipController(path=points)
        self.mode, self.told = '', 0
        self.commands = self.create_publisher(FluidPressure, 'pressure_command', 10)
        self.create_subscription(PoseWithCovarianceStamped, 'tip', self.take_tip, 10)
        self.create_subscription(Float64MultiArray, 'tip_jacobian', self.take_jacobian, 10)
        # Silence is a matter of the steady clock: also where simulated time stands still.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / RATE, self.step, clock=clock)

    def take_tip(self, message: PoseWithCovarianceStamped) -> None:
        place = message.pose.pose.position
        self.controller.take_tip(place.x, place.y, time.monotonic())

    def take_jacobian(self, message: Float64MultiArray) -> None:
        # 3 x 4, row by row: d(x, y, theta) / d(pressure, F1, F2, M).
        self.controller.take_slope(message.data[0], message.data[4])

    def step(self) -> None:
        self.send(self.controller.step(time.monotonic()))
        self.tell()

    def send(self, pressure: float) -> None:
        message = FluidPressure(fluid_pressure=pressure)
        message.header.stamp = self.get_clock().now().to_msg()
        self.commands.publish(message)

    def tell(self) -> None:
        """Say in the log what is new."""
        controller, log = self.controller, self.get_logger()
        if controller.mode != self.mode:
            self.mode = controller.mode
            sentence = f'{self.mode} at {controller.command / 1000.0:.1f} kPa'
            if self.mode in ('holding', 'venting'):
                log.warning(f'{sentence}: no estimate of the tip comes')
            else:
                log.info(sentence)
        for left in controller.reached[self.told :]:
            self.told += 1
            log.info(
                f'target {self.told} of {len(controller.path)} reached: the tip is '
                f'{1000.0 * left:.1f} mm beside it at {controller.command / 1000.0:.1f} kPa'
            )


def main() -> None:
    # ROS must still be there after the signal, to vent the arm.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = TipControllerNode()
    try:
        rclpy.spin(node, SingleThreadedExecutor())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        # A valve holds what it was last told, so the arm is vented before leaving. Against a
        # process that is killed the valve must guard itself.
        node.send(0.0)
        node.commands.wait_for_all_acked(Duration(seconds=1.0))
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
