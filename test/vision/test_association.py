"""Who is who among bright areas of a single frame."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.vision.association import (
    find_unplaced_rows,
    least_seen,
    row_from_clamp,
    share_of_blobs,
)
from pneunet_ros.vision.beam_search import BEAM_SEARCH
from pneunet_ros.vision.gating import consistent_spacing, FARTHEST
from pneunet_ros.vision.row_candidates import RowCandidates
import pytest
from support.target_rows import arc, ARCLENGTH, away_from, Mixture, SPACING

TARGETS = np.arange(ARCLENGTH.size)


def believed(mixture, row):
    """Return who is in a row, after the check that follows the search."""
    points = np.where(row.chosen[:, None] >= 0, mixture.points[row.chosen], np.nan)
    seen = consistent_spacing(*np.ascontiguousarray(points.T), ARCLENGTH, FARTHEST, DOMAIN.stretch)
    return np.where(seen, mixture.named(row.chosen), -1)


@pytest.mark.parametrize('bend', [(0.0, 0.0), (35.0, 35.0), (-35.0, 10.0), (5.0, 40.0)])
def test_a_row_alone_is_found_whole(bend):
    rng = np.random.default_rng(3)
    mixture = Mixture(rng, arc(*bend), TARGETS >= 0, np.zeros((0, 2)))
    row = row_from_clamp(mixture.points, mixture.areas, ARCLENGTH, 0.0)
    assert mixture.named(row.chosen).tolist() == TARGETS.tolist()


@pytest.mark.parametrize('bend', [-28.0, -15.0, 15.0, 28.0])
def test_a_row_of_three_on_an_arm_that_curls_is_found(bend):
    """As far as the finger of a gripper whose tip meets that of the other finger."""
    places = ARCLENGTH[[0, 11, 22]]
    row = arc(0.7 * bend, 1.3 * bend, places)
    others = row[1:] * [-1.0, 1.0]  # of the finger on the other side of the clamp
    points = np.vstack([others, row])[[3, 0, 4, 1, 2]]
    found = row_from_clamp(points, np.full(5, 80.0), places, 0.0)
    assert found.chosen.tolist() == [4, 0, 2]


@pytest.mark.parametrize('end', [0, -1])
@pytest.mark.parametrize('off', [1e-3, 0.1])
def test_a_row_that_goes_on_is_no_row_however_well_it_fits(end, off):
    """One dot more than the model has, off by a share of the spacing; the others fit exactly."""
    row = np.stack([SPACING * np.arange(ARCLENGTH.size + 1), np.zeros(ARCLENGTH.size + 1)], 1)
    row += np.random.default_rng(2).normal(0.0, 1e-4 * SPACING, row.shape)
    row[end, 1] += off * SPACING
    areas = np.full(len(row), 80.0)
    assert find_unplaced_rows(row, areas, ARCLENGTH) == []
    assert row_from_clamp(row - row[0] + [ARCLENGTH[0], 0.0], areas, ARCLENGTH, 0.0).seen == 0
    left = np.delete(row, end, axis=0)
    assert len(find_unplaced_rows(left, areas[1:], ARCLENGTH)) == 2  # from either end


def test_rows_among_many_others_with_gaps_have_no_swaps():
    """Up to 150 areas that are none, a tenth of the targets and a run of up to four hidden."""
    rng = np.random.default_rng(1)
    visible_count = found_count = 0
    for _ in range(300):
        row = arc(*rng.uniform(-35.0, 35.0, 2))
        visible = rng.random(TARGETS.size) > 0.1
        hidden = rng.integers(0, 23)
        visible[hidden : hidden + rng.integers(0, 5)] = False
        others = rng.uniform([-0.02, -0.08], [0.13, 0.08], (rng.integers(0, 150), 2))
        mixture = Mixture(rng, row, visible, away_from(row, others, 0.5 * SPACING))
        found = row_from_clamp(mixture.points, mixture.areas, ARCLENGTH, 0.0)
        who = believed(mixture, found)
        if np.count_nonzero(who >= 0) < least_seen(TARGETS.size):
            continue
        wrong = (who != -1) & (who != TARGETS)
        assert not wrong.any(), who
        visible_count += visible.sum()
        found_count += np.count_nonzero(who == TARGETS)
    assert found_count > 0.99 * visible_count > 5000


def test_a_run_hidden_next_to_the_clamp_is_no_shift():
    """What is seen first is many targets from the clamp: it may be another one."""
    rng = np.random.default_rng(2)
    for first in range(1, 12):
        for bend in (-30.0, 0.0, 25.0):
            mixture = Mixture(rng, arc(bend, bend), first <= TARGETS, np.zeros((0, 2)))
            found = row_from_clamp(mixture.points, mixture.areas, ARCLENGTH, 0.0)
            who = mixture.named(found.chosen)
            assert np.all((who == -1) | (who == TARGETS)), (first, bend, who)


@pytest.mark.parametrize('count', [1, 3, 200])
def test_spots_without_a_row_are_no_row(count):
    rng = np.random.default_rng(4)
    for _ in range(20 if count < 100 else 4):
        points = rng.uniform([-0.02, -0.08], [0.13, 0.08], (count, 2))
        areas = rng.uniform(15.0, 400.0, count)
        row = row_from_clamp(points, areas, ARCLENGTH, 0.0)
        found = np.where(row.chosen[:, None] >= 0, points[row.chosen], np.nan)
        seen = consistent_spacing(
            *np.ascontiguousarray(found.T), ARCLENGTH, FARTHEST, DOMAIN.stretch
        )
        assert np.count_nonzero(seen) < least_seen(TARGETS.size)
        assert all(
            row.seen <= TARGETS.size for row in find_unplaced_rows(points, areas, ARCLENGTH)
        )


def test_nothing_bright_is_no_row():
    row = row_from_clamp(np.zeros((0, 2)), np.zeros(0), ARCLENGTH, 0.0)
    assert row.seen == 0
    assert find_unplaced_rows(np.zeros((0, 2)), np.zeros(0), ARCLENGTH) == []


def test_a_straight_row_is_found_wherever_it_is_from_both_ends():
    rng = np.random.default_rng(5)
    for _ in range(20):
        turn = rng.uniform(-3.0, 3.0)
        turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        row = 3000.0 * arc(0.0, 0.0) @ turned + 400.0
        others = np.vstack(
            [
                rng.uniform(0.0, 800.0, (40, 2)),
                # A row of equal dots, shorter than the arm's.
                np.column_stack([100.0 + 14.0 * np.arange(15), np.full(15, 60.0)]),
            ]
        )
        mixture = Mixture(rng, row, TARGETS >= 0, away_from(row, others, 20.0), noise=0.1)
        rows = find_unplaced_rows(mixture.points, mixture.areas, ARCLENGTH)
        found = {tuple(mixture.named(row.chosen).tolist()) for row in rows}
        assert tuple(TARGETS.tolist()) in found
        assert tuple(TARGETS[::-1].tolist()) in found


@pytest.mark.parametrize('seen', [23, 22])
@pytest.mark.parametrize('even', [True, False])
def test_near_a_row_that_costs_little_are_its_targets_and_few_others(seen, even):
    """Rows of others cost far more; the last target may be one of the areas not known yet."""
    rng = np.random.default_rng(7)
    arclength = ARCLENGTH
    if not even:
        arclength = ARCLENGTH + 0.1 * SPACING * rng.uniform(-1.0, 1.0, TARGETS.size)
        arclength = arclength - arclength[0]
    row = 3000.0 * arc(0.0, 5.0, arclength=arclength)
    others = rng.uniform([-100.0, -200.0], [400.0, 200.0], (60, 2))
    mixture = Mixture(rng, row, TARGETS >= 0, away_from(row, others, 8.0), noise=0.1)
    points, areas = mixture.points, mixture.areas

    def near_rows_of(known, limit):
        candidates = RowCandidates(
            points[known], areas[known], arclength, BEAM_SEARCH, most=len(points)
        )
        return candidates.near(points, limit)

    known = mixture.who < seen
    near = {limit: near_rows_of(known, limit) for limit in (10.0, 30.0, np.inf)}
    for found in near.values():
        assert set(np.flatnonzero(mixture.who >= 0)) <= set(found)
    assert len(near[10.0]) <= len(near[30.0]) < 0.4 * len(near[np.inf])
    assert not len(near_rows_of(mixture.who < 0, 10.0))


@pytest.mark.parametrize('even', [True, False])
def test_a_row_that_begins_or_ends_with_odd_dots_is_near_itself(even):
    """What a row costs may be spent at one end or at the other, or in its middle."""
    rng = np.random.default_rng(8)
    arclength = ARCLENGTH if even else ARCLENGTH * np.linspace(0.8, 1.0, TARGETS.size)
    row, shapes = 3000.0 * arc(0.0, 0.0, arclength=arclength), np.zeros((TARGETS.size, 3))
    for odd in (TARGETS < 4, TARGETS > 18, abs(TARGETS - 11) < 3):
        areas = np.where(odd, 80.0 * np.exp(rng.uniform(-1.0, 1.0, TARGETS.size)), 80.0)
        candidates = RowCandidates(row, areas, arclength, BEAM_SEARCH, shapes)
        (best, *_) = find_unplaced_rows(row, areas, arclength, shapes=shapes)
        (there, *_) = find_unplaced_rows(
            row, areas, arclength, shapes=shapes, limit=2.0 * best.cost
        )
        assert there.cost == best.cost and share_of_blobs(there, best) == 1.0
        assert len(candidates.near(row, 2.0 * best.cost)) == TARGETS.size


def test_a_crowd_has_parts_of_rows_by_chance_and_a_single_row_has_not():
    rng = np.random.default_rng(9)
    row = 3000.0 * arc(0.0, 5.0)
    crowd = rng.uniform([-100.0, -200.0], [400.0, 200.0], (400, 2))
    alone, crowded = (
        RowCandidates(points, np.full(len(points), 80.0), ARCLENGTH) for points in (row, crowd)
    )
    assert crowded.are_crowded(10, 100.0)
    assert not alone.are_crowded(10, 100.0)


def test_a_longer_row_of_equal_dots_is_not_the_arm():
    points = np.column_stack([10.0 * np.arange(30), np.full(30, 5.0)])
    assert find_unplaced_rows(points, np.full(30, 80.0), ARCLENGTH) == []


def test_two_rows_alike_are_both_given():
    one = 3000.0 * arc(0.0, 0.0)
    points = np.vstack([one, one + np.array([0.0, 100.0])])
    rows = find_unplaced_rows(points, np.full(len(points), 80.0), ARCLENGTH)
    assert len(rows) == 4
    assert {share_of_blobs(rows[0], row) for row in rows} == {0.0, 1.0}


def test_a_glint_beside_the_arm_does_not_lead_astray():
    row = arc(10.0, 20.0)
    glint = row[12] + [0.0, 0.3 * SPACING]
    rng = np.random.default_rng(6)
    mixture = Mixture(rng, row, TARGETS >= 0, glint[None])
    found = row_from_clamp(mixture.points, mixture.areas, ARCLENGTH, 0.0)
    who = believed(mixture, found)
    assert np.all((who == TARGETS) | (who == -1))
    assert np.count_nonzero(who == TARGETS) >= 22


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_spacing_need_not_be_equal(seed):
    rng = np.random.default_rng(seed)
    arclength = np.cumsum(rng.uniform(0.004, 0.007, 15)) - 0.004
    row = arc(*rng.uniform(-20.0, 20.0, 2), arclength=np.concatenate([[0.0], arclength]))[1:]
    found = row_from_clamp(row[::-1].copy(), np.full(15, 80.0), arclength, 0.0)
    assert found.chosen.tolist() == list(range(14, -1, -1))


def test_elongated_dots_cost_the_same_whichever_way_they_point():
    """From the middle on they are longer, which is odd of the first one of them alone."""
    row, areas, costs = arc(10.0, 20.0), np.full(TARGETS.size, 80.0), []
    for along, aslant in ((0.6, 0.0), (0.0, 0.6), (-0.36, 0.48)):
        shapes = np.zeros((TARGETS.size, 3))
        shapes[12:, :2] = along, aslant
        found = row_from_clamp(row, areas, ARCLENGTH, 0.0, shapes=shapes)
        assert found.chosen.tolist() == TARGETS.tolist()
        costs.append(found.cost)
    assert costs == pytest.approx([costs[0]] * 3)
