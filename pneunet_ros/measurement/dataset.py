"""A recording as calibration and diagnosis see it: readings, and the frames with their targets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.model.uncertainty import SensorNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class IdleSensorSettings:
    """When a force sensor that was recorded had nothing to measure."""

    reach: float = tuning(4.0, 'of an idle sensor', unit='sigma', source='convention')
    chance: float = tuning(0.01, 'that noise alone reaches further in a long recording')


IDLE_SENSOR = IdleSensorSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingData:
    """One recording: what was read, and where the targets were seen meanwhile.

    `reading_stamp_ns` (readings,) and `pressure` (readings,) Pa are all pressure readings, stamps
    increasing; `stamp_ns` (frames,) are the frames in which targets were seen and `reading`
    (frames,) the pressure reading that belongs to each. force (frames, 2) N and moment (frames,)
    N m are the end load at the frames in the base frame, as read; `loaded` is False where nothing
    was attached, and the load then exactly zero. x, y (frames, targets) m in the base frame, NaN
    where a target was not seen. tip_pose (frames, 3): x, y m and heading rad of the tip, NaN where
    not measured; None: never (see `measurement.tip_pose`). static: frames are steady states in any
    order, their stamps mean nothing. pressurized: False where no pressure was recorded; it is then
    zero. load_known: the load is a known constant, which no sensor has read. wrench_stamp_ns
    (wrenches,) and wrench (wrenches, 3) N, N m are all readings of the end load; None where only
    those at the frames are known. Raises RecordingError where these do not fit together.
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
    static: bool = False
    pressurized: bool = True
    load_known: bool = False
    wrench_stamp_ns: Stamps | None = None
    wrench: Array | None = None

    def __post_init__(self) -> None:
        """Check the shapes and the order of the stamps."""
        readings, frames = len(self.reading_stamp_ns), len(self.stamp_ns)
        if readings == 0 or frames == 0:
            raise RecordingError(f'{self.name}: no frame with targets and a pressure reading')
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
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape))
        for name in ('reading_stamp_ns', 'stamp_ns'):
            if not np.all(np.diff(getattr(self, name)) > 0):
                raise RecordingError(f'{self.name}: {name} must increase')
        if not (np.all(self.reading >= 0) and np.all(self.reading < readings)):
            raise RecordingError(f'{self.name}: a frame belongs to a reading that is not there')

    def without_load(self) -> RecordingData:
        """Return the run with nothing attached: what a force sensor read is its own error."""
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
        """Return the run under a known constant end load (N, base frame) that no sensor read."""
        frames = len(self.stamp_ns)
        force = np.tile([force_x, force_y], (frames, 1))
        return replace(self, loaded=True, load_known=True, force=force, moment=np.zeros(frames))

    def is_idle(self, noise: SensorNoise, settings: IdleSensorSettings = IDLE_SENSOR) -> bool:
        """Whether every wrench is within the noise of the sensor: nothing was attached."""
        reach = self.idle_reach(settings)
        return not self.load_known and bool(
            np.all(np.abs(self.force) <= reach * noise.force_std)
            and np.all(np.abs(self.moment) <= reach * noise.moment_std)
        )

    def idle_reach(self, settings: IdleSensorSettings = IDLE_SENSOR) -> float:
        """Return how far (sigma) the noise of an idle sensor reaches in a run of this length."""
        values = 3 * len(self.stamp_ns)
        return max(settings.reach, -NormalDist().inv_cdf(0.5 * settings.chance / values))

    def thin(self, most: int) -> RecordingData:
        """Return the run with at most so many frames, evenly spread over it."""
        frames = len(self.stamp_ns)
        if frames <= most:
            return self
        kept = np.unique(np.linspace(0, frames - 1, most).astype(np.int64))
        cut = {
            name: getattr(self, name)[kept]
            for name in ('stamp_ns', 'reading', 'force', 'moment', 'x', 'y')
        }
        if self.tip_pose is not None:
            cut['tip_pose'] = self.tip_pose[kept]
        return replace(self, **cut)

    def delay_frames(self, delay: float) -> RecordingData:
        """Return the run with every frame showing the arm of its stamp minus delay (s).

        Pressure and load between readings are on the straight line; before the first and after the
        last they stay. Static frames have no time.
        """
        if self.static or delay == 0.0:
            return self
        shown = self.reading_stamp_ns[self.reading] - round(delay * NANOSECONDS_PER_SECOND)
        stamps = np.union1d(self.reading_stamp_ns, shown)
        start = int(stamps[0])
        load = np.column_stack([self.force, self.moment])
        read_ns, read = self.stamp_ns, load
        if self.wrench_stamp_ns is not None and self.wrench is not None:
            read_ns, read = self.wrench_stamp_ns, self.wrench
        read_at, at = (
            (item - start) / NANOSECONDS_PER_SECOND for item in (read_ns, self.stamp_ns)
        )
        changes = [
            np.interp(at - delay, read_at, part) - np.interp(at, read_at, part) for part in read.T
        ]
        load = load + np.transpose(changes)
        return replace(
            self,
            reading_stamp_ns=stamps,
            pressure=np.interp(stamps - start, self.reading_stamp_ns - start, self.pressure),
            reading=np.searchsorted(stamps, shown),
            force=load[:, :2],
            moment=load[:, 2],
        )

    @property
    def points(self) -> Array:
        """Measured targets (frames, 2, targets) m, NaN where one was not seen."""
        return np.stack([self.x, self.y], axis=1)

    @property
    def progress(self) -> Array:
        """How far into the run every frame is, (frames,) 0 to 1; of static frames their order."""
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
        """Which targets were seen in which frame, (frames, targets)."""
        return np.isfinite(self.x)
