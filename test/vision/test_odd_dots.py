"""Rows whose dots differ in size, mirrored pictures, and what is said of missing targets."""

from __future__ import annotations

from dataclasses import replace
import json

import cv2
import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import CameraError
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.track import TrackStep, TrackTally
from pneunet_ros.recordings.images.image_stream import StreamItem
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.overlay import draw
from pneunet_ros.vision.tracker import Tracker, TrackerState
import pytest
from support.camera_images import as_image
from support.films import ARM
from support.refusals import refused

WIDTH, HEIGHT, CLAMP, LENGTH = 640, 360, (70.0, 120.0), 500.0
FRAME_NS = 33_333_333
LENS = Lens(
    width=WIDTH,
    height=HEIGHT,
    model='plumb_bob',
    matrix=np.array([[700.0, 0.0, 319.5], [0.0, 700.0, 179.5], [0.0, 0.0, 1.0]]),
    distortion=np.zeros(5),
)


def arm_of(places) -> Arm:
    """Return the paper's arm with targets at these shares of its length."""
    return replace(ARM, target_arclength=np.asarray(places) * ARM.length)


def centers(places, bend):
    """Return where dots are in the picture (n, 2) px, of an arm bent by so much, rad."""
    angle = bend * np.asarray(places)
    along = np.sinc(angle / np.pi) * places
    across = np.where(angle == 0.0, 0.0, (1.0 - np.cos(angle)) / np.where(angle == 0, 1, bend))
    return np.array(CLAMP) + LENGTH * np.column_stack([along, across])


