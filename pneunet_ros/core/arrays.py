"""Read-only float64 arrays, tables over pressure, and bitwise equality of values."""

from __future__ import annotations

from dataclasses import fields
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import ModelError, PneunetError, RequestError

Array = npt.NDArray[np.float64]


def frozen_array(value: npt.ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return a read-only float64 array; raises RequestError if it does not have `shape`."""
    array = np.asarray(value, dtype=np.float64, order='C')
    if array is value and array.shape == shape and not array.flags.writeable:
        return array
    if shape is not None and array.shape != shape:
        raise RequestError(
            f'expected an array of shape {shape}, got {array.shape}', reason='wrong_shape'
        )
    if array.flags.writeable:
        if array is value:
            array = array.copy()
        array.flags.writeable = False
    return array


def freeze(array: Array) -> Array:
    """Make an array owned by the caller read-only, without a copy."""
    array.flags.writeable = False
    return array


def median(values: Array) -> float:
    """Return the median of finite values; for few values ten times as fast as numpy."""
    ordered = np.sort(values, axis=None)
    return 0.5 * float(ordered[(ordered.size - 1) // 2] + ordered[ordered.size // 2])


def root_mean_square(values: Array) -> float:
    """Return the root mean square of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def same_values(left: Any, right: Any) -> bool:
    """Whether two objects are equal field by field, arrays bitwise (NaN equals NaN)."""
    if type(left) is not type(right):
        return False
    if isinstance(left, np.ndarray):
        return bool(np.array_equal(left, right, equal_nan=True))
    if hasattr(left, '__dataclass_fields__'):
        return all(
            same_values(getattr(left, field.name), getattr(right, field.name))
            for field in fields(left)
        )
    if isinstance(left, tuple) and len(left) == len(right):
        return all(same_values(*pair) for pair in zip(left, right, strict=True))
    return bool(left == right)


LARGEST = 1e30  # above any reading or number of an arm; squares and splines would overflow


def are_numbers(values: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return a mask of usable values: finite and not beyond LARGEST."""
    return np.asarray(np.abs(values) <= LARGEST)


def pressure_rows(pressure: Array, at: npt.ArrayLike) -> tuple[npt.NDArray[np.int64], Array]:
    """Return the rows below `at` in a table over pressure, and the weight of the row above.

    pressure (rows,) Pa increasing, at (...) Pa; returns the row index and the weight, each (...).
    In a table with a single row, this row is also the row above and has all the weight.
    """
    at = np.asarray(at, dtype=np.float64)
    if pressure.size == 1:
        return np.full(at.shape, -1), np.ones(at.shape)
    row = np.clip(np.searchsorted(pressure, at, side='right') - 1, 0, pressure.size - 2)
    return row, (at - pressure[row]) / (pressure[row + 1] - pressure[row])


def checked_pressures(pressure: npt.ArrayLike, where: str) -> Array:
    """Return a pressure column that is finite, increasing and not empty; else ModelError."""
    column = table_array(pressure, f'{where}.pressure', 1)
    if column.size < 1 or not np.all(np.diff(column) > 0.0):
        raise ModelError(
            f'{where}.pressure must be one or more strictly increasing values in Pa',
            reason='not_increasing',
        )
    return column


def only_numbers(values: Any) -> bool:
    """Whether a nested list or an array contains only numbers, without texts or booleans."""
    if isinstance(values, np.ndarray):
        return values.dtype.kind in 'iuf'
    if isinstance(values, (list, tuple)):
        return all(only_numbers(value) for value in values)
    return isinstance(values, (int, float, np.number)) and not isinstance(values, bool)


def table_array(
    values: npt.ArrayLike, where: str, dimensions: int, error: type[PneunetError] = ModelError
) -> Array:
    """Return a read-only table of finite numbers with this many dimensions; else raise `error`."""
    sentence = f'{where} must be a table of numbers with rows of equal length'
    if not only_numbers(values):
        raise error(sentence, reason='not_a_table')
    try:
        array = np.array(values, dtype=np.float64)
    except (ValueError, OverflowError):
        raise error(sentence, reason='not_a_table') from None
    if array.ndim != dimensions:
        kind = ['a number', 'a list of numbers', 'a list of rows of numbers'][dimensions]
        raise error(
            f'{where} must be {kind}, got an array of shape {array.shape}', reason='wrong_shape'
        )
    if not np.all(np.isfinite(array)):
        raise error(f'{where} contains NaN or infinity', reason='not_finite')
    if np.any(np.abs(array) > LARGEST):
        raise error(f'{where} contains a number larger than {LARGEST:g}', reason='too_large')
    return frozen_array(array)
