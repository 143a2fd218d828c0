"""What can be believed of a row, and where lost targets are expected."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.vision.gating import (
    consistent_motion,
    consistent_size,
    consistent_spacing,
    expected_points,
    FARTHEST,
    initial_area,
)
import pytest
from support.target_rows import arc, ARCLENGTH, SPACING


def believed(points, farthest=FARTHEST):
    return consistent_spacing(*np.ascontiguousarray(points.T), ARCLENGTH, farthest, DOMAIN.stretch)


@given(st.floats(-35.0, 35.0), st.floats(-35.0, 35.0), st.integers(0, 2**32 - 1))
def test_a_bent_row_with_badly_painted_targets_is_believed(first, last, seed):
    noise = np.random.default_rng(seed).normal(0.0, 5e-5, (ARCLENGTH.size, 2))
    assert believed(arc(first, last) + noise).all()


@given(st.integers(0, 22), st.floats(0.0, 6.28), st.floats(0.5, 3.0))
@example(20, 4.0, 2.0)
def test_a_target_beside_its_place_is_not_believed_and_all_others_are(target, angle, away):
    points = arc(5.0, 25.0)
    points[target] += away * SPACING * np.array([np.cos(angle), np.sin(angle)])
    # Also where the curve of its neighbor, through it, is further off than it is itself.
    assert np.flatnonzero(~believed(points)).tolist() == [target]


@pytest.mark.parametrize('target', [0, 11, 22])
def test_two_names_for_one_area_are_not_both_believed(target):
    points = arc(10.0, 10.0)
    other = target + 1 if target < 22 else target - 1
    points[other] = points[target]
    assert not believed(points)[[target, other]].all()


def test_a_last_target_far_from_all_others_is_believed_only_where_it_was_followed():
    points = arc(10.0, 10.0)
    points[18:22] = np.nan
    assert not believed(points)[22]
    assert believed(points, np.inf)[22]


def test_nothing_is_believed_of_a_single_target():
    points = np.full((ARCLENGTH.size, 2), np.nan)
    points[4] = 0.02, 0.0
    assert not believed(points).any()


@pytest.mark.parametrize(
    ('hidden', 'off'),
    [([7], 0.01), ([7, 8, 9], 0.06), ([0], 0.1), ([22], 0.1), ([21, 22], 0.25), ([0, 5, 22], 0.1)],
)
def test_lost_targets_are_expected_where_they_are(hidden, off):
    for bend in [(0.0, 0.0), (35.0, 35.0), (5.0, 30.0)]:
        points = arc(*bend)
        partly = points.copy()
        partly[hidden] = np.nan
        found = np.column_stack(expected_points(*np.ascontiguousarray(partly.T), ARCLENGTH))
        assert np.hypot(*(found - points).T).max() <= off * SPACING
        known = np.delete(np.arange(ARCLENGTH.size), hidden)
        assert np.array_equal(found[known], points[known])


def test_nothing_is_expected_of_a_single_target():
    points = np.full((ARCLENGTH.size, 2), np.nan)
    points[4] = 0.02, 0.0
    found = np.column_stack(expected_points(*np.ascontiguousarray(points.T), ARCLENGTH))
    assert np.count_nonzero(np.isfinite(found[:, 0])) == 1


def start_areas(*area, whole=()):
    """Return how large targets of these areas start; whole: those with all of their edge."""
    return initial_area(np.array(area), np.isin(np.arange(len(area)), whole))


def test_a_target_starts_about_as_large_as_most():
    first = start_areas(80.0, np.nan, 30.0, 82.0, 81.0)
    assert first[1] == pytest.approx(80.5)
    assert first[2] > 50.0  # it was covered in the first frame, and may come out larger
    assert start_areas(80.0, 120.0, 80.0, 80.0)[1] < 90.0  # with a glint
    assert first[[0, 3, 4]].tolist() == [80.0, 82.0, 81.0]
    assert np.isnan(start_areas(np.nan, np.nan, np.nan)).all()


def test_a_dot_painted_by_hand_whose_edge_is_all_seen_is_as_large_as_it_is():
    first = start_areas(80.0, 120.0, 50.0, 82.0, 50.0, whole=(0, 1, 2))
    assert first[[0, 1, 2]].tolist() == [80.0, 120.0, 50.0]
    assert first[4] > 50.0


@pytest.mark.parametrize(
    ('area', 'elongation', 'alike'),
    [(1.0, 1.1, True), (0.75, 1.1, False), (1.4, 1.1, False), (1.1, 1.8, False)],
)
def test_what_is_covered_or_has_a_glint_on_it_does_not_look_alike(area, elongation, alike):
    usual = np.full(9, 80.0)
    areas, elongations = usual.copy(), np.full(9, 1.05)
    areas[4] *= area
    elongations[4] = elongation
    expected_mask = np.arange(9) != 4
    expected_mask[4] = alike
    assert consistent_size(areas, usual, elongations).tolist() == expected_mask.tolist()


@pytest.mark.parametrize(('area', 'alike'), [(0.9, True), (1.2, True), (1.38, False)])
def test_a_glint_that_hangs_on_to_a_target_shows_when_a_row_is_found(area, alike):
    areas = np.full(9, 48.0)
    areas[4] *= area
    elongation = np.full(9, 1.02)
    elongation[4] = 1.34  # hardly allowed: the area must tell
    assert consistent_size(
        areas, initial_area(areas, np.zeros(9, np.bool_)), elongation
    ).tolist() == [place != 4 or alike for place in range(9)]


def test_motion_makes_all_longer_and_larger_alike():
    usual = np.full(9, 80.0)
    assert consistent_size(1.3 * usual, usual, np.full(9, 1.9)).all()
    assert not consistent_size(np.full(9, np.nan), usual, np.full(9, np.nan)).any()


def test_a_target_that_moves_alone_is_told_from_those_that_move_together():
    off_x = np.linspace(0.0, 6.0, 23)  # the further out the faster
    off_y = 0.3 * off_x
    assert consistent_motion(np.column_stack([off_x, off_y]), 20.0)[0].all()
    off_x[20] += 2.0  # a glint touches it
    together = consistent_motion(np.column_stack([off_x, off_y]), 20.0)[0]
    assert np.flatnonzero(~together).tolist() == [20]
    off_x[14:18] = np.nan  # a hand; what is beyond it moves otherwise than what is before it
    off_x[18:] += 5.0
    together = consistent_motion(np.column_stack([off_x, off_y]), 20.0)[0]
    assert together[:14].all()
    assert together[[18, 19, 21, 22]].all()
    assert not together[14:18].any()
