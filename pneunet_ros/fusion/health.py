"""Health of the fusion: inputs, estimates and refusals, summarized once a second."""

from __future__ import annotations

import math
from typing import Any

from pneunet_ros.core.health import age, count_texts, InputHealth, Level, Report, texts
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.health import force_judged, solve_values
from pneunet_ros.fusion.contact import Contact
from pneunet_ros.fusion.estimate import FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState, RunningNis

NO_LONGER_READ = (
    'end_wrench: no recent reading, so the force is estimated without it. Check the force sensor, '
    'its cable and the clock of its stamps'
)
AMBIGUOUS = 'no force is published, because two different loads explain the targets'


class FusionHealth(InputHealth):
    """Collects the outcomes of readings and frames.

    The level of a report is the worst since the last one: ERROR while there are no estimates, WARN
    if readings were dropped or estimates are limited.
    """

    def __init__(self, pressure_topic: str, targets_topic: str, now: float) -> None:
        super().__init__(f'pressure on {pressure_topic} or targets on {targets_topic}', now)
        self._at: dict[str, float] = {}
        self._estimate: FusedEstimate | None = None
        self._solve_time: float | None = None
        self._nis: RunningNis | None = None
        self._warnings: dict[str, None] = {}
        self._force_was_read = False

    def record(self, sensor: str, outcome: object, now: float, solve_time: float | None) -> None:
        """Record the outcome of a sensor's message, and its processing time (s).

        solve_time: None in a replay.
        """
        stopped = isinstance(outcome, Refusal) and outcome.error
        if not isinstance(outcome, Refusal) or (stopped and sensor == 'pressure'):
            self._at[sensor] = now  # a pressure is usable even if another input stops estimates
        if stopped:
            self._estimate = None
        if isinstance(outcome, (FusedEstimate, Refusal)):
            self.take(outcome, now)
        if isinstance(outcome, FusedEstimate):
            self._estimate, self._solve_time = outcome, solve_time
            self._force_was_read |= outcome.estimate.wrench_age is not None
            self._warnings.update(dict.fromkeys(warnings_of(outcome)))

    def report(
        self, state: FusionState, fusion: Fusion, now: float, *, left_out: str = ''
    ) -> Report:
        """Summarize the time since the last report, and begin the next one.

        left_out: description of the model error that its standard deviations omit.
        """
        silent = self.silent(fusion, now)
        nis = state.nis if state.nis is not self._nis else None
        level, message = self._verdict(nis, now, silent=silent)
        values = self._values(state, now, silent=silent)
        values |= {
            'pressure_offset_pa': f'{fusion.sensors.pressure_offset:.6g}',
            'std_leaves_out': left_out,
            'other_sensors': '; '.join(fusion.other_sensors(state).values()),
        }
        self.begin_next(now)
        self._warnings, self._nis = {}, state.nis
        return Report(level=level, message=message, values=values)

    def silent(self, fusion: Fusion, now: float) -> bool:
        """Whether no usable input has arrived for longer than the timeout."""
        timeout = max(fusion.sensors.input_timeout, fusion.settings.target_timeout)
        return self.silence(now) > timeout

    def _verdict(self, nis: RunningNis | None, now: float, *, silent: bool) -> tuple[Level, str]:
        errors, dropped = self.problems()
        beyond = [nis.sentence] if nis is not None and nis.beyond else []
        if silent:
            # A refusal since the last report is the likely cause; older errors were reported.
            return Level.ERROR, '; '.join([self.silence_sentence(now), *dropped])
        if errors:
            return Level.ERROR, '; '.join([*errors, *dropped, *beyond])
        warnings = [*dropped, *self._warnings, *beyond]
        if self._lacks_force():
            warnings.append(NO_LONGER_READ)
        if warnings:
            return Level.WARN, '; '.join(warnings)
        if self._estimate is None:
            return Level.OK, f'waiting for {self.source}'
        return Level.OK, f'estimating at {self.rate(now):.3g} Hz: {self._estimate.mode.sentence}'

    def _lacks_force(self) -> bool:
        """Whether a force sensor was read, and the last estimate had to do without."""
        last = self._estimate
        if last is None or not self._force_was_read or last.force_sensor is not None:
            return False
        return last.estimate.wrench_age is None

    def _values(self, state: FusionState, now: float, *, silent: bool) -> dict[str, str]:
        """Return numbers by name, those of an estimate only while there are estimates."""
        last, nis = None if silent else self._estimate, state.nis
        wrench_age = None if last is None else last.estimate.wrench_age
        sensor = None if last is None else last.force_sensor
        values: dict[str, Any] = {
            'mode': 'none' if last is None else last.mode.name.lower(),
            'rate_hz': self.rate(now),
            'estimates': state.counts.estimates,
            'resets': state.readings.resets,
            'frames': state.counts.frames,
            'nis': None if nis is None else nis.last,
            'nis_mean': None if nis is None else nis.mean,
            'nis_limit': None if nis is None else nis.limit,
            'pressure_age_s': age(self._at.get('pressure'), now),
            'targets_age_s': age(self._at.get('targets'), now),
            'wrench_age_s': age(self._at.get('end_wrench'), now),
            'target_lag_s': None if last is None else last.target_age,
            'wrench_lag_s': wrench_age,
            'force_judged': None if last is None else force_judged(wrench_age is not None),
            'ambiguous': None if last is None else last.ambiguous,
            'determined': None if last is None else determined_words(last),
            'contact': None if last is None else contact_words(last.contact),
            'pressure_bias_pa': None if last is None else last.pressure_bias,
            'pressure_bias_std_pa': None if last is None else last.pressure_bias_std,
            'force_sensor': None if sensor is None else sensor.words,
            'frame_delay_s': state.frame_delay,
            **solve_values(None if last is None else last.estimate, state.readings.wrench),
            'solve_time_s': self._solve_time,
            'latency_p50_s': self.latency(50.0),
            'latency_p99_s': self.latency(99.0),
            'warnings': '; '.join(warnings_of(last)) if last else None,
        }
        return (
            texts(values)
            | count_texts('rejected', state.readings.rejected)
            | count_texts('frames_unused', state.counts.unused)
        )


def warnings_of(outcome: FusedEstimate) -> list[str]:
    """Return sentences that say how an estimate is limited."""
    limited = (
        []
        if outcome.mode is Mode.FUSED
        else [f'{outcome.mode.name.lower()}: {outcome.mode.sentence}']
    )
    if outcome.ambiguous:
        limited.append(AMBIGUOUS)
    return [*limited, *outcome.estimate.warnings]


def determined_words(outcome: FusedEstimate) -> str:
    """Say which components of the tip force are determined."""
    known = [
        name
        for name, value in zip(('F1', 'F2'), outcome.force.tolist(), strict=True)
        if not math.isnan(value)
    ]
    return ', '.join(known) or 'none'


def contact_words(contact: Contact | None) -> str:
    """Return the estimated contact in words."""
    if contact is None:
        return 'none'
    if contact.ambiguous:
        return 'ambiguous'
    return f'{contact.force:.3g} N at {contact.arclength:.3g} m'
