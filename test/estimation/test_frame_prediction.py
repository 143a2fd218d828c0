"""Targets between two estimates, beside the rod solved there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.frame_prediction import predict_frame
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.model.equilibrium import solve
import pytest
from support.example_arms import paper_arm
from support.made_datasets import USUAL

ARM = replace(paper_arm(), sensors=USUAL)
PERIOD = 20_000_000  # ns
START = 1_000_000_000


def estimates(pressures, forces, late: int = 0):
    """Return estimates at pressures (Pa), F2 (N); a wrench is known so many readings late."""
    estimator, state = Estimator(arm=ARM), EstimatorState()
    found = []
    for index, pressure in enumerate(pressures):
        of = max(index - late, 0)
        stamp = START + index * PERIOD
        wrench = WrenchReading(
            stamp_ns=START + of * PERIOD,
            force_x=0.1,
            force_y=forces[of],
            moment=0.0,
            frame_id='pneunet_base',
        )
        state, _ = estimator.step(state, wrench)
        state, estimate = estimator.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
        found.append(estimate)
    return estimator, found


def truth(pressure, force):
    shape = solve(ARM, pressure=pressure, force=(0.1, force), stations=2241)
    places = ARM.target_arclength
    return [np.interp(places, shape.arclength, values) for values in (shape.x, shape.y)]


@pytest.mark.parametrize('late', [0, 1], ids=['wrench in time', 'wrench late'])
@pytest.mark.parametrize('share', [0.0, 0.3, 0.5, 0.9])
def test_on_a_ramp_targets_are_where_the_ramp_is(late, share):
    pressures, forces = 30e3 + 2e3 * np.arange(6), 0.05 + 2e-3 * np.arange(6)
    estimator, found = estimates(pressures.tolist(), forces.tolist(), late)
    predicted = predict_frame(estimator, found, START + round((2 + share) * PERIOD))
    x, y = truth(34e3 + 2e3 * share, 0.054 + 2e-3 * share)
    np.testing.assert_allclose(predicted.x, x, atol=3e-5)
    np.testing.assert_allclose(predicted.y, y, atol=3e-5)
    # The arm has gone 0.6 mm and more from the nearest estimate on the way.
    nearest = predict_frame(estimator, found[2:3], START + 2 * PERIOD)
    if share == 0.5:
        assert np.hypot(predicted.x - nearest.x, predicted.y - nearest.y)[-1] > 5e-4


def test_noise_of_two_readings_averages_out():
    estimator, found = estimates([30e3] * 6, [0.1] * 6)
    at, between = (
        predict_frame(estimator, found, START + round(place * PERIOD)).errors for place in (2, 2.5)
    )
    np.testing.assert_allclose(between[: PRESSURE + 1], at[: PRESSURE + 1] / np.sqrt(2.0))
    np.testing.assert_array_equal(between[PRESSURE + 1 :], at[PRESSURE + 1 :])


def test_in_a_jump_the_pressure_is_as_uncertain_as_its_instant():
    estimator, found = estimates([20e3] * 3 + [24e3] * 3, [0.1] * 6)
    errors = predict_frame(estimator, found, START + round(2.5 * PERIOD)).errors
    moved = np.subtract(truth(24e3, 0.1), truth(20e3, 0.1))
    np.testing.assert_allclose(errors[PRESSURE], 0.5 * moved, rtol=0.05, atol=2e-5)
