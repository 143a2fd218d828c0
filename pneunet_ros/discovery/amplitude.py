"""Amplitude of a kind of cause, frame by frame, and the part explained by a law.

With X all unknowns of the base fit and V = 1 + X X^T, a kind at a place has a field per frame: the
change of the whitened points per unit of its amplitude, at equilibrium. The score z = E^T V^-1 r
and the information C = E^T V^-1 E of its columns contain all the information of the recordings,
with base, placement and camera refitted. Here columns are field times covariate, or field times
frame, and z and C are those of all or some runs.
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
        """Return the evidence for some of the columns."""
        return Evidence(
            score=self.score[list(chosen)], information=self.information[np.ix_(chosen, chosen)]
        )

    def along(self, factors: Array) -> Evidence:
        """Return the evidence for m linear combinations of the columns, with factors (n, m)."""
        return Evidence(
            score=factors.T @ self.score, information=factors.T @ self.information @ factors
        )

    def log_gain(self, std: float) -> float:
        """Return `log_gains` for one prior standard deviation of every coefficient."""
        return float(log_gains(self.score, self.information, [std])[0])

    def estimate(self, std: float) -> tuple[Array, Array]:
        """Return coefficients (n,) and their covariance (n, n)."""
        prior = np.eye(self.score.size) / std**2
        covariance = np.asarray(np.linalg.inv(self.information + prior), np.float64)
        return covariance @ self.score, covariance

    @property
    def explained(self) -> float:
        """The reduction of chi squared by the best coefficients."""
        return float(self.score @ np.linalg.lstsq(self.information, self.score, rcond=1e-10)[0])


class Projection:
    """Projection of columns on the refitted base, in any runs of a fit."""

    def __init__(self, gaussian: GaussianModel) -> None:
        self.gaussian = gaussian
        self.solved: dict[Runs, tuple[tuple[Array, bool], Array]] = {}

    def of(self, runs: Runs) -> tuple[tuple[Array, bool], Array]:
        """Return the factor of 1 + X^T X in these runs, and the best step of the base."""
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
    """A field with one column per frame of every run.

    Evidence covers the frames of all runs in order, with zeros for other runs. parts: per run,
    columns^T columns, X^T columns, columns^T residuals.
    """

    def __init__(
        self, projection: Projection, parts: Sequence[tuple[Array, Array, Array]]
    ) -> None:
        self.projection, self.parts = projection, parts
        ends = np.cumsum([0, *(score.size for _, _, score in parts)])
        self.frames = [slice(first, last) for first, last in itertools.pairwise(ends.tolist())]

    @classmethod
    def of(
        cls, projection: Projection, linearization: Linearization, fields: Sequence[Array]
    ) -> FrameColumns:
        """Take a field (frames, 2 targets) m of every run, whitened frame by frame."""
        gaussian, parts = projection.gaussian, []
        for block, field, columns, residuals in zip(
            linearization.blocks, fields, gaussian.columns, gaussian.residuals, strict=True
        ):
            white = block.white_by_frame(field[:, :, None])
            parts.append((white.T @ white, columns.T @ white, white.T @ residuals))
        return cls(projection, parts)

    def along(self, factors: Sequence[Array]) -> FrameColumns:
        """Return weighted sums over the frames of every run; factors: (frames, n) per run."""
        return FrameColumns(
            self.projection,
            [
                (factor.T @ gram @ factor, cross @ factor, factor.T @ score)
                for factor, (gram, cross, score) in zip(factors, self.parts, strict=True)
            ],
        )

    def of_run(self, which: int) -> Array:
        """Return the mask (frames,) of the frames of a run."""
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


def log_gains(score: Array, information: Array, stds: Sequence[float] | Array) -> Array:
    """Return the log probability of runs with columns relative to that without, (..., stds).

    score (..., n) and information (..., n, n) of columns; stds: priors of their coefficients.
    """
    values, axes = np.linalg.eigh(information)
    scores = np.einsum('...ij,...i->...j', axes, score)[..., None, :]
    variances = np.square(stds)[:, None]
    shrunk = 1.0 + variances * np.maximum(values, 0.0)[..., None, :]
    return np.asarray(0.5 * (variances * scores**2 / shrunk - np.log(shrunk)).sum(axis=-1))


def left_out_gains(
    evidence: Sequence[Evidence], chosen: Sequence[Sequence[int]], stds: Sequence[float]
) -> Array:
    """Return gains in log probability of every run predicted from the others, (choices, stds).

    evidence: as in `Columns.left_out`; chosen: indices of the columns, equally many per choice;
    stds: priors of their coefficients.
    """
    which = np.asarray(chosen)
    score = np.stack([item.score[which] for item in evidence])
    information = np.stack(
        [item.information[which[:, :, None], which[:, None, :]] for item in evidence]
    )
    gains = log_gains(score, information, stds)
    return np.asarray((gains[0] - gains[1:]).sum(axis=0))


def unit_fields(
    fit: Refit, before: Sequence[Array], effect: Effect, size: float
) -> tuple[Array, ...] | None:
    """Return the derivatives of points (frames, 2 targets) m by an amplitude, per run.

    before: points (frames, 2, targets) m of the fit; effect: with an amplitude of `size` in every
    frame of the runs. None if the arm has no shape with this effect.
    """
    linearization, point = fit.linearization, fit.point
    runs = range(len(linearization.blocks))
    after = linearization.points(replace(point, effects=(*point.effects, effect)).arm, runs)
    if after is None:
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
