"""Readings as a table: a row per stamp, with what was said at it; from and to recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import seconds_between
from pneunet_ros.messages.readings import (
    TARGETS_NAME,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingTable:
    """What was read at each stamp, in the words of the contract.

    stamp_ns (rows,) increases; pressure (rows,) Pa gauge and wrench (rows, 3) N, N, N m in the
    base frame are NaN where there is no reading; x and y (rows, targets) m where targets were
    seen, NaN where not. A row without any target is no frame.
    """

    stamp_ns: Stamps
    pressure: Array
    wrench: Array
    x: Array
    y: Array

    def __post_init__(self) -> None:
        """Check the shapes and the order of the stamps."""
        rows, targets = len(self.stamp_ns), np.shape(self.x)[1]
        shapes = {
            'pressure': (rows,),
            'wrench': (rows, 3),
            'x': (rows, targets),
            'y': (rows, targets),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape))
        if not np.all(np.diff(self.stamp_ns) > 0):
            raise RecordingError('the stamps of a table must increase')

    @property
    def framed(self) -> npt.NDArray[np.bool_]:
        """In which rows targets were seen, (rows,)."""
        return np.asarray((np.isfinite(self.x) & np.isfinite(self.y)).any(axis=1))

    def counts(self) -> dict[str, int]:
        """Return how many readings there are, by the names of their topics."""
        return {
            'pressure': int(np.count_nonzero(np.isfinite(self.pressure))),
            'end_wrench': int(np.count_nonzero(np.isfinite(self.wrench).all(axis=1))),
            TARGETS_NAME: int(np.count_nonzero(self.framed)),
        }


def columns(table: ReadingTable) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of a table by names that `import` knows; time counts from its start.

    What was never read has no column.
    """
    start = int(table.stamp_ns[0]) if len(table.stamp_ns) else 0
    seconds = [seconds_between(start, stamp) for stamp in table.stamp_ns.tolist()]
    found: dict[str, npt.NDArray[np.generic]] = {
        'stamp_ns': table.stamp_ns,
        'time_s': np.array(seconds),
    }
    counts = table.counts()
    if counts['pressure']:
        found['pressure_pa'] = table.pressure
    if counts['end_wrench']:
        for place, name in enumerate(('force_x_n', 'force_y_n', 'moment_n_m')):
            found[name] = table.wrench[:, place]
    for target in range(table.x.shape[1]):
        found[f'x{target}_m'] = table.x[:, target]
        found[f'y{target}_m'] = table.y[:, target]
    return found
