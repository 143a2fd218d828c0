"""The table of target areas, as exported by the paper's image analysis: CSV."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import csv
from pathlib import Path
from typing import TextIO

import numpy as np
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.files.atomic import atomic_output

COLUMNS = {
    'u': 'u_px',
    'v': 'v_px',
    'area': 'area_px2',
    'major': 'major_px',
    'minor': 'minor_px',
    'angle': 'angle_rad',
    'x': 'x_m',
    'y': 'y_m',
    'std': 'std_m',
}


class TargetTable:
    """Writes sightings, one line per seen target; made by `write_table`."""

    __slots__ = ('_lines',)

    def __init__(self, stream: TextIO) -> None:
        """Write the names of the columns, with their units."""
        self._lines = csv.writer(stream, lineterminator='\n')
        self._lines.writerow(['stamp_ns', 'id', *COLUMNS.values()])

    def write(self, sightings: TargetSightings) -> None:
        """Write the seen targets with all digits."""
        columns = [getattr(sightings, name) for name in COLUMNS]
        for target in np.flatnonzero(np.isfinite(sightings.x)).tolist():
            values = [repr(float(column[target])) for column in columns]
            self._lines.writerow([sightings.stamp_ns, target, *values])


@contextmanager
def write_table(
    path: Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Iterator[TargetTable]:
    """Write a table atomically: the file appears when complete. Raises like `atomic_output`."""
    with (
        atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary,
        temporary.open('w', encoding='utf-8', newline='') as stream,
    ):
        yield TargetTable(stream)
