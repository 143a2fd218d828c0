"""Whether the readings of a recording are of the unit, reference and sign that are declared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.pressure_convention import PressureConvention
from pneunet_ros.measurement.pressure_judge import (
    expected_of,
    ExpectedPressure,
    judge_pressure,
    PressureVerdict,
    record_of,
)
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, Sensor, TARGETS, TIP_POSE
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.batch import solve_many
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.recordings.recorded_series import find_series, nearest, read_series, ReadingSeries
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.tables.reading_table import ReadingTable

LEVELS = 8  # pressures at which the model is compared with targets


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetFit:
    """How well a model reproduces measured points by a meaning of the pressure readings.

    reading (frames,): in the unit of the sensor; load (frames, 3) N, N, N m on the free end;
    points (frames, 2, targets) m, NaN where not seen; places (targets,) m along the arm.
    """

    arm: Arm
    reading: Array
    load: Array
    points: Array
    places: Array

    def __call__(self, meaning: PressureConvention) -> tuple[float, int]:
        """Return the mean squared error over the length squared, and the number of levels."""
        arm = self.arm
        low, high = arm.pressure_range
        loads = [
            arm.sense(Load(pressure=meaning.gauge(reading), force_x=x, force_y=y, moment=moment))
            for reading, (x, y, moment) in zip(self.reading.tolist(), self.load, strict=True)
        ]
        shapes = solve_many(
            arm,
            np.clip([load.pressure for load in loads], low, high),
            [(load.force_x, load.force_y) for load in loads],
            [load.moment for load in loads],
            start=solve(arm, 0.5 * (low + high)),
        )
        squares = []
        for x, y, seen, solved in zip(
            shapes.x, shapes.y, self.points, shapes.converged, strict=True
        ):
            found = arm.see(*(np.interp(self.places, shapes.arclength, part) for part in (x, y)))
            off = np.sum((np.array(found) - seen) ** 2, axis=0) / arm.length**2
            squares.append(float(np.nanmean(off)) if solved else 1.0)
        return float(np.mean(squares)), len(squares)


def judge_recording(
    recording: Recording,
    arm: Arm,
    settings: EstimatorSettings,
    overrides: Mapping[str, str],
) -> PressureVerdict | None:
    """Weigh what the pressure readings of a recording may mean, by targets where there are any.

    None where there is no pressure in it, where it is the same zero throughout, or where
    `judge_readings` is false. Raises RecordingError as `find_series` does.
    """
    if not settings.judge_readings:
        return None
    series = readable_series(recording, arm, settings, overrides)
    return judge_series(series, arm, settings)


def judge_series(
    series: Mapping[str, ReadingSeries], arm: Arm, settings: EstimatorSettings
) -> PressureVerdict | None:
    """Do what `judge_recording` does, with the series of the recording."""
    pressure = series.get(PRESSURE.name)
    if pressure is None or not len(pressure.stamp_ns):
        return None
    declared = settings.pressure
    reading = np.array([declared.reading(value) for value in pressure.values[:, 0].tolist()])
    record = record_of(pressure.stamp_ns.tolist(), reading.tolist())
    fit = target_fit(series, reading, arm)
    return judge_pressure(record, declared, [expected_of(arm)], fit=fit)


def judge_table(
    table: ReadingTable, expected: Sequence[ExpectedPressure]
) -> PressureVerdict | None:
    """Weigh what the pressures of a table may mean; its column names their unit."""
    declared = PressureConvention(unit=table.pressure_unit)
    kept = np.isfinite(table.values[PRESSURE.name][:, 0])
    values = table.values[PRESSURE.name][kept, 0] / declared.size
    record = record_of(table.stamp_ns[kept].tolist(), values.tolist())
    return judge_pressure(record, declared, expected)


def table_doubts(table: ReadingTable, expected: Sequence[ExpectedPressure]) -> tuple[str, ...]:
    """Say what the pressures of a table most likely are, and what to do; empty where they fit."""
    verdict = judge_table(table, expected)
    if verdict is None or not verdict.doubted:
        return ()
    changes = dict(verdict.changes)
    unit = changes.pop('pressure_unit', None)
    do = [f'rename its column to pressure_{unit.lower()}'] if unit else []
    if changes:
        options = (f'--{name.replace("_", "-")} {value}' for name, value in changes.items())
        do.append(f'give {" ".join(options)} to every verb that reads the recording')
    return (f'the pressure is {verdict.finding}: {" and ".join(do)}',)


def readable_series(
    recording: Recording, arm: Arm, settings: EstimatorSettings, overrides: Mapping[str, str]
) -> dict[str, ReadingSeries]:
    """Read what judges the pressure; what cannot be read is somebody else's to report."""
    series: dict[str, ReadingSeries] = {}
    wanted: tuple[Sensor, ...] = (PRESSURE, END_WRENCH, TARGETS, TIP_POSE)  # type: ignore[type-arg]
    for sensor in wanted:
        topic = find_series(recording, sensor, overrides, required=False)
        if topic is None:
            continue
        targets = arm.target_arclength.size if sensor is TARGETS else None
        try:
            series |= read_series(recording, {sensor.name: topic}, settings, targets)
        except RecordingError:
            if sensor is PRESSURE:
                raise
    return series


def target_fit(series: Mapping[str, ReadingSeries], reading: Array, arm: Arm) -> TargetFit | None:
    """Choose frames at a few pressures from lowest to highest; None where there are no targets.

    reading (readings,): of the pressure, in the unit of the sensor.
    """
    pressure = series[PRESSURE.name]
    seen = measured_points(series, arm)
    if seen is None:
        return None
    stamp_ns, points, places = seen
    at, matched = nearest(stamp_ns, pressure)
    load = np.zeros((len(stamp_ns), 3))
    wrench = series.get(END_WRENCH.name)
    if wrench is not None and len(wrench.stamp_ns):
        found, near = nearest(stamp_ns, wrench)
        load, matched = wrench.values[found], matched & near
    usable = np.flatnonzero(matched & np.isfinite(points).any(axis=(1, 2)))
    if not usable.size:
        return None
    values = reading[at[usable]]
    levels = np.linspace(values.min(), values.max(), LEVELS)
    chosen = usable[sorted({int(np.argmin(np.abs(values - level))) for level in levels})]
    return TargetFit(
        arm=arm,
        reading=reading[at[chosen]],
        load=load[chosen],
        points=points[chosen],
        places=places,
    )


def measured_points(
    series: Mapping[str, ReadingSeries], arm: Arm
) -> tuple[Stamps, Array, Array] | None:
    """Return stamps, points (frames, 2, targets) m and their places (targets,) m on the arm."""
    targets, pose = series.get(TARGETS.name), series.get(TIP_POSE.name)
    count = arm.target_arclength.size
    if targets is not None and len(targets.stamp_ns) and targets.values.shape[2] == count > 0:
        return targets.stamp_ns, targets.values, arm.target_arclength
    if pose is not None and len(pose.stamp_ns):
        return pose.stamp_ns, pose.values[:, :2, None], np.array([arm.reach])
    return None


def verdict_summary(verdict: PressureVerdict | None) -> dict[str, object] | None:
    """Return a verdict as JSON carries it: likely, log_odds, doubted, and the settings to use."""
    if verdict is None:
        return None
    return {
        'declared': verdict.declared.words,
        'likely': verdict.other.words if verdict.doubted else verdict.declared.words,
        'log_odds': verdict.log_odds,
        'doubted': verdict.doubted,
        'settings': verdict.changes if verdict.doubted else {},
    }
