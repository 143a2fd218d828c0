"""How the estimator is doing: what it took, gave and refused, summed up once a second."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import enum
from typing import Any

import numpy as np
from pneunet_ros.estimator_state import EstimatorState
from pneunet_ros.shape import Refusal, ShapeEstimate

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


class Health:
    """Collects what happens to readings. All times are seconds of one steady clock.

    The level of a report is the worst since the last one: ERROR while there are no estimates, WARN
    where readings were dropped or estimates are limited.
    """

    def __init__(self, pressure_topic: str, now: float) -> None:
        self._pressure_topic = pressure_topic
        self._started = self._reported = now
        self._pressure_at: float | None = None
        self._wrench_at: float | None = None
        self._estimate: ShapeEstimate | None = None
        self._solve_time = 0.0
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._estimates = 0
        self._stopped: Refusal | None = None
        self._problems: dict[str, Refusal] = {}
        self._warnings: dict[str, None] = {}

    def took_pressure(
        self, outcome: ShapeEstimate | Refusal, now: float, solve_time: float
    ) -> None:
        """Note what became of a pressure reading, and how long that took (s)."""
        if isinstance(outcome, Refusal):
            self.refused(outcome)
            if not outcome.error:
                return
            self._stopped = outcome
        else:
            self._stopped = None
            self._estimate = outcome
            self._estimates += 1
            self._solve_time = solve_time
            self._warnings.update(dict.fromkeys(outcome.warnings))
        self._pressure_at = now

    def took_wrench(self, refusal: Refusal | None, now: float) -> None:
        """Note what became of a wrench reading."""
        if refusal is None:
            self._wrench_at = now
        else:
            self.refused(refusal)

    def refused(self, refusal: Refusal) -> None:
        """Note a reading that was refused."""
        self._problems[refusal.reason] = refusal

    def published(self, latency: float) -> None:
        """Note the time (s) from the receipt of a reading until its estimate was published."""
        self._latencies.append(latency)

    def silence(self, now: float) -> float:
        """Return for how long (s) there has been no usable pressure reading."""
        return now - (self._started if self._pressure_at is None else self._pressure_at)

    def report(self, state: EstimatorState, input_timeout: float, now: float) -> Report:
        """Sum up the time since the last report, and begin the next one."""
        rate = self._estimates / max(now - self._reported, 1e-9)
        level, message = self._verdict(input_timeout, rate, now)
        values = self._values(state, rate, now)
        self._reported, self._estimates = now, 0
        self._problems, self._warnings = {}, {}
        return Report(level=level, message=message, values=values)

    def _verdict(self, input_timeout: float, rate: float, now: float) -> tuple[Level, str]:
        problems = self._problems
        if self._stopped is not None:
            problems = {self._stopped.reason: self._stopped, **problems}
        errors = [problem.sentence for problem in problems.values() if problem.error]
        dropped = [problem.sentence for problem in problems.values() if not problem.error]
        silence = self.silence(now)
        if silence > input_timeout:
            # What was refused in the meantime is the likely cause; older errors are no news.
            sentence = f'no usable pressure on {self._pressure_topic} for {silence:.1f} s'
            return Level.ERROR, '; '.join([sentence, *dropped])
        if errors:
            return Level.ERROR, '; '.join(errors)
        if dropped or self._warnings:
            return Level.WARN, '; '.join([*dropped, *self._warnings])
        if self._estimate is None:
            return Level.OK, f'waiting for pressure on {self._pressure_topic}'
        return Level.OK, f'estimating at {rate:.3g} Hz'

    def _values(self, state: EstimatorState, rate: float, now: float) -> dict[str, str]:
        estimate = self._estimate
        values: dict[str, Any] = {
            'rate_hz': rate,
            'estimates': state.estimates,
            'resets': state.resets,
            'pressure_age_s': _age(self._pressure_at, now),
            'wrench_age_s': _age(self._wrench_at, now),
            'wrench_lag_s': estimate.wrench_age if estimate else None,
            'residual_rad': estimate.shape.residual if estimate else None,
            'iterations': estimate.shape.iterations if estimate else None,
            'stable': estimate.shape.stable if estimate else None,
            'extrapolated': estimate.shape.extrapolated if estimate else None,
            'solve_time_s': self._solve_time if estimate else None,
            'latency_p50_s': self._latency(50.0),
            'latency_p99_s': self._latency(99.0),
            'warnings': '; '.join(estimate.warnings) if estimate else None,
            'rejected': sum(state.rejected.values()),
        }
        values |= {f'rejected/{reason}': count for reason, count in state.rejected.items()}
        return {name: _text(value) for name, value in values.items()}

    def _latency(self, percent: float) -> float | None:
        if not self._latencies:
            return None
        return float(np.percentile(np.array(self._latencies), percent))


def _age(at: float | None, now: float) -> float | None:
    return None if at is None else now - at


def _text(value: Any) -> str:
    """Text of a value; empty where there is none."""
    if value is None:
        return ''
    return f'{value:.4g}' if isinstance(value, float) else str(value)
