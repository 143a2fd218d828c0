"""A recording for calibration and diagnosis: readings, and frames with their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import match_stamps, Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.model.uncertainty import SensorNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureJumpSettings:
    """Criteria for a pressure step between two readings, at an unknown time."""

    neighbors: float = tuning(
        3.0, 'smallest ratio of a jump to the adjacent changes', source='invented'
    )


SIGMA_OF_MEDIAN = 1.4826  # of a normal distribution, over its median absolute deviation
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
IDLE_REACH = 4.0  # sigma: largest reading of a force sensor without a load
CHANCE = 0.01  # probability that noise alone exceeds a limit in a long recording
SAME_INSTANT = 0.1  # of a period, largest time from a reading to a frame triggered with it
TRIGGERED = 0.95  # share of the frames that must be this close
JUMP_NOISE = 8.0  # sigma: a jump that noise does not explain
JUMP_SPAN = 0.01  # of the span of the readings: least jump that matters
CERTAIN = 0.1  # of a change, largest time from a reading to a frame that shows its value
PRESSURE_JUMP = PressureJumpSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingData:
    """One recording: readings, and the targets seen.

    `reading_stamp_ns` (readings,) and `pressure` (readings,) Pa are all pressure readings, stamps
    increasing; `stamp_ns` (frames,) are the frames in which targets were seen and `reading`
    (frames,) the pressure reading that belongs to each. force (frames, 2) N and moment (frames,) N
    m are the end load at the frames in the base frame, as read; `loaded` is False if nothing was
    attached; the load is then exactly zero. x, y (frames, targets) m in the base frame, NaN where
    a target was not seen. tip_pose (frames, 3): x, y m and heading rad of the tip, NaN where not
    measured; None: never (see `measurement.tip_pose`); in the frame tip_frame. base_turn_std: one
    sigma (rad) of the direction of the base frame of the targets. static: frames are steady states
    in any order, without meaningful stamps. pressurized: False if no pressure was recorded; it is
    then zero. load_known: the load is a known constant, not measured by a sensor. wrench_stamp_ns
    (wrenches,) and wrench (wrenches, 3) N, N m are all readings of the end load; None if only
    those at the frames are known. gravity (frames, 2): along x and y in the base frame, in g;
    None: as in the model; gravity_stamp_ns (n,) and gravity_read (n, 2): all its readings. Raises
    RecordingError if these do not fit together.
    """

    name: str
    reading_stamp_ns: Stamps
    pressure: Array
    stamp_ns: Stamps
    reading: Stamps
    loaded: bool
    force: Array
    moment: Array
    x: Array
    y: Array
    tip_pose: Array | None = None
    tip_frame: str = BASE_FRAME
    base_turn_std: float = 0.0
    static: bool = False
    pressurized: bool = True
    load_known: bool = False
    wrench_stamp_ns: Stamps | None = None
    wrench: Array | None = None
    gravity: Array | None = None
    gravity_stamp_ns: Stamps | None = None
    gravity_read: Array | None = None

    def __post_init__(self) -> None:
        """Check the shapes and the order of the stamps."""
        readings, frames = len(self.reading_stamp_ns), len(self.stamp_ns)
        if readings == 0 or frames == 0:
            raise RecordingError(
                f'{self.name}: no frame with targets and a pressure reading', reason='no_frames'
            )
        for name in ('reading_stamp_ns', 'stamp_ns', 'reading'):
            values = np.array(getattr(self, name), dtype=np.int64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        targets = np.asarray(self.x).shape[1]
        shapes = {
            'pressure': (readings,),
            'force': (frames, 2),
            'moment': (frames,),
            'x': (frames, targets),
            'y': (frames, targets),
        }
        if self.tip_pose is not None:
            shapes['tip_pose'] = (frames, 3)
        if self.gravity is not None:
            shapes['gravity'] = (frames, 2)
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape))
        for name in ('reading_stamp_ns', 'stamp_ns'):
            if not np.all(np.diff(getattr(self, name)) > 0):
                raise RecordingError(
                    f'{self.name}: {name} must be increasing', reason='not_increasing'
                )
        if not (np.all(self.reading >= 0) and np.all(self.reading < readings)):
            raise RecordingError(
                f'{self.name}: a frame belongs to a reading that does not exist',
                reason='wrong_order',
            )

    def without_load(self) -> RecordingData:
        """Return the run as unloaded; its force readings are treated as sensor errors."""
        if not self.loaded:
            return self
        frames = len(self.stamp_ns)
        return replace(
            self,
            loaded=False,
            load_known=False,
            force=np.zeros((frames, 2)),
            moment=np.zeros(frames),
            wrench_stamp_ns=None,
            wrench=None,
        )

    def with_end_load(self, force_x: float, force_y: float) -> RecordingData:
        """Return the run under a known constant end load (N, base frame), without a sensor."""
        frames = len(self.stamp_ns)
        force = np.tile([force_x, force_y], (frames, 1))
        return replace(
            self,
            loaded=True,
            load_known=True,
            force=force,
            moment=np.zeros(frames),
            wrench_stamp_ns=None,
            wrench=None,
        )

    def is_idle(self, noise: SensorNoise) -> bool:
        """Whether every wrench is within the sensor noise, so that no load was attached."""
        reach = self.idle_reach()
        return not self.load_known and bool(
            np.all(np.abs(self.force) <= reach * noise.force_std)
            and np.all(np.abs(self.moment) <= reach * noise.moment_std)
        )

    def idle_reach(self) -> float:
        """Return the largest noise (sigma) expected of an idle sensor in a run of this length."""
        values = 3 * len(self.stamp_ns)
        return max(IDLE_REACH, -NormalDist().inv_cdf(0.5 * CHANCE / values))

    def thin(self, most: int) -> RecordingData:
        """Return the run with at most this many evenly spaced frames."""
        frames = len(self.stamp_ns)
        if frames <= most:
            return self
        return self.subset(np.unique(np.linspace(0, frames - 1, most).astype(np.int64)))

    def subset(self, kept: npt.NDArray[np.int64]) -> RecordingData:
        """Return the run with only these frames, in increasing order."""
        cut = {
            name: getattr(self, name)[kept]
            for name in ('stamp_ns', 'reading', 'force', 'moment', 'x', 'y')
        }
        for name in ('tip_pose', 'gravity'):
            if getattr(self, name) is not None:
                cut[name] = getattr(self, name)[kept]
        return replace(self, **cut)

    def at_instants(self, delay: float) -> RecordingData:
        """Return the run with readings taken `delay` (s) before the stamp of each frame.

        Pressure and load are interpolated linearly; static frames have no time. The load of a
        frame is its own reading, with the noise of that reading, plus the change of the
        interpolated `wrench`.
        """
        if self.static:
            return self
        delay_ns = round(delay * NANOSECONDS_PER_SECOND)
        shown = self.instants - delay_ns
        stamps, load = np.union1d(self.reading_stamp_ns, shown), self.load
        if not self.load_known:
            load = load + self.load_changes(delay_ns)
        return replace(
            self,
            reading_stamp_ns=stamps,
            pressure=interpolate(
                shown=stamps, stamp_ns=self.reading_stamp_ns, values=self.pressure
            ),
            reading=np.searchsorted(stamps, shown),
            force=load[:, :2],
            moment=load[:, 2],
            gravity=self.gravity_at(shown),
        )

    def gravity_at(self, shown: Stamps) -> Array | None:
        """Return gravity (frames, 2) at stamps (ns), by linear interpolation."""
        if self.gravity_stamp_ns is None or self.gravity_read is None:
            return self.gravity
        columns = self.gravity_read.T
        return np.column_stack([interpolate(shown, self.gravity_stamp_ns, one) for one in columns])

    def load_changes(self, delay_ns: int) -> Array:
        """Return the change of the load (frames, 3) from its reading to the frame.

        delay_ns: delay of the stamp of a frame.
        """
        stamps, values, reading_stamps = self.instants, self.load, self.instants
        shown = reading_stamps
        if self.wrench_stamp_ns is not None and self.wrench is not None:
            stamps, values = self.wrench_stamp_ns, self.wrench
            nearest, _ = match_stamps(self.stamp_ns, stamps, 0.0)
            reading_stamps, shown = stamps[nearest], instants_among(self.stamp_ns, stamps)
        return np.column_stack(
            [
                interpolate(shown - delay_ns, stamps, part)
                - interpolate(reading_stamps, stamps, part)
                for part in values.T
            ]
        )

    @property
    def instants(self) -> Stamps:
        """Times of all frames on the clock of the pressure readings, (frames,) ns."""
        return frame_instants(self.stamp_ns, self.reading_stamp_ns, self.reading)

    @property
    def load(self) -> Array:
        """End load F1, F2 (N), M (N m) as read at every frame, (frames, 3)."""
        return freeze(np.column_stack([self.force, self.moment]))

    @property
    def points(self) -> Array:
        """Measured targets (frames, 2, targets) m, NaN where not seen."""
        return np.stack([self.x, self.y], axis=1)

    @property
    def progress(self) -> Array:
        """Position of every frame in the run, (frames,) 0 to 1; of static frames their order."""
        if self.static:
            return freeze(np.linspace(0.0, 1.0, len(self.stamp_ns)))
        span = max(int(self.stamp_ns[-1] - self.stamp_ns[0]), 1)
        return freeze((self.stamp_ns - self.stamp_ns[0]) / span)

    def without_tip_pose(self) -> RecordingData:
        """Return the run as if the pose of the tip had not been measured."""
        return replace(self, tip_pose=None)

    @property
    def heading(self) -> Array | None:
        """Heading (rad) of the tip in every frame, (frames,) NaN where not measured."""
        if self.tip_pose is None or not np.isfinite(self.tip_pose[:, 2]).any():
            return None
        return freeze(self.tip_pose[:, 2])

    @property
    def frame_pressure(self) -> Array:
        """Pressure (Pa) as read at every frame, (frames,)."""
        return freeze(self.pressure[self.reading])

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Mask of seen targets, (frames, targets)."""
        return np.isfinite(self.x)


