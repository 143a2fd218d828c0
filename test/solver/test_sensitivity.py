"""Sensitivity: each variation is a solve with one quantity changed, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import solve
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw
from pneunet_ros.reports.paper_views.sensitivity import FACTORS, SPLITS, variations
from pneunet_ros.reports.paper_views.steady_states import find_steady_states
import pytest
from support.small_calibration import ARM, calibration

SECTION = {'width': 0.015, 'thickness': 0.003, 'height': 0.012, 't1': 0.002, 't2': 0.008}


@pytest.fixture(scope='module')
def steady_state():
    """Return a loaded steady state."""
    fit = calibration().joint
    return find_steady_states(fit.runs[2], fit.arm)[-6]


def test_each_is_one_change(steady_state):
    force, splitting, rigidity = variations(ARM, steady_state)
    f1, f2 = steady_state.force.tolist()
    for factor, shape in zip(FACTORS, force.shapes, strict=True):
        alone = solve(ARM, steady_state.pressure, (factor * f1, f2))
        assert np.allclose(shape.x, alone.x, atol=1e-9)
    law = ARM.moment_law
    for split, shape in zip(SPLITS, splitting.shapes, strict=True):
        moved = replace(law, split=np.full(law.split.size, split))
        alone = solve(replace(ARM, moment_law=moved), steady_state.pressure, (f1, f2))
        assert np.allclose(shape.y, alone.y, atol=1e-9)
    nominal = solve(ARM, steady_state.pressure, (f1, f2))
    assert np.allclose(rigidity.shapes[2].x, nominal.x, atol=1e-9)
    assert rigidity.labels[2] == 'as fitted'
    assert force.travel > 1e-3


@pytest.mark.parametrize(
    ('law', 'name'),
    [(LinearLaw(bending_stiffness=1.4e-4), 'EI'), (MajidiLaw(modulus=3e6, **SECTION), 'E')],
    ids=['linear', 'majidi'],
)
def test_a_law_of_one_section_has_no_l1(steady_state, law, name):
    arm = replace(ARM, moment_law=law, covariance=None)
    found = variations(arm, steady_state)
    assert [variation.name for variation in found] == ['F1', name]
    first, *_, last = found[1].shapes
    assert not np.allclose(first.x, last.x, atol=1e-5)
