"""Steady states: holds of a staircase are found, averaged, freed of what the camera adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.reports.paper_views.steady_states import (
    find_steady_states,
    longest_states,
    predict_states,
    thin,
)
from pneunet_ros.solver.columns import X, Y
import pytest
from support.small_calibration import ARM, calibration, FRAMES, NOISE, TOP


@pytest.fixture(scope='module')
def stairs():
    """Return the steady states of the staircase."""
    fit = calibration(with_load=False).joint
    return find_steady_states(fit.runs[1], fit.arm)


def test_every_step_is_one_steady_state(stairs):
    assert [steady_state.frames for steady_state in stairs] == [4] * (FRAMES // 4)
    steps = np.linspace(0.0, TOP, FRAMES // 4)
    found = np.array([steady_state.pressure for steady_state in stairs])
    assert np.max(np.abs(found - steps)) < 3.0 * NOISE.pressure_std
    assert {steady_state.run for steady_state in stairs} == {'bags/stairs.mcap'}


def test_a_ramp_is_many_short_steady_states():
    fit = calibration(with_load=False).joint
    assert (
        max(steady_state.frames for steady_state in find_steady_states(fit.runs[0], fit.arm)) == 1
    )


def test_a_change_of_force_ends_a_steady_state():
    fit = calibration().joint
    assert len(find_steady_states(fit.runs[3], fit.arm)) > FRAMES // 3  # a sweep at one pressure


def test_mean_targets_are_where_the_model_has_them(stairs):
    fit = calibration(with_load=False).joint
    fields = predict_states(fit.arm, stairs, ARM.target_arclength)
    for steady_state, field in zip(stairs, fields, strict=True):
        away = np.hypot(steady_state.x - field[X], steady_state.y - field[Y])
        # without the place of camera and targets taken off it would be 0.1 mm everywhere
        assert np.nanmean(away[:12]) < NOISE.target_std


def test_effects_of_the_camera_are_taken_off(stairs):
    fit = calibration(with_load=False).joint
    from pneunet_ros.effects import EFFECTS

    turned = replace(fit.arm, effects=(EFFECTS['camera_rotation'](angle=0.1),))
    (first, *_), (other, *_) = stairs, find_steady_states(fit.runs[1], turned)
    back = np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]])
    assert np.allclose([other.x, other.y], back @ np.stack([first.x, first.y]), atol=1e-9)


def test_a_target_never_seen_stays_unknown(stairs):
    fit = calibration(with_load=False).joint
    run = fit.runs[1].run
    x, y = run.x.copy(), run.y.copy()
    x[:4, 5] = y[:4, 5] = np.nan
    blind = replace(fit.runs[1], run=replace(run, x=x, y=y))
    first = find_steady_states(blind, fit.arm)[0]
    assert np.isnan(first.x[5])
    assert first.count[5] == 0.0
    assert np.isnan(first.sightings(NOISE.target_std).std[5])
    assert first.sightings(NOISE.target_std).std[0] >= NOISE.target_std / 2.0


def test_the_longest_of_neighbors_is_chosen(stairs):
    short = [
        replace(steady_state, frames=1, pressure=steady_state.pressure + 500.0)
        for steady_state in stairs
    ]
    assert thin([*short, *stairs], len(stairs)) == list(stairs)


def test_the_way_between_holds_is_left_out(stairs):
    short = [
        replace(steady_state, frames=1, pressure=steady_state.pressure + 5e3)
        for steady_state in stairs[:-1]
    ]
    assert longest_states([*stairs, *short]) == list(stairs)
    assert longest_states([*stairs[:2], *short]) == [
        *stairs[:2],
        *short,
    ]  # these holds span too little
    assert longest_states([]) == []


def test_no_steady_state_is_predicted_to_nothing():
    assert predict_states(ARM, [], np.zeros(3)).shape == (0, 6, 3)
    assert thin([], 4) == []