def thin_runs(runs: Sequence[RecordingData], most: int) -> list[RecordingData]:
    """Return runs thinned to at most this many frames in total.

    A long film shows the same shapes many times, mostly of an arm at rest, while a short recording
    may show shapes that the film lacks. Half of the frames are therefore divided in proportion to
    length and half equally; the unused part of a share is divided among the other runs.
    """
    lengths = np.array([len(run.stamp_ns) for run in runs])
    if lengths.sum() <= most:
        return [*runs]
    shares, whole = lengths.copy(), np.zeros(len(runs), dtype=np.bool_)
    while True:
        left, of_others = most - int(lengths[whole].sum()), lengths[~whole]
        shares[~whole] = 0.5 * left * (of_others / of_others.sum() + 1.0 / len(of_others))
        if (whole == (shares >= lengths)).all():
            break
        whole |= shares >= lengths
        shares[whole] = lengths[whole]
    return [
        run if share >= length else thin_by_course(run, max(share, 1))
        for run, share, length in zip(runs, shares.tolist(), lengths.tolist(), strict=True)
    ]


def thin_by_course(run: RecordingData, most: int) -> RecordingData:
    """Return a run thinned evenly in time, pressure and load to at most this many frames.

    Half of the spacing is by time, half by the changes of pressure and load: if these change in
    only a tenth of the frames, half of the chosen frames are from that tenth.
    """
    changes = [
        np.abs(np.diff(values)) / np.ptp(values)
        for values in (run.frame_pressure, *run.load.T)
        if np.ptp(values) > 0.0
    ]
    if run.static or not changes:
        return run.thin(most)
    intervals = np.diff(run.stamp_ns).astype(np.float64)
    course = np.cumsum(
        [0.0, *(np.sum(changes, axis=0) / np.sum(changes) + intervals / intervals.sum())]
    )
    return run.subset(np.unique(np.searchsorted(course, np.linspace(0.0, course[-1], most))))


