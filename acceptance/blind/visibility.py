"""How much each of several hidden effects shows beside the others; no diagnosis is told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pneunet_ros.diagnosis.diagnosis import Investigation
from pneunet_ros.diagnosis.refit import Refit, refit
from pneunet_ros.diagnosis.score_test import Candidate


def shown_beside(found: Investigation, names: Sequence[str]) -> dict[str, float]:
    """Return by how much each effect lowers chi squared beside the others, fitted jointly.

    Empty where nothing settled, or the recordings show one of them not at all.
    """
    if found.selection is None or found.base is None:
        return {}
    candidates = {item.name: item for item in found.selection.score_candidates(found.base)}
    if not set(names) <= set(candidates):
        return {}
    chosen = [candidates[name] for name in names]
    every = fitted(found, chosen)
    if every is None:
        return {}
    shown = {}
    for name in names:
        rest = fitted(found, [item for item in chosen if item.name != name])
        if rest is not None:
            shown[name] = 2.0 * (rest.cost - every.cost)
    return shown


def fitted(found: Investigation, chosen: Sequence[Candidate]) -> Refit | None:
    """Return the joint fit of candidates, from where their scores begin."""
    assert found.selection is not None and found.base is not None
    settings = found.selection.settings.refit
    return refit(
        found.base.refit.linearization,
        [item.hypothesis for item in chosen],
        np.concatenate([item.start for item in chosen]),
        settings.rounds,
        settings,
    )
