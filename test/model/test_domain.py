"""The domain of a model: what it spans, what is beyond it, and what a load beyond is told."""

from __future__ import annotations

from dataclasses import replace
import itertools
import math

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.domain import (
    DOMAIN,
    Domain,
    load_hull,
    MOST_LOADS,
    spanned_domain,
    WRITTEN_LOADS,
)
from pneunet_ros.model.domain_position import (
    LOAD_BEYOND,
    LOAD_OUT_OF_DOMAIN,
    LOADS_UNKNOWN,
    locate_load,
    OUT_OF_RANGE,
    PRESSURE_BEYOND,
)
from pneunet_ros.model.equilibrium import solve
import pytest
from scipy.spatial import ConvexHull
from support.example_arms import LENGTH, paper_arm, TABLE_1, WIDE
from support.refusals import refused

QUIET = np.zeros(4)
RANGE = (0.0, 60e3)


def hull_of(*rows, pressure=RANGE):
    return load_hull(np.array(rows, dtype=float), pressure, LENGTH)


def distance(hull, *load):
    return hull.distance(np.array(load, dtype=float), QUIET)


def position(arm, force=(0.0, 0.0), moment=0.0, pressure=31e3):
    load = Load(pressure=pressure, force_x=force[0], force_y=force[1], moment=moment)
    return locate_load(arm, load, pressure)


# The hull


def test_the_distance_is_that_to_the_faces_of_the_hull():
    """Against the half-spaces of Qhull: inside none is violated, outside the nearest is."""
    rng = np.random.default_rng(4)
    rows = np.column_stack(
        [rng.uniform(-0.3, 0.3, (24, 2)), rng.uniform(-0.02, 0.02, 24), rng.uniform(0.0, 60e3, 24)]
    )
    hull = hull_of(*rows)
    faces = ConvexHull(hull.points).equations
    inside = 0
    for load in rng.uniform(-1.0, 1.0, (200, 4)) * (0.3, 0.3, 0.02, 30e3) + (0, 0, 0, 30e3):
        at = load * hull.scale
        largest = float(np.max(faces[:, :4] @ at + faces[:, 4]))
        found = distance(hull, *load)
        inside += largest <= 0.0
        assert (found == 0.0) == (largest <= 0.0)
        assert found >= largest - 1e-12
        nearest = at - hull.way_out(at)
        assert np.max(faces[:, :4] @ nearest + faces[:, 4]) < 1e-9
    assert 20 < inside < 180


@pytest.mark.parametrize(
    ('rows', 'load', 'expected'),
    [
        # a box: the nearest face, edge, corner
        (list(itertools.product((0, 0.3), (0, 0.3), (0,), RANGE)), (0.4, 0.1, 0, 1e4), 0.1),
        (list(itertools.product((0, 0.3), (0, 0.3), (0,), RANGE)), (0.4, 0.4, 0, 1e4), 0.02**0.5),
        # one weight: on the way to it, beside it, beyond it
        ([(0, 0.3, 0, 0), (0, 0.3, 0, 60e3)], (0, 0.15, 0, 3e4), 0.0),
        ([(0, 0.3, 0, 0), (0, 0.3, 0, 60e3)], (0.1, 0.15, 0, 3e4), 0.1),
        ([(0, 0.3, 0, 0), (0, 0.3, 0, 60e3)], (0, 0.5, 0, 3e4), 0.2),
        # a moment alone, as the force that makes it at the end of the arm
        ([(0, 0, 0.01, 0), (0, 0, 0.01, 60e3)], (0, 0, 0.02, 3e4), 0.01 / LENGTH),
        # never loaded
        ([(0, 0, 0, 0)], (0, 0, 0, 4e4), 0.0),
        ([(0, 0, 0, 0)], (0, 0.2, 0, 4e4), 0.2),
    ],
)
def test_hulls_of_all_kinds_have_a_distance(rows, load, expected):
    assert distance(hull_of(*rows), *load) == pytest.approx(expected, abs=1e-12)


def test_a_load_at_another_pressure_is_beyond_by_the_pressure_between():
    """Half of the range counts as half of the largest load; the way there is the shortest."""
    hull = hull_of((0, 0.4, 0, 0))
    assert hull.scale[3] == pytest.approx(0.4 / 60e3)
    assert distance(hull, 0, 0.4, 0, 30e3) == pytest.approx(0.2 / math.sqrt(2.0))


def test_an_arm_of_one_pressure_has_a_hull():
    hull = hull_of((0, 0.3, 0, 0), pressure=(0.0, 0.0))
    assert distance(hull, 0, 0.2, 0, 0) == 0.0
    assert hull.share(distance(hull, 0, 0.6, 0, 0)) == pytest.approx(1.0)


