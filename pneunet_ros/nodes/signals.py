"""Shutdown by signals: the first one stops the process, later ones do not disturb the clean-up."""

from __future__ import annotations

from collections.abc import Callable
import signal
import sys
from types import FrameType

from pneunet_ros.core.interrupt import Deferrable, forget_interrupt

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_at_signal() -> None:
    """Let the first signal raise KeyboardInterrupt."""
    _handle(_end)


def ignore_signals() -> None:
    """Ignore signals by a handler: rclpy would restore another one over SIG_IGN."""
    _handle(_ignore)


def refuse_signals() -> None:
    """Ignore all signals during the last moments of the interpreter.

    Python puts the default in the place of every handler of its own when it ends, and a signal
    would kill it there. Only after ROS has shut down, which puts back the handler it found.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    forget_interrupt()


def signal_came() -> bool:
    """Whether a signal has arrived or the shutdown has begun."""
    return signal.getsignal(SIGNALS[0]) == Deferrable(_ignore)


def _handle(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in SIGNALS:
        signal.signal(number, Deferrable(handler))


def _end(number: int, frame: FrameType | None) -> None:
    ignore_signals()
    # A compiler that is cut off in the middle complains from its destructors, to no one's use.
    sys.unraisablehook = _say_nothing
    raise KeyboardInterrupt


def _say_nothing(unraisable: object) -> None:
    pass


def _ignore(number: int, frame: FrameType | None) -> None:
    pass
