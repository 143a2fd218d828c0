"""One camera, several arms in its images: each tracker follows the row at its clamp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.image import Image
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import PosePlane
from pneunet_ros.vision.several_rows import check_rows, step_rows
from pneunet_ros.vision.tracker import Tracker, TrackerState
import pytest
from support import films, rows_film
from support.refusals import refused

WIDTH, HEIGHT, SCALE = 1280, 720, 6000.0  # px, px, px/m
CLAMPS = {'left': (200.0, 180.0, 1.0), 'right': (200.0, 540.0, -1.0)}  # u, v, and the bent side
FRAME_NS, REST, FRAMES, RISE = 33_000_000, 8, 36, 1.2e3  # Pa a frame
ARM = load_model(share_path('config/lab_arm.yaml'))
LENS = Lens(
    width=WIDTH,
    height=HEIGHT,
    model='plumb_bob',
    matrix=np.array([[WIDTH, 0.0, WIDTH / 2], [0.0, WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]]),
    distortion=np.zeros(5),
)


def targets_at(pressure):
    shape = solve(ARM, pressure=pressure)
    places = ARM.target_arclength
    return [np.interp(places, shape.arclength, row) for row in (shape.x, shape.y)]


def picture(pressures, frame):
    """Draw both arms as white dots."""
    grey = np.full((HEIGHT, WIDTH), 30.0)
    for (u, v, side), pressure in zip(CLAMPS.values(), pressures, strict=True):
        x, y = targets_at(pressure)
        for at_u, at_v in zip(u + SCALE * x, v + side * SCALE * y, strict=True):
            top, left = max(int(at_v) - 12, 0), max(int(at_u) - 12, 0)
            part = grey[top : int(at_v) + 13, left : int(at_u) + 13]
            down, across = np.indices(part.shape)
            distance = np.hypot(across + left - at_u, down + top - at_v)
            part[:] = np.maximum(part, 30.0 + 200.0 * np.clip(9.5 - distance, 0.0, 1.0))
    return Image(
        stamp_ns=1_000_000_000 + FRAME_NS * frame,
        frame_id='camera',
        width=WIDTH,
        height=HEIGHT,
        step=WIDTH,
        encoding='mono8',
        data=np.rint(grey).astype(np.uint8).ravel(),
    )


@pytest.fixture(scope='module')
def film():
    """Return pressures of both arms, which differ, and pictures."""
    rises = [max(frame - REST, 0) * RISE for frame in range(FRAMES)]
    pressures = [(rise, 0.5 * rise) for rise in rises]
    return pressures, [picture(pair, frame) for frame, pair in enumerate(pressures)]


@pytest.mark.parametrize('name', CLAMPS)
def test_a_tracker_follows_the_row_at_its_clamp(film, name):
    u, v, side = CLAMPS[name]
    settings = replace(load_camera(share_path('config/camera.yaml')), clamp_pixel=(u, v))
    tracker, state = Tracker(ARM, settings), TrackerState()
    state, _ = tracker.step(state, LENS)
    which, pressures = list(CLAMPS).index(name), film[0]
    for frame, image in enumerate(film[1]):
        state, found = tracker.step(state, image)
        if frame < settings.rest_frames:
            continue
        x, y = targets_at(pressures[frame][which])
        assert found.sightings.seen == ARM.target_arclength.size, found.sentence
        # The image has y down: what bends up in it is positive.
        assert np.hypot(found.sightings.x - x, found.sightings.y + side * y).max() < 2e-4


CAMERA = load_camera(share_path('config/camera.yaml'))
FILM_LENS = Lens(
    width=rows_film.WIDTH,
    height=rows_film.HEIGHT,
    model='plumb_bob',
    matrix=np.asarray(rows_film.CAMERA.matrix),
    distortion=np.zeros(5),
)


def tracker_at(clamp, **changes):
    return Tracker(films.ARM, replace(CAMERA, clamp_pixel=clamp, **changes))


def stolen(arm, index, sightings):
    """Return how many targets are reported that are hidden, or are not where they are reported."""
    x, y = rows_film.place_of(arm, index)
    off = np.hypot(sightings.x - x, sightings.y - rows_film.POSES[arm].side * y)
    return np.count_nonzero((off > 1e-4) | (np.isfinite(off) & rows_film.covered(arm, index)))


def follow(step):
    """Follow the film of three arms; returns dots taken from others, and targets not found.

    step: of trackers, states and a reading to states and outcomes.
    """
    trackers = {arm: tracker_at(rows_film.clamp_pixel(arm)) for arm in rows_film.POSES}
    states = [state for state, _ in step(trackers.values(), [TrackerState()] * 3, FILM_LENS)]
    wrong = missed = 0
    for index, picture in enumerate(rows_film.pictures()):
        image = rows_film.image_of(picture, index)
        states, outcomes = zip(*step(trackers.values(), states, image), strict=True)
        for arm, outcome in zip(trackers, outcomes, strict=True):
            if index < CAMERA.rest_frames:
                continue
            wrong += stolen(arm, index, outcome.sightings)
            shown = np.count_nonzero(~rows_film.covered(arm, index))
            missed += max(shown - outcome.sightings.seen, 0)
    return wrong, missed


def each_alone(trackers, states, reading):
    return [one.step(state, reading) for one, state in zip(trackers, states, strict=True)]


def test_no_arm_takes_the_dot_of_another_that_hides_its_own():
    together = follow(lambda trackers, *more: step_rows(list(trackers), *more))
    assert together == (0, 0)
    assert follow(each_alone)[0] > 0  # so the film would show it


def test_the_image_is_searched_once_for_all_rows(monkeypatch):
    from pneunet_ros.vision.dots import blobs

    made = []
    monkeypatch.setattr(
        blobs,
        'round_areas',
        lambda *arguments, find=blobs.round_areas: made.append(1) or find(*arguments),
    )
    trackers = [
        tracker_at(rows_film.clamp_pixel(arm), polarity='bright') for arm in rows_film.POSES
    ]
    states = [state for state, _ in step_rows(trackers, [TrackerState()] * 3, FILM_LENS)]
    step_rows(trackers, states, rows_film.image_of(rows_film.pictures()[0], 0))
    assert len(made) == 1


def test_of_two_trackers_of_one_row_the_second_finds_none():
    clamp = rows_film.clamp_pixel('upper')
    trackers = [tracker_at(clamp), tracker_at((clamp[0] + 1.0, clamp[1]))]
    states = [state for state, _ in step_rows(trackers, [TrackerState()] * 2, FILM_LENS)]
    for index, picture in enumerate(rows_film.pictures()[: CAMERA.rest_frames + 1]):
        image = rows_film.image_of(picture, index)
        states, (first, second) = zip(*step_rows(trackers, states, image), strict=True)
    assert first.sightings.seen == films.ARM.target_arclength.size
    assert (second.reason, second.sightings.seen) == ('wrong_clamp', 0)


def test_targets_of_other_arms_are_no_row_at_rest():
    tracker, image = tracker_at(None), rows_film.image_of(rows_film.pictures()[0], 0)
    start, _ = tracker.step(TrackerState(), FILM_LENS)
    tables = {}
    for arm in rows_film.POSES:
        other = tracker_at(rows_film.clamp_pixel(arm), rest_frames=1)
        state, _ = other.step(start, image)
        assert state.row is not None
        tables[arm] = state.row.table
    crowd, _ = tracker.step(start, image)
    (still,) = crowd.still.values()
    state, outcome = tracker.step(start, image, tables['lower'])
    assert outcome.reason == 'several_rows'
    (free,) = state.still.values()  # what rested and moves is searched for among these
    assert len(free.seen) == len(still.seen) - len(tables['lower'])
    both = np.concatenate([tables['lower'], tables['beside']])
    assert tracker.step(start, image, both)[1].reason == 'resting'


def test_who_searches_is_told_what_others_follow():
    trackers = [tracker_at(None), tracker_at(rows_film.clamp_pixel('lower'))]
    states = [state for state, _ in step_rows(trackers, [TrackerState()] * 2, FILM_LENS)]
    for index, picture in enumerate(rows_film.pictures()[: rows_film.REST + 3]):
        image = rows_film.image_of(picture, index)
        states = [state for state, _ in step_rows(trackers, states, image)]
    (still,) = states[0].still.values()
    apart = still.centers[:, None] - states[1].row.table[:, :2]
    assert not np.any((np.hypot(*apart.transpose(2, 0, 1)) < 1.0).any(axis=1) & (still.unseen < 1))


def test_a_shared_camera_needs_the_row_of_each_arm():
    here, there = tracker_at((10.0, 20.0)), tracker_at((10.0, 90.0))
    pose = PosePlane(position=(0.0, 0.0, 0.2), quaternion=(1.0, 0.0, 0.0, 0.0))
    check_rows({'left': tracker_at(None)})
    check_rows({'left': here, 'right': there})
    check_rows({'left': here, 'right': tracker_at(None, plane=pose)})
    for other in (tracker_at(None), tracker_at((10.0, 20.0))):
        with refused(CameraError, 'missing'):
            check_rows({'left': here, 'right': other})
    with refused(CameraError, 'missing'):
        check_rows({'left': tracker_at(None, plane=pose), 'right': tracker_at(None, plane=pose)})


@pytest.mark.ros
def test_the_tracker_node_is_told_the_clamp():
    pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")
    from pneunet_ros.nodes.tracker.configuration import configured_tracker, PARAMETERS

    def configured(clamp, current=None):
        return configured_tracker(PARAMETERS.completed({'clamp_pixel': clamp}), current)

    given = configured('200, 180')
    assert given.tracker.settings.clamp_pixel == (200.0, 180.0)
    assert configured('[200 180.5]', given).tracker.settings.clamp_pixel == (200.0, 180.5)
    assert configured('', given).tracker.settings.clamp_pixel is None
    for wrong in ('200', 'u, v', '1, 2, 3'):
        with refused(CameraError, 'wrong_shape'):
            configured(wrong)
