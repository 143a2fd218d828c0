"""The arm of the virtual lab moves as the model says."""

from __future__ import annotations

from functools import partial

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import load_model
from pneunet_ros.lab.live import LiveLab, Load
from pneunet_ros.lab.motion import Film, ramp, SCENE, sinus, up_and_down
from pneunet_ros.messages.camera import camera_info_message, grey_image_message
from pneunet_ros.messages.tracker import decode_camera_info, decode_image
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.vision.camera_settings import PosePlane
from pneunet_ros.vision.tracker import Tracker
from pneunet_ros.vision.tracker_state import TrackerState, Tracking
import pytest
from support.lab_pairs import recorded
from support.moving_arm import motion_of


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
    with pytest.raises(RequestError, match='50001 Pa'):
        motion.targets(50_001.0)
    with pytest.raises(RequestError, match='no shape at'):
        motion_of(arm, (0.0, 200e3))


@pytest.mark.parametrize(
    ('profile', 'expected'),
    [
        (
            partial(up_and_down, rest=1.0, rise=2.0, hold=0.5, top=50e3),
            {0.0: 0, 1.0: 0, 2.0: 25e3, 3.0: 50e3, 3.5: 50e3, 4.5: 25e3, 5.5: 0, 9.0: 0},
        ),
        (
            partial(sinus, rest=1.0, period=4.0, top=40e3),
            {0.5: 0, 1.0: 0, 2.0: 20e3, 3.0: 40e3, 4.0: 20e3, 5.0: 0, 7.0: 40e3},
        ),
        (
            partial(ramp, rest=1.0, rate=10e3, top=30e3),
            {0.0: 0, 1.0: 0, 2.5: 15e3, 4.0: 30e3, 8.0: 30e3},
        ),
    ],
    ids=['up_and_down', 'sinus', 'ramp'],
)
def test_profiles(profile, expected):
    for time, pressure in expected.items():
        assert profile(time) == pytest.approx(pressure, abs=1e-6)


# ---- live --------------------------------------------------------------------------------------

HEADING = ('camera', ROSBAGS_TYPES)


def test_the_camera_file_says_where_the_camera_is():
    plane = load_camera(share_path('config/lab_camera.yaml')).plane
    assert isinstance(plane, PosePlane)
    assert plane.position == tuple(np.round(SCENE.camera.position, 12).tolist())
    assert tuple(plane.quaternion) == (1.0, 0.0, 0.0, 0.0)
    assert np.array_equal(SCENE.camera.rotation, np.diag([1.0, -1.0, -1.0]))


def test_the_tracker_finds_all_targets_where_they_are():
    lab = LiveLab(scenario=recorded('unloaded_ramp').scenario)
    film, random = Film(lab), np.random.default_rng(0)
    tracker = Tracker(
        load_model(share_path('config/lab_arm.yaml')),
        load_camera(share_path('config/lab_camera.yaml')),
    )
    lens = decode_camera_info(camera_info_message(SCENE.camera, 1, *HEADING))
    tracking, _ = tracker.step(TrackerState(), lens)
    state = lab.begin()
    load = Load(force_x=0.05, force_y=0.05)
    # Already bent when the first image comes: the camera knows where it is.
    for frame, command in enumerate((30e3, 31e3, 33e3, 32e3), start=1):
        state, shape = lab.shape(lab.step(state, 2.0 + 0.1 * frame, command, load))
        message = grey_image_message(film.image(shape, random), frame, *HEADING)
        tracking, outcome = tracker.step(tracking, decode_image(message))
        assert isinstance(outcome, Tracking)
        points = lab.seen(shape)
        for found, there in (
            (outcome.sightings.x, points[:, 0]),
            (outcome.sightings.y, points[:, 1]),
        ):
            assert np.abs(found - there).max() < 1e-4
