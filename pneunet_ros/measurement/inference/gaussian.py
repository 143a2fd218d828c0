"""A Gaussian by its mean and a root of its covariance, and what becomes of it.

The root (n, m) may have more columns than rows: moves and forgotten unknowns add columns, a
measurement keeps them, and `compressed` makes the root square again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
import math
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from scipy.linalg.lapack import dgeqrf, dpotrf, dtrtrs

BLOCK = 32  # columns that LAPACK reflects at once
Where = slice | npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gaussian:
    """Mean (n,) and root (n, m) with root root^T the covariance."""

    mean: Array
    root: Array

    def std(self, which: int) -> float:
        """Return one sigma of an unknown."""
        return math.sqrt(float(self.root[which] @ self.root[which]))

    def covariance_of(self, where: Where) -> Array:
        """Return the covariance of some unknowns."""
        root = self.root[where]
        return np.asarray(root @ root.T)


Known = TypeVar('Known', bound=Gaussian)


def with_columns(root: Array, more: int) -> Array:
    """Return a copy of a root (n, m) with so many more columns, of zeros."""
    rows, columns = root.shape
    wider = np.empty((rows, columns + more))
    wider[:, :columns], wider[:, columns:] = root, 0.0
    return wider


def forget(known: Known, where: Where, std: Array) -> Known:
    """Replace what is known of some unknowns by a mean of zero and one sigma std (k,)."""
    mean, root = known.mean.copy(), known.root.copy()
    mean[where], root[where] = 0.0, 0.0
    return widen(replace(known, mean=freeze(mean), root=root), where, std)


def widen(known: Known, where: Where, std: Array) -> Known:
    """Let some unknowns have moved by any amount of one sigma std (k,)."""
    before = known.root.shape[1]
    root = with_columns(known.root, std.size)
    root[where, before:] = np.diag(std)
    return replace(known, root=freeze(root))


def take_measurement(known: Known, response: Array, value: Array, std: Array) -> Known:
    """Take a linear measurement: value (k,) = response (k, n) x + noise.

    std (k,) of the noise, independent. The square-root form of the Kalman update.
    """
    seen = response @ known.root / std[:, None]
    factor = innovation_factor(seen)
    root = root_after(known.root, seen, factor)
    step = root @ (root.T @ (response.T @ ((value - response @ known.mean) / std**2)))
    return replace(known, mean=freeze(known.mean + step), root=freeze(root))


def innovation_factor(seen: Array) -> Array:
    """Return the Cholesky factor (k, k), below its diagonal, of the innovation's covariance.

    seen (k, m): what a measurement of white noise 1 sees of each column of the root.
    """
    covariance = seen @ seen.T
    covariance.flat[:: len(seen) + 1] += 1.0
    factor, _ = dpotrf(covariance.T, lower=1, overwrite_a=1)  # as Fortran has it: it is symmetric
    return np.asarray(factor)


def root_after(root: Array, seen: Array, factor: Array) -> Array:
    """Return the root of the covariance after a measurement of white noise 1.

    seen (k, m): what it sees of each column of the root (n, m); factor: `innovation_factor`.

    Source: Andrews, AIAA Journal 6 (1968).
    """
    with_white = factor.copy(order='F')
    with_white.flat[:: len(seen) + 1] += 1.0
    gain, _ = dtrtrs(with_white, seen, lower=1)
    gain, _ = dtrtrs(factor, gain, lower=1, trans=1, overwrite_b=1)
    return np.asarray(root - (root @ seen.T) @ gain)


def compress(root: Array) -> Array:
    """Return a square root (n, n) of the covariance of a root (n, m), m >= n."""
    size = len(root)
    reflected, _, _, _ = dgeqrf(root.T, lwork=BLOCK * size)
    return freeze(reflected[:size].T * lower_triangle(size))


def compressed(known: Known) -> Known:
    """Return the same with a square root; the root grows with all that moves."""
    rows, columns = known.root.shape
    return known if columns <= rows else replace(known, root=compress(known.root))


@cache
def lower_triangle(size: int) -> Array:
    """Return ones on and below the diagonal, (size, size)."""
    return freeze(np.tri(size))
