"""Scale and base frame from the arm at rest."""

from __future__ import annotations

import numpy as np
from pneunet_ros.vision.rest_plane import bow, Failure, RestAverage, row_at_rest, row_points
import pytest
from support.target_rows import arc, ARCLENGTH, away_from, Mixture, SPACING

TARGETS = np.arange(ARCLENGTH.size)
FOCAL, ORIGIN, SCALE = 700.0, np.array([320.0, 240.0]), 2.5  # px, px, normalized per m


def view(turn=0.0, bend=0.0, others=(), shift=(-0.15, 0.02)):
    """Return a mixture in normalized coordinates, with the arm where a camera may see it."""
    rng = np.random.default_rng(7)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    row = SCALE * arc(bend, bend) @ turned + np.array(shift)
    spots = np.vstack([rng.uniform(-0.4, 0.4, (30, 2)), *others])
    return Mixture(rng, row, TARGETS >= 0, away_from(row, spots, 0.02), noise=1e-5), row


def found(mixture, clamp_pixel=None, straightness=0.02):
    pixels = FOCAL * mixture.points + ORIGIN
    return row_at_rest(mixture.points, pixels, mixture.areas, ARCLENGTH, clamp_pixel, straightness)


@pytest.mark.parametrize('turn', [0.0, 0.4, -1.2])
def test_the_left_most_end_is_the_clamp(turn):
    mixture, row = view(turn)
    result = found(mixture)
    assert mixture.named(result.chosen).tolist() == TARGETS.tolist()
    assert row_points(result, mixture.points) == pytest.approx(row, abs=1e-4)


def test_the_clamp_is_where_clamp_pixel_says():
    mixture, row = view()
    result = found(mixture, clamp_pixel=tuple(FOCAL * row[-1] + ORIGIN + 3.0))
    assert mixture.named(result.chosen).tolist() == TARGETS[::-1].tolist()


def test_a_row_that_does_not_begin_at_clamp_pixel_is_refused():
    mixture, row = view()
    result = found(mixture, clamp_pixel=tuple(FOCAL * row[11] + ORIGIN))
    assert isinstance(result, Failure)
    assert result.reason == 'wrong_clamp'


def test_a_bent_arm_is_refused_with_how_bent_it_is():
    mixture, row = view(bend=6.0)
    result = found(mixture)
    assert isinstance(result, Failure)
    assert result.reason == 'not_straight'
    assert f'{bow(row):.1%} of the length' in result.sentence
    assert not isinstance(found(mixture, straightness=1.2 * bow(row)), Failure)


def test_two_rows_alike_are_refused_unless_the_clamp_is_told():
    _, row = view()
    mixture, row = view(others=[row + np.array([0.05, 0.15])])
    mixture.areas[mixture.who < 0] = 80.0
    result = found(mixture)
    assert isinstance(result, Failure)
    assert result.reason == 'several_rows'
    told = found(mixture, clamp_pixel=tuple(FOCAL * row[0] + ORIGIN))
    assert mixture.named(told.chosen).tolist() == TARGETS.tolist()


def test_no_row_says_how_many_areas_there_were():
    points = np.random.default_rng(8).uniform(-0.4, 0.4, (17, 2))
    result = row_at_rest(points, points, np.full(17, 80.0), ARCLENGTH, None, 0.02)
    assert isinstance(result, Failure)
    assert result.reason == 'no_row'
    assert '23 targets' in result.sentence
    assert '17 bright areas' in result.sentence


def test_frames_at_rest_are_averaged():
    rng = np.random.default_rng(9)
    ends = np.array([[-0.15, 0.02], [0.12, 0.02]])
    frames = ends + rng.normal(0.0, 1e-4, (5, 2, 2))
    rest = RestAverage()
    for frame in frames:
        rest = rest.with_frame(frame, SCALE * SPACING)
    assert rest.frames == 5
    assert rest.ends == pytest.approx(frames.mean(axis=0), abs=1e-15)
    plane = rest.plane(ARCLENGTH)
    assert plane.points(rest.ends) == pytest.approx(np.array([[0.0, 0.0], [0.11, 0.0]]), abs=1e-12)


def test_an_arm_that_moves_is_not_at_rest():
    ends = np.array([[-0.15, 0.02], [0.12, 0.02]])
    rest = RestAverage().with_frame(ends, SCALE * SPACING)
    moved = ends + np.array([[0.0, 0.0], [0.0, 0.2 * SCALE * SPACING]])
    rest = rest.with_frame(moved, SCALE * SPACING)
    assert rest.frames == 1
    assert np.array_equal(rest.ends, moved)