def frame_instants(stamp_ns: Stamps, reading_stamp_ns: Stamps, reading: Stamps) -> Stamps:
    """Return the times of all frames on the clock of the readings, (frames,) ns.

    For a camera triggered together with the readings, the times are those of the readings
    `reading` (frames,), because its stamps have jitter of their own; for any other camera they are
    its stamps.
    """
    reading_times = reading_stamp_ns[reading]
    if len(reading_stamp_ns) < 2:
        return reading_times
    period = float(np.median(np.diff(reading_stamp_ns)))
    offset = float(np.quantile(np.abs(stamp_ns - reading_times), TRIGGERED))
    if offset <= SAME_INSTANT * period:
        return reading_times
    return stamp_ns


def frames_in_jumps(shown: Stamps, stamp_ns: Stamps, pressure: Array) -> npt.NDArray[np.bool_]:
    """Return the frames (frames,) taken during a pressure jump between two readings.

    shown (ns): times of the frames; stamp_ns (readings,) and pressure (readings,) Pa. Such a frame
    shows the arm at the pressure before or after the jump, not in between: linear interpolation is
    wrong by up to the whole jump.
    """
    if len(stamp_ns) < 4:
        return np.zeros(len(shown), np.bool_)
    changes = np.abs(np.diff(pressure))
    noise = SIGMA_OF_MEDIAN * float(np.median(np.abs(np.diff(pressure, 2)))) / np.sqrt(6.0)
    padded = np.pad(changes, 1)
    neighbors_change = np.maximum(padded[:-2], padded[2:])
    jumped = changes > PRESSURE_JUMP.neighbors * neighbors_change
    jumped &= changes > max(JUMP_NOISE * noise, JUMP_SPAN * float(np.ptp(pressure)))
    after = np.clip(np.searchsorted(stamp_ns, shown), 1, len(stamp_ns) - 1)
    interval = np.maximum(stamp_ns[after] - stamp_ns[after - 1], 1)
    fraction = (shown - stamp_ns[after - 1]) / interval
    between = np.minimum(fraction, 1.0 - fraction) > CERTAIN
    return np.asarray(jumped[after - 1] & between)


def instants_among(stamp_ns: Stamps, reading_stamp_ns: Stamps) -> Stamps:
    """Return the times of all frames on the clock of some readings, (frames,) ns."""
    nearest, _ = match_stamps(stamp_ns, reading_stamp_ns, 0.0)
    return frame_instants(stamp_ns, reading_stamp_ns, nearest)