def test_noise_of_the_load_is_no_distance():
    hull = hull_of((0, 0.3, 0, 0), (0, 0.3, 0, 60e3))
    noise = np.array([0.004, 0.002, 0.0, 0.0])
    assert hull.distance(np.array([0.0039, 0.1, 0, 1e4]), noise) == 0.0
    assert hull.distance(np.array([0.0141, 0.1, 0, 1e4]), noise) == pytest.approx(0.0101)
    assert hull.distance(np.array([0.0, 0.31, 0, 1e4]), noise) == pytest.approx(0.008)


@pytest.mark.parametrize('force', [5e-324, 1e-200])
def test_a_force_too_small_to_be_squared_is_no_load_beyond(force):
    hull = hull_of((0, 0.3, 0, 0), (0, 0.3, 0, 60e3))
    assert distance(hull, force, 0, 0, 0) == 0.0


def test_forces_beyond_all_reason_have_a_distance():
    hull = hull_of((0, 0.3, 0, 0))
    for force in (1e6, 1e30, 1e200):
        assert hull.share(distance(hull, force, -force, 0, 0)) > 1e6


# What recordings span


def test_few_vertices_stand_for_all_loads_that_were_seen():
    rng = np.random.default_rng(2)
    frames = 800
    turn = rng.uniform(0.0, 2.0 * math.pi, frames)
    pull = 0.3 * np.sqrt(rng.uniform(size=frames))
    loads = np.column_stack(
        [pull * np.cos(turn), pull * np.sin(turn), np.zeros(frames), rng.uniform(-90, 5e4, frames)]
    )
    domain = spanned_domain(loads, LENGTH, (0.0, 66e3))
    assert len(domain.end_load) <= WRITTEN_LOADS
    assert domain.pressure == pytest.approx((0.0, loads[:, 3].max()), rel=1e-5)
    hull = load_hull(domain.end_load, domain.pressure, LENGTH)
    clipped = np.clip(loads, [-1, -1, -1, 0.0], np.inf)
    furthest = max(hull.share(distance(hull, *load)) for load in clipped)
    assert furthest < 0.15
    assert domain.largest_force == pytest.approx(np.hypot(*loads[:, :2].T).max(), rel=1e-5)
    assert all(float(f'{value:.6g}') == value for value in domain.end_load.ravel())


def test_an_arm_that_was_never_loaded_spans_its_pressures_alone():
    loads = np.column_stack([np.zeros((5, 3)), np.linspace(1e3, 4e4, 5)])
    domain = spanned_domain(loads, LENGTH, (0.0, 66e3))
    assert domain.pressure == (1e3, 4e4)
    np.testing.assert_array_equal(domain.end_load, [[0.0, 0.0, 0.0, 1e3]])


def test_weights_along_a_line_are_two_vertices_with_the_unloaded_arm():
    loads = np.column_stack(
        [np.zeros(30), np.tile([0.1, 0.2, 0.3], 10), np.zeros(30), np.repeat([0.0, 5e4], 15)]
    )
    domain = spanned_domain(loads, LENGTH, (0.0, 66e3))
    assert sorted(domain.end_load[:, 1:].tolist()) == [[0.3, 0.0, 0.0], [0.3, 0.0, 5e4]]


def test_what_is_known_is_said_in_words():
    said = paper_arm().domain.words
    assert ('0 to 66 kPa' in said, '0.313 N' in said) == (True, True)
    assert ('0.849 N' in WIDE.words, '10 mN m' in WIDE.words) == (True, True)
    never = Domain(pressure=(0.0, 5e3), end_load=[[0, 0, 0, 0]])
    assert '0 to 5 kPa' in never.words
    assert ' N' not in never.words


# What the file may hold


@pytest.mark.parametrize(
    ('pressure', 'end_load', 'reason'),
    [
        ([0.0], [[0, 0, 0, 0]], 'wrong_shape'),
        ([6e4, 0.0], [[0, 0, 0, 0]], 'wrong_shape'),
        ([0.0, math.nan], [[0, 0, 0, 0]], 'not_finite'),
        ([0.0, 6e4], [[0, math.inf, 0, 0]], 'not_finite'),
        ([0.0, 6e4], [[0, 0, 0]], 'wrong_shape'),
        ([0.0, 6e4], [], 'wrong_shape'),
        ([0.0, 6e4], [0, 0, 0, 0], 'wrong_shape'),
        ([0.0, 6e4], [[0, 0, 0, 0], [0, 0, 0]], 'not_a_table'),
        ([0.0, 6e4], [['a', 0, 0, 0]], 'not_a_table'),
        ([0.0, 6e4], [[0, 0, 0, 0]] * (MOST_LOADS + 1), 'wrong_shape'),
        ([0.0, 6e4], [[0, 0, 0, 7e4]], 'out_of_bounds'),
    ],
)
def test_what_is_no_domain_is_refused(pressure, end_load, reason):
    with refused(ModelError, reason):
        Domain(pressure=pressure, end_load=end_load)


