"""Score test of each effect before it is fitted, and its detection limit.

The detection limit is the size at which the score would have been significant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import itertools
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis
from pneunet_ros.diagnosis.fit.law_errors import OpenLaws
from pneunet_ros.diagnosis.fit.refit import effect_direction, Refit
from pneunet_ros.diagnosis.result import Detectable
from pneunet_ros.diagnosis.settings import LACK_OF_FIT, SCORE_TEST, SELECTION
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel

DRAWS = 5000  # simulations of the largest score of clean data
NUGGET = 1e-9  # variance that is added, as directions of effects may be equal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """An effect that may be added to a refit: its reduction of chi squared, and a start.

    start (numbers,): start of a fit; tried (numbers,): values at which the effect was tried;
    which: index of the varied size. information: chi squared of this size on these recordings,
    after all other unknowns are refitted; direction: decrease of the whitened residuals (rows,)
    per run.
    """

    hypothesis: Hypothesis
    which: int
    tried: Array
    gain: float
    start: Array
    information: float
    direction: tuple[Array, ...]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.hypothesis.name


def score_effects(
    refit: Refit, hypotheses: Sequence[Hypothesis], problem: OpenLaws | None = None
) -> list[Candidate]:
    """Score every hypothesis that is not in a refit, most promising first.

    problem: linear problem of the refit with law errors; None: exact laws.
    """
    linearization = refit.linearization
    problem = problem or OpenLaws(gaussian=refit.gaussian)
    runs = range(linearization.training)
    residuals = linearization.residual(refit.point.values, refit.effects, runs)
    if residuals is None:
        return []
    scored = [
        score_effect(refit, problem, item, residuals)
        for item in hypotheses
        if item.name not in refit.names
    ]
    return sorted((item for item in scored if item is not None), key=lambda item: -item.gain)


def score_effect(
    refit: Refit, problem: OpenLaws, hypothesis: Hypothesis, residuals: list[Array]
) -> Candidate | None:
    """Return the best start of an effect; None if the arm has no shape with it.

    residuals (rows,) per training run: of the refit.
    """
    best = None
    for which, numbers in hypothesis.starts():
        effect = hypothesis.effect(numbers)
        direction = effect_direction(refit.linearization, refit, residuals, effect)
        if direction is None:
            continue
        direction = problem.white(direction)
        columns = [item[:, None] for item in direction]
        score = float(problem.gaussian.score(columns)[0])
        information = float(problem.gaussian.inner(columns, columns)[0, 0])
        if information <= 0.0:
            continue
        share = score / information
        if share * numbers[which] < hypothesis.coordinates[which].low:
            share, score = 0.0, 0.0
        gain = score**2 / information
        if best is not None and best.gain >= gain:
            continue
        start = numbers.copy()
        if not hypothesis.is_linear:
            most = SCORE_TEST.largest_step
            share = float(np.clip(share, 1.0 / most, most))
        start[which] *= share
        best = Candidate(
            hypothesis=hypothesis,
            which=which,
            tried=numbers,
            gain=gain,
            start=np.clip(start, hypothesis.low, hypothesis.high),
            information=information,
            direction=direction,
        )
    return best


def cosine_matrix(gaussian: GaussianModel, candidates: Sequence[Candidate]) -> Array:
    """Return the cosines of the effects' directions after refitting all other unknowns, (n, n)."""
    directions = zip(*(item.direction for item in candidates), strict=True)
    columns = [np.column_stack(run) for run in directions]
    inner = gaussian.inner(columns, columns)
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    cosines: Array = inner / np.outer(size, size)
    return cosines


def largest_clean_score(
    gaussian: GaussianModel, candidates: Sequence[Candidate], seed: int
) -> float:
    """Return the critical value of the largest score, at the level of the lack-of-fit tests.

    Simulated with correlated normal scores of the linearized refit.
    """
    if not candidates:
        return 0.0
    count = len(candidates)
    correlation = cosine_matrix(gaussian, candidates) + NUGGET * np.eye(count)
    random = np.random.default_rng([seed, DRAWS])
    draws = random.standard_normal((DRAWS, count)) @ np.linalg.cholesky(correlation).T
    return float(np.quantile(np.max(draws**2, axis=1), 1.0 - LACK_OF_FIT.level))


def detection_limits(
    hypotheses: Sequence[Hypothesis], candidates: Sequence[Candidate]
) -> Mapping[str, Detectable]:
    """Return the detection limit of every effect after refitting the base model.

    At the limit, the expected score is one sigma beyond the smallest gain of an additional effect,
    so that 84 of 100 such effects are found. An effect that only rescales the pressure is never
    observable, because kappa_p0(p) absorbs it.
    """
    by_name = {item.name: item for item in candidates}
    limits, visible = {}, (math.sqrt(SELECTION.least_gain) + 1.0) ** 2
    for item in hypotheses:
        candidate = by_name.get(item.name)
        which = item.sizes[0] if candidate is None else candidate.which
        coordinate = item.coordinates[which]
        size = math.inf
        if candidate is not None and not item.confounded_with_pressure_scale:
            tried = abs(float(candidate.tried[which]))
            size = tried * math.sqrt(visible / candidate.information)
        limits[item.name] = Detectable(
            parameter=coordinate.parameter,
            observable=size <= coordinate.end,
            smallest=1.0 / size if coordinate.reciprocal else size,
            expected=coordinate.expected,
            unit=coordinate.unit,
        )
    return limits


def effect_cosines(
    gaussian: GaussianModel, candidates: Sequence[Candidate]
) -> Mapping[tuple[str, str], float]:
    """Return the cosines between the directions of two effects, -1 to 1."""
    if not candidates:
        return {}
    cosines = cosine_matrix(gaussian, candidates)
    return {
        (candidates[i].name, candidates[j].name): float(cosines[i, j])
        for i, j in itertools.combinations(range(len(candidates)), 2)
    }
