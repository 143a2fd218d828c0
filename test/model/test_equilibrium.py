"""Solves as values, branches, stability, and how a shape answers to small changes."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros import solve, solve_many
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import quantities
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.effect import Load
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.model.equilibrium import linearize_shape, solve_rod, tip_jacobian
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.perturbation import Perturbation, with_pressure_change
import pytest
from scipy.optimize import brentq
from scipy.special import jv
from support.example_arms import (
    ALL_MECHANICS,
    LENGTH,
    paper_arm,
    plain_arm,
    rebuilt,
    STIFFNESS,
    TABLE_1,
    two_sections,
)
from support.random_rods import random_case
from support.refusals import refused

FIELDS = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')
BUCKLING = math.pi**2 * STIFFNESS / (4 * LENGTH**2)  # N


# ---- a solve is a value -------------------------------------------------------------------------


def test_a_load_that_turns_the_arm_inside_out_is_refused():
    arm = replace(paper_arm((Extensibility(axial_stiffness=0.15),)), domain=None)
    near = solve(arm, 0.0, (-0.12, 0.0))
    assert near.converged and near.tip[0] == pytest.approx(0.2 * LENGTH)
    for start in (None, near):  # a stretch of -0.33, beyond zero
        shape = solve(arm, 0.0, (-0.2, 0.0), start=start)
        assert not shape.converged and 'shortens' in shape.status
    shapes = solve_many(arm, [0.0, 0.0], [(-0.2, 0.0), (-0.12, 0.0)], start=near)
    assert shapes.converged.tolist() == [False, True]


def test_a_shape_has_stations_from_clamp_to_tip():
    shape = solve(paper_arm(), 31e3, (0.175, 0.07))
    assert shape.arclength == pytest.approx(np.linspace(0, 0.112, 57))
    assert (shape.x[0], shape.y[0], shape.theta[0]) == (0.0, 0.0, 0.0)
    assert shape.tip == (shape.x[-1], shape.y[-1], shape.theta[-1])
    assert (shape.force, shape.end_moment, shape.pressure) == ((0.175, 0.07), 0.0, 31e3)
    assert shape.converged
    assert shape.residual < 1e-6
    for name in FIELDS:
        assert getattr(shape, name).shape == (57,)
        assert not getattr(shape, name).flags.writeable


@pytest.mark.parametrize('count', [2, 3, 10, 1000])
def test_stations_do_not_change_the_shape(count):
    many = solve(paper_arm(), 31e3, (0.175, 0.07), stations=count)
    few = solve(paper_arm(), 31e3, (0.175, 0.07))
    assert many.arclength.size == count
    assert many.tip == pytest.approx(few.tip, abs=1e-15)


def test_the_same_request_gives_the_same_bits():
    one, other = (solve(paper_arm(ALL_MECHANICS), 50e3, (0.15, 0.2)) for _ in range(2))
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in FIELDS)
    assert one.status == other.status


def test_the_moment_is_that_of_the_end_load():
    # Eq 8 of the paper.
    force, moment = (0.15, 0.2), 1e-3
    shape = solve(paper_arm(), 50e3, force, moment)
    x, y, _ = shape.tip
    expected = (x - shape.x) * force[1] - (y - shape.y) * force[0] + moment
    assert shape.moment == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    'arguments',
    [
        {'pressure': math.nan},
        {'pressure': math.inf},
        {'pressure': '31000'},
        {'pressure': None},
        {'pressure': 31e3, 'force': (math.nan, 0.0)},
        {'pressure': 31e3, 'force': (0.0, -math.inf)},
        {'pressure': 31e3, 'force': (0.1,)},
        {'pressure': 31e3, 'force': (0.1, 0.0, 0.0)},
        {'pressure': 31e3, 'force': 0.1},
        {'pressure': 31e3, 'force': {0.0, 0.1}},
        {'pressure': 31e3, 'force': {0.0: 0.1, 1.0: 0.2}},
        {'pressure': 31e3, 'moment': math.nan},
        {'pressure': 31e3, 'stations': 1},
        {'pressure': 31e3, 'stations': 0},
        {'pressure': 31e3, 'stations': -5},
    ],
)
def test_requests_that_make_no_sense_are_refused(arguments):
    with refused(RequestError, 'too_few' if 'stations' in arguments else 'not_finite'):
        solve(paper_arm(), **arguments)


def assert_failed(shape, sentence):
    """Check that the shape says why it is none, and that all its fields are NaN."""
    assert not shape.converged
    assert sentence in shape.status
    assert shape.solution is None
    assert shape.stable is None
    assert all(np.isnan(getattr(shape, name)).all() for name in FIELDS)
    assert np.isfinite(shape.arclength).all()


@pytest.mark.parametrize('pressure', [-3.4e3, 70e3, 101_325.0, 1e300])
def test_out_of_range_is_said_with_the_range(pressure):
    shape = solve(paper_arm(), pressure, (0.1, 0.1))
    assert_failed(shape, '0 to 66 kPa')


@pytest.mark.parametrize('pressure', [-3.2e3, 66.5e3, 69.2e3])
def test_a_little_beyond_the_range_is_extrapolated_and_said(pressure):
    shape = solve(paper_arm(), pressure, (0.1, 0.1))
    assert shape.converged
    assert shape.extrapolated
    assert not solve(paper_arm(), 66e3, (0.15, 0.275)).extrapolated


def test_an_arm_shortened_to_nothing_is_said():
    effect = PressureElongation(strain_per_pascal=-1e-5)
    arm = plain_arm(effects=[effect])
    assert solve(arm, 90e3, (0.1, 0.0)).converged
    assert_failed(solve(arm, 98e3, (0.1, 0.0)), '5 %')


def test_forces_beyond_all_reason_end_in_a_value():
    for force in ((1e3, 1e3), (-1e6, 3.0), (0.0, 1e12), (1e200, 0.0)):
        shape = solve(paper_arm(), 31e3, force)
        assert shape.converged or shape.status
        assert shape.converged == bool(np.isfinite(shape.x).all())


# ---- sensing effects and history apply to what is held steady ----------------------------------


def test_solve_takes_what_the_sensors_read():
    effects = (PressureGain(gain=1.1), PressureOffset(offset=-300.0), PressureLag(time_constant=3))
    read = solve(paper_arm(effects), 30e3, (0.15, 0.1))
    true = solve(paper_arm(), 1.1 * 30e3 - 300.0, (0.15, 0.1))
    assert read.pressure == pytest.approx(1.1 * 30e3 - 300.0)
    assert read.x == pytest.approx(true.x, abs=1e-15)


# ---- branches -----------------------------------------------------------------------------------


def buckled(push, above):
    """Lead the column to one side, under more than its buckling load."""
    shape = None
    for across in (3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 0.0):
        aside = across if above else -across
        shape = solve(plain_arm(), 0.0, (-push, aside), start=shape)
    return shape


def test_a_warm_start_follows_its_branch():
    push = 1.5 * BUCKLING
    up, down = buckled(push, above=True), buckled(push, above=False)
    assert up.stable
    assert down.stable
    assert up.tip[1] > 0.03
    assert down.y == pytest.approx(-up.y, abs=1e-12)
    for start in (up, down):
        again = solve(plain_arm(), 0.0, (-push, 0.0), start=start)
        assert again.y == pytest.approx(start.y, abs=1e-12)


@pytest.mark.parametrize(('across', 'side'), [(-0.02, 1), (-0.08, 1), (-0.1, -1), (-0.5, -1)])
def test_a_branch_that_ends_is_left_for_a_stable_one(across, side):
    # Pushed back hard enough, the buckled column snaps through; it never ends up unstable.
    push = 1.5 * BUCKLING
    snapped = solve(plain_arm(), 0.0, (-push, across), start=buckled(push, above=True))
    assert snapped.stable
    assert math.copysign(1, snapped.tip[1]) == side


def test_small_steps_and_one_step_end_at_the_same_shape():
    shape = None
    for share in np.linspace(0, 1, 30):
        row = TABLE_1[-1]
        force = (share * row.force[0], share * row.force[1])
        shape = solve(paper_arm(), share * row.pressure, force, start=shape)
    direct = solve(paper_arm(), row.pressure, row.force)
    assert shape.x == pytest.approx(direct.x, abs=1e-9)


# ---- stability ----------------------------------------------------------------------------------


@pytest.mark.parametrize(('share', 'stable'), [(0.5, True), (0.99999, True), (1.00001, False)])
def test_a_straight_column_is_stable_up_to_its_buckling_load(share, stable):
    shape = solve(plain_arm(), 0.0, (-share * BUCKLING, 0.0))
    assert shape.y == pytest.approx(0.0, abs=1e-12)
    assert shape.stable is stable


def test_a_pull_never_makes_it_unstable():
    assert solve(plain_arm(), 0.0, (50 * BUCKLING, 0.0)).stable


def test_a_soft_clamp_lowers_the_buckling_load():
    # q tan(q l) = 1 / (B c) with q^2 = P / B, Timoshenko's column on a rotational spring.
    compliance = 40.0

    def critical():
        low, high = 0.0, math.pi / (2 * LENGTH) * (1 - 1e-12)
        for _ in range(200):
            q = 0.5 * (low + high)
            over = q * math.tan(q * LENGTH) > 1 / (STIFFNESS * compliance)
            low, high = (low, q) if over else (q, high)
        return STIFFNESS * low**2

    arm = plain_arm(effects=[ClampCompliance(compliance=compliance)])
    assert critical() < 0.6 * BUCKLING
    assert solve(arm, 0.0, (-critical() * (1 - 1e-5), 0.0)).stable is True
    assert solve(arm, 0.0, (-critical() * (1 + 1e-5), 0.0)).stable is False


def test_a_soft_axis_raises_the_buckling_load():
    # Squeezed by P the column is shorter: P (1 - P / EA) = pi^2 B / (4 l^2).
    stiffness = 2.0
    critical = 0.5 * stiffness * (1 - math.sqrt(1 - 4 * BUCKLING / stiffness))
    assert critical > 1.1 * BUCKLING
    arm = plain_arm(effects=[Extensibility(axial_stiffness=stiffness)])
    assert solve(arm, 0.0, (-critical * (1 - 1e-5), 0.0)).stable is True
    assert solve(arm, 0.0, (-critical * (1 + 1e-5), 0.0)).stable is False


@pytest.mark.parametrize(('share', 'stable'), [(0.9999, True), (1.0001, False)])
def test_a_column_buckles_under_its_own_weight_as_greenhill_says(share, stable):
    # q l^3 / B = 9/4 j^2 with j the first zero of the Bessel function of order -1/3: 7.837.
    zero = brentq(lambda x: jv(-1 / 3, x), 1.5, 2.2, xtol=1e-14)
    critical = 2.25 * zero**2 * STIFFNESS / LENGTH**3
    assert critical == pytest.approx(7.837 * STIFFNESS / LENGTH**3, rel=1e-4)
    arm = plain_arm(effects=[Gravity(weight_x=-share * critical)])
    assert solve(arm, 0.0).stable is stable


def test_stability_is_not_defined_for_negative_rigidity():
    shape = solve(plain_arm(law=LinearLaw(bending_stiffness=-1e-3)), 0.0, (0.1, 0.1))
    assert shape.converged
    assert shape.stable is None


def test_an_unstable_shape_can_be_followed():
    straight = solve(plain_arm(), 0.0, (-0.99 * BUCKLING, 0.0))
    beyond = solve(plain_arm(), 0.0, (-1.2 * BUCKLING, 0.0), start=straight)
    assert beyond.stable is False
    assert beyond.y == pytest.approx(0.0, abs=1e-12)


# ---- sensitivities ------------------------------------------------------------------------------

ARMS = {
    'base': paper_arm(),
    'all effects': paper_arm(ALL_MECHANICS),
    'negative': rebuilt(paper_arm(ALL_MECHANICS[1:]), moment_law=two_sections(-5e-4, 2e-4)),
}


def solved(arm, pressure, force, moment, start=None):
    return solve(arm, pressure, force, moment, start=start)


def differences(arm, pressure, force, moment, start, field, steps=(2.0, 1e-5, 1e-5, 1e-7)):
    """Differentiate a field by pressure, F1, F2 and M with full solves, to fourth order."""
    columns = []
    for cause, step in enumerate(steps):

        def at(times, cause=cause, step=step):
            load = [pressure, force[0], force[1], moment]
            load[cause] += times * step
            return field(solved(arm, load[0], (load[1], load[2]), load[3], start))

        columns.append((8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step))
    return np.array(columns)


@pytest.mark.parametrize('arm', ARMS.values(), ids=ARMS)
@pytest.mark.parametrize(
    ('pressure', 'force', 'moment'),
    [(24.2e3, (0.2, 0.05), 0.0), (60e3, (0.15, 0.25), 1e-3), (40e3, (0.1, -0.05), -5e-4)],
)
def test_the_jacobian_is_that_of_full_solves(arm, pressure, force, moment):
    start = solve(arm, pressure, force, moment)
    found = tip_jacobian(arm, start)
    expected = differences(arm, pressure, force, moment, start, lambda shape: np.array(shape.tip))
    assert found.shape == (3, 4)
    scale = np.abs(found).max(axis=0)
    assert found / scale == pytest.approx(expected.T / scale, abs=2e-6)


@pytest.mark.parametrize('arm', ARMS.values(), ids=ARMS)
def test_the_stations_answer_as_full_solves_do(arm):
    pressure, force, moment = 45e3, (0.15, 0.15), 2e-4
    start = solve(arm, pressure, force, moment)
    rods, change = with_pressure_change(arm, pressure)
    response = linearize_shape(start.solution, rods, change)
    stations = response.stations(start.arclength)
    expected = differences(
        arm, pressure, force, moment, start,
        lambda shape: np.stack([getattr(shape, name) for name in FIELDS]),
    )  # fmt: skip
    order = [3, 0, 1, 2]  # pressure comes last among the causes of a response
    split = np.abs(start.arclength - start.solution.panels[start.solution.counts[0], 15]) < 2e-3
    for cause, row in enumerate(order):
        for field, name in enumerate(FIELDS):
            found, right = stations[row, field], expected[cause, field]
            scale = max(np.abs(right).max(), 1e-12)
            # l1 moves with pressure: curvature has no derivative where it jumps.
            keep = ~split if name == 'curvature' else slice(None)
            assert found[keep] / scale == pytest.approx(right[keep] / scale, abs=1e-5), name
    assert response.tip[:, 0] == pytest.approx(stations[:, 0, -1], rel=1e-6)
    assert response.stable == start.stable


@pytest.mark.parametrize('arm', ARMS.values(), ids=ARMS)
def test_the_stations_change_as_moved_panels_and_nodes_do(arm):
    shape = solve(arm, 45e3, (0.15, 0.15), 2e-4)
    rods, change = with_pressure_change(arm, 45e3)
    names = [f'moment_law.rigidity.{row}.0' for row in range(len(arm.moment_law.pressure))]
    sides = (arm.with_changes(dict.fromkeys(names, sign * 1e-3)) for sign in (-1, 1))
    before, after = (side.rods(np.array([45e3])) for side in sides)
    change = change.followed_by(Perturbation.between(before, after, 2e-3))
    found = linearize_shape(shape.solution, rods, change)
    at = np.delete(shape.arclength, 14)  # the joint of two panels, which moves with l1
    for cause, changes in enumerate(found.stations(at)):
        step = 1e-5 / np.abs(found.node_changes[cause, :, 0]).max()
        sides = []
        for sign in (-step, step):
            panels, rotation = np.array(shape.solution.panels), np.array(found.rotation)
            if cause < 2:
                panels[:, 6 + cause] += sign
            elif cause > 2:
                panels += sign * found.panel_changes[cause - 3]
                rotation += sign * found.rotation_changes[cause - 3]
            nodes = shape.solution.nodes + sign * found.node_changes[cause]
            moved = replace(shape.solution, panels=panels, nodes=nodes)
            sides.append(replace(found, solution=moved, rotation=rotation).fields(at))
        expected = (sides[1] - sides[0]) / (2.0 * step)
        scale = np.abs(expected).max(axis=1, keepdims=True) + 1e-300
        np.testing.assert_allclose(changes / scale, expected / scale, atol=1e-7)


@pytest.mark.parametrize('seed', range(25))
def test_the_answer_to_conservative_loads_is_symmetric(seed):
    # A dead load has a potential, so d(x, y, theta)/d(F1, F2, M) is symmetric (Maxwell-Betti).
    case = random_case(seed)
    arm = rebuilt(case.arm, effects=tuple(e for e in case.arm.effects if e.name != 'load_offset'))
    shape = solve(arm, case.pressure, case.force, case.moment)
    block = tip_jacobian(arm, shape)[:, 1:]
    size = np.sqrt(np.abs(np.outer(np.diag(block), np.diag(block)))) + 1e-12
    assert (block - block.T) / size == pytest.approx(np.zeros((3, 3)), abs=1e-6)


def test_the_answer_of_a_stable_shape_to_a_force_is_along_it():
    for row in TABLE_1[3:]:
        block = tip_jacobian(paper_arm(), solve(paper_arm(), row.pressure, row.force))[:, 1:]
        assert np.linalg.eigvalsh(0.5 * (block + block.T)).min() > 0.0


def test_a_straight_arm_answers_as_euler_and_bernoulli_say():
    jacobian = tip_jacobian(plain_arm(), solve(plain_arm(), 0.0))
    length, stiffness = LENGTH, STIFFNESS
    expected = np.zeros((3, 4))
    expected[1, 2] = length**3 / (3 * stiffness)
    expected[1, 3] = expected[2, 2] = length**2 / (2 * stiffness)
    expected[2, 3] = length / stiffness
    assert jacobian == pytest.approx(expected, abs=1e-9)


def test_softness_of_the_unloaded_arm_is_that_of_the_card():
    # CARD.md: 1 mN across an unloaded tip moves it by 4-8 mm... per 100 mN m of B ~ 1e-4.
    arm = plain_arm(law=LinearLaw(bending_stiffness=1e-4))
    assert tip_jacobian(arm, solve(arm, 0.0))[1, 2] * 1e-3 == pytest.approx(4.7e-3, abs=1e-4)


def test_sensing_effects_are_not_in_the_jacobian():
    # It is d/d(pressure in the chamber, true load), whatever the sensors make of it.
    arm = paper_arm((PressureGain(gain=1.1), PressureOffset(offset=500.0)))
    force = (0.15, 0.1)
    shape = solve(arm, 30e3, force)
    bare = solve(paper_arm(), shape.pressure, shape.force)
    assert tip_jacobian(arm, shape) == pytest.approx(tip_jacobian(paper_arm(), bare), rel=1e-9)


def test_no_jacobian_without_a_shape():
    with refused(RequestError, 'no_equilibrium'):
        tip_jacobian(paper_arm(), solve(paper_arm(), 200e3))


def parameters(effect):
    return [item.name for item in quantities(effect)]


@pytest.mark.parametrize('seed', range(30))
def test_a_change_of_the_record_moves_random_rods_as_full_solves_do(seed):
    # Every column of the record at once: h, law, mechanics, clamp and rotation all change.
    case = random_case(seed, negative=seed % 2 == 0)
    names = {
        'arm.length': 1e-5,
        'arm.clamp_angle': 1e-4,
        'moment_law.split.0': 1e-5,
        'moment_law.split.1': 1e-5,
        'moment_law.rigidity.1.0': 1e-5 * case.arm.moment_law.rigidity[1, 0],
        'moment_law.rigidity.1.1': 1e-5 * case.arm.moment_law.rigidity[1, 1],
        'moment_law.moment_offset.1.0': 1e-6,
        'intrinsic_curvature.curvature.1.3': 1e-4,
    } | {
        f'effects.{effect.name}.{name}': 1e-5 * getattr(effect, name)
        for effect in case.arm.effects
        for name in parameters(effect)
    }
    sides = [case.arm.with_changes({k: sign * v for k, v in names.items()}) for sign in (-1, 1)]
    shape = solve(case.arm, case.pressure, case.force, case.moment)
    pressure = np.array([case.pressure])
    before, after = (side.rods(pressure) for side in sides)
    change = Perturbation.between(before, after, 2.0)
    tip = linearize_shape(shape.solution, case.arm.rods(pressure), change).tip[-1]
    load = Load(
        pressure=case.pressure, force_x=case.force[0], force_y=case.force[1], moment=case.moment
    )
    low, high = (
        solve_rod(arm, rods, load, shape.solution, np.array([arm.length])).tip
        for arm, rods in zip(sides, (before, after), strict=True)
    )
    expected = (np.array(high) - np.array(low)) / 2.0
    assert tip == pytest.approx(expected, rel=2e-3, abs=1e-9)
