"""Shapes of many frames and how they answer: against single solves and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import solve
from pneunet_ros.effects.camera_rotation import CameraRotation
from pneunet_ros.effects.camera_scale import CameraScale
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.effect import Load
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.softening import Softening
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs, inputs_of
from pneunet_ros.model.equilibrium import linearize_shape, solve_rod
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.solver.columns import (
    CURVATURE,
    NODE_MOMENT,
    NODE_THETA,
    PANEL_START,
    RIGIDITY,
    START,
    THETA,
    X,
    Y,
)
from pneunet_ros.solver.frame_series import start_at_points
import pytest
from support.example_arms import ALL_MECHANICS, paper_arm, TABLE_1
from support.made_datasets import made

NONE = np.zeros((0, 2), dtype=np.int64)
LAW_COLUMNS = np.array([[0, RIGIDITY], [1, RIGIDITY], [1, START]])
PASTS = (Hysteresis(width=4e3), Creep(amplitude=0.15, time_constant=2.0), Softening(loss=0.2))


def table_1() -> Inputs:
    return Inputs(
        pressure=np.array([row.pressure for row in TABLE_1]),
        loads=np.array([[*row.force, 1e-3] for row in TABLE_1]),
    )


def solved(arm, inputs: Inputs) -> ForwardModel:
    series = ForwardModel(arm.target_arclength)
    assert series.solve(arm, inputs).all()
    return series


@pytest.mark.parametrize('effects', [(), ALL_MECHANICS], ids=['plain', 'all mechanics'])
def test_shapes_are_those_of_single_solves(effects):
    arm, inputs = paper_arm(effects), table_1()
    series = solved(arm, inputs)
    for frame, row in enumerate(TABLE_1):
        shape = solve(arm, row.pressure, row.force, 1e-3, stations=57)
        s = shape.arclength
        for field, name in ((X, 'x'), (Y, 'y'), (THETA, 'theta')):
            at = np.isin(np.round(arm.target_arclength, 9), np.round(s, 9))
            there = np.isin(np.round(s, 9), np.round(arm.target_arclength, 9))
            assert at.sum() > 2
            wanted = getattr(shape, name)[there]
            assert series.fields[frame, field, at] == pytest.approx(wanted, abs=2e-8)


def test_points_answer_to_loads_as_a_single_solve_does():
    arm, inputs = paper_arm(ALL_MECHANICS), table_1()
    series = solved(arm, inputs)
    answer = series.jacobian(arm, inputs, NONE)
    for frame in (2, 9):
        rods = arm.rods(inputs.pressure[[frame]])
        f1, f2, moment = inputs.loads[frame].tolist()
        load = Load(pressure=rods.pressure[0], force_x=f1, force_y=f2, moment=moment)
        shape = solve_rod(arm, rods, load, None, arm.target_arclength)
        single = linearize_shape(shape.solution, rods).stations(arm.target_arclength)
        assert answer[frame, :3] == pytest.approx(single, rel=1e-5, abs=1e-5)


def test_points_answer_to_every_cause_as_finite_differences():
    arm, inputs = paper_arm(ALL_MECHANICS), table_1()
    answer = solved(arm, inputs).jacobian(arm, inputs, LAW_COLUMNS)[:, :, :CURVATURE]
    knots = arm.intrinsic_curvature.arclength.size
    assert answer.shape[1] == 3 + knots + len(LAW_COLUMNS)

    def fields(arm, inputs):
        return solved(arm, inputs).fields[:, :CURVATURE]

    for load, step in enumerate((1e-4, 1e-4, 1e-6)):
        sides = [
            fields(arm, inputs.with_loads(inputs.loads + sign * step * np.eye(3)[load]))
            for sign in (-1, 1)
        ]
        wanted = (sides[1] - sides[0]) / (2 * step)
        assert answer[:, load] == pytest.approx(wanted, abs=2e-5 * np.abs(wanted).max())
    table = arm.intrinsic_curvature
    for knot in range(knots):
        unit = 1e-2 * np.eye(knots)[knot]
        sides = [
            fields(
                replace(
                    arm,
                    intrinsic_curvature=replace(table, curvature=table.curvature + sign * unit),
                    covariance=None,
                ),
                inputs,
            )
            for sign in (-1, 1)
        ]
        wanted = (sides[1] - sides[0]) / 2e-2
        assert answer[:, 3 + knot] == pytest.approx(wanted, abs=1e-5 * np.abs(wanted).max())
    law = arm.moment_law
    scale = arm.weight * arm.length**2
    for place, (section, column) in enumerate(LAW_COLUMNS.tolist()):
        unit = np.eye(2)[section]
        moves = []
        for sign in (-1, 1):
            if column == RIGIDITY:
                moves.append(replace(law, rigidity=law.rigidity + sign * 1e-4 * unit))
            else:
                moves.append(replace(law, split=law.split + sign * 1e-4))
        size = scale if column == RIGIDITY else arm.length
        sides = [fields(replace(arm, moment_law=move, covariance=None), inputs) for move in moves]
        wanted = (sides[1] - sides[0]) / (2e-4 * size)
        found = answer[:, 3 + knots + place]
        assert found == pytest.approx(wanted, abs=1e-3 * np.abs(wanted).max())


def test_answers_with_a_past_are_finite_differences():
    arm = paper_arm((*PASTS, PressureElongation(strain_per_pascal=1e-6)))
    run = made(arm, np.concatenate([np.linspace(0, 6e4, 8), np.linspace(55e3, 5e3, 6)]))
    (inputs,) = inputs_of(arm, [run])
    series = solved(arm, inputs)
    answer = series.load_jacobian(arm, inputs)
    step = np.array([0.0, 1e-4, 0.0])
    sides = [
        solved(arm, inputs.with_loads(inputs.loads + sign * step)).points.reshape(14, -1)
        for sign in (-1, 1)
    ]
    assert answer[:, :, 1] == pytest.approx((sides[1] - sides[0]) / 2e-4, rel=1e-3, abs=1e-3)


def test_a_camera_sees_points_and_their_answers_alike():
    plain, inputs = paper_arm(), table_1()
    turned = paper_arm((CameraScale(factor=1.02), CameraRotation(angle=0.03)))
    first, second = solved(plain, inputs), solved(turned, inputs)
    assert np.array_equal(first.fields, second.fields)
    cosine, sine = 1.02 * np.cos(0.03), 1.02 * np.sin(0.03)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    assert second.points == pytest.approx(np.matmul(turn, first.points), abs=1e-15)
    one, other = (
        item.jacobian(arm, inputs, LAW_COLUMNS)[:, :, :2]
        for item, arm in ((first, plain), (second, turned))
    )
    assert other == pytest.approx(np.matmul(turn, one), rel=1e-9, abs=1e-9)


def test_starting_from_a_neighbor_changes_nothing():
    arm, inputs = paper_arm(), table_1()
    stiffer = replace(
        arm, moment_law=replace(arm.moment_law, rigidity=arm.moment_law.rigidity * 2)
    )
    series = solved(stiffer, inputs)
    assert series.solve(arm, inputs).all()
    assert series.points == pytest.approx(solved(arm, inputs).points, abs=1e-9)
    some = np.array([3, 8])
    part = series.subset(some)
    assert part.solve(arm, inputs.subset(some)).all()
    assert part.points == pytest.approx(series.points[some], abs=1e-12)


def test_a_frame_without_equilibrium_is_said_and_harms_no_other():
    arm, inputs = paper_arm(), table_1()
    pressure = inputs.pressure.copy()
    pressure[[0, 7]] = 200e3, -50e3
    series = ForwardModel(arm.target_arclength)
    found = series.solve(arm, replace(inputs, pressure=pressure))
    assert np.flatnonzero(~found).tolist() == [0, 7]
    others = solved(arm, inputs)
    assert series.points[found] == pytest.approx(others.points[found], abs=1e-9)


@pytest.mark.parametrize('side', [1.0, -1.0], ids=['up', 'down'])
@pytest.mark.parametrize('hidden', [0, -1], ids=['none hidden', 'only the tip seen'])
def test_a_buckled_arm_is_found_on_the_side_on_which_it_was_seen(side, hidden):
    arm = paper_arm()
    unpressed, pushed = np.zeros(3), np.full((3, 2), [-0.03, 0.0])
    measured = made(arm, unpressed, pushed + np.array([0.02, side * 0.03])).points
    measured[:, :, :hidden] = np.nan
    inputs = Inputs(pressure=unpressed, loads=np.column_stack([pushed, np.zeros(3)]))
    series = ForwardModel(arm.target_arclength, measured)
    assert series.solve(arm, inputs).all()
    series.jacobian(arm, inputs, NONE)
    assert series.stable.all()
    assert np.all(side * series.points[:, 1, -1] > 0.05)


def test_frames_start_at_the_shape_through_the_points_that_were_seen():
    arm, inputs = paper_arm(), table_1()
    s, random = arm.target_arclength, np.random.default_rng(0)
    points = solved(arm, inputs).points
    seen = (random.uniform(size=(len(points), s.size)) > 0.3) & (s > 0.0)
    points[~seen[:, None, :].repeat(2, axis=1)] = np.nan
    series, rods = ForwardModel(s, points), inputs.rods(arm)
    series.remesh(np.array([5, 9]), len(points))
    series.stations = s
    start_at_points(rods, inputs.loads, series.solutions(), s, points)
    assert series.known.all()
    for frame, own in enumerate(seen):
        ways = np.diff(points[frame][:, own], axis=1, prepend=0.0)
        chords = np.unwrap(np.append(rods.clamp[frame, 0], np.arctan2(ways[1], ways[0])))
        middles = s[own] - 0.5 * np.diff(s[own], prepend=0.0)
        there = BoundaryValueProblem(
            rods.record(frame), tuple(inputs.loads[frame, :2]), inputs.loads[frame, 2]
        )
        there.mesh(series.counts)
        joints = np.append(there.panels[:, PANEL_START], arm.length)
        inner = joints < middles[-1]  # beyond, the last two chords are continued
        wanted = np.interp(joints, np.append(0.0, middles), chords)[inner]
        assert series.nodes[frame, inner, NODE_THETA] == pytest.approx(wanted, abs=1e-12)
        # The moment at the clamp is that of the load on the way to the tip.
        force, moment = inputs.loads[frame, :2], inputs.loads[frame, 2]
        x, y = points[frame][:, own][:, -1]
        lever = moment + x * force[1] - y * force[0]
        room = 0.15 * np.abs(force).sum() * arm.length
        assert series.nodes[frame, 0, NODE_MOMENT] == pytest.approx(lever, abs=room)


def test_where_nothing_is_seen_an_arm_is_found_as_from_no_load():
    arm, inputs = paper_arm(), table_1()
    blind = ForwardModel(
        arm.target_arclength, np.full((len(TABLE_1), 2, arm.target_arclength.size), np.nan)
    )
    assert blind.solve(arm, inputs).all()
    assert np.array_equal(blind.points, solved(arm, inputs).points)
