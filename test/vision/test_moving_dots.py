"""Dots that move far while the shutter is open: where they are, and what is none."""

from __future__ import annotations

import math

import cv2
import numpy as np
from pneunet_ros.vision.dots.centroid import AREA, CONTRAST, EXACT, outlines, rows_of, STD, U, V
from pneunet_ros.vision.dots.ellipse_fit import BEHIND, ELLIPSE, PLATEAU, SMEAR_U, SMEAR_V, WIDTH
from pneunet_ros.vision.dots.moving_dots import (
    as_fitted,
    end_of_arm,
    fit_moving_dot,
    is_dot,
    Known,
    moves_far,
    MOVING_DOTS,
    prior_alone,
    prior_from_neighbors,
)
import pytest

RADIUS, HALF, BLUR = 5.0, 14.0, 0.8  # px
PAINT, SKIN = 200.0, 80.0
FINE = 5  # parts of a pixel, per axis
CENTER = np.array([40.3, 39.6])
WAYS = [(0.0, 14.0), (3.0, -12.0), (-2.0, 8.0)]
ALONG = np.array([1.0, 0.0])
NOISE = 1.5


def picture(way, end=None, dot=True, cover=None, seed=0):
    """Draw an arm along u that moves over a background, with a dot at CENTER; where it ends."""
    parts = (np.arange(81 * FINE) + 0.5) / FINE - 0.5
    u, v = parts[None, :] - CENTER[0], parts[:, None] - CENTER[1]
    behind = 130.0 + 60.0 * np.sign(v) + 0.8 * u + 20.0 * np.sin(u / 9.0)
    total = np.zeros_like(behind)
    times = (np.arange(60) + 0.5) / 60 - 0.5
    for time in times:
        x, y = u - time * way[0], v - time * way[1]
        arm = np.abs(y) <= HALF
        if end is not None:
            arm = arm & (x <= end)
        seen = np.where(arm, SKIN - 0.1 * y, behind)
        if dot:
            seen = np.where(arm & (x**2 + y**2 <= RADIUS**2), PAINT, seen)
        total += seen if cover is None else np.where(cover(u, v), 150.0, seen)
    mean = (total / len(times)).reshape(81, FINE, 81, FINE).mean(axis=(1, 3))
    soft = cv2.GaussianBlur(mean, (0, 0), math.sqrt(BLUR**2 - 1.0 / 12.0))
    noise = NOISE * np.random.default_rng(seed).standard_normal(soft.shape)
    return np.clip(np.rint(soft + noise), 0.0, 255.0).astype(np.uint8)


def outline(way, off=(0.0, 0.0)):
    """Return what neighbors tell of the dot: all but where it is, and its way hardly."""
    one = np.ones(1)
    axes = RADIUS * np.array([[1.0, 0.0, 1.0]])
    stds = (0.01 * one, 0.1, one)
    start = outlines(CENTER[None] + off, axes, BLUR * one, 0.85 * np.array([way]), stds)[0]
    start[[PLATEAU, BEHIND]] = PAINT, SKIN
    return start


def known(contrast=PAINT - SKIN):
    """Return what neighbors tell of the contrast."""
    return Known(
        contrast=contrast,
        contrast_std=0.1 * contrast,
        size=1.0,
        size_std=0.01,
        longer=1.1,
        way_std=0.1,
    )


@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize('end', [None, 0.8 * RADIUS])
def test_a_dot_is_found_whatever_is_behind_the_arm(way, end):
    """The sides of the arm, and its end, are smeared into two greys behind it."""
    errors = []
    for seed, off in enumerate([(0.5, -1.0), (-1.0, 0.7), (0.2, 2.0)]):
        start = outline(way, off)
        last = math.inf if end is None else end_of_arm(start, ALONG)
        dot = fit_moving_dot(picture(way, end, seed=seed), start, ALONG, last, known())
        assert dot is not None
        assert is_dot(dot, known())
        assert dot.contrast == pytest.approx(PAINT - SKIN, rel=0.15)
        errors.append((dot.center - CENTER) / dot.std)
        assert math.hypot(*(dot.center - CENTER)) < 0.3
        assert dot.std < 0.15 * RADIUS
    assert np.abs(errors).max() < 3.5


def test_a_dot_tells_its_size_where_nothing_else_does():
    start = outline((0.0, 12.0))
    start[2:5] *= 0.94
    nothing = prior_alone(start, 70.0, MOVING_DOTS)
    dot = fit_moving_dot(picture((0.0, 12.0)), start, ALONG, math.inf, nothing)
    assert dot.size == pytest.approx(1.0 / 0.94, abs=0.02)
    assert dot.way == pytest.approx([0.0, 12.0], abs=0.5)
    alike = prior_from_neighbors([dot, dot, dot])
    assert (alike.size, alike.contrast) == (dot.size, dot.contrast)
    assert alike.longer == pytest.approx(1.0 / 0.85, abs=0.05)
    assert alike.size_std == MOVING_DOTS.paint


@pytest.mark.parametrize('way', WAYS)
def test_an_arm_without_a_dot_shows_none(way):
    dot = fit_moving_dot(picture(way, dot=False), outline(way), ALONG, math.inf, known())
    assert dot is None or not is_dot(dot, known())


def test_a_dot_that_is_half_covered_is_none():
    way = (0.0, 14.0)
    covered = picture(way, cover=lambda u, v: v > 0.0 * u)
    dot = fit_moving_dot(covered, outline(way), ALONG, math.inf, known())
    assert dot is None or not is_dot(dot, known()) or dot.std > 0.15 * RADIUS


def test_a_dot_beyond_the_image_is_none():
    start = outline((0.0, 14.0), (500.0, 0.0))
    grey = picture((0.0, 14.0))
    assert fit_moving_dot(grey, start, ALONG, math.inf, known()) is None
    start = outline((0.0, 14.0), (-500.0, 0.0))
    assert fit_moving_dot(grey, start, ALONG, math.inf, known()) is None


def test_the_end_of_the_arm_is_nearer_where_it_moves_along_itself():
    start = outline((0.0, 14.0))
    aside = end_of_arm(start, ALONG)
    assert aside == pytest.approx(MOVING_DOTS.ends * RADIUS - ELLIPSE.around * BLUR)
    start[[SMEAR_U, SMEAR_V]] = 2.0, 14.0
    assert end_of_arm(start, ALONG) == pytest.approx(aside - 1.0)


def test_a_dot_moves_far_from_a_radius_on():
    both = np.array([outline((0.0, 5.5)), outline((0.0, 6.5))])
    assert moves_far(both).tolist() == [False, True]


def test_a_dot_becomes_a_row_of_the_table():
    start = outline((0.0, 14.0))
    dot = fit_moving_dot(picture((0.0, 14.0)), start, ALONG, math.inf, known())
    row = rows_of(as_fitted(start, dot)[None])[0]
    assert row[[U, V]] == pytest.approx(dot.center)
    assert row[AREA] == pytest.approx(math.pi * (dot.size * RADIUS) ** 2)
    assert (row[STD], row[EXACT]) == (dot.std, 0.0)
    assert row[CONTRAST] == pytest.approx(dot.contrast)
    assert start[WIDTH] == BLUR
