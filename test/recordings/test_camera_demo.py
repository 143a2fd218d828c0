"""The shipped recording of a camera is what its script makes, and its truth is in its images."""

from __future__ import annotations

import csv
from importlib.util import module_from_spec, spec_from_file_location

import cv2
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.messages.readings import decode_pressure
from pneunet_ros.offline.track import track_steps
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.tracker import Tracker
import pytest
from rosbags.rosbag2 import Reader

IMAGES = 241
TARGETS = 23
SECOND = 10**9


@pytest.fixture(scope='module')
def folder(checkout):
    return checkout / 'bags' / 'camera_demo'


@pytest.fixture(scope='module')
def script(folder):
    spec = spec_from_file_location('make_camera_demo', folder / 'make_camera_demo.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def messages(folder):
    """Return what each topic holds: (log time, message)."""
    recording = open_recording(folder)
    found = {topic.name: [] for topic in recording.topics}
    for topic, log_time, message, _ in recording.messages(list(found)):
        found[topic].append((log_time, message))
    return found


@pytest.fixture(scope='module')
def truth(folder):
    """Return columns of truth.csv, (images, targets)."""
    with (folder / 'truth.csv').open(encoding='utf-8', newline='') as stream:
        rows = list(csv.DictReader(stream))
    return {
        name: np.array([float(row[name]) for row in rows]).reshape(IMAGES, TARGETS)
        for name in rows[0]
    }


def image_of(messages, index):
    _, message = messages['/pneunet/image_raw/compressed'][index]
    return cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)


def test_the_folder_is_a_small_recording_with_script_and_truth(folder):
    files = {file.name: file.stat().st_size for file in folder.iterdir() if file.is_file()}
    assert set(files) == {
        'README.md',
        'make_camera_demo.py',
        'metadata.yaml',
        'camera_demo.mcap',
        'truth.csv',
    }
    assert sum(files.values()) < 5_000_000
    assert files['truth.csv'] < 500_000
    with Reader(folder) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert counts == {
        '/pneunet/image_raw/compressed': IMAGES,
        '/pneunet/camera_info': IMAGES,
        '/pneunet/pressure': 481,
    }


