"""Files of numbers: columns as CSV or NumPy arrays; target areas in the format of the paper."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
import csv
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.files.atomic import atomic_output

SUFFIXES = ('.csv', '.npz')

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


def check_suffix(path: Path) -> None:
    """Reject a file name with an unknown suffix."""
    if path.suffix.lower() not in SUFFIXES:
        raise RequestError(
            f'--output {path} must end in {" or ".join(SUFFIXES)}', reason='wrong_suffix'
        )


def write_columns(
    path: Path,
    columns: Mapping[str, npt.NDArray[np.generic]],
    *,
    overwrite: bool = False,
    inputs: Iterable[Path] = (),
) -> None:
    """Write columns of equal length in full precision; NaN becomes an empty cell in CSV.

    Raises RequestError for any other suffix, and the errors of `atomic_output`.
    """
    check_suffix(path)
    with atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary:
        if path.suffix.lower() == '.npz':
            arrays: dict[str, Any] = dict(columns)
            with temporary.open('wb') as binary:
                np.savez_compressed(binary, **arrays)
            return
        with temporary.open('w', encoding='utf-8', newline='') as stream:
            lines = csv.writer(stream, lineterminator='\n')
            lines.writerow(columns)
            lists = [values.tolist() for values in columns.values()]
            for row in zip(*lists, strict=True):
                # A NaN is not equal to itself.
                lines.writerow([repr(value) if value == value else '' for value in row])


@contextmanager
def write_table(
    path: Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Iterator[Callable[[TargetSightings], None]]:
    """Write a table atomically: the file appears when complete. Raises like `atomic_output`.

    Yields the function that writes sightings, one line per seen target, with all digits.
    """
    with (
        atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary,
        temporary.open('w', encoding='utf-8', newline='') as stream,
    ):
        lines = csv.writer(stream, lineterminator='\n')
        lines.writerow(['stamp_ns', 'id', *COLUMNS.values()])

        def write(sightings: TargetSightings) -> None:
            columns = [getattr(sightings, name) for name in COLUMNS]
            for target in np.flatnonzero(np.isfinite(sightings.x)).tolist():
                values = [repr(float(column[target])) for column in columns]
                lines.writerow([sightings.stamp_ns, target, *values])

        yield write
