"""The camera of the live lab: what the tracker makes of its images, by the shipped files."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import load_model
from pneunet_ros.lab.live import LiveLab, Load
from pneunet_ros.lab.motion import Film, SCENE
from pneunet_ros.messages.builders import header, image
from pneunet_ros.messages.tracker import camera_info_message, decode_camera_info, decode_image
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.vision.camera_settings import PosePlane
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
from support.lab_pairs import recorded

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
        message = image(film.image(shape, random), header(frame, *HEADING), ROSBAGS_TYPES)
        tracking, outcome = tracker.step(tracking, decode_image(message))
        assert isinstance(outcome, Tracking)
        points = lab.seen(shape)
        for found, there in (
            (outcome.sightings.x, points[:, 0]),
            (outcome.sightings.y, points[:, 1]),
        ):
            assert np.abs(found - there).max() < 1e-4
