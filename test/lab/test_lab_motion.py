"""The arm of the virtual lab moves as the model says."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.files.model_file import load_model
from pneunet_ros.model.equilibrium import solve
import pytest
from support.moving_arm import motion_of, up_and_down
from support.refusals import refused


@pytest.fixture(scope='module')
def arm(checkout):
    return load_model(checkout / 'config/paper_arm.yaml')


@pytest.fixture(scope='module')
def motion(arm):
    return motion_of(arm, (0.0, 50e3))


@pytest.mark.parametrize('pressure', [0.0, 3333.0, 23.7e3, 49.1e3, 50e3])
def test_targets_are_where_the_arm_is(arm, motion, pressure):
    shape = solve(arm, pressure, stations=2241)  # every 0.05 mm, so that targets are stations
    at = np.rint(arm.target_arclength / 0.00005).astype(int)
    np.testing.assert_allclose(shape.arclength[at], arm.target_arclength, atol=1e-9)
    np.testing.assert_allclose(motion.targets(pressure), [shape.x[at], shape.y[at]], atol=3e-6)


def test_the_band_of_the_arm_follows_its_targets(motion):
    moment = motion.frame_state(40e3)
    places = np.stack([moment.body.x, moment.body.y], axis=1)
    for x, y in zip(moment.dots.x, moment.dots.y, strict=True):
        assert np.hypot(*(places - [x, y]).T).min() < 0.0011
    slope = np.arctan2(np.diff(moment.body.y), np.diff(moment.body.x))
    np.testing.assert_allclose(
        slope, 0.5 * (moment.body.theta[1:] + moment.body.theta[:-1]), atol=0.003
    )


def test_dots_move_as_far_as_the_pressure_changes_while_the_shutter_is_open(motion):
    dots = motion.frame_state(30e3, 29e3, 31e3).dots
    expected = motion.targets(31e3) - motion.targets(29e3)
    np.testing.assert_array_equal(dots.motion, expected.T)
    np.testing.assert_array_equal([dots.x, dots.y], motion.targets(30e3))
    assert np.hypot(*dots.motion.T)[-1] > 5e-4
    assert not motion.frame_state(30e3).dots.motion.any()


def test_misplaced_targets_turn_with_the_arm(arm, motion):
    placement = np.random.default_rng(0).normal(0.0, 0.0003, (arm.target_arclength.size, 2))
    misplaced = motion_of(arm, (0.0, 50e3), placement=placement)
    np.testing.assert_allclose(
        (misplaced.targets(0.0) - motion.targets(0.0)).T, placement, atol=1e-12
    )
    moved = (misplaced.targets(50e3) - motion.targets(50e3)).T
    np.testing.assert_allclose(np.hypot(*moved.T), np.hypot(*placement.T), rtol=1e-6)
    shape = solve(arm, 50e3)
    theta = np.interp(arm.target_arclength, shape.arclength, shape.theta)
    turn = np.angle((moved @ [1, 1j]) / (placement @ [1, 1j]))
    np.testing.assert_allclose(turn, theta, atol=0.01)


def test_a_loaded_arm_is_elsewhere(arm, motion):
    loaded = motion_of(arm, (0.0, 30e3), force=(0.1, 0.05))
    shape = solve(arm, 30e3, force=(0.1, 0.05))
    assert loaded.targets(30e3)[:, -1] == pytest.approx(
        [
            np.interp(arm.target_arclength[-1], shape.arclength, values)
            for values in (shape.x, shape.y)
        ],
        abs=1e-5,
    )
    assert np.abs(loaded.targets(30e3) - motion.targets(30e3)).max() > 0.002


def test_pressures_beyond_the_range_are_refused(arm, motion):
    with pytest.raises(RequestError):
        motion.targets(50_001.0)
    with refused(RequestError, 'no_equilibrium'):
        motion_of(arm, (0.0, 200e3))


@pytest.mark.parametrize(
    ('time', 'pressure'),
    [(0.0, 0), (1.0, 0), (2.0, 25e3), (3.0, 50e3), (3.5, 50e3), (4.5, 25e3), (5.5, 0), (9.0, 0)],
)
def test_it_goes_up_and_down(time, pressure):
    risen = up_and_down(time, rest=1.0, rise=2.0, hold=0.5, top=50e3)
    assert risen == pytest.approx(pressure, abs=1e-6)
