"""The arm of the lab: its tables, and arms that vary from it."""

from __future__ import annotations

import dataclasses

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.lab_arm import vary_arm
import pytest
from scipy.integrate import cumulative_simpson
from support.lab_pairs import recorded
from support.refusals import refused

ARM = recorded('strings').scenario.arm


def test_the_unloaded_arm_turns_by_the_integral_of_its_curvature():
    s = np.linspace(0.0, ARM.length, 2001)
    integral = cumulative_simpson(ARM.intrinsic_curvature(s), x=s, axis=1, initial=0.0)
    assert ARM.turning_angle(s) == pytest.approx(integral, abs=1e-10)


def test_between_rows_all_is_linear_in_pressure():
    rows = ARM.curvature_pressure
    assert ARM.curvature_weights(rows) == pytest.approx(np.eye(rows.size))
    between = ARM.curvature_weights(np.array([0.25 * rows[1] + 0.75 * rows[2]]))[0]
    assert between[:4] == pytest.approx([0.0, 0.25, 0.75, 0.0])
    rigidity, split = ARM.stiffness(np.array([37950.0]))  # halfway from 31 to 44.9 kPa
    scale = ARM.weight * ARM.length**2
    assert rigidity[0] / scale == pytest.approx([0.08815, 0.05085])
    assert split[0] / ARM.length == pytest.approx(0.125)


def test_varied_arms_differ_by_up_to_15_percent():
    assert same_values(vary_arm(ARM, 0), ARM)
    assert same_values(vary_arm(ARM, 5), vary_arm(ARM, 5))
    s = np.linspace(0.0, ARM.length, 50)
    base, changes = ARM.intrinsic_curvature(s)[1:], []
    for seed in range(1, 200):
        arm = vary_arm(ARM, seed)
        ratios = (
            arm.intrinsic_curvature(s)[1:] / base,
            arm.rigidity / ARM.rigidity,
            arm.split / ARM.split,
        )
        changes.append([np.abs(ratio - 1.0).max() for ratio in ratios])
        assert arm.seed == seed
    assert np.max(changes) <= 0.15 + 1e-9
    assert np.min(np.max(changes, axis=0)) > 0.12  # of each, in some arm


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'length': -1.0}, 'out_of_bounds'),
        ({'split': np.full(4, 1.2)}, 'out_of_bounds'),
        ({'rigidity': np.full((4, 2), -0.1)}, 'singular_rigidity'),
        ({'targets': np.array([0.0, 0.2])}, 'out_of_bounds'),
        ({'targets': np.array([0.01, 0.0])}, 'not_increasing'),
        ({'law_pressure': np.array([7e4, 8e4, 9e4, 1e5])}, 'no_common_pressure'),
        ({'split': np.full(4, np.nan)}, 'not_finite'),
        ({'split': np.full(3, 0.1)}, 'wrong_shape'),
    ],
)
def test_an_impossible_arm_is_refused(changes, reason):
    with refused(RequestError, reason):
        dataclasses.replace(ARM, **changes)
