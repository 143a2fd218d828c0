"""Columns of numbers by name -> a file: CSV, or NumPy arrays for the suffix .npz."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import csv
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import RequestError
from pneunet_ros.files.atomic import atomic_output

SUFFIXES = ('.csv', '.npz')


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
