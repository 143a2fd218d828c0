"""Stances: the holds of a staircase are found, averaged, and freed of what the camera adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.steady_states import held, predicted, spread, stances
from pneunet_ros.measurement.forward_model import X, Y
import pytest
from support.small_calibration import ARM, calibration, FRAMES, NOISE, TOP


@pytest.fixture(scope='module')
def stairs():
    """Return the stances of the staircase."""
    fit = calibration(with_load=False).joint
    return stances(fit.runs[1], fit.arm)


def test_every_step_is_one_stance(stairs):
    assert [stance.frames for stance in stairs] == [4] * (FRAMES // 4)
    steps = np.linspace(0.0, TOP, FRAMES // 4)
    found = np.array([stance.pressure for stance in stairs])
    assert np.max(np.abs(found - steps)) < 3.0 * NOISE.pressure_std
    assert {stance.run for stance in stairs} == {'bags/stairs.mcap'}


def test_a_ramp_is_many_short_stances():
    fit = calibration(with_load=False).joint
    assert max(stance.frames for stance in stances(fit.runs[0], fit.arm)) == 1


def test_a_change_of_force_ends_a_stance():
    fit = calibration().joint
    assert len(stances(fit.runs[3], fit.arm)) > FRAMES // 3  # a sweep at one pressure


def test_mean_targets_are_where_the_model_has_them(stairs):
    fit = calibration(with_load=False).joint
    fields = predicted(fit.arm, stairs, ARM.target_arclength)
    for stance, field in zip(stairs, fields, strict=True):
        away = np.hypot(stance.x - field[X], stance.y - field[Y])
        # without the place of camera and targets taken off it would be 0.1 mm everywhere
        assert np.nanmean(away[:12]) < NOISE.target_std


def test_effects_of_the_camera_are_taken_off(stairs):
    fit = calibration(with_load=False).joint
    from pneunet_ros.effects import EFFECTS

    turned = replace(fit.arm, effects=(EFFECTS['camera_rotation'](angle=0.1),))
    (first, *_), (other, *_) = stairs, stances(fit.runs[1], turned)
    back = np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]])
    assert np.allclose([other.x, other.y], back @ np.stack([first.x, first.y]), atol=1e-9)


def test_a_target_never_seen_stays_unknown(stairs):
    fit = calibration(with_load=False).joint
    run = fit.runs[1].run
    x, y = run.x.copy(), run.y.copy()
    x[:4, 5] = y[:4, 5] = np.nan
    blind = replace(fit.runs[1], run=replace(run, x=x, y=y))
    first = stances(blind, fit.arm)[0]
    assert np.isnan(first.x[5])
    assert first.count[5] == 0.0
    assert np.isnan(first.sightings(NOISE.target_std).std[5])
    assert first.sightings(NOISE.target_std).std[0] >= NOISE.target_std / 2.0


def test_the_longest_of_neighbors_is_chosen(stairs):
    short = [replace(stance, frames=1, pressure=stance.pressure + 500.0) for stance in stairs]
    assert spread([*short, *stairs], len(stairs)) == list(stairs)


def test_the_way_between_holds_is_left_out(stairs):
    short = [replace(stance, frames=1, pressure=stance.pressure + 5e3) for stance in stairs[:-1]]
    assert held([*stairs, *short]) == list(stairs)
    assert held([*stairs[:2], *short]) == [*stairs[:2], *short]  # these holds span too little
    assert held([]) == []


def test_no_stance_is_predicted_to_nothing():
    assert predicted(ARM, [], np.zeros(3)).shape == (0, 6, 3)
    assert spread([], 4) == []
