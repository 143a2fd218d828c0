"""A recording as calibration and diagnosis see it: readings, and the frames with their targets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.stamps import Stamps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingData:
    """One recording: what was read, and where the targets were seen meanwhile.

    `reading_stamp_ns` (readings,) and `pressure` (readings,) Pa are all pressure readings, stamps
    increasing; `stamp_ns` (frames,) are the frames in which targets were seen and `reading`
    (frames,) the pressure reading that belongs to each. force (frames, 2) N and moment (frames,)
    N m are the end load at the frames in the base frame, as read; `loaded` is False where nothing
    was attached, and the load then exactly zero. x, y (frames, targets) m in the base frame, NaN
    where a target was not seen. Raises RecordingError where these do not fit together.
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
        return replace(self, loaded=False, force=np.zeros((frames, 2)), moment=np.zeros(frames))

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
        return replace(self, **cut)

    @property
    def points(self) -> Array:
        """Measured targets (frames, 2, targets) m, NaN where one was not seen."""
        return np.stack([self.x, self.y], axis=1)

    @property
    def frame_pressure(self) -> Array:
        """Pressure (Pa) as read at every frame, (frames,)."""
        return freeze(self.pressure[self.reading])

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Which targets were seen in which frame, (frames, targets)."""
        return np.isfinite(self.x)
