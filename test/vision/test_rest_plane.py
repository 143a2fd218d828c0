"""Scale and base frame from the arm at rest."""

from __future__ import annotations

import numpy as np
from pneunet_ros.vision.camera.camera_settings import CurvedRestPlane, RestPlane
from pneunet_ros.vision.rest_plane import (
    bow,
    Failure,
    PLACES,
    plane_at_rest,
    RestSearch,
    row_at_rest,
    row_points,
)
from pneunet_ros.vision.settings import VISION
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


def found(mixture, clamp_pixel=None, straightness=0.02, shapes=None):
    points, areas = mixture.points, mixture.areas
    pixels = FOCAL * points + ORIGIN
    return row_at_rest(points, pixels, areas, ARCLENGTH, clamp_pixel, straightness, VISION, shapes)


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
    assert f'{bow(row):.1%}' in result.sentence
    assert not isinstance(found(mixture, straightness=1.2 * bow(row)), Failure)


def test_two_rows_alike_are_refused_unless_the_clamp_is_told():
    _, row = view()
    mixture, row = view(others=[row + np.array([0.05, 0.15])])
    mixture.areas[mixture.who < 0] = 80.0
    result = found(mixture)
    assert isinstance(result, Failure)
    assert result.reason == 'several_rows'
    given = found(mixture, clamp_pixel=tuple(FOCAL * row[0] + ORIGIN))
    assert mixture.named(given.chosen).tolist() == TARGETS.tolist()


def test_a_second_row_whose_targets_are_not_alike_is_there_by_chance():
    """Where areas are many, some of them stand in a row: with jumps of size no arm has."""
    _, row = view()
    mixture, row = view(others=[row + np.array([0.05, 0.15])])
    rivals = np.flatnonzero((mixture.who < 0) & (np.abs(mixture.points[:, 1] - 0.17) < 1e-9))
    assert rivals.size == TARGETS.size
    along = rivals[np.argsort(mixture.points[rivals, 0])]
    for smaller, larger, chance in ((76.0, 84.0, False), (55.0, 110.0, True)):
        mixture.areas[along] = np.where(TARGETS % 2, smaller, larger)
        result = found(mixture)
        assert isinstance(result, Failure) == (not chance)
    assert mixture.named(result.chosen).tolist() == TARGETS.tolist()


@pytest.mark.parametrize('column', [0, 1, 2])
def test_a_second_row_of_other_shapes_or_blur_is_there_by_chance(column):
    """Clutter stands in a row here and there, but dots are as round and as sharp as each other."""
    _, row = view()
    mixture, row = view(others=[row + np.array([0.05, 0.15])])
    mixture.areas[mixture.who < 0] = 80.0
    rivals = np.flatnonzero((mixture.who < 0) & (np.abs(mixture.points[:, 1] - 0.17) < 1e-9))
    shapes = np.random.default_rng(3).normal(0.0, 0.02, (len(mixture.points), 3))
    assert isinstance(found(mixture, shapes=shapes), Failure)
    shapes[rivals[::2], column] += 0.4
    result = found(mixture, shapes=shapes)
    assert mixture.named(result.chosen).tolist() == TARGETS.tolist()


def test_no_row_says_how_many_areas_there_were():
    points = np.random.default_rng(8).uniform(-0.4, 0.4, (17, 2))
    result = row_at_rest(points, points, np.full(17, 80.0), ARCLENGTH, None, 0.02)
    assert isinstance(result, Failure)
    assert result.reason == 'no_row'
    assert '23 targets' in result.sentence
    assert '17 areas' in result.sentence


LENGTH = ARCLENGTH[-1]


def frames_at_rest(count, at=(-0.15, 0.02), noise=1e-4):
    """Return rows of a straight arm (count, targets, 2), normalized."""
    rng = np.random.default_rng(9)
    row = SCALE * arc(0.0, 0.0) + np.array(at)
    return row + rng.normal(0.0, noise, (count, *row.shape))


def averaged(frames, rest=None):
    rest = RestSearch() if rest is None else rest
    for frame in frames:
        rest = rest.with_frame(frame, SCALE * SPACING)
    return rest


def test_frames_at_rest_are_averaged():
    frames = frames_at_rest(5)
    rest = averaged(frames)
    assert rest.frames == 5
    (place,) = rest.places
    assert place.points == pytest.approx(frames.mean(axis=0), abs=1e-15)
    plane = plane_at_rest(place.points, ARCLENGTH, RestPlane(), 0.0)
    assert plane.points(place.points[[0, -1]]) == pytest.approx(
        np.array([[0.0, 0.0], [LENGTH, 0.0]]), abs=1e-12
    )


