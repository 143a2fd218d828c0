"""A soft wall for the virtual arm: it pushes the tip back, as foam would.

    python examples/soft_wall.py --ros-args -p place:="[0.0896, 0.0572]" -p normal:=-0.82

The wall goes through `place` (m). Behind it the tip is pushed along the normal, at the angle
`normal` (rad), by `stiffness` (N/m) times the depth, without friction. The force follows the depth
with a delay, because the virtual arm needs a load to compute a tip, and slowly, because an arm
without mass and with a compliance of meters per newton would oscillate.
"""

from __future__ import annotations

import math
import signal

from geometry_msgs.msg import PoseStamped, WrenchStamped
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

RATE = 100.0  # Hz, of loads
FOLLOWS = 0.02  # share of the remaining change of force per step


class SoftWall(Node):
    """Turns the true tip into a load on it."""

    def __init__(self) -> None:
        super().__init__('soft_wall', namespace='/pneunet')
        self.place = self.declare_parameter('place', [0.0896, 0.0572]).value
        angle = self.declare_parameter('normal', -0.82).value
        self.normal = math.cos(angle), math.sin(angle)
        self.stiffness = self.declare_parameter('stiffness', 2.0).value
        self.depth = self.force = 0.0
        self.loads = self.create_publisher(WrenchStamped, 'force_command', 10)
        self.create_subscription(PoseStamped, 'true_tip', self.take_tip, 10)
        self.create_timer(1.0 / RATE, self.follow)

    def take_tip(self, message: PoseStamped) -> None:
        tip = message.pose.position
        (x, y), (along_x, along_y) = self.place, self.normal
        self.depth = max(0.0, (x - tip.x) * along_x + (y - tip.y) * along_y)

    def follow(self) -> None:
        """Move the force towards the one at this depth."""
        self.push(self.force + FOLLOWS * (self.stiffness * self.depth - self.force))

    def push(self, force: float) -> None:
        """Apply a load to the tip; a negligible one counts as none."""
        self.force = force if force > 1e-6 else 0.0
        message = WrenchStamped()
        message.header.frame_id = 'pneunet_base'
        message.wrench.force.x = self.force * self.normal[0]
        message.wrench.force.y = self.force * self.normal[1]
        self.loads.publish(message)


def main() -> None:
    # ROS must still run after the signal, to remove the load.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # The handler raises nothing, because an exception within a call of ROS is no clean end.
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    node = SoftWall()
    node.get_logger().info('the soft wall is ready')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopped:
            executor.spin_once(timeout_sec=0.1)
    finally:
        node.push(0.0)
        node.loads.wait_for_all_acked(Duration(seconds=1.0))
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
