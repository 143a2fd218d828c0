"""An arm beside its equilibrium: kinematics by differences, and how a wrong force shows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.fusion.belief import first_belief
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.readings import path_of, PressureInstant
from pneunet_ros.measurement.blocks.motion import Motion as Block
from pneunet_ros.measurement.moving_arm import (
    advance_between_readings,
    follow_reading,
    linearized_rates,
    MovingState,
)
from pneunet_ros.measurement.swinging_arm import ERRORS, Reference
from pneunet_ros.model.equilibrium import linearize_shape
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.vibration import LINKS, links_at
from pneunet_ros.solver.links import center_derivatives
from pneunet_ros.solver.swing import at_rest, Q
import pytest

PRESSURE, FORCE = 25e3, (0.02, 0.05)
DAMPING_TIME = 0.03


@cache
def swinging():
    """Return the swinging arm of a fusion, and its model."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    arm = replace(arm, motion=Motion(damping_time=DAMPING_TIME))
    arm = replace(arm, target_arclength=np.linspace(0.01, arm.length, 12))
    return Fusion(arm=arm).model.swinging, arm


def reference_at(solution, unknowns):
    """Return a reference at an equilibrium, from which nothing lags."""
    chain, _ = swinging()
    links, modes = links_at(solution), chain.moving.modes
    _, onto = linearized_rates(links, chain.moving.masses, DAMPING_TIME, modes.moment)
    return Reference(
        heading=links.heading,
        projection=onto,
        links=links,
        turned=np.zeros(LINKS),
        unknowns=unknowns,
        turning=np.zeros((LINKS, unknowns.size)),
        at_tip=np.zeros((2, 2)),
        lag=np.zeros(LINKS),
        left_out=np.zeros((ERRORS, LINKS)),
        turns=np.cumsum(modes.moment * links.compliance, axis=1),
        pull=np.zeros((4, 2)),
    )


def there(force, place):
    """Return x, y, theta of the targets of an arm at some places of its shapes."""
    chain, arm = swinging()
    unknowns = np.zeros(chain.where.stop)
    reference = reference_at(solve(arm, PRESSURE, FORCE).solution, unknowns)
    unknowns[chain.part(Block.PLACE)] = place
    shape = solve(arm, PRESSURE, force)
    swing_deviation = chain.swing_deviation(shape.solution, unknowns, reference, chain.targets)
    x, y, theta = (
        np.interp(arm.target_arclength, shape.arclength, row)
        for row in (shape.x, shape.y, shape.theta)
    )
    return np.stack([x, y, theta]) + swing_deviation.deviation[:3], swing_deviation, shape


@pytest.mark.parametrize('place', [(0.0, 0.0), (2e-3, 5e-5)])
def test_what_moves_the_targets_is_its_jacobian(place):
    chain, arm = swinging()
    _, swing_deviation, shape = there(FORCE, np.array(place))
    for which, step in ((0, 1e-6), (1, 1e-7)):
        side = step * np.eye(2)[which]
        after, before = (there(FORCE, np.array(place) + sign * side)[0] for sign in (1, -1))
        numeric = (after - before)[:2] / (2.0 * step)
        scale = np.abs(numeric).max()
        assert np.abs(swing_deviation.by_shape[which, :2] - numeric).max() < 2e-3 * scale
    rods = arm.rods(np.array([PRESSURE]))
    sensitivity = linearize_shape(shape.solution, rods)
    moves = sensitivity.stations(arm.target_arclength)[:2, :2]
    moves = moves + swing_deviation.moves(chain.headings(sensitivity))[:2, :2]
    for axis in range(2):
        force = [np.array(FORCE) + sign * 2e-3 * np.eye(2)[axis] for sign in (1, -1)]
        numeric = (there(tuple(force[0]), np.array(place))[0]
                   - there(tuple(force[1]), np.array(place))[0])[:2] / 4e-3  # fmt: skip
        still = np.abs(sensitivity.stations(arm.target_arclength)[axis, :2]).max()
        assert np.abs(moves[axis] - numeric).max() < 0.01 * still
        assert np.abs(moves[axis]).max() < 0.06 * still  # the arm does not jump with the load