def test_an_arm_that_moves_is_not_at_rest():
    frame = frames_at_rest(1)[0]
    moved = frame + np.outer(np.linspace(0.0, 0.2 * SCALE * SPACING, len(frame)), [0.0, 1.0])
    rest = averaged([frame, moved])
    assert rest.frames == 1
    assert np.array_equal(rest.places[0].points, moved)


def test_one_bad_frame_does_not_begin_the_rest_anew():
    frames = frames_at_rest(5)
    rest = averaged([*frames[:3], frames_at_rest(1, at=(-0.1, 0.1))[0], *frames[3:]])
    assert rest.places[0].frames == 5
    assert rest.places[0].points == pytest.approx(frames.mean(axis=0), abs=1e-15)
    assert rest.missing_frames(5) == ''


def test_only_so_many_places_are_remembered_and_the_richest_among_them():
    rest = averaged(frames_at_rest(3))
    for place in range(2 * PLACES):
        rest = averaged(frames_at_rest(1, at=(0.05 * place, 0.3)), rest)
    assert len(rest.places) == PLACES
    assert rest.frames == 3


def test_targets_may_be_missing_in_frames_of_the_rest():
    frames = frames_at_rest(5)
    frames[1, 4] = frames[2, 22] = frames[3, 22] = np.nan
    place = averaged(frames).places[0]
    assert place.seen.tolist() == [5] * 4 + [4] + [5] * 17 + [3]
    assert place.points[22] == pytest.approx(frames[[0, 1, 4], 22].mean(axis=0), abs=1e-15)
    assert place.missing_frames(5) == ''


def test_what_is_missing_is_said():
    frames = frames_at_rest(5)
    frames[:, 7] = np.nan
    said = averaged(frames[:3]).missing_frames(5)
    assert ('3 of 5 ' in said, 'target 7 ' in said) == (True, True)


def test_the_outermost_targets_that_are_seen_give_the_scale():
    frames = frames_at_rest(5, noise=0.0)
    whole = plane_at_rest(averaged(frames).places[0].points, ARCLENGTH, RestPlane(), 0.0)
    frames[:, [0, 21, 22]] = np.nan
    place = averaged(frames).places[0]
    assert place.missing_frames(5) == ''
    plane = plane_at_rest(place.points, ARCLENGTH, RestPlane(), 0.0)
    assert plane.points(frames[0, 1:21]) == pytest.approx(whole.points(frames[0, 1:21]), abs=1e-12)


def test_targets_are_recognized_where_the_arm_has_rested():
    first, second = frames_at_rest(2)
    others = np.random.default_rng(3).uniform(-0.4, 0.4, (50, 2))
    points = np.concatenate([second[1:-1], away_from(second, others, 0.01)])
    found = averaged([first]).recognize(points, ARCLENGTH)
    assert np.isnan(found[[0, -1]]).all()
    assert np.array_equal(found[1:-1], second[1:-1])
    assert averaged([first]).recognize(points[8:], ARCLENGTH) is None
    assert RestSearch().recognize(points, ARCLENGTH) is None


@pytest.mark.parametrize('hidden', [0, 3])
@pytest.mark.parametrize('turn', [0.0, 0.7])
def test_an_arm_bent_at_rest_gives_scale_along_its_arc_and_frame_at_its_clamp(turn, hidden):
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    row = SCALE * arc(25.0, 5.0) @ turned + np.array([-0.1, 0.05])
    row[5] = row[:hidden] = np.nan
    plane = plane_at_rest(row, ARCLENGTH, CurvedRestPlane(), 0.0)
    back = plane.points(row)
    expected = arc(25.0, 5.0) * [1.0, -1.0]  # y is up where the image goes down
    assert np.nanmax(np.hypot(*(back - expected).T)) < 2e-5 * (1 + hidden)


@pytest.mark.parametrize('turn', [0.5 * np.pi, 1.45, -1.65])
def test_an_upright_row_has_no_left_end(turn):
    mixture, row = view(turn)
    result = found(mixture)
    assert isinstance(result, Failure)
    assert result.reason == 'upright' and 'clamp_pixel' in result.sentence
    given = found(mixture, clamp_pixel=tuple(FOCAL * row[0] + ORIGIN))
    assert mixture.named(given.chosen).tolist() == TARGETS.tolist()