def picture(places, radii, bend=0.0, end=None):
    """Draw white dots on a dark arm that ends `end` px beyond the last center."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    grey = np.full((HEIGHT, WIDTH), 40.0)
    at = centers(places, bend)
    for (x, y), radius in zip(at, radii, strict=True):
        left, top = (max(int(near - radius) - 1, 0) for near in (x, y))
        near = np.s_[top : int(y + radius) + 3, left : int(x + radius) + 3]
        inside = np.clip(radius + 0.5 - np.hypot(u[near] - x, v[near] - y), 0.0, 1.0)
        grey[near] = np.maximum(grey[near], 40.0 + 170.0 * inside)
    if end is not None:
        x, y = at[-1]
        along = np.cos(bend) * (u - x) + np.sin(bend) * (v - y)
        grey = np.where(np.clip(end + 0.5 - along, 0.0, 1.0) < 0.5, 40.0, grey)
    noise = np.random.default_rng(round(1e4 * bend)).normal(0.0, 1.5, grey.shape)
    return np.clip(np.rint(cv2.GaussianBlur(grey, (0, 0), 0.7) + noise), 0, 255).astype(np.uint8)


def tracked(places, pictures, **settings):
    """Return what a tracker says of each picture, and its last state."""
    tracker = Tracker(arm_of(places), CameraSettings(**settings))
    state, _ = tracker.step(TrackerState(), LENS)
    outcomes = []
    for number, grey in enumerate(pictures, start=1):
        state, outcome = tracker.step(state, as_image(grey, stamp_ns=number * FRAME_NS))
        outcomes.append(outcome)
    return outcomes, state


BENDS = (*[0.0] * 5, *np.linspace(0.08, 0.48, 6).tolist())


@pytest.mark.parametrize(
    ('count', 'odd', 'factor'),
    [(6, -1, 1.8), (9, 0, 1.8), (9, -1, 2.5), (9, 4, 1.8), (16, 0, 1.8), (23, -1, 1.22)],
)
def test_dots_painted_by_hand_may_differ_and_one_of_them_far(count, odd, factor):
    places = np.linspace(0.0, 1.0, count)
    radii = 6.0 * np.random.default_rng(count).uniform(0.75, 1.25, count)
    radii[odd] = factor * 6.0
    outcomes, _ = tracked(places, [picture(places, radii, bend) for bend in BENDS])
    assert [it.reason for it in outcomes] == ['resting'] * 4 + [''] * 7
    for bend, outcome in zip(BENDS[4:], outcomes[4:], strict=True):
        at = np.column_stack([outcome.sightings.u, outcome.sightings.v])
        assert np.hypot(*(at - centers(places, bend)).T).max() < 0.1
        assert not outcome.missing


@pytest.mark.parametrize('factor', [1.22, 1.6])
def test_a_wide_tip_that_the_end_of_the_arm_cuts_is_seen(factor):
    places, radii = np.linspace(0.0, 1.0, 12), np.full(12, 6.0)
    radii[-1] *= factor
    pictures = [picture(places, radii, bend, end=0.8 * radii[-1]) for bend in BENDS]
    outcomes, _ = tracked(places, pictures)
    for bend, outcome in zip(BENDS[4:], outcomes[4:], strict=True):
        at = np.array([outcome.sightings.u[-1], outcome.sightings.v[-1]])
        assert np.hypot(*(at - centers(places, bend)[-1])) < 0.4


def test_distances_that_fit_from_the_right_alone_are_asked_about():
    places = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
    shown = picture(1.0 - places[::-1], np.full(6, 6.0))
    (outcome,), _ = tracked(places, [shown])
    assert outcome.reason == 'wrong_clamp'
    u = centers([1.0], 0.0)[0, 0]
    (outcome,), _ = tracked(places, [shown], clamp_pixel=(u, CLAMP[1]))
    assert outcome.reason == 'resting'


def test_in_a_mirrored_picture_nothing_is_measured_once_the_arm_moves():
    places, radii = np.linspace(0.0, 1.0, 10), np.full(10, 6.0)
    pictures = [picture(places, radii, bend)[:, ::-1] for bend in BENDS]
    outcomes, state = tracked(places, pictures)
    said = [it.reason for it in outcomes]
    assert 'wrong_clamp' in said
    assert set(said[said.index('wrong_clamp') + 1 :]) == {'no_plane'}
    assert f'[{WIDTH - 1 - CLAMP[0]:.0f}, {CLAMP[1]:.0f}]' in state.trouble
    outcomes, _ = tracked(places, pictures, clamp_pixel=(WIDTH - 1 - CLAMP[0], CLAMP[1]))
    assert [it.reason for it in outcomes[4:]] == [''] * 7


def folder_of(path, pictures):
    path.mkdir()
    for number, grey in enumerate(pictures):
        cv2.imwrite(str(path / f'{number:03d}.png'), grey)
    return str(path)


def test_a_mirrored_film_is_refused_with_a_picture_also_where_it_hardly_moves(tmp_path, capsys):
    places, radii = ARM.target_arclength / ARM.length, np.full(23, 5.0)
    bends = (*[0.0] * 5, *np.linspace(0.0, 0.03, 7).tolist())
    folder = folder_of(tmp_path / 'f', [picture(places, radii, it)[:, ::-1] for it in bends])
    words = ['track', folder, '--camera-info', 'none', '--preview', str(tmp_path / 'p.png')]
    table = tmp_path / 't.csv'
    assert main([*words, '--table', str(table)]) != 0
    assert '--clamp-pixel' in capsys.readouterr().err
    assert cv2.imread(str(tmp_path / 'p.png')) is not None
    assert not table.exists()


def test_a_short_row_is_measured_where_clamp_pixel_says_which_target_is_missing():
    places, radii = np.linspace(0.0, 1.0, 9), np.full(9, 6.0)
    pictures = [picture(places[:-1], radii[:-1], bend) for bend in BENDS]
    outcomes, _ = tracked(places, pictures)
    assert {it.reason for it in outcomes} == {'no_row'}
    assert outcomes[0].row == 8
    outcomes, _ = tracked(places, pictures, clamp_pixel=CLAMP)
    assert [it.reason for it in outcomes[4:]] == [''] * 7
    for bend, outcome in zip(BENDS[4:], outcomes[4:], strict=True):
        assert np.abs(outcome.sightings.u - centers(places, bend)[:, 0])[:-1].max() < 0.1
        assert outcome.missing[8].cause == 'no_dot'


def notes_of(outcomes, state):
    tally = TrackTally(targets=9)
    for number, outcome in enumerate(outcomes):
        item = StreamItem(number, '', None, b'')
        tally.count(TrackStep(item=item, frame=True, outcome=outcome, state=state))
    return tally.notes


def test_a_dot_that_is_far_wider_than_the_others_is_followed_and_noted():
    places, radii = np.linspace(0.0, 1.0, 9), np.full(9, 6.0)
    radii[4] *= 1.8
    (note,) = notes_of(*tracked(places, [picture(places, radii, bend) for bend in BENDS]))
    assert 'target 4 ' in note
    assert ' 1.8 ' in note


def test_a_target_that_is_often_missing_is_noted_with_its_cause_and_shown():
    places, radii = np.linspace(0.0, 1.0, 9), np.full(9, 6.0)
    whole = [picture(places, radii, bend) for bend in BENDS]
    hidden = [np.where(np.arange(WIDTH) > 530, 40, grey).astype(np.uint8) for grey in whole]
    outcomes, state = tracked(places, [*whole[:6], *hidden[6:]])
    (note,) = notes_of(outcomes, state)
    assert note.startswith('target 8 ')
    marked = draw(as_image(hidden[-1], stamp_ns=1), outcomes[-1])
    at = outcomes[-1].missing[8]
    place = marked[round(at.v) - 3 : round(at.v) + 4, round(at.u) - 3 : round(at.u) + 4]
    assert np.ptp(place.astype(int), axis=2).max() > 100  # colored, in a grey picture


def test_areas_of_a_frame_without_a_row_are_shown():
    places, radii = np.linspace(0.0, 1.0, 9), np.full(9, 6.0)
    shown = picture(places[:5], radii[:5])
    (outcome,), _ = tracked(places, [shown])
    assert outcome.reason == 'no_row'
    assert len(outcome.found) >= 5
    marked = draw(as_image(shown, stamp_ns=1), outcome)
    assert np.ptp(marked[80:160].astype(int), axis=2).max() > 100


# Dots that stand out by their color


def colored(places, radii, bend=0.0):
    """Draw red dots on skin that is as bright as they are, (height, width, 3) BGR."""
    share = (picture(places, radii, bend).astype(np.float64)[:, :, None] - 40.0) / 170.0
    return np.clip(np.rint(97.0 + share * (np.array([30, 20, 200]) - 97.0)), 0, 255).astype(
        np.uint8
    )


def camera_file(path, **keys):
    lines = ['schema_version: 1', *(f'{key}: {value}' for key, value in keys.items())]
    path.write_text('\n'.join(lines), encoding='utf-8')
    return str(path)


@pytest.mark.parametrize('suffix', ['png', 'jpg', 'bmp'])
def test_dots_that_only_their_color_shows_are_tracked(tmp_path, capsys, suffix):
    places, radii = ARM.target_arclength / ARM.length, np.full(23, 6.0)
    folder = tmp_path / 'f'
    folder.mkdir()
    bends = BENDS[:8]
    for number, bend in enumerate(bends):
        cv2.imwrite(str(folder / f'{number}.{suffix}'), colored(places, radii, bend))
    words = ['track', str(folder), '--camera-info', 'none', '--json']
    assert main(words) != 0
    assert json.loads(capsys.readouterr().out)['explained'] == 0
    table = tmp_path / 't.csv'
    file = camera_file(tmp_path / 'c.yaml', dot_color=[200, 20, 30])
    assert main([*words, '--camera', file, '--table', str(table)]) == 0
    assert json.loads(capsys.readouterr().out)['explained'] == 4
    lines = np.genfromtxt(table, delimiter=',', names=True)
    at = np.column_stack([lines['u_px'], lines['v_px']])
    truth = np.concatenate([centers(places, bend) for bend in bends[4:]])
    assert np.hypot(*(at - truth).T).max() < 0.5


def test_a_grey_image_has_no_colors_and_is_refused():
    places = np.linspace(0.0, 1.0, 9)
    (outcome,), _ = tracked(places, [picture(places, np.full(9, 6.0))], dot_color=(200, 20, 30))
    assert outcome.reason == 'no_colors'


@pytest.mark.parametrize(
    ('color', 'reason'),
    [([90, 92, 95], 'not_a_color'), ([300, 0, 0], 'wrong_shape'), ([1, 2], 'wrong_shape')],
)
def test_a_color_that_is_none_is_refused(tmp_path, color, reason):
    with refused(CameraError, reason):
        load_camera(camera_file(tmp_path / 'c.yaml', dot_color=color))
