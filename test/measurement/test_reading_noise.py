"""The noise of readings that effects remember: it widens errors of effects with a memory alone."""

from __future__ import annotations

import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from pneunet_ros.diagnosis.fit import reading_noise
from pneunet_ros.diagnosis.fit.linearization import KnownInputs
from pneunet_ros.diagnosis.fit.reading_noise import double_reading_noise, with_reading_noise
from pneunet_ros.diagnosis.fit.refit import Refit
from support.lab_designs import asked, fitted


def more(refit: Refit, pressure_std: float) -> float:
    """Return the variance that the noise of a sensor like this adds to the first number."""
    linearization = copy.copy(refit.linearization)
    linearization.noise = replace(linearization.noise, pressure_std=pressure_std)
    linearization.known_inputs = KnownInputs(linearization.runs, linearization.noise)
    louder = with_reading_noise(replace(refit, linearization=linearization), 1)
    return float(louder.covariance[0, 0] - refit.covariance[0, 0])


def test_without_a_memory_nothing_changes():
    refit: Any = SimpleNamespace(hypotheses=(asked('load_offset'), asked('gravity')))
    assert with_reading_noise(refit, seed=1) is refit


def test_a_play_is_known_less_well_the_noisier_the_sensor(monkeypatch):
    few = replace(reading_noise.READING_NOISE, draws=4)
    monkeypatch.setattr(reading_noise, 'READING_NOISE', few)
    refit = fitted('hysteresis', 'hysteresis')
    quiet, usual, loud = (more(refit, std) for std in (1.0, 60.0, 300.0))
    assert 0.0 <= quiet < usual < loud
    assert loud > refit.covariance[0, 0]  # with a poor sensor it is most of the error


def test_noise_of_the_frames_own_readings_is_not_added_again():
    linearization = fitted('hysteresis', 'hysteresis').linearization
    moved = double_reading_noise(linearization, np.random.default_rng(3))
    base = linearization.point
    without = replace(base, effects=()).arm
    before, after = (item.known_inputs.of(without) for item in (linearization, moved))
    for one, other in zip(before, after, strict=True):
        # At a triggered reading the line's change is taken off again; between two it may stay.
        assert np.abs(one.pressure - other.pressure).max() < linearization.noise.pressure_std * 4.0
