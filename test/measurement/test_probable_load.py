"""Where a frame is linearized: the load that its reading and its targets make most probable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.probable_load import probable_load_errors
from pneunet_ros.model.domain import DOMAIN
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

ARM = paper_arm()
PRESSURE = np.full(3, 33e3)
# A curled arm that is pulled this way opens: the noise of the sensor moves its tip by millimeters.
FORCE = np.array([[0.006, -0.0055], [0.0055, -0.005], [0.12, -0.11]])
MISREAD = np.array([[1.5e-3, -1e-3], [-1e-3, 1e-3], [1e-3, 0.0]])


def misread(error=MISREAD, load_known=False):
    """Return a run without any noise but that of the force as read, and its errors found."""
    exact = made(ARM, PRESSURE, FORCE)
    run = replace(exact, force=FORCE + error, load_known=load_known)
    (inputs,) = inputs_of(ARM, [run])
    model = ForwardModel(ARM.target_arclength)
    nothing = np.zeros_like(run.points)
    found = probable_load_errors(model, ARM, run, inputs, nothing, USUAL)
    return run, inputs, found, model


def apart(run, model, inputs):
    """Return by how much the targets are off (m)."""
    assert model.solve(ARM, inputs).all()
    return np.abs(run.points - model.points).max(axis=(1, 2))


def test_targets_say_what_the_sensor_misread_where_the_arm_is_compliant():
    run, inputs, found, model = misread()
    before, after = (
        apart(run, model, inputs),
        apart(run, model, inputs.with_loads(inputs.loads + found)),
    )
    assert before[:2].min() > 1.5e-3
    assert np.all(after < 0.05 * before)
    assert found[:2, :2] == pytest.approx(-MISREAD[:2], abs=0.4 * USUAL.force_std)
    assert not found[:, 2].any()


def test_what_no_noise_explains_is_not_taken_for_noise():
    assert not misread(error=20.0 * MISREAD)[2][:2].any()
    assert np.abs(misread()[2]).max() < DOMAIN.significant * USUAL.force_std


def test_a_known_load_and_no_load_have_no_errors():
    assert not misread(load_known=True)[2].any()
    run = made(ARM, PRESSURE)
    (inputs,) = inputs_of(ARM, [run])
    model = ForwardModel(ARM.target_arclength)
    nothing = np.zeros_like(run.points)
    assert not probable_load_errors(model, ARM, run, inputs, nothing, USUAL).any()


def snapped(error):
    """Return a run of an arm seen just before it snaps over, and the load as it was misread."""
    pressure = np.full(3, 5e3)
    raised = made(ARM, pressure, np.full((3, 2), [-0.0125, 0.03]))
    before = np.column_stack([np.full(3, -0.025), [-0.0058, -0.0055, -0.005]])
    exact = made(ARM, pressure, before)
    (inputs,) = inputs_of(ARM, [exact])
    model = ForwardModel(ARM.target_arclength, raised.points)
    assert model.solve(ARM, inputs).all()
    x, y = model.points[:, 0], model.points[:, 1]
    return replace(exact, x=x, y=y, force=before + error)


def test_an_arm_seen_before_it_snaps_is_looked_for_at_loads_at_which_it_has_not():
    run = snapped([0.0, -0.0015])
    (inputs,) = inputs_of(ARM, [run])
    model = ForwardModel(ARM.target_arclength, run.points)
    before = apart(run, model, inputs)
    assert before.min() > 0.1  # the load as read holds it only on the other side
    found = probable_load_errors(model, ARM, run, inputs, np.zeros_like(run.points), USUAL)
    assert np.abs(found).max() <= DOMAIN.significant * USUAL.force_std
    after = apart(run, model, inputs.with_loads(inputs.loads + found))
    assert after.max() < 0.02


def test_a_load_that_no_noise_explains_is_not_looked_for_around_the_reading():
    run = snapped([0.0, -0.02])
    (inputs,) = inputs_of(ARM, [run])
    model = ForwardModel(ARM.target_arclength, run.points)
    assert not probable_load_errors(
        model, ARM, run, inputs, np.zeros_like(run.points), USUAL
    ).any()
