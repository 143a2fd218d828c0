"""How long work says how far it is."""

from __future__ import annotations

from collections.abc import Callable

# Called with the stage, how much of it is done, and of how much (0: unknown).
OnProgress = Callable[[str, int, int], None]


def say_nothing(stage: str, done: int, total: int) -> None:
    """Keep progress to oneself: where nobody looks."""
