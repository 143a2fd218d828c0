"""Health of the estimator: inputs, estimates and refusals, summarized every second."""

from __future__ import annotations

from typing import Any

from pneunet_ros.core.health import age, count_texts, InputHealth, Level, Report, texts
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.estimation.consistency import ConsistencyState, Disagreement, FORCE_NOT_JUDGED
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState

NO_CONSISTENCY = ConsistencyState()


class EstimatorHealth(InputHealth):
    """Collects counts and latencies of readings.

    The level of a report is the worst since the last report: ERROR without estimates, WARN if
    readings were dropped or estimates are limited.
    """

    def __init__(self, pressure_topic: str, now: float) -> None:
        super().__init__(f'pressure on {pressure_topic}', now)
        self._wrench_at: float | None = None
        self._targets_at: float | None = None
        self._estimate: ShapeEstimate | None = None
        self._solve_time: float | None = None
        self._warnings: dict[str, None] = {}
        self._settled: list[bool] = []

    def record_pressure(
        self, outcome: ShapeEstimate | Refusal, now: float, solve_time: float | None
    ) -> None:
        """Record the outcome of a pressure reading and its processing time (s); None: not live."""
        self.take(outcome, now)
        if isinstance(outcome, ShapeEstimate):
            self._estimate = outcome
            self._solve_time = solve_time
            self._warnings.update(dict.fromkeys(outcome.warnings))
            if outcome.motion is not None:
                self._settled.append(outcome.motion.settled)
        elif outcome.error:
            self._estimate = None

    def record_wrench(self, refusal: Refusal | None, now: float) -> None:
        """Record the outcome of a wrench reading."""
        if refusal is None:
            self._wrench_at = now
        else:
            self.note_refusal(refusal)

    def note_comparison(self, now: float) -> None:
        """Record that a frame of targets was compared with an estimate."""
        self._targets_at = now

    def disagreement(
        self, settings: EstimatorSettings, consistency: ConsistencyState, now: float
    ) -> Disagreement | None:
        """Return the disagreement of targets with estimates; None without recent frames."""
        if self._targets_at is None or now - self._targets_at > settings.watch_time:
            return None
        return consistency.disagreement()

    def report(
        self,
        state: EstimatorState,
        settings: EstimatorSettings,
        now: float,
        consistency: ConsistencyState = NO_CONSISTENCY,
        left_out: str = '',
    ) -> Report:
        """Summarize the time since the last report, and start the next period.

        left_out: description of the model error that the standard deviations do not include.
        """
        found = self.disagreement(settings, consistency, now)
        level, message = self._verdict(settings.input_timeout, now, found)
        if self.silence(now) > settings.input_timeout:
            self._estimate = None
        offset = {
            'pressure_offset_pa': f'{settings.pressure_offset:.6g}',
            'std_leaves_out': left_out,
        }
        values = (
            offset | self._values(state, now) | self._consistency_values(consistency, found, now)
        )
        self.begin_next(now)
        self._warnings, self._settled = {}, []
        return Report(level=level, message=message, values=values)

    def _verdict(
        self, input_timeout: float, now: float, found: Disagreement | None
    ) -> tuple[Level, str]:
        errors, dropped = self.problems()
        if self.silence(now) > input_timeout:
            # A rejection since the last report is the likely cause; older errors were reported.
            return Level.ERROR, '; '.join([self.silence_sentence(now), *dropped])
        if errors:
            return Level.ERROR, '; '.join([*errors, *dropped])
        warnings = [*dropped, *self._warnings]
        if found is not None and found.beyond:
            warnings.append(found.sentence)
        if warnings:
            return Level.WARN, '; '.join(warnings)
        if self._estimate is None:
            return Level.OK, f'waiting for {self.source}'
        return Level.OK, f'estimating at {self.rate(now):.3g} Hz'

    def _values(self, state: EstimatorState, now: float) -> dict[str, str]:
        estimate = self._estimate
        values: dict[str, Any] = {
            'rate_hz': self.rate(now),
            'estimates': state.estimates,
            'resets': state.resets,
            'pressure_age_s': self.input_age(now),
            'wrench_age_s': age(self._wrench_at, now),
            'wrench_lag_s': estimate.wrench_age if estimate else None,
            **solve_values(estimate, state.wrench),
            'solve_time_s': self._solve_time if estimate else None,
            'latency_p50_s': self.latency(50.0),
            'latency_p99_s': self.latency(99.0),
            'warnings': '; '.join(estimate.warnings) if estimate else None,
        }
        return texts(values | self._motion_values()) | count_texts('rejected', state.rejected)

    def _motion_values(self) -> dict[str, float | None]:
        motion = self._estimate.motion if self._estimate else None
        modes = motion.modes() if motion else None
        return {
            'settled': sum(self._settled) / len(self._settled) if self._settled else None,
            'frequency_hz': modes.hertz if modes else None,
            'decay_time_s': modes.decay_time if modes else None,
        }

    def _consistency_values(
        self, consistency: ConsistencyState, found: Disagreement | None, now: float
    ) -> dict[str, str]:
        values: dict[str, Any] = {
            'disagreement': found.rms if found else None,
            'disagreement_limit': found.limit if found else None,
            'force_judged': None if found is None else force_judged(found.force_read),
            'worst_target': found.target if found else None,
            'worst_station_m': found.arclength if found else None,
            'targets_age_s': age(self._targets_at, now),
            'targets_matched': consistency.matched,
        }
        return texts(values) | count_texts('targets_unmatched', consistency.unmatched)


def solve_values(estimate: ShapeEstimate | None, wrench: WrenchReading | None) -> dict[str, Any]:
    """Return numbers of an estimate, and the out-of-plane part of the last wrench."""
    position = estimate.position if estimate else None
    gravity = estimate.gravity if estimate else None
    return {
        'residual_rad': estimate.shape.residual if estimate else None,
        'iterations': estimate.shape.iterations if estimate else None,
        'stable': estimate.shape.stable if estimate else None,
        'extrapolated': estimate.shape.extrapolated if estimate else None,
        'pressure_beyond': position.pressure_beyond if position else None,
        'load_beyond': position.load_beyond if position else None,
        'gravity_x_g': gravity[0] if gravity else None,
        'gravity_y_g': gravity[1] if gravity else None,
        'force_z_n': wrench.force_z if wrench else None,
        'moment_x_n_m': wrench.moment_x if wrench else None,
        'moment_y_n_m': wrench.moment_y if wrench else None,
    }


def force_judged(force_read: bool) -> str:
    """State whether a comparison with targets can reveal an error of the force."""
    return 'yes' if force_read else f'no: {FORCE_NOT_JUDGED}'
