"""Amplitude of a kind of cause, frame by frame, and the part explained by a law.

With X all unknowns of the base fit and V = 1 + X X^T, a kind at a place has a field per frame: the
change of the whitened points per unit of its amplitude, at equilibrium. The score z = E^T V^-1 r
and the information C = E^T V^-1 E of its columns are sufficient statistics of the recordings, with
base, placement and camera refitted. Columns are products of field and covariate, or of field and
frame indicator; z and C are those of all or some runs.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
import functools
from functools import cached_property
import itertools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel

Runs = tuple[int, ...]
Parts = tuple[Array, Array, Array]  # columns^T columns, X^T columns, columns^T residuals


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
        self.in_runs = functools.cache(gaussian.subset)

    def evidence(self, runs: Runs, gram: Array, cross: Array, score: Array) -> Evidence:
        """Return the evidence for columns in these runs.

        gram, cross, score: columns^T columns, X^T columns and columns^T residuals.
        """
        base = self.in_runs(runs)
        return Evidence(
            score=score - cross.T @ base.step, information=gram - cross.T @ base.solved(cross)
        )


class RunColumns(abc.ABC):
    """Columns of every run of a fit, for evidence in any subset of the runs."""

    @abc.abstractmethod
    def evidence(self, runs: Runs) -> Evidence:
        """Return score and information in these runs alone."""

    def left_out(self, runs: Runs) -> tuple[Evidence, ...]:
        """Return the evidence in these runs, then without each of them in turn."""
        return (
            self.evidence(runs),
            *(self.evidence(tuple(other for other in runs if other != which)) for which in runs),
        )

    def left_out_gain(self, runs: Runs, std: float) -> float:
        """Return the gain in log probability of every run, predicted from the others."""
        every = self.left_out(runs)
        return float(cross_validation_gains(every, [range(every[0].score.size)], [std])[0, 0])


@dataclass(frozen=True, eq=False)
class Columns(RunColumns):
    """Whitened columns (rows, n) of every run, with the same coefficients in all of them."""

    projection: Projection
    white: tuple[Array, ...]

    @cached_property
    def parts(self) -> list[Parts]:
        """The part of each run."""
        gaussian = self.projection.gaussian
        return [
            parts_of(*run)
            for run in zip(self.white, gaussian.columns, gaussian.residuals, strict=True)
        ]

    def evidence(self, runs: Runs) -> Evidence:
        """Return score and information in these runs alone."""
        sums = [np.zeros_like(part) for part in self.parts[0]]
        for which in runs:
            sums = [total + part for total, part in zip(sums, self.parts[which], strict=True)]
        return self.projection.evidence(runs, *sums)


@dataclass(frozen=True, eq=False)
class PerRunColumns(RunColumns):
    """Columns with coefficients of their own in every run, such as one per frame.

    Evidence covers the coefficients of all runs in order, with zeros for other runs.
    """

    projection: Projection
    parts: Sequence[Parts]

    @classmethod
    def of_frames(
        cls, projection: Projection, linearization: Linearization, fields: Sequence[Array]
    ) -> PerRunColumns:
        """Build columns from fields (frames, 2 targets) m per run, whitened frame by frame."""
        gaussian = projection.gaussian
        return cls(
            projection,
            [
                parts_of(block.white_by_frame(field[:, :, None]), columns, residuals)
                for block, field, columns, residuals in zip(
                    linearization.blocks, fields, gaussian.columns, gaussian.residuals, strict=True
                )
            ],
        )

    @cached_property
    def of_run(self) -> list[slice]:
        """The columns of each run."""
        ends = np.cumsum([0, *(score.size for _, _, score in self.parts)])
        return [slice(first, last) for first, last in itertools.pairwise(ends.tolist())]

    def combined(self, factors: Sequence[Array]) -> PerRunColumns:
        """Return weighted sums over the columns of every run; factors: (columns, n) per run."""
        return PerRunColumns(
            self.projection,
            [
                (factor.T @ gram @ factor, cross @ factor, factor.T @ score)
                for factor, (gram, cross, score) in zip(factors, self.parts, strict=True)
            ],
        )

    def evidence(self, runs: Runs) -> Evidence:
        """Return score and information in these runs alone."""
        count, base = self.of_run[-1].stop, self.projection.gaussian.position.size
        gram, cross, score = np.zeros((count, count)), np.zeros((base, count)), np.zeros(count)
        for which in runs:
            where = self.of_run[which]
            gram[where, where], cross[:, where], score[where] = self.parts[which]
        return self.projection.evidence(runs, gram, cross, score)


def parts_of(white: Array, columns: Array, residuals: Array) -> Parts:
    """Return columns^T columns, X^T columns and columns^T residuals of whitened columns."""
    return white.T @ white, columns.T @ white, white.T @ residuals


def log_gains(score: Array, information: Array, stds: Sequence[float] | Array) -> Array:
    """Return the log probability of runs with columns relative to that without, (..., stds).

    score (..., n) and information (..., n, n) of columns; stds: priors of their coefficients.
    """
    values, axes = np.linalg.eigh(information)
    scores = np.einsum('...ij,...i->...j', axes, score)[..., None, :]
    variances = np.square(stds)[:, None]
    shrunk = 1.0 + variances * np.maximum(values, 0.0)[..., None, :]
    return np.asarray(0.5 * (variances * scores**2 / shrunk - np.log(shrunk)).sum(axis=-1))


def cross_validation_gains(
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
