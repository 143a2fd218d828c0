"""How a node is doing: what a report of its health is made of."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import enum
from typing import Any

import numpy as np

LATENCIES = 1000  # readings over which percentiles are taken


class Level(enum.IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Level, one line for a person, and numbers by name, of the time since the last report."""

    level: Level
    message: str
    values: Mapping[str, str]


class Latencies:
    """The times (s) from receipt to publishing of the last readings."""

    def __init__(self) -> None:
        self._seconds: deque[float] = deque(maxlen=LATENCIES)

    def note(self, seconds: float) -> None:
        """Note one more."""
        self._seconds.append(seconds)

    def percentile(self, percent: float) -> float | None:
        """Return a percentile; None as long as there is nothing to take it of."""
        if not self._seconds:
            return None
        return float(np.percentile(np.array(self._seconds), percent))


def age(at: float | None, now: float) -> float | None:
    """Return how long ago something was; None if it never was."""
    return None if at is None else now - at


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return values as texts, empty where there is none."""
    return {
        name: '' if value is None else f'{value:.4g}' if isinstance(value, float) else str(value)
        for name, value in values.items()
    }


def counted(what: str, counts: Mapping[str, int]) -> dict[str, str]:
    """Return a count and, below it, its parts by reason."""
    parts = {f'{what}/{reason}': str(count) for reason, count in counts.items()}
    return {what: str(sum(counts.values())), **parts}
