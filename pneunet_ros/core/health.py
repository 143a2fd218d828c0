"""Health of a node: outcomes of its input, and the content of a report."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import enum
from typing import Any

import numpy as np
from pneunet_ros.core.outcome import Refusal

REPORT_PERIOD = 1.0  # s, between two reports
LATENCIES = 1000  # readings per percentile


class Level(enum.IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Level, one line of text, and numbers by name, for the time since the last report."""

    level: Level
    message: str
    values: Mapping[str, str]


def hardware_id(namespace: str, node: str) -> str:
    """Return the hardware of a status: the namespace of its node, or the node if it has none."""
    return namespace.strip('/') or node


class InputHealth:
    """Collects the outcomes of the essential input of a node: readings or images.

    All times are in seconds of one steady clock. A fault that stopped the results appears in every
    report until there is a result, other faults only in the next report.
    """

    def __init__(self, source: str, now: float) -> None:
        """Initialize; source: input of the node, e.g. 'pressure on /pneunet/pressure'."""
        self.source = source
        self._begun = self._reported = now
        self._input_at: float | None = None
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._stopped: Refusal | None = None
        self._problems: dict[str, Refusal] = {}
        self._results = 0

    def take(self, outcome: object, now: float) -> None:
        """Record a result, or the reason for a missing result."""
        if isinstance(outcome, Refusal):
            self.note_refusal(outcome)
            if not outcome.error:
                return
        else:
            self._results += 1
        self._stopped = outcome if isinstance(outcome, Refusal) else None
        self._input_at = now

    def note_refusal(self, refusal: Refusal) -> None:
        """Record a rejected message."""
        self._problems[refusal.reason] = refusal

    def published(self, latency: float) -> None:
        """Record the time (s) from receiving the input to publishing its result."""
        self._latencies.append(latency)

    def silence(self, now: float) -> float:
        """Return the time (s) without usable input."""
        return now - (self._begun if self._input_at is None else self._input_at)

    def silence_sentence(self, now: float) -> str:
        """Describe the time without usable input."""
        return f'no usable {self.source} for {self.silence(now):.1f} s'

    def input_age(self, now: float) -> float | None:
        """Return the age (s) of the last usable input; None before the first."""
        return age(self._input_at, now)

    def rate(self, now: float) -> float:
        """Return the results per second (Hz) since the last report."""
        seconds = now - self._reported
        return self._results / seconds if seconds > 0.0 else 0.0

    def problems(self) -> tuple[list[str], list[str]]:
        """Describe errors and dropped messages since the last report."""
        problems = self._problems
        if self._stopped is not None:
            problems = {self._stopped.reason: self._stopped, **problems}
        errors = [problem.sentence for problem in problems.values() if problem.error]
        return errors, [problem.sentence for problem in problems.values() if not problem.error]

    def latency(self, percent: float) -> float | None:
        """Return a percentile of recent latencies (s); None if nothing was published."""
        return float(np.percentile(self._latencies, percent)) if self._latencies else None

    def begin_next(self, now: float) -> None:
        """Start the next report period."""
        self._reported, self._results, self._problems = now, 0, {}


def age(at: float | None, now: float) -> float | None:
    """Return the age of an event; None if it never happened."""
    return None if at is None else now - at


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return values as text; empty for None."""
    return {
        name: '' if value is None else f'{value:.4g}' if isinstance(value, float) else str(value)
        for name, value in values.items()
    }


def count_texts(what: str, counts: Mapping[str, int]) -> dict[str, str]:
    """Return a count and, below it, its parts by reason."""
    parts = {f'{what}/{reason}': str(count) for reason, count in counts.items()}
    return {what: str(sum(counts.values())), **parts}
