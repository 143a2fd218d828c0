"""What one sigma of a reading does to the causes of a shape, and the covariance that follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Load
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.measurement.errors.noise_jacobian import noise_jacobian, propagate_covariance
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.example_arms import paper_arm

STD = (0.01, 0.02, 1e-4, 60.0)
READING = Load(pressure=30e3, force_x=0.1, force_y=0.2, moment=1e-3)


def test_without_effects_of_sensing_every_source_is_a_cause():
    found = noise_jacobian(PerturbationTable(arm=paper_arm()), READING, STD)
    np.testing.assert_array_equal(found, np.diag(STD))


def test_a_gain_scales_the_noise_of_the_pressure_and_its_error_moves_it():
    gain = ModelCovariance(quantities=('effects.pressure_gain.gain',), factor=[[0.05]])
    arm = replace(paper_arm((PressureGain(gain=1.1),)), covariance=gain)
    expected = np.diag([*STD, 1.0])
    expected[3, 3] *= 1.1
    expected[4, 3] = 0.05 * READING.pressure
    found = noise_jacobian(PerturbationTable(arm=arm), READING, STD)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_turned_force_sensor_turns_its_noise():
    arm = paper_arm((EFFECTS['force_misalignment'](angle=0.3),))
    found = noise_jacobian(PerturbationTable(arm=arm), READING, (0.01, 0.01, 0.0, 60.0))
    covariance = found[:, :2].T @ found[:, :2]
    np.testing.assert_allclose(covariance, 1e-4 * np.eye(2), atol=1e-15)


def test_covariance_is_that_of_matrices_and_what_is_not_finite_is_told():
    random = np.random.default_rng(1)
    noise, tip = random.standard_normal((6, 6)), random.standard_normal((6, 3))
    stations, further = random.standard_normal((6, 6, 9)), random.standard_normal((3, 9))
    covariance, std = np.empty((3, 3)), np.empty((3, 9))
    assert propagate_covariance(noise, tip, stations, further, covariance, std)
    moved = noise @ tip
    own = np.outer(further[:, -1], further[:, -1])
    np.testing.assert_allclose(covariance, moved.T @ moved + own, rtol=1e-12)
    errors = np.tensordot(noise, stations[:, [0, 1, 3]], axes=1)
    variance = (errors**2).sum(axis=0)
    variance[:2] += further[:2] ** 2  # a curvature is none of its numbers
    np.testing.assert_allclose(std, np.sqrt(variance), rtol=1e-12)
    for wrong in (np.nan, np.inf):
        stations[2, 3, 4] = wrong
        assert not propagate_covariance(noise, tip, stations, further, covariance, std)


@pytest.mark.parametrize('name', sorted(EFFECTS))
def test_a_neutral_effect_adds_no_noise(name):
    table = PerturbationTable(arm=paper_arm((EFFECTS[name](),)))
    np.testing.assert_allclose(noise_jacobian(table, READING, STD), np.diag(STD), atol=1e-12)
