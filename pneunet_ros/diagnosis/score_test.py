"""How well each effect would explain what is left, before it is fitted: projected scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.refit import Refit
from pneunet_ros.effects.effect import Effect

DRAWS = 5000  # of clean data
NUGGET = 1e-9  # so that effects that act alike can be drawn together
SMALLEST_STEP, LARGEST_STEP = 0.3, 3.0  # from where an effect with a history was tried


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """An effect on top of a refit: by how much chi squared would fall, and where to begin.

    start (numbers,); tried: its sizes where the answer was taken; information: of one such size on
    these recordings, after refitting all else (chi squared per size squared); direction: the
    whitened answer (rows,) per run.
    """

    hypothesis: Hypothesis
    which: int
    tried: Array
    gain: float
    start: Array
    information: float
    direction: tuple[Array, ...]


def score_effects(refit: Refit, hypotheses: Sequence[Hypothesis]) -> list[Candidate]:
    """Try every hypothesis beside the effects of a refit, the most promising first."""
    own = [item for item in hypotheses if item.name not in refit.names]
    here = residuals(refit, refit.effects)
    if here is None:
        return []
    found = [candidate(refit, item, here) for item in own]
    return sorted((item for item in found if item is not None), key=lambda item: -item.gain)


def likeness(linear: GaussianModel, found: Sequence[Candidate]) -> Array:
    """Return the cosines of how effects act beside a refitted base, (effects, effects)."""
    columns = [
        np.column_stack([item.direction[run] for item in found])
        for run in range(len(linear.columns))
    ]
    inner = linear.inner(columns, columns)
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    alike: Array = inner / np.outer(size, size)
    return alike


def clean_score(
    linear: GaussianModel, found: Sequence[Candidate], level: float, seed: int
) -> float:
    """Return what the largest score of all effects exceeds in clean data with a probability.

    Simulated: normal scores of the linearized refit, with their correlations.
    """
    if not found:
        return 0.0
    alike = likeness(linear, found) + NUGGET * np.eye(len(found))
    random = np.random.default_rng([seed, DRAWS])
    draws = random.standard_normal((DRAWS, len(found))) @ np.linalg.cholesky(alike).T
    return float(np.quantile(np.max(draws**2, axis=1), 1.0 - level))


def residuals(refit: Refit, effects: Sequence[Effect]) -> list[Array] | None:
    """Return residuals (rows,) per training run with these effects, all else as refitted."""
    design = refit.design
    return design.residual(refit.point.values, effects, range(design.training))


def candidate(refit: Refit, hypothesis: Hypothesis, here: list[Array]) -> Candidate | None:
    """Try one; None where the arm has no shape with it. here: residuals without it."""
    best = None
    for which, numbers in hypothesis.starts():
        there = residuals(refit, (*refit.effects, hypothesis.effect(numbers)))
        if there is None:
            continue
        direction = tuple(a - b for a, b in zip(here, there, strict=True))
        columns = [item[:, None] for item in direction]
        score = float(refit.linear.score(columns)[0])
        information = float(refit.linear.inner(columns, columns)[0, 0])
        if information <= 0.0:
            continue
        share = score / information
        coordinate = hypothesis.coordinates[which]
        if share * numbers[which] < coordinate.low:
            share, score = 0.0, 0.0
        gain = score**2 / information
        if best is not None and best.gain >= gain:
            continue
        start = numbers.copy()
        if hypothesis.has_memory:
            share = float(np.clip(share, SMALLEST_STEP, LARGEST_STEP))
        start[which] *= share
        best = Candidate(
            hypothesis=hypothesis,
            which=which,
            tried=numbers,
            gain=gain,
            start=hypothesis.clipped(start),
            information=information,
            direction=direction,
        )
    return best
