"""Archives of arrays (npz): loaded without pickle, and checked against declarations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
import struct
import tokenize
from typing import Any, Literal
from zipfile import BadZipFile, ZipFile
import zlib

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array, LARGEST
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.files.regular_file import open_regular

LARGEST_ARCHIVE = 100_000_000  # bytes, unpacked
ROUNDING = 1e-9  # largest asymmetry of a sum of outer products, relative to its largest entry
KINDS = {'number': 'iuf', 'integer': 'iu', 'text': 'U'}  # kind codes of numpy

# Errors of zipfile and numpy for damaged bytes; also RuntimeError (encrypted) and
# NotImplementedError (unknown compression) of zipfile.
DAMAGED = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    EOFError,
    OverflowError,
    MemoryError,
    SyntaxError,
    RuntimeError,
    BadZipFile,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)


class ArchiveError(PneunetError):
    """An archive is damaged, or an array in it does not match its declaration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Declared:
    """Declaration of an array of an archive.

    axes: a name for the size of each axis; axes with the same name have the same size. Numbers are
    finite and below 1e30 in magnitude. increasing: strictly. definite: a covariance or information
    matrix, symmetric and positive (semi)definite. required: whether the archive must have it.
    """

    kind: Literal['number', 'integer', 'text'] = 'number'
    axes: tuple[str, ...] = ()
    increasing: bool = False
    definite: Literal['no', 'positive', 'semi'] = 'no'
    required: bool = True


def read_arrays(path: Path, declared: Mapping[str, Declared]) -> dict[str, Any]:
    """Return the declared arrays of an archive by name: float64, int64, text.

    Raises:
        FileNotFoundError: the file does not exist.
        ArchiveError: it is damaged, or an array is missing or does not match its declaration.
    """
    try:
        with open_regular(path) as stream:
            with ZipFile(stream) as archive:
                if sum(item.file_size for item in archive.infolist()) > LARGEST_ARCHIVE:
                    raise ArchiveError(
                        f'it contains more than {LARGEST_ARCHIVE // 1_000_000} MB',
                        reason='too_large',
                    )
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as content:
                found = {name: content[name] for name in declared if name in content}
    except FileNotFoundError:
        raise
    except DAMAGED as error:
        raise ArchiveError(' '.join(str(error).split()), reason='damaged') from error
    sizes: dict[str, int] = {}
    for name, what in declared.items():
        if name in found:
            found[name] = _as_declared(name, np.asarray(found[name]), what, sizes)
        elif what.required:
            raise ArchiveError(f'{name} is missing', reason='missing')
    return found


def _as_declared(name: str, array: Any, what: Declared, sizes: dict[str, int]) -> Any:
    """Return one array, checked against its declaration; else ArchiveError."""
    if array.dtype.kind not in KINDS[what.kind]:
        raise ArchiveError(
            f'{name} must be of kind {what.kind}, but is {array.dtype}', reason='wrong_kind'
        )
    fits = array.ndim == len(what.axes) and all(
        sizes.setdefault(axis, size) == size
        for axis, size in zip(what.axes, array.shape, strict=True)
    )
    if not fits:
        expected = ', '.join(
            f'{axis} {sizes[axis]}' if axis in sizes else axis for axis in what.axes
        )
        raise ArchiveError(
            f'{name} must have the shape ({expected}), but has {array.shape}', reason='wrong_shape'
        )
    if what.kind == 'text':
        return array.item() if not what.axes else array
    if what.kind == 'integer':
        if array.dtype.kind == 'u' and array.size and array.max() > np.iinfo(np.int64).max:
            raise ArchiveError(f'{name} contains an integer beyond 64 bits', reason='too_large')
        values = array.astype(np.int64)
    else:
        values = frozen_array(array.astype(np.float64))
        if not np.all(np.abs(values) <= LARGEST):
            raise ArchiveError(
                f'{name} contains NaN, infinity or a number beyond {LARGEST:g}',
                reason='not_finite',
            )
    if what.increasing and not np.all(values[1:] > values[:-1]):
        raise ArchiveError(f'{name} must increase strictly', reason='not_increasing')
    if what.definite != 'no':
        _check_definite(name, values, strictly=what.definite == 'positive')
    return values if what.axes else values.item()


def _check_definite(name: str, matrix: Array, *, strictly: bool) -> None:
    """Reject a matrix that is not definite (covariance) or semidefinite (information)."""
    rounding = ROUNDING * np.max(np.abs(matrix), initial=0.0)
    if np.any(np.abs(matrix - matrix.T) > rounding):
        raise ArchiveError(f'{name} is not symmetric', reason='not_symmetric')
    if not strictly:
        if np.any(np.linalg.eigvalsh(matrix) < -rounding * len(matrix)):
            raise ArchiveError(f'{name} is not positive semidefinite', reason='not_definite')
        return
    diagonal = np.diag(matrix)
    if np.any(diagonal <= 0.0):
        raise ArchiveError(
            f'{name} contains a variance that is not positive', reason='not_definite'
        )
    std = np.sqrt(diagonal)
    try:  # as a correlation: its quantities have different units
        np.linalg.cholesky(matrix / std / std[:, None])
    except np.linalg.LinAlgError:
        raise ArchiveError(f'{name} is not positive definite', reason='not_definite') from None
