"""Linear algebra of hypothesis tests: the component of a direction orthogonal to the base model.

All unknowns are scaled to unit prior. With columns X, residual r and position x of the unknowns
(prior mean 0), V = 1 + X X^T is the covariance of residuals; z = E^T V^-1 r and C = E^T V^-1 E are
the score of further columns E and its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
import scipy

PER_RUN = ('columns', 'residuals', 'grams', 'information_vectors', 'squares', 'log_volumes')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GaussianModel:
    """Runs as one linear problem: columns per run (rows, n), residuals (rows,), position (n,).

    log_volumes: log volume of the covariance used for whitening, per run.
    """

    columns: tuple[Array, ...]
    residuals: tuple[Array, ...]
    position: Array
    grams: tuple[Array, ...]
    information_vectors: tuple[Array, ...]
    squares: tuple[float, ...]
    log_volumes: tuple[float, ...]
    factor: tuple[Array, bool] = field(init=False)
    step: Array = field(init=False)

    def __post_init__(self) -> None:
        """Solve the problem."""
        factor = scipy.linalg.cho_factor(sum(self.grams, np.eye(self.position.size)))
        object.__setattr__(self, 'factor', factor)
        object.__setattr__(
            self, 'step', self.solved(sum(self.information_vectors, -self.position))
        )

    @classmethod
    def of(
        cls,
        columns: Sequence[Array],
        residuals: Sequence[Array],
        position: Array,
        grams: Sequence[Array] = (),
        log_volumes: Sequence[float] = (),
    ) -> GaussianModel:
        """Set up the problem; grams: column^T column per run, where known.

        log_volumes: may be omitted if all compared models are whitened in the same way.
        """
        vectors = tuple(item.T @ rest for item, rest in zip(columns, residuals, strict=True))
        grams = tuple(grams) or tuple(item.T @ item for item in columns)
        return cls(
            columns=tuple(columns),
            residuals=tuple(residuals),
            position=position,
            grams=grams,
            information_vectors=vectors,
            squares=tuple(float(rest @ rest) for rest in residuals),
            log_volumes=tuple(log_volumes) or (0.0,) * len(grams),
        )

    def subset(self, runs: Sequence[int]) -> GaussianModel:
        """Return the problem of some of the runs."""
        chosen: dict[str, Any] = {
            name: tuple(getattr(self, name)[which] for which in runs) for name in PER_RUN
        }
        return replace(self, **chosen)

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns, (n, n)."""
        return self.solved(np.eye(self.position.size))

    @property
    def gain(self) -> float:
        """Reduction of the cost by the optimal step."""
        return 0.5 * float(sum(self.information_vectors, -self.position) @ self.step)

    def solved(self, right: Array) -> Array:
        """Return the covariance of the unknowns times a matrix (n, k)."""
        value: Array = scipy.linalg.cho_solve(self.factor, right)
        return value

    def best_residuals(self) -> tuple[Array, ...]:
        """Residuals (rows,) of each run after the optimal step."""
        pairs = zip(self.columns, self.residuals, strict=True)
        return tuple(rest - item @ self.step for item, rest in pairs)

    def inner(self, left: Sequence[Array], right: Sequence[Array]) -> Array:
        """Return left^T V^-1 right for columns per run."""
        plain = sum(a.T @ b for a, b in zip(left, right, strict=True))
        projected_left = sum(x.T @ a for x, a in zip(self.columns, left, strict=True))
        projected_right = projected_left
        if right is not left:
            projected_right = sum(x.T @ b for x, b in zip(self.columns, right, strict=True))
        value: Array = plain - np.asarray(projected_left).T @ self.solved(
            np.asarray(projected_right)
        )
        return value

    def score(self, columns: Sequence[Array]) -> Array:
        """Return z of further columns (rows, k) per run."""
        parts = zip(columns, self.best_residuals(), strict=True)
        value: Array = np.asarray(sum(item.T @ rest for item, rest in parts))
        return value

    @property
    def cost(self) -> float:
        """Negative log posterior at the optimal step, including log volumes."""
        squares = sum(self.squares) + float(self.position @ self.position)
        return 0.5 * squares - self.gain + sum(self.log_volumes)

    def log_probability(self) -> float:
        """Log probability of the runs, up to a common constant."""
        return -self.cost - float(np.log(np.diag(self.factor[0])).sum())

    def without(self, run: int) -> GaussianModel:
        """Return the problem of all runs but one."""
        return self.subset([which for which in range(len(self.grams)) if which != run])

    def evidence(self) -> float:
        """Sum of the log probabilities of every run, predicted from the other runs."""
        total = self.log_probability()
        return sum(total - self.without(run).log_probability() for run in range(len(self.grams)))
