"""From the tip to the end force: the inverse of the load mode, or the reason why there is none."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from pneunet_ros import solve, solve_tip
from pneunet_ros.core.errors import RequestError
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.model.inverse import DETERMINED, force_jacobian
import pytest
from support.example_arms import (
    ALL_MECHANICS,
    LENGTH,
    paper_arm,
    plain_arm,
    STIFFNESS,
    TABLE_1,
    two_sections,
)
from support.random_rods import random_case
from support.refusals import refused

FIELDS = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')


def weakest(arm, shape):
    """How far, in lengths, the tip moves at least with a force of the scale of the arm."""
    rods = arm.rods(np.array([shape.pressure]))
    least = np.linalg.svd(force_jacobian(rods, shape), compute_uv=False)[-1]
    return least * arm.force_scale / arm.length


def assert_failed(shape, sentence):
    assert not shape.converged
    assert sentence in shape.status
    assert all(math.isnan(value) for value in shape.force)
    assert all(np.isnan(getattr(shape, name)).all() for name in FIELDS)
    assert shape.solution is None


# ---- the inverse of the load mode ---------------------------------------------------------------


@pytest.mark.parametrize('moment', [0.0, 4e-4])
@pytest.mark.parametrize('row', TABLE_1, ids=lambda row: f'{row.pressure / 1000:g} kPa')
def test_rows_of_table_1_are_found_again_or_said_to_be_undetermined(row, moment):
    shape = solve(paper_arm(), row.pressure, row.force, moment)
    found = solve_tip(paper_arm(), row.pressure, shape.tip[:2], moment)
    if weakest(paper_arm(), shape) < DETERMINED:
        assert_failed(found, 'at least 0.054 mm is needed')
        assert row in TABLE_1[:3]
        return
    assert found.force == pytest.approx(row.force, abs=1e-9)
    assert found.tip[:2] == pytest.approx(shape.tip[:2], abs=1e-12)
    assert found.status == shape.status
    assert found.end_moment == moment
    for name in FIELDS:
        assert getattr(found, name) == pytest.approx(getattr(shape, name), abs=1e-7), name


@pytest.mark.parametrize('row', TABLE_1, ids=lambda row: f'{row.pressure / 1000:g} kPa')
def test_rows_are_found_again_with_all_effects(row):
    arm = paper_arm(ALL_MECHANICS)
    shape = solve(arm, row.pressure, row.force)
    assert weakest(arm, shape) > DETERMINED
    found = solve_tip(arm, row.pressure, shape.tip[:2])
    assert found.force == pytest.approx(row.force, abs=1e-9)


def test_an_arm_that_is_stiff_in_newtons_is_so_under_larger_forces():
    """Rigidities go with the weight, so the shape is the same under a force that does."""
    row, arm = TABLE_1[5], paper_arm()
    heavy = dataclasses.replace(arm, weight=100.0 * arm.weight, domain=None)
    force = tuple(100.0 * part for part in row.force)
    found = solve_tip(heavy, row.pressure, solve(arm, row.pressure, row.force).tip[:2])
    assert found.force == pytest.approx(force, rel=1e-6)


def test_the_end_moment_must_be_known():
    shape = solve(paper_arm(), 50e3, (0.15, 0.15), 1e-3)
    without = solve_tip(paper_arm(), 50e3, shape.tip[:2])
    assert without.tip[:2] == pytest.approx(shape.tip[:2], abs=1e-12)
    assert without.force != pytest.approx((0.15, 0.15), abs=1e-3)


def test_sensing_effects_turn_the_reading_into_the_pressure():
    arm = paper_arm((PressureOffset(offset=2e3),))
    shape = solve(paper_arm(), 50e3, (0.15, 0.15))
    assert solve_tip(arm, 48e3, shape.tip[:2]).force == pytest.approx((0.15, 0.15), abs=1e-9)


@pytest.mark.parametrize('count', [2, 57, 200])
def test_stations_are_those_asked_for(count):
    tip = solve(paper_arm(), 50e3, (0.15, 0.15)).tip[:2]
    assert solve_tip(paper_arm(), 50e3, tip, stations=count).x.size == count


def found_again(seeds, negative):
    """Count random stable rods whose force is found from near and from nothing, or is not."""
    near_by = found = others = 0
    for seed in seeds:
        case = random_case(seed, negative=negative)
        arm, pressure, force, moment = case.arm, case.pressure, case.force, case.moment
        shape = solve(arm, pressure, force, moment)
        if not shape.converged or shape.stable is False:
            continue
        start = solve(arm, pressure, (0.97 * force[0], 0.97 * force[1]), moment, start=shape)
        near = solve_tip(arm, pressure, shape.tip[:2], moment, start=start)
        cold = solve_tip(arm, pressure, shape.tip[:2], moment)
        weak = weakest(arm, shape)
        if weak < DETERMINED:
            assert_failed(near, 'this tip position does not determine the end force')
            continue
        # Where it is hardly determined, a tip as good as any is one of many forces.
        exact = 1e-9 if weak > 10.0 * DETERMINED else 1e-6
        assert near.force == pytest.approx(force, abs=exact), seed
        near_by += 1
        # From nothing another equilibrium may be found: it must be one, at the same tip.
        if not cold.converged:
            assert_failed(cold, '')
        elif cold.force == pytest.approx(force, abs=1e-9):
            found += 1
        else:
            others += 1
            again = solve(arm, pressure, cold.force, moment, start=cold)
            assert again.tip[:2] == pytest.approx(shape.tip[:2], abs=1e-9), seed
    return near_by, found, others


def test_random_stable_rods_are_found_again():
    near_by, found, others = found_again(range(60), negative=False)
    assert near_by >= 55
    assert found >= 0.95 * near_by
    assert found + others >= near_by - 1


@pytest.mark.slow
def test_many_random_rods_are_found_again():
    near_by, found, others = found_again(range(500), negative=False)
    assert near_by >= 480
    assert found >= 0.97 * near_by
    assert found + others >= near_by - 3
    near_by, found, others = found_again(range(200), negative=True)
    assert near_by >= 188
    assert found >= 0.6 * near_by  # most have several equilibria with the tip at this place


# ---- branches -----------------------------------------------------------------------------------


def test_a_start_says_which_branch():
    # A straight arm with its tip at rest: without load, or buckled and pushed back.
    push = 3.0 * math.pi**2 * STIFFNESS / (4 * LENGTH**2)
    shape = None
    for across in (3e-2, 1e-2, 1e-3, 0.0):
        shape = solve(plain_arm(), 0.0, (-push, across), start=shape)
    assert shape.stable
    tip = shape.tip[:2]
    cold = solve_tip(plain_arm(), 0.0, tip)
    near = solve_tip(plain_arm(), 0.0, tip, start=shape)
    assert near.force == pytest.approx((-push, 0.0), abs=1e-9)
    assert cold.tip[:2] == pytest.approx(tip, abs=1e-12)


def test_a_start_that_has_failed_is_no_start():
    tip = solve(paper_arm(), 50e3, (0.15, 0.15)).tip[:2]
    failed = solve(paper_arm(), 500e3)
    assert solve_tip(paper_arm(), 50e3, tip, start=failed).force == pytest.approx((0.15, 0.15))


def test_a_start_helps_where_there_is_no_way_from_the_unloaded_arm():
    case = random_case(34)
    arm, moment = case.arm, case.moment
    shape = solve(arm, case.pressure, case.force, moment)
    assert not solve(arm, case.pressure, (0.0, 0.0), moment).converged
    assert not solve_tip(arm, case.pressure, shape.tip[:2], moment).converged
    found = solve_tip(arm, case.pressure, shape.tip[:2], moment, start=shape)
    assert found.force == pytest.approx(case.force, abs=1e-9)


def test_a_tip_is_followed_along_a_path():
    start = solve(paper_arm(), 40e3, (0.15, 0.1))
    for share in np.linspace(0, 1, 11):
        force = (0.15 - 0.1 * share, 0.1 + 0.2 * share)
        tip = solve(paper_arm(), 40e3, force).tip[:2]
        start = solve_tip(paper_arm(), 40e3, tip, start=start)
        assert start.force == pytest.approx(force, abs=1e-9)


def test_negative_rigidity_is_inverted_near_a_start():
    arm = plain_arm(curvature=10.0, law=two_sections(-5e-4, 3e-4))
    shape = solve(arm, 0.0, (0.1, 0.15))
    near = solve(arm, 0.0, (0.098, 0.147), start=shape)
    found = solve_tip(arm, 0.0, shape.tip[:2], start=near)
    assert found.force == pytest.approx((0.1, 0.15), abs=1e-9)
    assert found.stable is None


# ---- no answer ----------------------------------------------------------------------------------


def test_a_straight_inextensible_arm_does_not_tell_its_pull():
    found = solve_tip(plain_arm(), 0.0, (LENGTH, 0.0))
    assert_failed(found, 'at least 0.099 mm is needed')


def test_a_straight_extensible_arm_tells_its_pull():
    arm = plain_arm(effects=[Extensibility(axial_stiffness=40.0)])
    tip = (LENGTH * (1 + 0.25 / 40.0), 0.0)
    assert solve_tip(arm, 0.0, tip).force == pytest.approx((0.25, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    'tip', [(0.2, 0.0), (0.0, -0.13), (0.08, 0.08), (-1e6, 1e6), (0.1135, 0.0)]
)
def test_a_tip_out_of_reach_is_said(tip):
    found = solve_tip(paper_arm(), 40e3, tip)
    assert_failed(found, ' mm')
    away = float(found.status.split('found is ')[1].split(' mm')[0])
    assert away == pytest.approx(1e3 * (math.hypot(*tip) - LENGTH), rel=0.1, abs=0.3)


def test_pressure_out_of_range_is_said_before_anything():
    assert_failed(solve_tip(paper_arm(), 90e3, (0.05, 0.05)), '90 kPa')


@pytest.mark.parametrize(
    'arguments',
    [
        {'pressure': math.nan, 'tip': (0.05, 0.05)},
        {'pressure': 40e3, 'tip': (math.nan, 0.05)},
        {'pressure': 40e3, 'tip': (0.05, math.inf)},
        {'pressure': 40e3, 'tip': (0.05, 0.05), 'moment': math.nan},
        {'pressure': 40e3, 'tip': ('0.05', 0.05)},
        {'pressure': 40e3, 'tip': (0.05,)},
        {'pressure': 40e3, 'tip': (0.05, 0.05, 0.0)},
        {'pressure': 40e3, 'tip': None},
        {'pressure': 40e3, 'tip': (0.05, 0.05), 'stations': 1},
    ],
)
def test_requests_that_make_no_sense_are_refused(arguments):
    with refused(RequestError, 'too_few' if 'stations' in arguments else 'not_finite'):
        solve_tip(paper_arm(), **arguments)
