"""No absolute size decides: an arm of any size, force and pressure gives the same answer."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.calibration.calibration import calibrate, Calibration
import pytest
from support.scaled import Size
from support.small_calibration import ARM, NOISE, runs_of

SIZES = [
    Size(length=0.125, force=0.0625),  # a finger of 14 mm
    Size(length=8.0, force=64.0),
    Size(pressure=0.125),
    Size(length=2.0, force=0.25, pressure=8.0),
]


@cache
def calibration(size: Size) -> Calibration:
    free, loaded = ([size.run(run) for run in runs] for runs in runs_of(ARM))
    return calibrate(free, loaded, size.arm(replace(ARM, sensors=NOISE)), compare=False)


@pytest.mark.lengthy
@pytest.mark.parametrize('size', SIZES)
def test_a_calibration_of_an_arm_of_another_size_is_the_same(size):
    expected, found = calibration(Size()), calibration(size)
    assert found.joint.converged
    assert found.notes == expected.notes
    back = Size(length=1.0 / size.length, force=1.0 / size.force, pressure=1.0 / size.pressure)
    arm = back.arm(found.arm)
    law, curvature = expected.arm.moment_law, expected.arm.intrinsic_curvature
    np.testing.assert_allclose(arm.intrinsic_curvature.pressure, curvature.pressure)
    # Both searches end within a twentieth of a sigma: `MapEstimationSettings.small_step`.
    std = np.sqrt(np.diag(expected.joint.covariance)[: curvature.curvature.size])
    difference = (arm.intrinsic_curvature.curvature - curvature.curvature).ravel()
    assert np.abs(difference / std).max() < 0.1
    np.testing.assert_allclose(arm.moment_law.rigidity, law.rigidity, rtol=1e-3)
    np.testing.assert_allclose(arm.moment_law.split, law.split, rtol=1e-2)
    for name in ('pressure_std', 'force_std', 'target_std', 'registration_std', 'drift_std'):
        assert getattr(arm.sensors, name) == pytest.approx(
            getattr(expected.arm.sensors, name),
            rel=5e-3,  # rounded to some digits
        )
