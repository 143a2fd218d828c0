"""A Gaussian in square-root form, and its updates.

The root (n, m) may have more columns than rows: process noise and reset unknowns append columns,
measurements do not, and `compressed` makes the root square again.
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

BLOCK = 32  # block size of LAPACK's reflections
TINY = 1e-12  # of a variance, due to rounding
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
    """Return a copy of a root (n, m) with this many zero columns appended."""
    rows, columns = root.shape
    wider = np.empty((rows, columns + more))
    wider[:, :columns], wider[:, columns:] = root, 0.0
    return wider


def forget(known: Known, where: Where, std: Array) -> Known:
    """Reset some unknowns to zero mean and one sigma std (k,)."""
    mean, root = known.mean.copy(), known.root.copy()
    mean[where], root[where] = 0.0, 0.0
    return widen(replace(known, mean=freeze(mean), root=root), where, std)


def widen(known: Known, where: Where, std: Array) -> Known:
    """Increase the uncertainty of some unknowns by independent changes of one sigma std (k,)."""
    before = known.root.shape[1]
    root = with_columns(known.root, std.size)
    root[where, before:] = np.diag(std)
    return replace(known, root=freeze(root))


def without_prior(known: Gaussian, which: int, before: float) -> tuple[float, float]:
    """Remove the prior of an unknown: return its estimate and its sigma in the score test.

    before: one sigma of its zero-mean prior. Both are infinite if the measurements have no
    information. Source: score test, Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948).
    """
    share = 1.0 - (known.std(which) / before) ** 2 if before > 0.0 else 0.0
    if share <= 0.0:
        return 0.0, math.inf
    return float(known.mean[which]) / share, before / math.sqrt(share)


def prior_log_odds(
    known: Gaussian, where: Where, before: Array, after: Array, center: Array | float = 0.0
) -> float:
    """Return the log odds (nats) of another prior, given all measurements so far.

    The unknowns of the prior are constant; before, after: one sigma (k,) of the present and of the
    other prior; center (k,): mean of both. Returns -inf if one of the unknowns was known exactly.
    """
    return (
        -math.inf if not before.all() else _other_prior(known, where, (before, after), center)[2]
    )


def with_prior(
    known: Known, where: Where, before: Array, after: Array, center: Array | float = 0.0
) -> tuple[Known, float]:
    """Replace the prior of some constant unknowns by another one, after all measurements.

    The information of all later measurements is kept, and correlated unknowns are updated.

    Args:
        known: mean and root of a belief that started from a prior on these unknowns.
        where: indices of the unknowns, which must be constant.
        before, after: one sigma (k,) of the original prior, and of a wider one.
        center: mean (k,) of both.

    Returns:
        The posterior with the other prior, and its `prior_log_odds`. Source: evidence of a linear
        model, MacKay, Neural Computation 4 (1992).
    """
    if not before.all():
        return known, -math.inf
    moved, covariance, log_odds, spectrum = _other_prior(known, where, (before, after), center)
    variance, axes = spectrum
    rows, mean = known.root[where] / before[:, None], (known.mean[where] - center) / before
    gain = known.root @ rows.T @ (axes / variance) @ axes.T
    grown, wider = np.linalg.eigh(covariance - (axes * variance) @ axes.T)
    more = gain @ (wider * np.sqrt(np.clip(grown, 0.0, None)))
    changed = replace(
        known,
        mean=freeze(known.mean + gain @ (moved - mean)),
        root=freeze(np.hstack([known.root, more])),
    )
    return changed, log_odds


def _other_prior(
    known: Gaussian, where: Where, stds: tuple[Array, Array], center: Array | float
) -> tuple[Array, Array, float, tuple[Array, Array]]:
    """Return mean, covariance and log odds under another prior, and the previous spectrum.

    All are in sigmas of the original prior.
    """
    before, after = stds
    root, mean = known.root[where] / before[:, None], (known.mean[where] - center) / before
    variance, axes = np.linalg.eigh(root @ root.T)
    variance = np.clip(variance, TINY, 1.0)  # measurements cannot reduce it
    information = (axes / variance) @ (axes.T @ mean)
    precision = (axes * (1.0 / variance - 1.0)) @ axes.T + np.diag((before / after) ** 2)
    covariance = np.linalg.inv(precision)
    moved = covariance @ information
    log_odds = 0.5 * (
        float(moved @ information - mean @ information)
        - float(np.linalg.slogdet(precision)[1])
        - float(np.log(variance).sum())
        - 2.0 * float(np.log(after / before).sum())
    )
    return moved, covariance, log_odds, (variance, axes)


def take_measurement(known: Known, response: Array, value: Array, std: Array) -> Known:
    """Update by a linear measurement: value (k,) = response (k, n) x + noise.

    std (k,) of the noise, independent. This is the square-root form of the Kalman update.
    """
    seen = response @ known.root / std[:, None]
    factor = innovation_factor(seen)
    root = root_after(known.root, seen, factor)
    step = root @ (root.T @ (response.T @ ((value - response @ known.mean) / std**2)))
    return replace(known, mean=freeze(known.mean + step), root=freeze(root))


def innovation_factor(seen: Array) -> Array:
    """Return the Cholesky factor (k, k), stored below the diagonal, of the innovation covariance.

    seen (k, m): response of a measurement with white noise 1 to each column of the root.
    """
    covariance = seen @ seen.T
    covariance.flat[:: len(seen) + 1] += 1.0
    factor, _ = dpotrf(covariance.T, lower=1, overwrite_a=1)  # in Fortran order; symmetric
    return np.asarray(factor)


def root_after(root: Array, seen: Array, factor: Array) -> Array:
    """Return the root of the covariance after a measurement of white noise 1.

    seen (k, m): its response to each column of the root (n, m); factor: `innovation_factor`.

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
    """Return the Gaussian with a square root (n, n); propagation adds columns to a root."""
    rows, columns = known.root.shape
    return known if columns <= rows else replace(known, root=compress(known.root))


@cache
def lower_triangle(size: int) -> Array:
    """Return ones on and below the diagonal, (size, size)."""
    return freeze(np.tri(size))
