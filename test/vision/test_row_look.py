"""What a row of targets tells of one of them: how large it is, and whether it is one."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.vision.dots.centroid import (
    ANGLE,
    AREA,
    BEYOND,
    BLUR,
    COLUMNS,
    CONTRAST,
    EXACT,
    FILLED,
    LEVEL,
    MAJOR,
    MINOR,
    SEEN,
    SMEAR,
    STD,
    U,
    V,
)
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_XY,
    AXIS_YY,
    BEHIND,
    PLATEAU,
    SHAPE_STD,
    SIZE_STD,
    SMEAR_STD,
    SMEAR_U,
    SMEAR_V,
)
from pneunet_ros.vision.row_look import (
    believable_parts,
    has_whole_edge,
    LEAST_SMEAR_STD,
    looks_of_neighbors,
    part_stds,
    ROW_LOOK,
    share_of_area,
    shows_own_size,
    whole_targets,
)
import pytest

COUNT = 12
UNKNOWN = np.full(COUNT, np.nan)  # how large each is by itself


def row_of(major, minor, angle=0.0):
    """Return a table of whole targets with these axes, (targets,) px."""
    table = np.zeros((COUNT, COLUMNS))
    table[:, U], table[:, V] = 40.0 * np.arange(COUNT), 100.0
    table[:, MAJOR], table[:, MINOR], table[:, ANGLE] = major, minor, angle
    table[:, AREA] = 0.25 * np.pi * table[:, MAJOR] * table[:, MINOR]
    table[:, BLUR], table[:, LEVEL], table[:, CONTRAST] = 0.8, 220.0, 170.0
    table[:, [SEEN, EXACT, FILLED]], table[:, STD] = 1.0, 0.02
    return table


@pytest.mark.parametrize('target', [0, 5, COUNT - 1])
def test_neighbors_tell_a_size_that_changes_along_the_arm(target):
    major = 10.0 - 0.3 * np.arange(COUNT)
    table = row_of(major, 0.8 * major, angle=0.5)
    whole = table.copy()
    table[target, [AREA, EXACT]] = 0.9 * table[target, AREA], 0.7
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)[target]
    cosine, sine = np.cos(0.5), np.sin(0.5)
    long, short = 0.5 * whole[target, MAJOR], 0.5 * whole[target, MINOR]
    assert expected[AXIS_XX] == pytest.approx(long * cosine**2 + short * sine**2)
    assert expected[AXIS_XY] == pytest.approx((long - short) * cosine * sine)
    assert expected[AXIS_YY] == pytest.approx(long * sine**2 + short * cosine**2)
    assert expected[SHAPE_STD] == ROW_LOOK.least_std
    assert expected[[PLATEAU, BEHIND]] == pytest.approx([220.0, 50.0])
    share = share_of_area(table, looks_of_neighbors(table, table[:, :2], UNKNOWN))
    assert share[target] == pytest.approx(0.9)
    assert np.delete(share, target) == pytest.approx(1.0)


def test_sizes_that_differ_tell_less():
    random = np.random.default_rng(2)
    major = 10.0 * (1.0 + 0.05 * random.standard_normal(COUNT))
    table = row_of(major, major)
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    assert 0.02 < np.median(expected[:, SIZE_STD]) < 0.15
    assert expected[:, SHAPE_STD] == pytest.approx(ROW_LOOK.least_std)  # all of them are round


def test_a_target_whose_own_size_is_known_has_it_whatever_its_neighbors_have():
    random = np.random.default_rng(2)
    major = 10.0 * (1.0 + 0.1 * random.standard_normal(COUNT))
    own = row_of(major, major)[:, AREA]
    table = row_of(1.02 * major, 1.02 * major)  # the camera is nearer now
    own[-1] = np.nan
    expected = looks_of_neighbors(table, table[:, :2], own)
    assert expected[:-1, AXIS_XX] == pytest.approx(0.51 * major[:-1])
    assert expected[:-1, SIZE_STD] == pytest.approx(ROW_LOOK.least_std)
    assert expected[-1, SIZE_STD] > 0.05
    covered = table.copy()
    covered[4, AREA] *= 0.97
    assert np.flatnonzero(~whole_targets(covered, expected)).tolist() == [4]


def test_a_part_may_be_as_large_as_sizes_differ():
    major = 10.0 * (1.0 + 0.1 * np.random.default_rng(2).standard_normal(COUNT))
    table = row_of(major, major)
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    small = table.copy()
    small[4, AREA] = 0.7 * math.pi * expected[4, AXIS_XX] ** 2
    assert believable_parts(small, expected, np.ones(COUNT))[4]
    expected[:, SIZE_STD] = ROW_LOOK.least_std
    assert not believable_parts(small, expected, np.ones(COUNT))[4]


def test_an_edge_that_is_hardly_known_is_not_a_whole_one():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[-1, STD] *= 5.0  # a tip that is cut off, to which an outline was fitted
    assert np.flatnonzero(~has_whole_edge(table)).tolist() == [COUNT - 1]
    assert not has_whole_edge(np.full_like(table, np.nan)).any()


@pytest.mark.parametrize(('way', 'shown'), [(5.0, True), (10.0, False)])
def test_a_larger_target_cut_off_shows_its_size_only_where_it_hardly_moves(way, shown):
    table = row_of(10.0, 10.0)
    table[-1, [MAJOR, AREA, EXACT]] = 18.0, 45.0 * np.pi, 0.9
    table[:, SMEAR] = 0.0, way  # a way of more than a radius may count as length
    assert bool(shows_own_size(table)[-1]) is shown


def test_too_few_whole_neighbors_tell_nothing():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[3:] = np.nan
    assert np.isnan(looks_of_neighbors(table, np.zeros((COUNT, 2)), UNKNOWN)[:3, AXIS_XX]).all()
    assert np.isfinite(looks_of_neighbors(table, np.zeros((COUNT, 2)), UNKNOWN)[3:, AXIS_XX]).all()


@pytest.mark.parametrize(
    ('column', 'value', 'share', 'believed'),
    [
        (SEEN, 0.55, np.nan, True),
        (SEEN, 0.45, np.nan, False),
        (SEEN, 0.45, 0.92, True),
        (FILLED, 0.4, 0.92, False),
        (LEVEL, 150.0, 0.92, False),
        (LEVEL, 195.0, np.nan, True),
        (U, np.nan, 1.0, True),
        (BEYOND, 0.2, 0.92, False),
        (BLUR, 1.2, 0.92, True),
        (BLUR, 1.5, 0.92, False),
        (STD, 0.9, 0.92, False),
    ],
)
def test_a_part_must_look_as_its_neighbors_do(column, value, share, believed):
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    found, shares = table.copy(), np.ones(COUNT)
    found[4, column], shares[4] = value, share
    assert believable_parts(found, expected, shares)[4] == believed
    assert not believable_parts(np.full_like(found, np.nan), expected, shares).any()


def test_a_part_that_moves_along_what_covers_it_is_less_sure():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[:, STD] = 0.02
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    assert part_stds(table, expected) == pytest.approx(np.full(COUNT, 0.02), rel=2e-3)
    table[:, SMEAR] = [3.0, 4.0]
    error = np.hypot(0.02, ROW_LOOK.part_error * 25.0 / 5.0)
    assert part_stds(table, expected) == pytest.approx(np.full(COUNT, error), rel=2e-3)


def test_a_part_of_another_level_or_blur_than_neighbors_is_less_sure():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[:, STD] = 0.02
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    table[3, LEVEL] -= 4.0 * ROW_LOOK.level_std * 170.0
    table[4, BLUR] += 3.0 * ROW_LOOK.blur_std
    assert part_stds(table, expected)[2:6] == pytest.approx([0.02, 0.08, 0.06, 0.02], rel=2e-3)


def test_a_target_of_which_a_bit_is_covered_tells_nothing_of_its_neighbors():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[7, [MINOR, AREA]] *= 0.95
    expected = looks_of_neighbors(table, table[:, :2], UNKNOWN)
    assert np.delete(expected[:, AXIS_YY], 7) == pytest.approx(5.0)
    assert expected[:, SHAPE_STD] == pytest.approx(ROW_LOOK.least_std)
    assert not whole_targets(table, expected)[7]


def test_neighbors_tell_how_far_a_target_moves_while_the_shutter_is_open():
    table = row_of(np.full(COUNT, 10.0), np.full(COUNT, 10.0))
    table[:, SMEAR] = np.column_stack([0.2 * np.arange(COUNT), -0.1 * np.arange(COUNT)])
    last = looks_of_neighbors(table, table[:, :2], UNKNOWN)[-1]
    assert last[[SMEAR_U, SMEAR_V]] == pytest.approx(table[-1, SMEAR])
    assert last[SMEAR_STD] == LEAST_SMEAR_STD
