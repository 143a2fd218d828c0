"""Detectability: the smallest visible size of every effect, and effects with like directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import itertools
import math

from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.result import Detectable
from pneunet_ros.diagnosis.score_test import Candidate, cosine_matrix
from pneunet_ros.diagnosis.settings import DEFAULTS, DetectabilitySettings


def detection_limits(
    hypotheses: Sequence[Hypothesis],
    candidates: Sequence[Candidate],
    settings: DetectabilitySettings = DEFAULTS.detectability,
) -> Mapping[str, Detectable]:
    """Return for every effect the size that is visible after refitting the base model.

    An effect that is another scale of pressure alone is never observable: kappa_p0(p) takes it up.
    """
    by_name = {item.name: item for item in candidates}
    limits = {}
    for item in hypotheses:
        candidate = by_name.get(item.name)
        which = item.sizes[0] if candidate is None else candidate.which
        coordinate = item.coordinates[which]
        size = math.inf
        if candidate is not None and not item.confounded_with_pressure_scale:
            tried = abs(float(candidate.tried[which]))
            size = tried * math.sqrt(settings.visible / candidate.information)
        limits[item.name] = Detectable(
            parameter=coordinate.parameter,
            observable=size <= settings.prior_range * coordinate.std,
            smallest=1.0 / size if coordinate.reciprocal else size,
            unit=coordinate.unit,
        )
    return limits


def effect_cosines(
    gaussian: GaussianModel,
    candidates: Sequence[Candidate],
    settings: DetectabilitySettings = DEFAULTS.detectability,
) -> Mapping[tuple[str, str], float]:
    """Return the cosine of every two effects' directions, -1 to 1, where it is worth a word."""
    if not candidates:
        return {}
    cosines = cosine_matrix(gaussian, candidates)
    return {
        (candidates[i].name, candidates[j].name): float(cosines[i, j])
        for i, j in itertools.combinations(range(len(candidates)), 2)
        if abs(cosines[i, j]) > settings.least_cosine
    }
