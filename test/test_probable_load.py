"""Where a frame is linearized: the load that its reading and its targets make most probable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.probable_load import PROBABLE_LOAD, probable_load_errors
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
    assert np.abs(misread()[2]).max() < PROBABLE_LOAD.furthest * USUAL.force_std


def test_a_known_load_and_no_load_have_no_errors():
    assert not misread(load_known=True)[2].any()
    run = made(ARM, PRESSURE)
    (inputs,) = inputs_of(ARM, [run])
    model = ForwardModel(ARM.target_arclength)
    nothing = np.zeros_like(run.points)
    assert not probable_load_errors(model, ARM, run, inputs, nothing, USUAL).any()
