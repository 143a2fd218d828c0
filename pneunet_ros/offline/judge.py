"""Check the declared unit, sign and frame of pressure and end wrench in a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.sensor_mapping import wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.meaning.pressure_judge import (
    expected_of,
    expected_without_model,
    ExpectedPressure,
    judge_pressure,
    PressureVerdict,
    record_of,
)
from pneunet_ros.measurement.meaning.wrench_judge import (
    expected_load,
    Forces,
    judge_wrench,
    ShownForces,
    WrenchConvention,
    WrenchVerdict,
)
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, Sensor, TARGETS, TIP_POSE
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.starting_arm import has_invented_stiffness
from pneunet_ros.recordings.recorded_gravity import read_gravity, RecordedGravity
from pneunet_ros.recordings.recorded_series import find_series, nearest, read_series, ReadingSeries
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.tables.reading_table import ReadingTable

LOADS = 12  # readings and frames at which loads are compared
FAR_OUTSIDE = 2.0  # largest calibrated loads
FEWEST = 3  # frames that show a force
LEVELS = 8  # pressures at which the model is compared with targets


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetFit:
    """Fit of a model to measured points, for one interpretation of the pressure readings.

    reading (frames,): in the unit of the sensor; load (frames, 3) N, N, N m at the free end;
    points (frames, 2, targets) m, NaN where not seen; places (targets,) m along the arm. gravity
    (frames, 2), in g; None: that of the model.
    """

    arm: Arm
    reading: Array
    load: Array
    points: Array
    places: Array
    gravity: Array | None = None

    def __call__(self, meaning: PressureConvention) -> tuple[float, int]:
        """Return the mean squared error over the squared length, and the number of levels.

        For a level without a shape, the error is set to the length.
        """
        arm = self.arm
        low, high = arm.pressure_range
        loads = [
            arm.sense(Load(pressure=meaning.gauge(reading), force_x=x, force_y=y, moment=moment))
            for reading, (x, y, moment) in zip(self.reading.tolist(), self.load, strict=True)
        ]
        inputs = Inputs(
            pressure=np.clip([load.pressure for load in loads], low, high),
            loads=np.array([[load.force_x, load.force_y, load.moment] for load in loads]),
            histories=None,
            gravity=self.gravity,
        )
        model = ForwardModel(self.places, self.points)
        solved = model.solve(arm, inputs)
        squared_error = np.sum((model.points - self.points) ** 2, axis=1) / arm.length**2
        of_frames = np.nanmean(np.where(solved[:, None], squared_error, 1.0), axis=1)
        return float(np.mean(of_frames)), len(loads)


Verdict = PressureVerdict | WrenchVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """Most likely interpretation of the pressure and the end wrench of a recording."""

    pressure: PressureVerdict | None = None
    wrench: WrenchVerdict | None = None

    @property
    def contradicted(self) -> dict[str, Verdict]:
        """Verdicts by sensor that almost certainly contradict the declaration."""
        found = {PRESSURE.name: self.pressure, END_WRENCH.name: self.wrench}
        return {
            name: item for name, item in found.items() if item is not None and item.contradicted
        }

    @property
    def model_mismatch(self) -> str:
        """Report readings outside the range of this model; empty if there are none."""
        return '' if self.pressure is None else self.pressure.model_mismatch

    @property
    def findings(self) -> str:
        """Describe the likely interpretation of the readings that contradict their declaration."""
        return '; '.join(f'{name} is {item.finding}' for name, item in self.contradicted.items())

    @property
    def options(self) -> str:
        """Return the command-line options for this interpretation of the readings."""
        return ' '.join(item.options for item in self.contradicted.values())

    @property
    def summary(self) -> dict[str, object]:
        """The verdicts for JSON, by sensor."""
        found = {PRESSURE.name: self.pressure, END_WRENCH.name: self.wrench}
        return {
            name: {
                'declared': item.declared.words,
                'likely': (item.other if item.contradicted else item.declared).words,
                'log_odds': item.log_odds,
                'doubted': item.contradicted,
                'settings': item.changes if item.contradicted else {},
            }
            for name, item in found.items()
            if item is not None
        }


NO_VERDICTS = Verdicts()


def judge_recording(
    recording: Recording,
    arm: Arm,
    settings: EstimatorSettings,
    overrides: Mapping[str, str],
    *,
    own_model: bool = True,
) -> Verdicts:
    """Judge the interpretation of the readings of a recording, using targets if there are any.

    own_model: whether a model was given; without one the recording may be of another arm. No
    verdict without readings, if all are zero, or if `judge_readings` is false. Raises
    RecordingError like `find_series`.
    """
    if not settings.judge_readings:
        return NO_VERDICTS
    frame = (
        '' if not settings.wrench_required else undeclared_frame(recording, settings, overrides)
    )
    read_settings = replace(settings, wrench_frame=frame) if frame else settings
    series = readable_series(recording, arm, read_settings, overrides)
    gravity = None
    try:
        gravity = read_gravity(recording, overrides, settings, arm.gravity)
    except RecordingError:  # reported by other checks; without it no shape reveals a load
        series = {name: series[name] for name in series.keys() - {TARGETS.name, TIP_POSE.name}}
    pressure = judge_pressure_series(series, gravity, arm, settings, own_model=own_model)
    trusted = pressure is None or not pressure.contradicted
    wrench = judge_wrench_series(series, gravity, arm, settings, targets_usable=trusted)
    if not frame:
        return Verdicts(pressure=pressure, wrench=wrench)
    declared = settings.wrench
    if wrench is None:
        wrench = WrenchVerdict(
            declared=declared, other=declared, log_odds=-math.inf, largest=0.0, limit=0.0
        )
    likely = wrench.other if wrench.contradicted else declared
    other = replace(likely, frame=frame)
    return Verdicts(pressure=pressure, wrench=replace(wrench, other=other, frame=frame))


def judge_pressure_series(
    series: Mapping[str, ReadingSeries],
    gravity: RecordedGravity | None,
    arm: Arm,
    settings: EstimatorSettings,
    *,
    own_model: bool = True,
) -> PressureVerdict | None:
    """Judge the interpretation of the pressure readings."""
    pressure = series.get(PRESSURE.name)
    if pressure is None or not len(pressure.stamp_ns):
        return None
    declared = settings.pressure
    reading = np.array([declared.reading(value) for value in pressure.values[:, 0].tolist()])
    record = record_of(pressure.stamp_ns.tolist(), reading.tolist())
    fit = target_fit(series, gravity, reading, arm)
    expected = [expected_of(arm)] if own_model else expected_without_model(arm)
    return judge_pressure(record, declared, expected, fit=fit)


def judge_wrench_series(
    series: Mapping[str, ReadingSeries],
    gravity: RecordedGravity | None,
    arm: Arm,
    settings: EstimatorSettings,
    *,
    targets_usable: bool,
) -> WrenchVerdict | None:
    """Judge the interpretation of the wrench readings; targets_usable: they show the force."""
    wrench, pressure = series.get(END_WRENCH.name), series.get(PRESSURE.name)
    if wrench is None or not len(wrench.stamp_ns):
        return None
    declared, forces = settings.wrench, complex_forces(wrench.values)
    largest = int(np.argmax(np.abs(forces)))
    chosen = np.append(np.linspace(0, len(forces) - 1, LOADS).astype(np.int64), largest)
    expected = None
    if pressure is not None and len(pressure.stamp_ns):
        index, _ = nearest(wrench.stamp_ns[chosen], pressure)
        expected = expected_load(arm, pressure.values[index, 0])
    shown = shown_forces(series, gravity, arm, declared) if targets_usable else None
    readings = declared.reading(forces[chosen])
    return judge_wrench(readings, declared, expected, shown)


def complex_forces(load: Array) -> Forces:
    """Return F1 + i F2 (n,) of loads (n, 2 or 3)."""
    return np.asarray(load[:, 0] + 1j * load[:, 1])


def shown_forces(
    series: Mapping[str, ReadingSeries],
    gravity: RecordedGravity | None,
    arm: Arm,
    declared: WrenchConvention,
) -> ShownForces | None:
    """Return the forces estimated from the targets of a few frames.

    None without targets, or if the stiffness, which scales these forces, is a placeholder.
    """
    if has_invented_stiffness(arm):
        return None
    targets, pressure = series.get(TARGETS.name), series.get(PRESSURE.name)
    wrench = series[END_WRENCH.name]
    if targets is None or pressure is None or not len(targets.stamp_ns):
        return None
    if targets.values.shape[2] != arm.target_arclength.size:
        return None
    pressure_index, has_pressure = nearest(targets.stamp_ns, pressure)
    wrench_index, has_wrench = nearest(targets.stamp_ns, wrench)
    usable = np.flatnonzero(
        has_pressure
        & has_wrench
        & np.isfinite(targets.values).any(axis=(1, 2))
        & has_gravity(gravity, targets.stamp_ns)
    )
    if usable.size < FEWEST:
        return None
    order = usable[
        np.argsort(np.abs(complex_forces(wrench.values[wrench_index[usable]])), kind='stable')
    ]
    chosen = np.sort(order[np.unique(np.linspace(0, order.size - 1, LOADS).astype(np.int64))])
    run = RecordingData(
        name='',
        reading_stamp_ns=pressure.stamp_ns,
        pressure=pressure.values[:, 0],
        stamp_ns=targets.stamp_ns[chosen],
        reading=pressure_index[chosen],
        loaded=False,
        force=np.zeros((chosen.size, 2)),
        moment=np.zeros(chosen.size),
        x=targets.values[chosen, 0],
        y=targets.values[chosen, 1],
        gravity=None if gravity is None else gravity.at(targets.stamp_ns[chosen]),
    )
    found = end_forces(arm, run)
    good = np.isfinite(found.force).all(axis=1)
    if np.count_nonzero(good) < FEWEST:
        return None
    return ShownForces(
        force=complex_forces(found.force[good]),
        std=np.sqrt(np.mean(found.sigma[good] ** 2, axis=1)),
        reading=declared.reading(complex_forces(wrench.values[wrench_index[chosen]][good])),
        scale=arm.force_scale,
    )


def has_gravity(gravity: RecordedGravity | None, stamp_ns: Stamps) -> bool | npt.NDArray[np.bool_]:
    """Return a mask of the stamps (ns) at which gravity is known; None: that of the model."""
    return True if gravity is None else gravity.is_known(stamp_ns)


def undeclared_frame(
    recording: Recording, settings: EstimatorSettings, overrides: Mapping[str, str]
) -> str:
    """Return the frame id of the end wrench if it is not a declared one, else ''."""
    topic = find_series(recording, END_WRENCH, overrides, required=False)
    for message in () if topic is None else recording.messages([topic]):
        try:
            reading = END_WRENCH.decode(message.message)
        except MessageError:
            continue
        return reading.frame_id if wrong_frame(settings, reading) else ''
    return ''


def judge_table(
    table: ReadingTable, expected: Sequence[ExpectedPressure]
) -> PressureVerdict | None:
    """Judge the interpretation of the pressures of a table, whose column names their unit."""
    declared = PressureConvention(unit=table.pressure_unit)
    kept = np.isfinite(table.values[PRESSURE.name][:, 0])
    values = table.values[PRESSURE.name][kept, 0] / declared.size
    record = record_of(table.stamp_ns[kept].tolist(), values.tolist())
    return judge_pressure(record, declared, expected)


def judge_table_readings(
    table: ReadingTable, expected: Sequence[ExpectedPressure]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Describe the likely unit of a table's pressures and the remedy, if certain, and if likely.

    Both are empty if the pressures fit. Absolute pressures are not judged here, because only the
    verbs know the atmospheric pressure.
    """
    verdict = None if table.absolute else judge_table(table, expected)
    if verdict is None:
        return (), ()
    if verdict.contradicted:
        return (f'the pressure is {verdict.finding}: {table_remedy(verdict)}',), ()
    if verdict.log_odds <= 0.0:
        return (), ()
    return (), (
        f'the pressure may be {verdict.other.words}, {verdict.range_of(verdict.other)}, and not '
        f'{verdict.declared.words}, {verdict.range_of(verdict.declared)}: if so, '
        f'{table_remedy(verdict)}',
    )