def test_a_domain_beside_the_tables_is_refused():
    with refused(ModelError, 'no_common_pressure'):
        replace(paper_arm(), domain=Domain(pressure=(7e4, 8e4), end_load=[[0, 0, 0, 7e4]]))


def test_the_tables_end_the_domain():
    wide = Domain(pressure=(-1e4, 8e4), end_load=[[0, 0.1, 0, 7e4]])
    assert replace(paper_arm(), domain=wide).pressure_range == (0.0, 66e3)


# Where a load stands


def test_table_1_and_the_unloaded_arm_are_inside():
    for row in TABLE_1:
        for force in (row.force, (0.5 * row.force[0], 0.5 * row.force[1]), (0.0, 0.0)):
            found = position(paper_arm(), force, pressure=row.pressure)
            assert (found.extrapolated, found.reason, found.notes) == (False, '', ())
            assert found.words == ''
            assert not any(found.error)


def test_the_largest_load_ever_seen_is_far_from_five_newtons():
    found = position(paper_arm(), (0.0, -5.0))
    assert found.reason == LOAD_OUT_OF_DOMAIN
    assert '0.313 N' in found.sentence
    assert 15.0 < found.load_beyond < 17.0


def test_beyond_the_hull_the_error_grows_with_the_distance():
    last = 0.0
    for force in (0.02, 0.05, 0.1, 0.14):
        found = position(paper_arm(), (-force, 0.0))
        assert found.notes == (LOAD_BEYOND,)
        assert found.extrapolated
        assert found.error[0] == found.error[1] > last
        last = found.error[0]
    assert last < DOMAIN.load_error * 0.14
    assert position(paper_arm(), (-0.3, 0.0)).reason == LOAD_OUT_OF_DOMAIN


@pytest.mark.parametrize(
    ('pressure', 'note', 'reason'),
    [
        (-480.0, '', ''),  # eight sigma at rest
        (-490.0, PRESSURE_BEYOND, ''),
        (-3290.0, PRESSURE_BEYOND, ''),
        (-3310.0, '', OUT_OF_RANGE),
        (66_480.0, '', ''),
        (69_290.0, PRESSURE_BEYOND, ''),
        (69_310.0, '', OUT_OF_RANGE),
    ],
)
def test_pressure_beyond_the_range(pressure, note, reason):
    found = position(paper_arm(), pressure=pressure)
    assert found.reason == reason
    assert reason or found.notes == ((note,) if note else ())
    assert reason or (found.error[3] != 0.0) == (note != '')


def test_the_noise_of_a_coarse_sensor_is_no_pressure_out_of_range():
    coarse = replace(paper_arm().sensors, pressure_std=1e3)
    found = position(replace(paper_arm(), sensors=coarse), pressure=-7e3)
    assert (found.reason, found.extrapolated) == ('', False)


def test_the_range_may_be_one_pressure():
    beam = replace(paper_arm(), domain=Domain(pressure=(0.0, 0.0), end_load=[[0, 0.3, 0, 0]]))
    assert position(beam, (0.0, 0.2), pressure=100.0).notes == ()
    assert position(beam, (0.0, 0.2), pressure=1e3).reason == OUT_OF_RANGE


def test_a_model_without_domain_says_so_under_a_load():
    bare = replace(paper_arm(), domain=None)
    assert position(bare).notes == position(bare, (0.003, -0.003)).notes == ()
    found = position(bare, (0.0, -5.0))
    assert (found.notes, found.reason, found.extrapolated) == ((LOADS_UNKNOWN,), '', False)
    assert math.isnan(found.load_beyond)


def test_an_arm_that_was_never_loaded_says_nothing_under_a_load():
    never = replace(paper_arm(), domain=Domain(pressure=RANGE, end_load=[[0, 0, 0, 0]]))
    assert position(never, (0.003, 0.0)).reason == ''
    found = position(never, (0.01, 0.0))
    assert found.reason == LOAD_OUT_OF_DOMAIN


def test_solve_says_where_the_load_stands():
    far = solve(paper_arm(), 31e3, (0.0, -5.0))
    assert far.converged
    assert far.extrapolated
    near = solve(paper_arm(), 31e3, (-0.1, 0.0))
    assert '30.6 %' in near.status
    assert LOADS_UNKNOWN in solve(replace(paper_arm(), domain=None), 31e3, (0.1, 0.1)).status


@pytest.mark.parametrize('turn', range(8))
def test_twenty_times_the_load_is_solved_or_said_to_be_not(turn):
    force = [
        20.0 * 0.313 * math.cos(turn * math.pi / 4),
        20.0 * 0.313 * math.sin(turn * math.pi / 4),
    ]
    shape = solve(paper_arm(), 31e3, (force[0], force[1]))
    assert shape.converged == bool(np.isfinite(shape.x).all())
    assert not shape.converged or shape.extrapolated