@pytest.mark.parametrize('swing', [0.0, 2e-3])
def test_a_wrong_force_pulls_the_arm_as_the_chain_is_pulled(swing):
    chain, arm = swinging()
    moving, seconds = chain.moving, 0.03
    links = links_at(solve(arm, PRESSURE, FORCE).solution)
    rates, onto = linearized_rates(links, moving.masses, DAMPING_TIME, moving.modes.moment)
    turns = np.cumsum(moving.modes.moment * links.compliance, axis=1)
    far = links._replace(heading=links.heading + np.array([swing, 0.0]) @ turns)
    from scipy.linalg import expm

    pulled = np.linalg.solve(-rates[2:, :2], turns @ center_derivatives(far)[:, -1].T)
    told = (np.eye(4) - expm(rates * seconds))[:, :2] @ pulled

    def ends(force):
        after = links_at(solve(arm, PRESSURE, force).solution)
        state = at_rest(2)
        state.state[Q] = np.array([swing, 0.0]) - onto @ (after.heading - links.heading)
        there = MovingState(stamp_ns=0, links=after, swing=state, turned=np.zeros(LINKS))
        stamp_ns = round(seconds * 1e9)
        there = advance_between_readings(
            there, stamp_ns, after, moving.masses, DAMPING_TIME, moving.modes
        )
        place = there.swing.state[Q] + onto @ (after.heading - links.heading)
        return np.concatenate([place, there.swing.state[1]])

    for axis, step in enumerate(2e-3 * np.eye(2)):
        numeric = ends(tuple(FORCE + step)) - ends(FORCE)
        first = np.abs(told[2, axis] * 2e-3 - numeric[2])
        assert first < 0.1 * np.abs(numeric[2])  # the slowest shape, which carries the arm


def test_a_frame_keeps_the_turn_rate_of_the_base():
    chain, arm = swinging()
    known = first_belief(Fusion(arm=arm).model.unknowns, 0)
    solution = solve(arm, PRESSURE).solution
    _, reference, _ = chain.advance((known, None, 0), known, solution, 1, turn_rate=0.7)
    swing = chain.swing_deviation(solution, known.mean, reference, chain.targets)
    seen = reference.at_estimate(swing, known.mean, reference.turning)
    assert seen.links.turn_rate == 0.7


def test_faster_shapes_answer_a_ramp_late():
    chain, _ = swinging()
    assert chain.response(1e-9).share < 1e-6
    assert chain.response(1e3).share > 0.9999
    ramp = np.ones(LINKS)
    slow = chain.lag_of(np.zeros(LINKS), ramp, 30.0)
    assert slow == pytest.approx(-DAMPING_TIME / 30.0 * ramp, rel=1e-6)
    left = chain.lag_of(ramp, np.zeros(LINKS), DAMPING_TIME)
    assert left == pytest.approx(np.exp(-1.0) * ramp)


@pytest.mark.parametrize('seconds', [0.003, 0.04, 2.0])
def test_when_a_load_walked_is_unknown_and_so_is_what_faster_shapes_answered(seconds):
    chain, _ = swinging()
    middles = (np.arange(100_000) + 0.5) / 100_000
    answers = 1.0 - np.exp(-seconds * middles / DAMPING_TIME)
    assert chain.response(seconds).share == pytest.approx(answers.mean(), rel=1e-4)
    assert chain.response(seconds).std == pytest.approx(answers.std(), rel=1e-3)


@pytest.mark.parametrize('seconds', [0.003, 0.04, 2.0])
def test_a_blow_at_an_unknown_time_is_still_answered_by_faster_shapes(seconds):
    chain, _ = swinging()
    ages = seconds * (np.arange(100_000) + 0.5) / 100_000
    forces = np.exp(-ages / DAMPING_TIME) / DAMPING_TIME
    assert chain.response(seconds).lasting == pytest.approx(np.sqrt(np.mean(forces**2)), rel=1e-3)
    assert chain.response(np.inf).lasting == 0.0


