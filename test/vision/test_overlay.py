"""The picture of a frame: what is marked in it, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.image import Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.working_plane import Plane
from pneunet_ros.vision.overlay import BAD, CURVE, curve_in_image, draw, GOOD, headline, SEEN
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import Tracking
import pytest

WIDTH, HEIGHT, COUNT = 640, 480, 23
GREY = 90
PICTURE = np.full((HEIGHT, WIDTH), GREY, np.uint8)


def image(picture=PICTURE):
    height, width = picture.shape
    return Image(
        stamp_ns=1,
        frame_id='camera',
        width=width,
        height=height,
        step=width,
        encoding='mono8',
        data=picture.ravel(),
    )


def tracking(missing=(), reason='', sentence=''):
    """Return targets on a parabola across the image."""
    u = np.linspace(100.0, 540.0, COUNT)
    v = 150.0 + 200.0 * ((u - 100.0) / 440.0) ** 2
    values = dict.fromkeys(('x', 'y', 'std', 'area'), np.ones(COUNT))
    values |= {'u': u, 'v': v, 'major': np.full(COUNT, 9.0), 'minor': np.full(COUNT, 8.0)}
    values['angle'] = np.zeros(COUNT)
    values = {name: numbers.copy() for name, numbers in values.items()}
    for numbers in values.values():
        numbers[list(missing)] = np.nan
    return Tracking(
        sightings=TargetSightings(stamp_ns=1, **values),
        curve=None,
        reason=reason,
        sentence=sentence,
    )


def like(picture, color):
    """Return where a picture has about a color."""
    return np.abs(picture.astype(int) - color).max(axis=2) < 40


def is_circled(picture, u, v):
    """Whether there is a mark around a place, not on it."""
    part = like(picture, SEEN)[round(v) - 9 : round(v) + 10, round(u) - 9 : round(u) + 10]
    return part.sum() > 20 and not part[7:12, 7:12].any()


def test_seen_targets_are_circled_and_missing_ones_are_not():
    missing = (0, 7, 22)
    all_seen = tracking().sightings
    picture = draw(image(), tracking(missing))
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    for target, (u, v) in enumerate(zip(all_seen.u, all_seen.v, strict=True)):
        assert is_circled(picture, u, v) == (target not in missing)


def test_the_image_itself_is_left_as_it_is():
    frame = image()
    draw(frame, tracking())
    assert (frame.grey() == GREY).all()


def test_what_is_not_marked_is_the_image():
    random = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    picture = draw(image(random), tracking())
    np.testing.assert_array_equal(picture[400:, :, 1], random[400:])


def test_the_curve_is_drawn_where_it_lies_in_the_image():
    lens = Lens(
        width=WIDTH,
        height=HEIGHT,
        model='plumb_bob',
        matrix=np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.2, 0.0, 0.0, 0.0]),
    )
    plane = Plane(base_from_normalized=np.diag([0.2, -0.2, 1.0]))
    x = np.linspace(-0.08, 0.08, 40)
    zero = np.zeros(40)
    curve = MeasuredCurve(
        stamp_ns=1,
        arclength=x,
        x=x,
        y=np.full(40, -0.02),
        theta=zero,
        curvature=zero,
        std_curvature=zero,
        rms=0.0,
    )
    pixels = curve_in_image(curve, plane, lens)
    # In the middle there is no distortion to speak of: 0.02 m are 0.1, and 60 px, down.
    assert pixels[:, 1] == pytest.approx(np.full(40, 300.0), abs=4.0)
    assert pixels[0, 0] < 120.0 < 520.0 < pixels[-1, 0]
    picture = like(draw(image(), tracking(range(COUNT)), pixels), CURVE)
    drawn = np.argwhere(picture)[:, ::-1]
    far = np.hypot(*(drawn[:, None, :] - pixels).transpose(2, 0, 1)).min(axis=1)
    assert len(drawn) > 350
    assert far.max() < 12.0


def test_what_leaves_the_image_is_no_trouble():
    curve = np.array([[1e9, -1e9], [np.nan, 3.0], [50.0, 50.0]])
    away = tracking()
    sightings = replace(away.sightings, u=away.sightings.u + 1e7)
    draw(image(), replace(away, sightings=sightings), curve)
    draw(image(), tracking(range(COUNT)), np.full((4, 2), np.nan))
    draw(image(PICTURE[:1, :1]), tracking())


def test_the_line_says_what_is_missing_or_wrong():
    assert headline(tracking()) == '23 of 23 targets'
    assert headline(tracking((4, 9))) == '21 of 23 targets, missing 4, 9'
    assert headline(tracking(range(20))).endswith(
        'missing 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, ...'
    )
    said = tracking(range(COUNT), 'no_row', 'no row of targets')
    assert headline(said) == 'no_row: no row of targets'


@pytest.mark.parametrize(('reason', 'color', 'other'), [('', GOOD, BAD), ('no_row', BAD, GOOD)])
def test_the_line_is_written_in_its_color_within_the_picture(reason, color, other):
    frame = tracking(range(COUNT), reason, 'a sentence – with a dash – ' * 6)
    written = draw(image(), frame)
    top = written[:60]
    assert like(top, color).sum() > 30
    assert not like(top, other).any()
    assert not like(written[:, -3:], color).any()
