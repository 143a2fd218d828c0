"""The table of areas that are targets, as the paper's image analysis exports it: CSV."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import csv
from pathlib import Path
from typing import TextIO

import numpy as np
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.tables.length_unit import LengthUnit

IN_IMAGE = {
    'u': 'u_px',
    'v': 'v_px',
    'area': 'area_px2',
    'major': 'major_px',
    'minor': 'minor_px',
    'angle': 'angle_rad',
}
IN_PLANE = ('x', 'y', 'std')


class TargetTable:
    """Takes sightings, a line per target that was seen; made by `write_table`."""

    __slots__ = ('_lines', '_unit')

    def __init__(self, stream: TextIO, unit: LengthUnit) -> None:
        """Write the names of the columns, with their units."""
        self._unit = unit
        self._lines = csv.writer(stream, lineterminator='\n')
        in_plane = [f'{name}_{unit.name}' for name in IN_PLANE]
        self._lines.writerow(['stamp_ns', 'id', *IN_IMAGE.values(), *in_plane])

    def write(self, sightings: TargetSightings) -> None:
        """Write the targets that were seen, to the last digit."""
        columns = [getattr(sightings, name) for name in IN_IMAGE]
        columns += [self._unit.per_meter * getattr(sightings, name) for name in IN_PLANE]
        for target in np.flatnonzero(np.isfinite(sightings.x)).tolist():
            values = [repr(float(column[target])) for column in columns]
            self._lines.writerow([sightings.stamp_ns, target, *values])


@contextmanager
def write_table(
    path: Path, unit: LengthUnit, *, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Iterator[TargetTable]:
    """Write a table that stands under its name when it is complete; errors of `atomic_output`."""
    with (
        atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary,
        temporary.open('w', encoding='utf-8', newline='') as stream,
    ):
        yield TargetTable(stream, unit)
