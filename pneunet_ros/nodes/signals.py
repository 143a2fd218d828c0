"""Shutdown by signals: the first stops the process, later ones do not interrupt the cleanup."""

from __future__ import annotations

from collections.abc import Callable
import signal
import sys
from types import FrameType

from pneunet_ros.core.interrupt import clear_interrupt, Deferrable

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_at_signal() -> None:
    """Let the first signal raise KeyboardInterrupt."""
    _handle(_end)


def ignore_signals() -> None:
    """Ignore signals with a handler, because rclpy would replace SIG_IGN by another one."""
    _handle(_ignore)


def refuse_signals() -> None:
    """Ignore all signals during the last moments of the interpreter.

    When Python ends, it restores the default handlers, and a signal would then kill it. Call this
    only after ROS has shut down, because ROS restores the previous handler.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    clear_interrupt()


def signal_came() -> bool:
    """Whether a signal has arrived or the shutdown has begun."""
    return signal.getsignal(SIGNALS[0]) == Deferrable(_ignore)


def _handle(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in SIGNALS:
        signal.signal(number, Deferrable(handler))


def _end(number: int, frame: FrameType | None) -> None:
    ignore_signals()
    # An interrupted compiler prints useless errors from its destructors.
    sys.unraisablehook = _say_nothing
    raise KeyboardInterrupt


def _say_nothing(unraisable: object) -> None:
    pass


def _ignore(number: int, frame: FrameType | None) -> None:
    pass
