"""Jumps of ROS time, from a restarted simulator or a looping bag.

Only messages stamped with the present use this time. Readings use their own stamps and timers the
steady clock, so nothing else changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pneunet_ros.core.health import REPORT_PERIOD
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration


def watch_time(node: Any, say: Callable[[str], None]) -> Any:
    """Report when the node's clock jumps back, or forward by more than a report period.

    Returns an object that must be kept as long as the time is to be watched.
    """
    threshold = JumpThreshold(
        min_forward=Duration(seconds=REPORT_PERIOD),
        min_backward=Duration(nanoseconds=-1),
        on_clock_change=False,
    )
    clock = node.get_clock()

    def report(jump: Any) -> None:
        seconds = 1e-9 * jump.delta.nanoseconds
        say(
            f'/clock jumped by {seconds:+.3f} s to {1e-09 * clock.now().nanoseconds:.3f} s; the '
            'node continues, because readings have their own stamps'
        )

    return clock.create_jump_callback(threshold, post_callback=report)
