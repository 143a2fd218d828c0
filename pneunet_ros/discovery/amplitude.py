"""How strong a kind of cause would have been, frame by frame, and what of it a law can explain.

With X all unknowns of the base fit and V = 1 + X X^T, a kind at a place has a field per frame:
what whitened points do per unit of its amplitude, taken through the equilibrium. The score
z = E^T V^-1 r and the information C = E^T V^-1 E of its columns say all that the recordings know
of it; base, placement and camera are refitted in them. Here columns are field times covariate, or
field times frame, and z and C are of all runs, or of some of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import itertools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.refit import Refit
from pneunet_ros.effects.effect import Effect
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import scipy

Runs = tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Score (n,) and information (n, n) of columns in some runs."""

    score: Array
    information: Array

    def part(self, chosen: Sequence[int]) -> Evidence:
        """Return that of some of the columns."""
        return Evidence(
            score=self.score[list(chosen)], information=self.information[np.ix_(chosen, chosen)]
        )

    def along(self, factors: Array) -> Evidence:
        """Return that of sums of the columns, with these factors (n, m)."""
        return Evidence(
            score=factors.T @ self.score, information=factors.T @ self.information @ factors
        )

    def log_gain(self, std: float) -> float:
        """Log probability of the runs with these columns over that without.

        std: prior standard deviation of every coefficient.
        """
        factor = scipy.linalg.cho_factor(
            np.eye(self.score.size) + std**2 * self.information, lower=True
        )
        score = std * self.score
        explained = float(score @ scipy.linalg.cho_solve(factor, score))
        return 0.5 * explained - float(np.log(np.diag(factor[0])).sum())

    def estimate(self, std: float) -> tuple[Array, Array]:
        """Return coefficients (n,) and their covariance (n, n)."""
        prior = np.eye(self.score.size) / std**2
        covariance = np.asarray(np.linalg.inv(self.information + prior), np.float64)
        return covariance @ self.score, covariance

    @property
    def explained(self) -> float:
        """By how much chi squared falls with the best coefficients."""
        return float(self.score @ np.linalg.lstsq(self.information, self.score, rcond=1e-10)[0])


class Projection:
    """What remains of columns once the base is refitted, in any of the runs of a fit."""

    def __init__(self, gaussian: GaussianModel) -> None:
        self.gaussian = gaussian
        self.solved: dict[Runs, tuple[tuple[Array, bool], Array]] = {}

    def of(self, runs: Runs) -> tuple[tuple[Array, bool], Array]:
        """Return the factor of 1 + X^T X in these runs, and the best step of the base there."""
        if runs not in self.solved:
            gaussian, size = self.gaussian, self.gaussian.position.size
            factor = scipy.linalg.cho_factor(
                sum((gaussian.grams[which] for which in runs), np.eye(size))
            )
            vector = sum(
                (gaussian.information_vectors[which] for which in runs), -gaussian.position
            )
            self.solved[runs] = factor, scipy.linalg.cho_solve(factor, vector)
        return self.solved[runs]


@dataclass(frozen=True, eq=False)
class Columns:
    """Whitened columns (rows, n) of every run of a fit, ready for evidence in any of the runs."""

    projection: Projection
    white: tuple[Array, ...]

    @cached_property
    def parts(self) -> list[tuple[Array, Array, Array]]:
        """Per run: columns^T columns, X^T columns, columns^T residuals."""
        gaussian = self.projection.gaussian
        return [
            (item.T @ item, columns.T @ item, item.T @ residuals)
            for item, columns, residuals in zip(
                self.white, gaussian.columns, gaussian.residuals, strict=True
            )
        ]

    def evidence(self, runs: Runs) -> Evidence:
        """Return score and information in these runs alone."""
        factor, step = self.projection.of(runs)
        gram, cross, score = (np.zeros_like(part) for part in self.parts[0])
        for which in runs:
            gram, cross, score = (
                total + part
                for total, part in zip((gram, cross, score), self.parts[which], strict=True)
            )
        return Evidence(
            score=score - cross.T @ step,
            information=gram - cross.T @ scipy.linalg.cho_solve(factor, cross),
        )

    def left_out(self, runs: Runs) -> tuple[Evidence, ...]:
        """Return the evidence in these runs, then without each of them in turn."""
        return (
            self.evidence(runs),
            *(self.evidence(tuple(other for other in runs if other != which)) for which in runs),
        )


class FrameColumns:
    """A field by frames: one column per frame of every run, of which each run has its own.

    Evidence is over all frames of all runs in turn, zero for those of other runs.
    """

    def __init__(
        self, projection: Projection, linearization: Linearization, fields: Sequence[Array]
    ) -> None:
        self.projection, gaussian = projection, projection.gaussian
        self.parts: list[tuple[Array, Array, Array]] = []
        for block, field, columns, residuals in zip(
            linearization.blocks, fields, gaussian.columns, gaussian.residuals, strict=True
        ):
            white = block.white(field[:, :, None] * np.eye(len(field))[:, None, :])
            self.parts.append((white.T @ white, columns.T @ white, white.T @ residuals))
        ends = np.cumsum([0, *(len(field) for field in fields)])
        self.frames = [slice(first, last) for first, last in itertools.pairwise(ends.tolist())]

    def of_run(self, which: int) -> Array:
        """Return which of all frames are those of a run, (frames,)."""
        own = self.frames[which]
        return np.arange(own.start, own.stop)

    def evidence(self, runs: Runs) -> Evidence:
        """Return score and information in these runs alone."""
        factor, step = self.projection.of(runs)
        count, base = self.frames[-1].stop, step.size
        score, gram, cross = np.zeros(count), np.zeros((count, count)), np.zeros((base, count))
        for which in runs:
            own = self.frames[which]
            gram[own, own], cross[:, own], score[own] = self.parts[which]
        return Evidence(
            score=score - cross.T @ step,
            information=gram - cross.T @ scipy.linalg.cho_solve(factor, cross),
        )


def left_out_gain(evidence: Sequence[Evidence], chosen: Sequence[int], std: float) -> float:
    """Return the gain in log probability of every run predicted from the others, summed.

    evidence: as of `Columns.left_out`; chosen: which columns; std: prior of their coefficients.
    """
    gains = [item.part(chosen).log_gain(std) for item in evidence]
    return sum(gains[0] - gain for gain in gains[1:])


def unit_fields(fit: Refit, effect: Effect, size: float) -> tuple[Array, ...] | None:
    """Return how points (frames, 2 targets) m answer to one unit of an amplitude, per run.

    effect: with an amplitude of `size` in every frame of the fit's runs. None where the arm has no
    shape with it.
    """
    linearization, point = fit.linearization, fit.point
    runs = range(len(linearization.blocks))
    before = linearization.points(point.arm, runs)
    after = linearization.points(replace(point, effects=(*point.effects, effect)).arm, runs)
    if before is None or after is None:
        return None
    return tuple(
        np.nan_to_num(with_it - without).reshape(len(without), -1) / size
        for with_it, without in zip(after, before, strict=True)
    )


def columns_of(
    projection: Projection,
    linearization: Linearization,
    fields: Sequence[Array],
    factors: Sequence[Array],
) -> Columns:
    """Return fields (frames, 2 targets) m times factors (frames, n) per run, whitened."""
    return Columns(
        projection,
        tuple(
            block.white(field[:, :, None] * factor[:, None, :])
            for block, field, factor in zip(linearization.blocks, fields, factors, strict=True)
        ),
    )