def test_a_blow_stops_the_arm_where_it_is_hit():
    chain, arm = swinging()
    shape = solve(arm, PRESSURE)
    known = first_belief(Fusion(arm=arm).model.unknowns, 0)
    _, first, _ = chain.advance((known, None, 0), known, shape.solution, 1)
    swing = chain.swing_deviation(shape.solution, known.mean, first, chain.targets)
    first = first.at_estimate(swing, known.mean, first.turning)
    _, reference, _ = chain.advance((known, first, 1), known, shape.solution, 40_000_001)
    mean = known.mean.copy()
    mean[chain.part(Block.MOMENTUM)] = (1e-4, -2e-4)
    places = np.array([0.05, 0.09])
    acting = chain.force_on_shapes(swing, reference.turns, places)
    turning = np.cumsum(np.ones((2, LINKS)), axis=1)
    assert chain.blow(known, first, acting, turning) is None  # nothing has passed since
    blow = chain.blow(replace(known, mean=mean), reference, acting, turning)
    for which, impulse in enumerate(blow.impulse):
        after = mean[chain.part(Block.MOMENTUM)] + impulse * acting[:, which]
        hit = acting[:, which] @ reference.impulses.mobility
        assert abs(hit @ after) < 1e-12 * abs(hit @ mean[chain.part(Block.MOMENTUM)])
    # A blow just before the frame changes the momenta alone, by the impulse on each shape.
    early, _, late = (np.abs(blow.swing[:, 0, when]) for when in range(3))
    assert (late < early).all()
    assert (
        np.abs(blow.left_out @ reference.projection.T).max() < 1e-9 * np.abs(blow.left_out).max()
    )


def test_between_two_stamps_pressure_and_force_go_as_they_are_read():
    known = tuple(pressed(stamp, 1e4 * stamp) for stamp in (1, 2, 4))
    pulls = tuple(
        WrenchReading(stamp_ns=stamp, force_x=0.0, force_y=force, moment=0.0, frame_id='')
        for stamp, force in ((0, 0.0), (2, 0.0), (3, 0.1), (5, 0.3))
    )
    alone = path_of(known, (), 0, 0.0, pressed(5, 5e4))
    assert [(one.stamp_ns, one.share) for one in alone] == [(1, 0.2), (2, 0.4), (4, 0.8)]
    path = path_of(known, pulls, 0, 0.0, pressed(5, 5e4))
    assert [one.share for one in path] == [one.share for one in alone]
    beyond = np.array([one.force_deviation for one in path])
    assert beyond == pytest.approx(np.array([[0.0, -0.06], [0.0, -0.12], [0.0, -0.04]]))


def test_a_force_that_is_read_goes_its_way_where_the_pressure_is_there_again():
    still = (pressed(1, 2e4), pressed(2, 2e4))
    assert path_of(still, (), 0, 2e4, pressed(4, 2e4)) == []
    pull = WrenchReading(stamp_ns=0, force_x=0.02, force_y=0.0, moment=0.0, frame_id='')
    path = path_of(still, (pull,), 0, 2e4, pressed(4, 2e4))
    assert [one.share for one in path] == [0.25, 0.5]
    assert not np.array([one.force_deviation for one in path]).any()


def test_a_pressure_that_returns_between_two_stamps_moves_the_arm():
    chain, arm = swinging()
    moving, most, half_ns = chain.moving, 4e3, 20_000_000
    path = path_of(
        (pressed(half_ns, PRESSURE + most),), (), 0, PRESSURE, pressed(2 * half_ns, PRESSURE)
    )
    known = first_belief(Fusion(arm=arm).model.unknowns, 0)
    solution = solve(arm, PRESSURE).solution
    links = links_at(solution)
    bent = links_at(solve(arm, PRESSURE + most).solution)
    turning = np.zeros((LINKS, known.mean.size))
    turning[:, chain.pressure] = (bent.heading - links.heading) / most
    reference = replace(reference_at(solution, known.mean), turning=turning)
    _, _, told = chain.advance((known, reference, 0), known, solution, 2 * half_ns, path)
    there = MovingState(stamp_ns=0, links=links, swing=at_rest(2), turned=np.zeros(LINKS))
    there = advance_between_readings(
        there, half_ns, bent, moving.masses, DAMPING_TIME, moving.modes
    )
    _, true = follow_reading(
        there, 2 * half_ns, solution.for_kernels(), moving.masses, DAMPING_TIME, moving.modes
    )
    assert np.hypot(*true.at_nodes[:2, -1]) > 1e-4  # m
    assert told.at_nodes[:2, -1] == pytest.approx(true.at_nodes[:2, -1], rel=0.02)


def pressed(stamp_ns: int, chamber: float) -> PressureInstant:
    """Return a pressure as a fusion keeps it."""
    return PressureInstant(
        stamp_ns=stamp_ns, gauge=chamber, chamber=chamber, std=0.0, history=(), memory=()
    )
