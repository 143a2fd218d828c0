"""What these recordings could show: the smallest visible size of every effect, and look-alikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import itertools
import math

from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.result import Detectable
from pneunet_ros.diagnosis.score_test import Candidate, likeness

VISIBLE = 25.0  # of chi squared: five standard deviations
ALIKE = 0.3  # cosines of less are not worth a word
PRIOR_RANGE = 2.0  # standard deviations of the prior: its far end


def detection_limits(
    hypotheses: Sequence[Hypothesis], found: Sequence[Candidate]
) -> Mapping[str, Detectable]:
    """Return for every effect the size that gives a chi squared of 25 beside a refitted base.

    An effect that is another scale of pressure alone is never observable: kappa_p0(p) takes it up.
    """
    by_name = {item.hypothesis.name: item for item in found}
    out = {}
    for item in hypotheses:
        candidate = by_name.get(item.name)
        which = item.sizes[0] if candidate is None else candidate.which
        coordinate = item.coordinates[which]
        size = math.inf
        if candidate is not None and not item.confounded_with_pressure_scale:
            tried = abs(float(candidate.tried[which]))
            size = tried * math.sqrt(VISIBLE / candidate.information)
        smallest = 1.0 / size if coordinate.reciprocal else size
        out[item.name] = Detectable(
            parameter=coordinate.parameter,
            observable=size <= PRIOR_RANGE * coordinate.std,
            smallest=smallest,
            unit=coordinate.unit,
        )
    return out


def cosines(linear: GaussianModel, found: Sequence[Candidate]) -> Mapping[tuple[str, str], float]:
    """Return how alike effects act beside a refitted base, -1 to 1, where it is worth a word."""
    if not found:
        return {}
    alike = likeness(linear, found)
    names = [item.hypothesis.name for item in found]
    return {
        (names[i], names[j]): float(alike[i, j])
        for i, j in itertools.combinations(range(len(names)), 2)
        if abs(alike[i, j]) > ALIKE
    }