def table_remedy(verdict: PressureVerdict) -> str:
    """Return the options that select the other interpretation of a table's pressures."""
    changes = dict(verdict.changes)
    unit = changes.pop('pressure_unit', None)
    steps = [f'rename its column to pressure_{unit.lower()}'] if unit else []
    if changes:
        options = (f'--{name.replace("_", "-")} {value}' for name, value in changes.items())
        steps.append(f'add {" ".join(options)} to every command that reads the recording')
    return ' and '.join(steps)


def readable_series(
    recording: Recording, arm: Arm, settings: EstimatorSettings, overrides: Mapping[str, str]
) -> dict[str, ReadingSeries]:
    """Read the series for judging the pressure; other checks report unreadable series."""
    series: dict[str, ReadingSeries] = {}
    sensors: tuple[Sensor, ...] = (PRESSURE, END_WRENCH, TARGETS, TIP_POSE)  # type: ignore[type-arg]
    for sensor in sensors:
        topic = find_series(recording, sensor, overrides, required=False)
        if topic is None:
            continue
        targets = arm.target_arclength.size if sensor is TARGETS else None
        try:
            series |= read_series(recording, {sensor.name: topic}, settings, targets)
        except RecordingError:
            if sensor is PRESSURE:
                raise
    return {name: item for name, item in series.items() if len(item.stamp_ns)}


