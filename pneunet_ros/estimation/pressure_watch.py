"""Online check of the declared pressure unit and reference."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.meaning.pressure_judge import (
    expected_of,
    judge_pressure,
    PressureRecord,
    PressureVerdict,
)
from pneunet_ros.model.arm import Arm

OTHER_PRESSURE = 'other_pressure'
FIRST = 10.0  # s of readings before the first verdict: a few breaths
PERIOD = 1.0  # s between verdicts, as of diagnostics


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureWatch:
    """Pressure readings so far, the time of the last check, and its verdict.

    since: the record since a verdict against the readings; it replaces the whole record if it
    shows that the sensor was corrected.
    """

    record: PressureRecord = field(default_factory=PressureRecord)
    judged_ns: int | None = None
    verdict: PressureVerdict | None = None
    since: PressureRecord = field(default_factory=PressureRecord)

    def after(
        self, reading: PressureReading, arm: Arm, settings: EstimatorSettings
    ) -> PressureWatch:
        """Return the watch after one more reading, with a new verdict when due."""
        record = self.record.after(reading.stamp_ns, reading.pressure)
        known = self.verdict is None or self.verdict.declared == settings.pressure
        last = self.judged_ns if known else None
        if not settings.judge_readings or record.seconds < FIRST:
            return PressureWatch(record=record)
        since = self.since
        if self.verdict is not None and self.verdict.contradicted:
            since = since.after(reading.stamp_ns, reading.pressure)
        if last is not None and seconds_between(last, reading.stamp_ns) < PERIOD:
            return replace(self, record=record, since=since)

        def judged(readings: PressureRecord) -> PressureVerdict | None:
            return judge_pressure(readings, settings.pressure, [expected_of(arm)], running=True)

        verdict = judged(record)
        if since.seconds >= FIRST:
            recent = judged(since)
            if recent is not None and recent.confirmed:
                record, verdict = since, recent
            since = PressureRecord()
        return PressureWatch(
            record=record, judged_ns=reading.stamp_ns, verdict=verdict, since=since
        )

    def refusal(self, stamp_ns: int) -> Refusal | None:
        """Return the error if the readings cannot be used, else None."""
        if self.verdict is None or not self.verdict.contradicted:
            return None
        return Refusal(
            stamp_ns=stamp_ns,
            reason=OTHER_PRESSURE,
            sentence=f'the pressure is {self.verdict.finding}: {parameters_remedy(self.verdict)}; '
            'if the readings are right, set judge_readings to false',
            error=True,
        )

    def hint(self, reading: PressureReading, arm: Arm, settings: EstimatorSettings) -> str:
        """Suggest the likely meaning of an impossible reading; empty if none fits.

        The suggestion is based on all readings so far or, if they do not agree, on this one alone.
        """
        alone = PressureRecord().after(reading.stamp_ns, reading.pressure)
        for record in (self.record, alone):
            verdict = judge_pressure(record, settings.pressure, [expected_of(arm)], running=True)
            if verdict is not None and verdict.log_odds > 0.0:
                return f'; {verdict.finding}: {parameters_remedy(verdict)} if so'
        return ''


def parameters_remedy(verdict: PressureVerdict) -> str:
    """Return the node parameters that select the other meaning of the readings."""
    return f'set {verdict.parameters}'