@pytest.mark.parametrize('index', [0, 40, 88, 130, 240])
def test_images_are_what_the_script_renders(script, messages, index):
    rendered, _ = script.picture(index)
    share_path = image_of(messages, index)
    assert share_path.shape == (480, 640)
    # JPEG takes some of the noise away; it must not take more.
    assert np.abs(share_path.astype(float) - rendered).mean() < 1.5
    again = script.image_message(0, rendered).data
    decoded = cv2.imdecode(np.frombuffer(again, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.abs(share_path.astype(float) - decoded).mean() < 0.3


def test_the_truth_is_what_the_script_says(script, truth):
    names = ('stamp_ns', 'id', 'u', 'v', 'x', 'y', 'visible')
    steps = np.array([0.0, 0.0, 0.001, 0.001, 1e-7, 1e-7, 0.001])  # the last digits
    stamps = script.stamps(30)
    for index in [*range(0, IMAGES, 8), 80, 84, 88, 92]:
        lines = list(script.truth_lines(stamps[index], script.picture(index)[1]))
        made = np.array([[float(word) for word in line.split(',')] for line in lines])
        share_path = np.stack([truth[name][index] for name in names], axis=1)
        assert np.all(np.abs(made - share_path) <= 1.01 * steps)


def test_making_a_recording_of_three_images_works(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script, 'DURATION', 2.0 / 30)
    script.make(tmp_path / 'camera_demo')
    found = [raw for _, _, raw in _raw(tmp_path / 'camera_demo')]
    assert len(found) == 3 + 3 + 5
    text = (tmp_path / 'camera_demo/truth.csv').read_text(encoding='utf-8')
    assert len(text.splitlines()) == 1 + 3 * TARGETS


def _raw(path):
    recording = open_recording(path)
    return [item[:3] for item in recording.raw_messages([t.name for t in recording.topics])]


def test_stamps_are_regular_and_log_times(script, messages, truth):
    images = messages['/pneunet/image_raw/compressed']
    assert [time for time, _ in images] == script.stamps(30)
    assert [time for time, _ in messages['/pneunet/camera_info']] == script.stamps(30)
    for time, message in [*images, *messages['/pneunet/camera_info']]:
        assert message.header.stamp.sec * SECOND + message.header.stamp.nanosec == time
        assert message.header.frame_id == 'camera'
    assert np.all(truth['stamp_ns'] == np.array(script.stamps(30))[:, None])
    assert np.all(truth['id'] == np.arange(TARGETS))


def test_the_camera_is_the_one_that_saw(script, messages):
    camera = script.SCENE.camera
    for _, info in messages['/pneunet/camera_info']:
        assert (info.width, info.height, info.distortion_model) == (640, 480, 'plumb_bob')
        np.testing.assert_array_equal(info.k, camera.matrix.ravel())
        np.testing.assert_array_equal(info.d, camera.distortion)
    assert -0.3 < camera.distortion[0] < -0.2


def test_pressure_rests_rises_and_falls(messages):
    readings = [decode_pressure(message) for _, message in messages['/pneunet/pressure']]
    seconds = np.array([reading.stamp_ns for reading in readings]) / SECOND - 1.0
    pressure = np.array([reading.pressure for reading in readings])
    rest = (seconds < 1.0) | (seconds > 7.4)
    assert 45.0 < pressure[rest].std() < 75.0
    assert np.abs(pressure[rest]).max() < 300.0
    assert pressure[(seconds > 4.0) & (seconds < 4.4)].mean() == pytest.approx(50e3, abs=60.0)
    assert all(reading.variance == 0.0 for reading in readings)


def test_the_arm_starts_straight_and_stays_in_view(truth):
    np.testing.assert_allclose(truth['x'][:30], np.tile(0.005 * np.arange(TARGETS), (30, 1)))
    np.testing.assert_array_equal(truth['y'][:30], 0.0)
    assert truth['u'].min() > 20.0 and truth['u'].max() < 620.0
    assert truth['v'].min() > 20.0 and truth['v'].max() < 460.0
    assert truth['y'][:, -1].max() > 0.06
    assert np.ptp(truth['v'][0]) > 2.0  # barrel and roll bend even the straight arm


def test_a_hand_hides_some_targets_for_about_a_second(truth):
    hidden = (truth['visible'] < 0.1).sum(axis=1)
    frames = np.flatnonzero(hidden)
    assert 15 <= frames.size <= 45
    assert frames[0] > 60 and frames[-1] < 125
    assert 3 <= hidden.max() <= 8


def test_some_targets_cross_glare(truth):
    hidden = truth['visible'][:60] < 0.95
    assert 1 <= np.count_nonzero(hidden.any(axis=1)) < 30
    assert 1 <= hidden.sum(axis=1).max() <= 2


def test_white_is_where_the_truth_says(messages, truth):
    errors = []
    for index in range(0, IMAGES, 6):
        image = image_of(messages, index).astype(float)
        for u, v, visible in zip(
            *(truth[name][index] for name in ('u', 'v', 'visible')), strict=True
        ):
            if visible < 0.999:
                continue
            row, column = round(v), round(u)
            rows, columns = np.mgrid[-6:7, -6:7]
            window = image[row - 6 : row + 7, column - 6 : column + 7]
            weight = np.clip(window - 0.5 * (window.max() + window.min()), 0.0, None)
            errors.append(
                [
                    column + (weight * columns).sum() / weight.sum() - u,
                    row + (weight * rows).sum() / weight.sum() - v,
                ]
            )
    assert len(errors) > 700
    assert np.sqrt(np.mean(np.square(errors))) < 0.06
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02
    assert np.abs(errors).max() < 0.4


def test_the_tracker_sees_what_is_true(folder, truth):
    tracker = Tracker(load_model(share_path('config/paper_arm.yaml')), CameraSettings())
    stream = open_images(folder, SourceRequest())
    steps = [step.outcome for step in track_steps(stream, tracker) if step.frame]
    assert [step.reason for step in steps] == ['resting'] * 4 + [''] * (IMAGES - 4)
    after = slice(4, None)
    seen = {
        name: np.array([getattr(step.sightings, name) for step in steps[after]])
        for name in ('x', 'y', 'u', 'v')
    }
    found, visible = np.isfinite(seen['x']), truth['visible'][after]
    assert not np.any(found & (visible < 0.5))
    assert np.count_nonzero(found & (visible > 0.99)) > 0.99 * np.count_nonzero(visible > 0.99)
    off_px = np.hypot(seen['u'] - truth['u'][after], seen['v'] - truth['v'][after])
    off = np.hypot(seen['x'] - truth['x'][after], seen['y'] - truth['y'][after])
    assert np.nanmax(off_px) < 0.6
    assert np.sqrt(np.nanmean(off**2)) < 2.5e-5
