"""Jumps of ROS time: a simulator that restarts, a bag in a loop.

Only what a node stamps with the present has this time. Readings are taken by their own stamps and
timers go by the steady clock, so nothing else changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pneunet_ros.core.health import REPORT_PERIOD
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration


def watch_time(node: Any, say: Callable[[str], None]) -> Any:
    """Report when the node's clock jumps back, or forward by more than a report period.

    Returns what must be kept for as long as this is wanted.
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
            f'/clock jumped by {seconds:+.3f} s to {1e-09 * clock.now().nanoseconds:.3f} s; '
            'the node goes on, as readings carry their own stamps'
        )

    return clock.create_jump_callback(threshold, post_callback=report)