def target_fit(
    series: Mapping[str, ReadingSeries], gravity: RecordedGravity | None, reading: Array, arm: Arm
) -> TargetFit | None:
    """Choose frames at pressures from lowest to highest; None if there are no targets.

    reading (readings,): of the pressure, in the unit of the sensor.
    """
    pressure = series[PRESSURE.name]
    seen = measured_points(series, arm)
    if seen is None:
        return None
    stamp_ns, points, places = seen
    pressure_index, matched = nearest(stamp_ns, pressure)
    load = np.zeros((len(stamp_ns), 3))
    wrench = series.get(END_WRENCH.name)
    if wrench is not None and len(wrench.stamp_ns):
        wrench_index, has_wrench = nearest(stamp_ns, wrench)
        load, matched = wrench.values[wrench_index], matched & has_wrench
        if arm.domain is not None:  # a load far outside the range is judged separately
            most = FAR_OUTSIDE * arm.domain.largest_force
            matched &= np.hypot(load[:, 0], load[:, 1]) <= most
    matched &= has_gravity(gravity, stamp_ns)
    usable = np.flatnonzero(matched & np.isfinite(points.sum(axis=1)).any(axis=1))
    if not usable.size:
        return None
    values = reading[pressure_index[usable]]
    levels = np.linspace(values.min(), values.max(), LEVELS)
    chosen = usable[sorted({int(np.argmin(np.abs(values - level))) for level in levels})]
    return TargetFit(
        arm=arm,
        reading=reading[pressure_index[chosen]],
        load=load[chosen],
        points=points[chosen],
        places=places,
        gravity=None if gravity is None else gravity.at(stamp_ns[chosen]),
    )


def measured_points(
    series: Mapping[str, ReadingSeries], arm: Arm
) -> tuple[Stamps, Array, Array] | None:
    """Return stamps, points (frames, 2, targets) m and their positions (targets,) m on the arm."""
    targets, pose = series.get(TARGETS.name), series.get(TIP_POSE.name)
    count = arm.target_arclength.size
    if targets is not None and len(targets.stamp_ns) and targets.values.shape[2] == count > 0:
        return targets.stamp_ns, targets.values, arm.target_arclength
    is_in_reach = (
        pose is not None and np.nanmax(np.abs(pose.values[:, :2]), initial=0.0) <= arm.reach
    )
    if pose is not None and is_in_reach:
        return pose.stamp_ns, pose.values[:, :2, None], np.array([arm.reach])
    return None
