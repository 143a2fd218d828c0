"""Errors hold what leaving out a loaded recording changes: a weight that is not what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

NOISE = replace(USUAL, target_std=1e-4, placement_std=0.0, registration_std=0.0, drift_std=0.0)
TRUTH = 1.5e-4  # N m^2
ARM = replace(
    paper_arm(),
    target_arclength=0.112 * np.array([0.0, 0.3, 0.6, 1.0]),
    sensors=replace(NOISE, placement_std=1e-5, registration_std=1e-5, drift_std=1e-5),
    covariance=None,
    moment_law=LinearLaw(bending_stiffness=TRUTH),
    intrinsic_curvature=IntrinsicCurvature(
        pressure=[0.0, 6.6e4], arclength=[0.0, 1.0], curvature=[[0.0, 0.0], [22.0, 22.0]]
    ),
)


@pytest.fixture(scope='module', params=[1.0, 1.4], ids=['as said', 'another weight'])
def found(request):
    """Return what is found where the last of three weights is so many times as large."""
    free = made(ARM, np.linspace(0.0, 6e4, 7), noise=NOISE)
    loaded = []
    for place, weight in enumerate((0.06, 0.1, 0.14)):
        factor = request.param if place == 2 else 1.0
        force = weight * np.column_stack([np.full(5, 0.5), np.linspace(0.2, 1.0, 5)])
        run = made(ARM, np.linspace(1e4, 5e4, 5), factor * force, noise=NOISE, seed=5 + place)
        loaded.append(replace(run, force=force, name=f'{place}', wrench=None))
    return request.param, calibrate([free], loaded, ARM), [free], loaded


def test_a_stiffness_is_as_sure_as_the_loads_agree(found):
    factor, calibration, _, _ = found
    fit = calibration.joint
    value, std = fit.values[-1], np.sqrt(fit.covariance[-1, -1])
    assert abs(value - TRUTH) < 3.0 * std
    said = any(note.reason == 'left_out_recordings' for note in calibration.notes)
    assert said is (factor > 1.0)
    assert bool(std > 0.02 * TRUTH) is (factor > 1.0)


def test_what_is_not_left_out_is_in_no_error(found):
    factor, calibration, free, loaded = found
    plain = calibrate(free, loaded, ARM, compare=False).joint
    more = calibration.joint.covariance[-1, -1] / plain.covariance[-1, -1]
    assert more == pytest.approx(1.0) if factor == 1.0 else more > 4.0
