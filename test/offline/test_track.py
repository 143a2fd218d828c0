"""Track: images become a recording with the tracker's topics, equal to the tracker's own steps."""

from __future__ import annotations

import csv

import numpy as np
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.messages.targets import TARGET_POINT
from pneunet_ros.messages.tracker import decode_camera_info, decode_image, TRACKER_OUTPUTS
from pneunet_ros.offline.track import look_ahead, record_tracking, track_steps, TrackTally
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.tables.table_writer import write_table
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
import pytest
from support.films import (
    ARM,
    COMPRESSED,
    encoded,
    film,
    FRAMES,
    IMAGE,
    INFO,
    pictures,
    place_of,
    RATE,
    REST,
    stamp_of,
    write_camera_info,
    write_folder,
    write_messages,
    write_video,
)
from support.made_recordings import PRESSURE
from support.random_estimates import plain
from support.refusals import reasons

TRACKER = Tracker(ARM, load_camera(share_path('config/camera.yaml')))
TARGETS = ARM.target_arclength.size
HIDDEN = 11  # in the last frame
SHOWN = pictures(hidden=HIDDEN)
EXPLAINED = FRAMES - REST + 1  # the last frame of rest is explained


def tracked(source, target, request=None, **options) -> list:
    """Track one file into another; returns the steps."""
    stream = open_images(source, request or SourceRequest())
    seen: list = []
    options = {'with_images': False} | options
    with write_recording(target) as writer:
        record_tracking(
            writer, stream, TRACKER, 'pneunet_base', on_progress=seen.append, **options
        )
    return seen


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Record raw images with camera_info and pressure."""
    return write_messages(tmp_path_factory.mktemp('source') / 'in.mcap', film(SHOWN))


@pytest.fixture(scope='module')
def track(source, tmp_path_factory):
    """Return the recording that was written, and the steps."""
    path = tmp_path_factory.mktemp('track') / 'out.mcap'
    steps = tracked(source, path)
    return open_recording(path), steps


def outcomes(steps) -> list:
    return [step.outcome for step in steps if isinstance(step.outcome, Tracking)]


def points(recording, name: str = '/pneunet/targets') -> list:
    """List the points of `targets`, one array of records per message."""
    return [
        np.frombuffer(item.message.data.tobytes(), TARGET_POINT)
        for item in recording.messages([name])
    ]


def test_the_outputs_stand_beside_the_copies_and_images_are_left_out(track):
    count = {topic.name: topic.count for topic in track[0].topics}
    assert count == {
        INFO: FRAMES,
        PRESSURE: FRAMES,
        '/pneunet/targets': FRAMES,
        '/pneunet/measured_centerline': EXPLAINED,
        '/pneunet/measured_curvature': EXPLAINED,
    }
    assert {output.name for output in TRACKER_OUTPUTS} < {name.split('/')[-1] for name in count}


def test_what_is_copied_is_equal_bit_by_bit(source, track):
    topics = [INFO, PRESSURE]
    before, after = open_recording(source), track[0]
    assert list(before.raw_messages(topics)) == list(after.raw_messages(topics))
    assert [after.topic(name) for name in topics] == [before.topic(name) for name in topics]


def test_images_are_copied_where_asked_for(source, tmp_path):
    tracked(source, tmp_path / 'out.mcap', with_images=True)
    after = open_recording(tmp_path / 'out.mcap')
    before = open_recording(source)
    assert list(before.raw_messages([IMAGE])) == list(after.raw_messages([IMAGE]))


def test_what_is_written_are_the_plain_messages_of_the_trackers_steps(source, track):
    state, expected = TrackerState(), []
    decoders = {INFO: decode_camera_info, IMAGE: decode_image}
    for item in open_recording(source).messages([INFO, IMAGE]):
        state, outcome = TRACKER.step(state, decoders[item.topic](item.message))
        if outcome is not None:
            expected.append((item.log_time_ns, outcome))
    assert len(expected) == FRAMES
    for output in TRACKER_OUTPUTS:
        results = [
            (time, outcome.sightings if output.name == 'targets' else outcome.curve)
            for time, outcome in expected
        ]
        made = [
            (time, plain(output.encode(result, 'pneunet_base', ROSBAGS_TYPES)))
            for time, result in results
            if result is not None
        ]
        written = [
            (item.log_time_ns, plain(item.message))
            for item in track[0].messages([f'/pneunet/{output.name}'])
        ]
        assert len(written) >= EXPLAINED
        assert str(written) == str(made), output.name  # NaN equals NaN


def test_the_targets_are_where_they_were_drawn(track):
    for index, cloud in enumerate(points(track[0])):
        assert cloud['id'].tolist() == list(range(TARGETS))
        if index < REST - 1:
            assert np.isnan(cloud['x']).all()
            continue
        x, y = place_of(index)
        seen = np.isfinite(cloud['x'])
        missing = [HIDDEN] if index == FRAMES - 1 else []
        assert np.flatnonzero(~seen).tolist() == missing
        np.testing.assert_allclose(cloud['x'][seen], x[seen], atol=6e-5)
        np.testing.assert_allclose(cloud['y'][seen], y[seen], atol=6e-5)


@pytest.fixture(scope='module')
def others(source, tmp_path_factory):
    """Track the same pictures from every other form they can have."""
    folder = tmp_path_factory.mktemp('others')
    lens = str(write_camera_info(folder / 'lens.yaml'))
    png = write_folder(folder / 'png', SHOWN)
    forms = {
        'compressed': (write_messages(folder / 'c.mcap', film([*map(encoded, SHOWN)])), None),
        'folder': (png, SourceRequest(camera_info=lens, rate=RATE)),
        'video': (write_video(folder / 'v.avi', SHOWN), SourceRequest(camera_info=lens)),
        'without distortion': (png, SourceRequest(camera_info='none', rate=RATE)),
    }
    found = {}
    for name, (path, request) in forms.items():
        tracked(path, folder / f'{name}.mcap', request)
        found[name] = open_recording(folder / f'{name}.mcap')
    return found


@pytest.mark.parametrize('form', ['compressed', 'folder', 'video'])
def test_the_same_pictures_give_the_same_numbers_whatever_holds_them(track, others, form):
    names = [f'/pneunet/{output.name}' for output in TRACKER_OUTPUTS]
    assert list(others[form].raw_messages(names)) == list(track[0].raw_messages(names))


def test_without_a_lens_the_numbers_of_a_lens_without_distortion_are_nearly_the_same(
    track, others
):
    for one, other in zip(points(track[0]), points(others['without distortion']), strict=True):
        for name in ('x', 'y', 'std'):
            np.testing.assert_allclose(one[name], other[name], rtol=1e-5, atol=1e-8)


def test_outputs_are_in_the_namespace_of_the_images(tmp_path):
    messages = film(SHOWN[:REST], topic='/left/cam/image_raw')
    write_messages(tmp_path / 'in.mcap', messages)
    tracked(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    names = {topic.name for topic in open_recording(tmp_path / 'out.mcap').topics}
    assert '/left/cam/targets' in names
    assert PRESSURE in names


def test_what_was_tracked_before_is_written_anew(source, tmp_path):
    tracked(source, tmp_path / 'first.mcap', with_images=True)
    stream = open_images(tmp_path / 'first.mcap', SourceRequest())
    with write_recording(tmp_path / 'second.mcap') as writer:
        sentences = record_tracking(
            writer, stream, TRACKER, 'pneunet_base', False, lambda step: None
        )
    assert reasons(sentences) == ['rewritten'] * 3
    second = open_recording(tmp_path / 'second.mcap')
    assert second.topic('/pneunet/targets').count == FRAMES


def test_a_truncated_jpeg_is_one_refused_frame(tmp_path):
    shown = [encoded(one, '.jpg') for one in SHOWN]
    shown[7] = shown[7][: len(shown[7]) // 2]
    write_messages(tmp_path / 'in.mcap', film(shown))
    steps = tracked(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    tally = TrackTally(targets=TARGETS)
    for step in steps:
        tally.count(step)
    assert (tally.frames, tally.explained) == (FRAMES, EXPLAINED - 1)
    assert tally.reasons['unreadable'] == 1
    assert steps[-1].state.rejected['unreadable'] == 1
    written = open_recording(tmp_path / 'out.mcap')
    assert COMPRESSED not in {topic.name for topic in written.topics}
    times = [item.log_time_ns for item in written.raw_messages(['/pneunet/targets'])]
    assert times == [stamp_of(index) for index in range(FRAMES) if index != 7]


def test_an_image_of_another_size_writes_nothing(tmp_path):
    shown = list(SHOWN)
    shown[8] = shown[8][:200]
    write_messages(tmp_path / 'in.mcap', film(shown))
    steps = tracked(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    refused = [step.outcome for step in steps if isinstance(step.outcome, Refusal)]
    assert [refusal.reason for refusal in refused] == ['wrong_size']
    assert open_recording(tmp_path / 'out.mcap').topic('/pneunet/targets').count == FRAMES - 1


# Recordings that do not begin at rest


def test_frames_before_the_rest_are_tracked_by_it(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(SHOWN[::-1]))
    stream, looked = open_images(path, SourceRequest()), []
    start, sentence = look_ahead(stream, TRACKER, looked.append)
    assert len(looked) == FRAMES
    assert f' {FRAMES}' in sentence
    steps = list(track_steps(stream, TRACKER, start=start))
    tracked_frames = outcomes(steps)
    assert len(tracked_frames) == FRAMES
    for index, outcome in enumerate(tracked_frames):
        x, y = place_of(FRAMES - 1 - index)
        found = outcome.sightings
        seen = np.isfinite(found.x)
        assert np.flatnonzero(~seen).tolist() == ([HIDDEN] if index == 0 else [])
        np.testing.assert_allclose(found.x[seen], x[seen], atol=6e-5)
        np.testing.assert_allclose(found.y[seen], y[seen], atol=6e-5)


def test_a_recording_that_begins_at_rest_is_tracked_as_live(source):
    start, sentence = look_ahead(open_images(source, SourceRequest()), TRACKER, lambda step: None)
    assert sentence == ''
    assert start.plane is None


def test_a_recording_without_rest_says_what_is_missing(tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(SHOWN[: REST - 2]))
    stream = open_images(path, SourceRequest())
    start, sentence = look_ahead(stream, TRACKER, lambda step: None)
    assert (start.plane, sentence) == (None, '')
    tally = TrackTally(targets=TARGETS)
    for step in track_steps(stream, TRACKER, start=start):
        tally.count(step)
    assert tally.explained == 0
    assert f'{REST - 2} of {REST} ' in tally.sentences['resting']


# The tally


def test_a_tally_counts_what_the_steps_say(track):
    tally = TrackTally(targets=TARGETS)
    for step in track[1]:
        tally.count(step)
    assert (tally.frames, tally.explained, tally.curves) == (FRAMES, EXPLAINED, EXPLAINED)
    assert dict(tally.reasons) == {'resting': REST - 1}
    assert tally.seen.tolist() == [EXPLAINED - (target == HIDDEN) for target in range(TARGETS)]
    assert tally.missing.sum() == 1
    rms = [outcome.curve.rms for outcome in outcomes(track[1]) if outcome.curve is not None]
    assert tally.rms == pytest.approx(np.sqrt(np.mean(np.square(rms))))
    assert tally.worst_rms == max(rms)
    assert tally.scale == pytest.approx(0.00026, rel=2e-3)


def test_a_tally_tells_of_images_stamped_ahead(tmp_path):
    messages = film(SHOWN)
    stamp = messages[-6][3].header.stamp  # of the last image but one
    stamp.sec += 5
    path = write_messages(tmp_path / 'in.mcap', messages)
    tally = TrackTally(targets=TARGETS)
    for step in track_steps(open_images(path, SourceRequest()), TRACKER):
        tally.count(step)
    assert any('in the future' in note for note in tally.notes)
    assert tally.explained == EXPLAINED


def test_a_tally_of_nothing_has_no_numbers():
    tally = TrackTally(targets=3)
    assert np.isnan([tally.scale, tally.rms]).all()
    assert tally.seen.tolist() == tally.missing.tolist() == [0, 0, 0]


def test_a_tally_counts_a_frame_once_and_camera_info_never(tmp_path):
    messages = film(SHOWN[:3])
    for place in (1, 4, 7):
        topic, kind, log_time_ns, info = messages[place]
        info.k = np.zeros(9)
        messages[place] = topic, kind, log_time_ns, info
    path = write_messages(tmp_path / 'in.mcap', messages)
    tally = TrackTally(targets=TARGETS)
    for step in track_steps(open_images(path, SourceRequest()), TRACKER):
        tally.count(step)
    assert tally.frames == 3
    assert dict(tally.reasons) == {'wrong_camera_info': 0, 'no_camera_info': 3}


# The table


def test_the_table_has_a_line_per_target_that_was_seen(track, tmp_path):
    with write_table(tmp_path / 'table.csv') as write:
        for outcome in outcomes(track[1]):
            write(outcome.sightings)
    with (tmp_path / 'table.csv').open(newline='') as stream:
        lines = list(csv.DictReader(stream))
    assert list(lines[0]) == [
        'stamp_ns', 'id', 'u_px', 'v_px', 'area_px2', 'major_px', 'minor_px', 'angle_rad',
        'x_m', 'y_m', 'std_m',
    ]  # fmt: skip
    assert len(lines) == EXPLAINED * TARGETS - 1
    place = iter(lines)
    for outcome in outcomes(track[1]):
        found = outcome.sightings
        for target in np.flatnonzero(np.isfinite(found.x)):
            line = next(place)
            assert (line['stamp_ns'], line['id']) == (str(found.stamp_ns), str(target))
            assert float(line['x_m']) == found.x[target]
            assert float(line['std_m']) == found.std[target]
            assert float(line['u_px']) == found.u[target]
            assert float(line['area_px2']) == found.area[target]
