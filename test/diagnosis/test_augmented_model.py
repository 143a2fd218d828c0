"""The numbers that a diagnosis states of its effects: values with the errors of their laws."""

from __future__ import annotations

from dataclasses import replace
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from pneunet_ros.diagnosis.fit.augmented_model import (
    augment_model,
    describe_effects,
    fit_with_effects,
)
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect
import pytest
from support.lab_designs import asked, fitted


def fit_of(name: str, std: float, **parameters: float) -> Any:
    """Return a fit of one effect, every number of it with this standard error."""
    item = asked(name)
    numbers = item.numbers(EFFECTS[name](**parameters))
    return SimpleNamespace(
        hypotheses=(item,), numbers=numbers, covariance=std**2 * np.eye(numbers.size)
    )


def test_the_error_of_a_law_counts_from_what_is_neutral():
    (found,) = describe_effects(fit_of('camera_scale', 0.0, factor=1.02), {'camera_scale': 1.0})
    error = EFFECTS['camera_scale'].law_error
    assert found.parameters['factor'].std == pytest.approx(0.02 * error)
    (found,) = describe_effects(fit_of('extensibility', 0.0, axial_stiffness=40.0), {})
    assert found.parameters['axial_stiffness'].std == pytest.approx(40.0 * error)


def test_a_time_constant_has_the_relative_error_of_its_law_however_far_from_its_default():
    for seconds in (3.0, 60.0, 200.0):
        fit = fit_of('creep', 0.0, amplitude=0.1, time_constant=seconds)
        (found,) = describe_effects(fit, {})
        wanted = seconds * EFFECTS['creep'].law_error
        assert found.parameters['time_constant'].std == pytest.approx(wanted)


def test_errors_of_the_fit_and_of_the_law_add_in_squares():
    (found,) = describe_effects(fit_of('hysteresis', 30.0, width=1000.0), {})
    assert found.parameters['width'].std == pytest.approx(math.hypot(30.0, 50.0))


def test_each_of_two_effects_takes_up_what_the_law_of_the_other_misses():
    one, other = asked('hysteresis'), asked('camera_scale')
    numbers = np.concatenate(
        [
            one.numbers(EFFECTS['hysteresis'](width=1000.0)),
            other.numbers(EFFECTS['camera_scale'](factor=1.02)),
        ]
    )
    fit: Any = SimpleNamespace(
        hypotheses=(one, other), numbers=numbers, covariance=np.zeros((numbers.size,) * 2)
    )
    found = {effect.name: effect.parameters for effect in describe_effects(fit, {})}
    assert found['hysteresis']['width'].std == pytest.approx(math.sqrt(2.0) * 50.0)
    assert found['camera_scale']['factor'].std == pytest.approx(math.sqrt(2.0) * 0.001)


def test_no_law_is_taken_for_exact():
    assert Effect.law_error > 0.0
    assert all(0.0 < kind.law_error < 0.5 for kind in EFFECTS.values())


def test_the_error_of_a_base_that_was_found_stays_in_the_model(monkeypatch):
    """Only a calibration had it: after a diagnosis the clamp was known exactly."""
    found = fitted('load_offset', 'load_offset')
    turned = [replace(run, base_turn_std=0.05) for run in found.linearization.runs]
    monkeypatch.setattr(found.linearization, 'runs', turned)
    covariance = augment_model(found, fit_with_effects(found)).covariance
    turn = covariance.factor[covariance.quantities.index('arm.clamp_angle')]
    assert np.linalg.norm(turn) == pytest.approx(0.05)
    assert covariance.quantities[-1] == 'effects.load_offset.offset'
    assert covariance.factor[-1, -1] > 0.0
