"""How the estimator is doing: what it took, gave and refused, summed up once a second."""

from __future__ import annotations

from typing import Any

from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.consistency import ConsistencyState, Disagreement
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.nodes.health import age, counted, Latencies, Level, Report, texts

NOTHING_WATCHED = ConsistencyState()


class EstimatorHealth:
    """Collects what happens to readings. All times are seconds of one steady clock.

    The level of a report is the worst since the last one: ERROR while there are no estimates, WARN
    where readings were dropped or estimates are limited.
    """

    def __init__(self, pressure_topic: str, now: float) -> None:
        self._pressure_topic = pressure_topic
        self._started = self._reported = now
        self._pressure_at: float | None = None
        self._wrench_at: float | None = None
        self._targets_at: float | None = None
        self._estimate: ShapeEstimate | None = None
        self._solve_time = 0.0
        self._latencies = Latencies()
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

    def compared_targets(self, now: float) -> None:
        """Note that a frame of targets was compared with an estimate."""
        self._targets_at = now

    def disagreement(
        self, settings: EstimatorSettings, watch: ConsistencyState, now: float
    ) -> Disagreement | None:
        """Return how far targets are from estimates; None where nothing was compared lately."""
        if self._targets_at is None or now - self._targets_at > settings.watch_time:
            return None
        return watch.disagreement()

    def refused(self, refusal: Refusal) -> None:
        """Note a reading that was refused."""
        self._problems[refusal.reason] = refusal

    def published(self, latency: float) -> None:
        """Note the time (s) from the receipt of a reading until its estimate was published."""
        self._latencies.note(latency)

    def silence(self, now: float) -> float:
        """Return for how long (s) there has been no usable pressure reading."""
        return now - (self._started if self._pressure_at is None else self._pressure_at)

    def report(
        self,
        state: EstimatorState,
        settings: EstimatorSettings,
        now: float,
        watch: ConsistencyState = NOTHING_WATCHED,
    ) -> Report:
        """Sum up the time since the last report, and begin the next one."""
        rate = self._estimates / max(now - self._reported, 1e-9)
        found = self.disagreement(settings, watch, now)
        level, message = self._verdict(settings.input_timeout, rate, now, found)
        offset = {'pressure_offset_pa': f'{settings.pressure_offset:.6g}'}
        values = offset | self._values(state, rate, now) | self._watch_values(watch, found, now)
        self._reported, self._estimates = now, 0
        self._problems, self._warnings = {}, {}
        return Report(level=level, message=message, values=values)

    def _verdict(
        self, input_timeout: float, rate: float, now: float, found: Disagreement | None
    ) -> tuple[Level, str]:
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
        warnings = [*dropped, *self._warnings]
        if found is not None and found.beyond:
            warnings.append(found.sentence)
        if warnings:
            return Level.WARN, '; '.join(warnings)
        if self._estimate is None:
            return Level.OK, f'waiting for pressure on {self._pressure_topic}'
        return Level.OK, f'estimating at {rate:.3g} Hz'

    def _values(self, state: EstimatorState, rate: float, now: float) -> dict[str, str]:
        estimate = self._estimate
        values: dict[str, Any] = {
            'rate_hz': rate,
            'estimates': state.estimates,
            'resets': state.resets,
            'pressure_age_s': age(self._pressure_at, now),
            'wrench_age_s': age(self._wrench_at, now),
            'wrench_lag_s': estimate.wrench_age if estimate else None,
            'residual_rad': estimate.shape.residual if estimate else None,
            'iterations': estimate.shape.iterations if estimate else None,
            'stable': estimate.shape.stable if estimate else None,
            'extrapolated': estimate.shape.extrapolated if estimate else None,
            'solve_time_s': self._solve_time if estimate else None,
            'latency_p50_s': self._latencies.percentile(50.0),
            'latency_p99_s': self._latencies.percentile(99.0),
            'warnings': '; '.join(estimate.warnings) if estimate else None,
        }
        return texts(values) | counted('rejected', state.rejected)

    def _watch_values(
        self, watch: ConsistencyState, found: Disagreement | None, now: float
    ) -> dict[str, str]:
        values: dict[str, Any] = {
            'disagreement': found.rms if found else None,
            'disagreement_limit': found.limit if found else None,
            'worst_target': found.target if found else None,
            'worst_station_m': found.arclength if found else None,
            'targets_age_s': age(self._targets_at, now),
            'targets_matched': watch.matched,
        }
        return texts(values) | counted('targets_unmatched', watch.unmatched)
