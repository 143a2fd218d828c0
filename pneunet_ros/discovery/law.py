"""A law of an amplitude: its covariates, selected by left-out recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.discovery.amplitude import Columns, cross_validation_gains, Runs
from pneunet_ros.discovery.covariates import Covariate
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.discovery.settings import LAW, MOST_TERMS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """A kind at a place, with the columns of possible laws.

    position (s / l), None if it has none; fields (frames, 2 targets) m per unit of amplitude, per
    run; covariates: those that its amplitude may follow; terms: names of the columns, first those
    of the covariates. A column is for the kind's prior times a covariate of size one.
    """

    kind: Kind
    position: float | None
    fields: tuple[Array, ...]
    covariates: tuple[Covariate, ...]
    terms: tuple[str, ...]
    columns: Columns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """Terms of a cause, and their gain.

    coefficients (terms,) and covariance, in units of the kind's prior per scaled covariate;
    left_out_gain: in log probability of every run predicted from the others; explained: reduction
    of chi squared; std: prior of the coefficients.
    """

    cause: Cause
    terms: tuple[str, ...]
    coefficients: Array
    covariance: Array
    left_out_gain: float
    explained: float
    std: float


def choose_law(cause: Cause, runs: Runs) -> Law | None:
    """Return the terms that best predict each run from the others; None if none does.

    Forward selection: the best term, then the best additional one, while the gain is large enough.
    """
    evidence = cause.columns.left_out(runs)
    best: Law | None = None
    chosen: list[int] = []
    gain = 0.0
    while len(chosen) < MOST_TERMS:
        rivals = [term for term in range(len(cause.terms)) if term not in chosen]
        if not rivals:
            break
        gains = cross_validation_gains(
            evidence, [[*chosen, term] for term in rivals], LAW.prior_sizes
        )
        row, column = np.unravel_index(gains.argmax(), gains.shape)
        most, std, term = float(gains.max()), LAW.prior_sizes[column], rivals[row]
        if most < gain + LAW.least_gain:
            break
        chosen.append(term)
        gain = most
        part = evidence[0].part(chosen)
        coefficients, covariance = part.estimate(std)
        best = Law(
            cause=cause,
            terms=tuple(cause.terms[term] for term in chosen),
            coefficients=coefficients,
            covariance=covariance,
            left_out_gain=gain,
            explained=part.explained,
            std=float(std),
        )
    return best
