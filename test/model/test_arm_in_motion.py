"""An arm that swings: small vibrations, energy, errors, the estimator, and a finger in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import itertools

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.arrays import freeze
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import ImuReading, PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.frame_prediction import predict_frame
from pneunet_ros.estimation.health import EstimatorHealth
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.sensors import noiseless, Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.moving_arm import (
    advance_between_readings,
    linearized_rates,
    MovingState,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.model.vibration import links_at, masses_of, vibration
from pneunet_ros.solver.links import mass_matrix
from pneunet_ros.solver.swing import advance_chain, at_rest, part_shapes, room_for, Swing
import pytest
from support.example_arms import paper_arm
from support.lab_run import true_model
from support.refusals import refused

DAMPING_TIME, PERIOD_NS = 0.025, 10_000_000
UNLOADED = EstimatorSettings(wrench_required=False)
LARGEST_95 = 5.99


def moving(damping_time: float = DAMPING_TIME, tip_mass: float = 0.0, **changes: object) -> Arm:
    """Return the paper's arm with mass and damping."""
    motion = Motion(damping_time=damping_time, tip_mass=tip_mass)
    return replace(paper_arm(), motion=motion, **changes)  # type: ignore[arg-type]


def swing_of(q: list[float]) -> Swing:
    """Return a chain that is let go beside its equilibrium."""
    swing = at_rest(len(q))
    swing.state[0] = q
    return swing


def estimates(arm: Arm, pressures: np.ndarray, settings: EstimatorSettings = UNLOADED):
    """Return what the estimator says of pressures (Pa) every 10 ms."""
    estimator, state, found = Estimator(arm=arm, settings=settings), EstimatorState(), []
    for index, pressure in enumerate(pressures.tolist()):
        reading = PressureReading(stamp_ns=10**9 + index * PERIOD_NS, pressure=pressure)
        state, outcome = estimator.step(state, reading)
        assert isinstance(outcome, ShapeEstimate), outcome
        found.append(outcome)
    return found


def step_of(low: float, high: float, count: int) -> np.ndarray:
    """Return pressures (Pa) that rest, go from one to another within 0.1 s, and rest."""
    return np.interp(np.arange(count), [20, 30], [low, high])


@pytest.mark.parametrize('pressure', [0.0, 45e3])
def test_a_small_swing_is_the_vibration_of_the_linearized_rod(pressure):
    arm = moving()
    shape = solve(arm, pressure)
    links, masses, modes = links_at(shape.solution), masses_of(arm), vibration(arm, shape, 1)
    swing, room = swing_of([1e-4]), room_for(1, links.heading.size)
    still = np.zeros(1)
    frequency, rate = modes.frequency[0], modes.damping[0]
    damped = np.sqrt(frequency**2 - 0.25 * rate**2)
    for index in range(1, 100):
        advance_chain(
            swing, 0.01, 2, links, links, masses, DAMPING_TIME, modes.moment, still, room
        )
        time = 0.01 * index
        wave = np.cos(damped * time) + 0.5 * rate / damped * np.sin(damped * time)
        wanted = 1e-4 * np.exp(-0.5 * rate * time) * wave
        assert swing.state[0, 0] == pytest.approx(wanted, abs=2e-7)


def energy(arm: Arm, swing: Swing, moments: np.ndarray, links) -> float:
    """Return the energy (J) of a swing about an equilibrium that stands still."""
    turns = np.cumsum(moments * links.compliance, axis=1)
    added = swing.state[0] @ turns
    turned = links._replace(heading=links.heading + added)
    inertia = turns @ mass_matrix(turned, masses_of(arm)) @ turns.T
    moving_energy = 0.5 * swing.state[1] @ np.linalg.solve(inertia, swing.state[1])
    bends = np.diff(added, prepend=0.0)
    bending = 0.5 * np.sum(bends**2 / links.compliance)
    along = np.stack([np.cos(turned.heading), np.sin(turned.heading)], axis=1)
    still = np.stack([np.cos(links.heading), np.sin(links.heading)], axis=1)
    normal = np.stack([-still[:, 1], still[:, 0]], axis=1)
    lifted = along - still - normal * added[:, None]
    loads = -np.sum(links.force * lifted * links.length[:, None])
    return float(moving_energy + bending + loads)


def test_without_damping_a_large_swing_keeps_its_energy():
    arm = moving(damping_time=0.0, gravity=gravity_of([0.6, -0.8]), tip_mass=0.004)
    shape = solve(arm, 20e3, (0.05, 0.02))
    links, masses, modes = links_at(shape.solution), masses_of(arm), vibration(arm, shape, 2)
    swing, room = swing_of([0.02, 1e-3]), room_for(2, links.heading.size)
    still = np.zeros(2)
    first = energy(arm, swing, modes.moment, links)
    turned = 0.0
    for _ in range(150):
        advance_chain(swing, 0.01, 4, links, links, masses, 0.0, modes.moment, still, room)
        assert energy(arm, swing, modes.moment, links) == pytest.approx(first, rel=2e-3)
        turned = max(turned, np.abs(swing.state[0] @ modes.shape)[-1])
    assert turned > 1.0  # rad: it is large


def test_a_change_at_an_unknown_instant_spreads_as_changes_at_all_instants():
    arm, seconds, steps = moving(), 0.2, 20
    low, high = (links_at(solve(arm, pressure).solution) for pressure in (20e3, 20.5e3))
    masses, modes = masses_of(arm), vibration(arm, solve(arm, 20e3), 2)
    room, change = room_for(2, low.heading.size), low.heading - high.heading
    _, projection = linearized_rates(high, masses, DAMPING_TIME, modes.moment)
    late, states = (np.arange(40) + 0.5) / 40 * seconds, []
    for rest in late:  # since the equilibrium jumped
        swing, still = swing_of(projection @ change), np.zeros(2)
        advance_chain(
            swing, rest, steps, high, high, masses, DAMPING_TIME, modes.moment, still, room
        )
        states.append(swing.state.ravel())
    swing, turned = at_rest(2), np.zeros(2)
    advance_chain(
        swing, seconds, steps, low, high, masses, DAMPING_TIME, modes.moment, turned, room
    )
    sizes = np.std(states, axis=0)
    assert swing.state.ravel() == pytest.approx(np.mean(states, axis=0), abs=0.02 * sizes.max())
    spread = swing.covariance / np.outer(sizes, sizes)
    assert spread == pytest.approx(np.cov(np.array(states).T / sizes[:, None], ddof=0), abs=0.03)
    swing = at_rest(2)  # it goes on as before, so that nothing came at any other instant
    advance_chain(
        swing, seconds, steps, low, high, masses, DAMPING_TIME, modes.moment, turned, room
    )
    assert np.diag(swing.covariance) == pytest.approx(np.zeros(4), abs=1e-12)
    advance_chain(  # and it is where it was: nothing has come
        swing, seconds, steps, high, high, masses, DAMPING_TIME, modes.moment, turned, room
    )
    assert np.diag(swing.covariance) == pytest.approx(np.zeros(4), abs=1e-12)


def test_errors_of_mass_and_damping_are_those_of_a_swing_with_others():
    arm = moving()
    low, high = (links_at(solve(arm, pressure).solution) for pressure in (20e3, 22e3))
    modes = vibration(arm, solve(arm, 20e3), 2)

    def swung(mass: float, damping: float) -> Swing:
        masses = masses_of(arm)
        masses = masses._replace(mass=freeze((1.0 + mass) * masses.mass))
        swing, room = at_rest(2), room_for(2, low.heading.size)
        before, still = low, np.zeros(2)
        for _ in range(60):
            advance_chain(
                swing, 0.01, 2, before, high, masses, (1.0 + damping) * DAMPING_TIME,
                modes.moment, still, room,
            )  # fmt: skip
            before = high
        return swing

    found, step = swung(0.0, 0.0), 1e-3
    for cause, (mass, damping) in enumerate(((step, 0.0), (0.0, step))):
        sides = [swung(sign * mass, sign * damping).state.ravel() for sign in (-1.0, 1.0)]
        slope = (sides[1] - sides[0]) / (2.0 * step)
        size = np.abs(slope.reshape(2, -1)).max(axis=1).repeat(2)
        assert found.columns[cause] / size == pytest.approx(slope / size, abs=0.15)


def test_without_motion_in_the_model_no_bit_changes_and_at_rest_it_is_the_equilibrium():
    still, rested = estimates(paper_arm(), np.full(3, 3e4)), estimates(moving(), np.full(3, 3e4))
    for one, other in zip(still, rested, strict=True):
        assert one.motion is None
        assert other.motion.settled
        assert other.shape.x == pytest.approx(one.shape.x, abs=1e-15)
        sizes = np.linalg.eigvalsh(one.tip_covariance), np.linalg.eigvalsh(other.tip_covariance)
        assert sizes[1][-1] == pytest.approx(sizes[0][-1], rel=0.03)  # see `part_shapes`
        assert (sizes[1] >= (1.0 - 1e-9) * sizes[0]).all()
        assert other.motion.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_step_of_pressure_lets_the_arm_swing_and_settle():
    arm = moving(0.05)
    found = estimates(arm, step_of(10e3, 30e3, 400))
    tips = np.array([one.shape.tip for one in found])
    rested = np.array(solve(arm, 30e3).tip)
    assert np.abs(tips[40:200] - rested).max() > 5e-3
    assert tips[-1] == pytest.approx(rested, abs=1e-4)
    settled = [one.motion.settled for one in found]
    assert all(settled[:20]) and not any(settled[25:60]) and settled[-1]
    velocity = np.array([one.motion.velocity for one in found])
    seen = np.gradient(tips, 0.01, axis=0)
    assert np.abs(velocity - seen)[32:].max() < 0.03 * np.abs(seen).max()
    widths = [np.sqrt(np.trace(one.tip_covariance[:2, :2])) for one in found]
    assert max(widths) > 1.05 * widths[-1]
    at_tip = found[60].motion.deviation(Estimator(arm=arm, settings=UNLOADED).target_places)
    assert at_tip[:2, -1] == pytest.approx(tips[60, :2] - rested[:2], rel=0.2)


def test_wrenches_that_show_nothing_do_not_tell_when_the_pressure_changed():
    estimator, sigmas = Estimator(arm=moving(), settings=EstimatorSettings()), []
    for every in (200, 100, 20):  # ms, from wrench to wrench; the pressure is read every 200
        state, outcome = EstimatorState(), None
        for time in range(0, 1001, every):
            reading = {'stamp_ns': 10**9 + time * 10**6, 'frame_id': 'pneunet_base'}
            pull = WrenchReading(force_x=0.0, force_y=0.0, moment=0.0, **reading)
            state, _ = estimator.step(state, pull)
            if time % 200 == 0:
                pressure = 22e3 if time == 1000 else 20e3
                event = PressureReading(stamp_ns=reading['stamp_ns'], pressure=pressure)
                state, outcome = estimator.step(state, event)
        assert isinstance(outcome, ShapeEstimate)
        sigmas.append(np.sqrt(np.diag(outcome.motion.swing.covariance)))
    assert (sigmas[0] > 0.0).all()
    assert sigmas[1] == pytest.approx(sigmas[0], rel=0.15)
    assert sigmas[2] == pytest.approx(sigmas[0], rel=0.05)


def test_errors_of_the_tip_mass_widen_the_covariance_of_a_swing():
    arm = moving(tip_mass=0.004)
    unsure = ModelCovariance(quantities=('motion.tip_mass',), factor=[[5e-4]])
    steps = step_of(10e3, 30e3, 60)
    sure, wide = estimates(arm, steps)[-1], estimates(replace(arm, covariance=unsure), steps)[-1]
    sides = [
        np.array(
            estimates(arm.with_changes({'motion.tip_mass': sign * 5e-4}), steps)[-1].shape.tip
        )
        for sign in (-1.0, 1.0)
    ]
    added = wide.tip_covariance - sure.tip_covariance
    moved = 0.5 * (sides[1] - sides[0])
    assert np.sqrt(added[0, 0]) == pytest.approx(abs(moved[0]), rel=0.2)


def test_a_gap_in_the_readings_is_followed_and_a_jump_back_starts_at_rest():
    arm = moving()
    estimator, state = Estimator(arm=arm, settings=UNLOADED), EstimatorState()
    for stamp, pressure in ((1.0, 1e4), (1.1, 3e4), (1.6, 3e4)):
        state, found = estimator.step(
            state, PressureReading(stamp_ns=round(1e9 * stamp), pressure=pressure)
        )
    fine = estimates(arm, np.interp(np.arange(61), [0, 10], [1e4, 3e4]))[-1]
    assert found.shape.tip == pytest.approx(fine.shape.tip, abs=2e-3)
    assert abs(found.shape.tip[0] - solve(arm, 3e4).tip[0]) > 2e-3
    back = PressureReading(stamp_ns=10_000, pressure=3e4)
    _, again = estimator.step(state, back)
    assert again.shape.tip == pytest.approx(solve(arm, 3e4).tip, abs=1e-12)


def test_after_a_long_gap_the_arm_may_swing_as_much_as_a_step_within_it_makes_it():
    arm, gap, low, high = moving(), 60.0, 30e3, 33e3

    def after(pressure: float) -> ShapeEstimate:
        estimator, state = Estimator(arm=arm, settings=UNLOADED), EstimatorState()
        for stamp, read in ((1.0, low), (1.01, low), (1.01 + gap, pressure)):
            state, found = estimator.step(
                state, PressureReading(stamp_ns=round(1e9 * stamp), pressure=read)
            )
        assert isinstance(found, ShapeEstimate)
        return found

    stepped, still = after(high), after(low)
    assert stepped.shape.tip == pytest.approx(solve(arm, high).tip, abs=1e-12)
    at_rest_there = estimates(arm, np.array([high]))[0]
    assert np.trace(still.tip_covariance[:2, :2]) == pytest.approx(
        np.trace(estimates(arm, np.array([low]))[0].tip_covariance[:2, :2]), rel=1e-9
    )
    more = np.trace((stepped.tip_covariance - at_rest_there.tip_covariance)[:2, :2])
    rest = np.array(solve(arm, high).tip[:2])
    swung = estimates(arm, np.array([low, low, *[high] * 1000]))[3:]
    square = sum(float(np.sum((np.array(one.shape.tip[:2]) - rest) ** 2)) for one in swung)
    assert more == pytest.approx(square * 1e-9 * PERIOD_NS / gap, rel=0.1)


def test_targets_are_predicted_where_the_moving_arm_has_them():
    arm = moving()
    estimator = Estimator(arm=arm, settings=UNLOADED)
    found = estimates(arm, step_of(10e3, 30e3, 60))[-4:]
    predicted = predict_frame(estimator, found, found[1].stamp_ns)
    assert predicted is not None
    wanted = [np.interp(arm.target_arclength, found[1].shape.arclength, found[1].shape.x)]
    assert predicted.x == pytest.approx(wanted[0], abs=3e-5)
    assert predicted.frame_error_count == len(predicted.errors) - 4 - 0


def test_an_arm_of_negative_rigidity_has_no_motion():
    law = LinearLaw(bending_stiffness=-1e-4)
    with refused(ModelError, 'no_equilibrium'):
        Estimator(arm=moving(moment_law=law, covariance=None, domain=None))


@pytest.mark.parametrize('force', [None, (0.05, 0.08)])
def test_mujoco_swings_alike_through_steps_of_40_kilopascals(force):
    mujoco = pytest.importorskip('mujoco', reason="no MuJoCo here: pip install '.[mujoco]'")
    from pneunet_ros.model.hinge_chain import hinge_chain
    from pneunet_ros.mujoco.equilibrium import come_to_rest
    from pneunet_ros.mujoco.finger import Finger
    from pneunet_ros.mujoco.hinge_chain import mjcf

    arm = moving()
    model = mujoco.MjModel.from_xml_string(mjcf(hinge_chain(arm, damping_time=DAMPING_TIME)))
    model.opt.timestep = 1e-3
    data = mujoco.MjData(model)
    finger, tip = Finger(model, data), model.site('tip').id
    body = int(model.site_bodyid[tip])
    times = np.arange(0.0, 3.0, 0.01)
    pressures = np.interp(times, [0.2, 0.3, 1.6, 1.7], [10e3, 50e3, 50e3, 15e3])

    def pull() -> None:
        if force is not None:
            data.qfrc_applied[:] = 0.0
            full, no_turn = np.array([*force, 0.0]), np.zeros(3)
            point = data.site_xpos[tip]
            mujoco.mj_applyFT(model, data, full, no_turn, point, body, data.qfrc_applied)

    finger.put_at_rest(pressures[0])
    come_to_rest(model, data, pull)
    truth = [data.site_xpos[tip][:2].copy()]
    for before, after in itertools.pairwise(pressures.tolist()):
        for part in range(10):
            finger.set_pressure(before + (part + 0.5) / 10 * (after - before))
            mujoco.mj_kinematics(model, data)
            pull()
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        truth.append(data.site_xpos[tip][:2].copy())

    settings = EstimatorSettings(wrench_required=force is not None)
    estimator, state, off, inside, still = Estimator(arm=arm, settings=settings), None, [], [], []
    state = EstimatorState()
    for index, pressure in enumerate(pressures.tolist()):
        stamp_ns = 10**9 + index * PERIOD_NS
        if force is not None:
            wrench = WrenchReading(
                stamp_ns=stamp_ns, force_x=force[0], force_y=force[1], moment=0.0,
                frame_id=settings.frame_id,
            )  # fmt: skip
            state, _ = estimator.step(state, wrench)
        state, found = estimator.step(state, PressureReading(stamp_ns=stamp_ns, pressure=pressure))
        error = np.array(found.shape.tip[:2]) - truth[index]
        off.append(error)
        inside.append(error @ np.linalg.solve(found.tip_covariance[:2, :2], error) <= LARGEST_95)
        still.append(np.array(solve(arm, pressure, force or (0.0, 0.0)).tip[:2]) - truth[index])
    rms = np.sqrt(np.mean(np.sum(np.square(off), axis=1)))
    assert rms < 0.4e-3
    assert np.mean(inside) > 0.9
    assert np.sqrt(np.mean(np.sum(np.square(still), axis=1))) > 10.0 * rms


def test_an_arm_on_a_turning_base_moves_as_one_whose_equilibrium_turns():
    arm, rate = moving(damping_time=0.0), 1.5
    shape = solve(arm, 30e3)
    masses, modes = masses_of(arm), vibration(arm, shape, 2)
    links = links_at(shape.solution)
    links = links._replace(force=np.zeros_like(links.force))
    on_base = links._replace(turn_rate=rate)
    turns = np.cumsum(modes.moment * links.compliance, axis=1)
    carried = turns @ mass_matrix(links, masses) @ np.full(links.heading.size, rate)
    seen, fixed = swing_of([0.0, 0.0]), swing_of([0.0, 0.0])
    fixed.state[1] = carried
    room, still, angle = room_for(2, links.heading.size), np.zeros(2), 0.0
    for _ in range(60):
        advance_chain(seen, 0.01, 4, on_base, on_base, masses, 0.0, modes.moment, still, room)
        before, after = (
            links._replace(heading=links.heading + turned)
            for turned in (angle, angle + 0.01 * rate)
        )
        advance_chain(fixed, 0.01, 4, before, after, masses, 0.0, modes.moment, np.zeros(2), room)
        angle += 0.01 * rate
        assert seen.state[0] == pytest.approx(fixed.state[0], rel=1e-6, abs=1e-12)
    assert np.abs(seen.state[0] @ turns)[-1] > 0.005  # rad: it is pulled outwards


def turned_tips(rates: Sequence[float]) -> list[np.ndarray]:
    """Return how far an estimator is off (m) on a base that MuJoCo turns by 1.6 rad in 1 s.

    Also one sigma of it, both as (2, readings). rates: by what the angular velocity that the IMU
    reads is multiplied, NaN: it reads none.
    """
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    every = Rates(pressure=100.0, wrench=100.0, frames=100.0, imu=100.0)
    protocol = Corners(
        duration=2.0, share=(0.0, 1.0), pressure=(30e3, 30e3), force_x=(0.0, 0.0),
        force_y=(0.0, 0.0),
    )  # fmt: skip
    turn = LabMotion(
        gravity_x=1.0, turn_share=(0.0, 0.2, 0.7, 1.0), turn_angle=(0.0, 0.0, 1.6, 1.6)
    )
    scenario = replace(
        scenario, protocol=protocol, rates=every, noise=noiseless(), motion=turn, effects=()
    )
    recording = simulate(scenario)
    arm = replace(true_model(scenario), motion=Motion(damping_time=turn.damping_time))
    tips = np.column_stack([recording.truth.x[:, -1], recording.truth.y[:, -1]])
    found = []
    for factor in rates:
        estimator, state, off = Estimator(arm=arm, settings=UNLOADED), EstimatorState(), []
        for index, stamp_ns in enumerate(recording.stamp_ns.tolist()):
            x, y, z, rate = recording.imu[index].tolist()
            reading = ImuReading(
                stamp_ns=stamp_ns,
                x=x,
                y=y,
                z=z,
                frame_id=BASE_FRAME,
                rate=(0.0, 0.0, factor * rate),
            )
            state, _ = estimator.step(state, reading)
            pressure = PressureReading(
                stamp_ns=stamp_ns, pressure=float(recording.pressure[index])
            )
            state, estimate = estimator.step(state, pressure)
            missed = np.hypot(*(np.array(estimate.shape.tip[:2]) - tips[index]))
            off.append([missed, np.sqrt(np.trace(estimate.tip_covariance[:2, :2]))])
        found.append(np.array(off).T)
    return found


def test_mujoco_bends_alike_on_a_base_that_turns():
    pytest.importorskip('mujoco', reason="no MuJoCo here: pip install '.[mujoco]'")
    read, unread, resting, endless, degrees = turned_tips([1.0, np.nan, 0.0, 1e300, 57.3])
    assert read[0].max() < 0.5e-3  # m
    assert unread[0].max() > 8e-3
    assert np.array_equal(unread[0], resting[0])
    assert np.array_equal(resting, endless)
    assert np.isfinite(degrees).all()
    assert np.mean(unread[0] <= 1.96 * unread[1] + read[0].max()) > 0.95
    assert np.mean(resting[0] <= 1.96 * resting[1] + read[0].max()) < 0.5  # said to be at rest
    assert unread[1][:20] == pytest.approx(read[1][:20], abs=1e-5)  # before it turns


def test_what_gravity_shows_of_a_turn_goes_on_through_loads_between_readings():
    arm = moving()
    shape = solve(arm, 20e3)
    links, masses, modes = links_at(shape.solution), masses_of(arm), vibration(arm, shape, 2)
    turned = MovingState(
        stamp_ns=0,
        links=links._replace(turn_rate=0.7),
        swing=swing_of([2e-3, 0.0]),
        turned=np.zeros(2),
    )
    state = replace(turned, links=links._replace(turn_rate=np.nan), turning=turned)
    there, alone = (
        advance_between_readings(
            one, PERIOD_NS, links._replace(turn_rate=rate), masses, DAMPING_TIME, modes
        )
        for one, rate in ((state, np.nan), (turned, 0.7))
    )
    assert there.turning is not None
    assert there.turning.stamp_ns == there.stamp_ns
    assert np.array_equal(there.turning.swing.state, alone.swing.state)
    assert not np.array_equal(there.swing.state, alone.swing.state)


def test_the_noise_of_an_accelerometer_widens_the_tip_as_it_moves_it():
    arm, std, found = moving(gravity=gravity_of('imu')), 0.1, {}
    for name, variance in (('still', 0.0), ('shaken', std**2)):
        random, estimator = np.random.default_rng(3), Estimator(arm=arm, settings=UNLOADED)
        state, found[name] = EstimatorState(), []
        for index in range(3000):
            stamp_ns = 10**9 + index * PERIOD_NS
            x, y = random.normal(0.0, std if variance else 0.0, 2).tolist()
            reading = ImuReading(
                stamp_ns=stamp_ns, x=x, y=y, z=STANDARD_GRAVITY, frame_id=BASE_FRAME,
                variance=variance,
            )  # fmt: skip
            state, _ = estimator.step(state, reading)
            pressure = PressureReading(stamp_ns=stamp_ns, pressure=20e3)
            state, estimate = estimator.step(state, pressure)
            found[name].append(estimate)
    tips = np.array([one.shape.tip[:2] for one in found['shaken'][300:]])
    stated = (found['shaken'][-1].tip_covariance - found['still'][-1].tip_covariance)[:2, :2]
    spread = float(np.trace(np.cov(tips.T)))
    assert np.sqrt(np.trace(stated) / spread) == pytest.approx(1.0, abs=0.3)
    assert np.sqrt(spread) > 1e-4  # m


def test_diagnostics_say_how_the_arm_moves():
    health, found = EstimatorHealth('/pressure', 0.0), estimates(moving(), step_of(1e4, 3e4, 40))
    for estimate in found:
        health.record_pressure(estimate, 0.1, 1e-4)
    values = health.report(EstimatorState(), UNLOADED, 0.2).values
    assert float(values['settled']) == pytest.approx(
        np.mean([one.motion.settled for one in found]), abs=1e-3
    )
    assert float(values['frequency_hz']) == pytest.approx(found[-1].motion.modes().hertz, rel=1e-3)
    assert float(values['decay_time_s']) > 0.1
    health.record_pressure(estimates(paper_arm(), np.full(1, 1e4))[0], 0.3, 1e-4)
    assert not any(
        health.report(EstimatorState(), UNLOADED, 0.4).values[name]
        for name in ('settled', 'frequency_hz', 'decay_time_s')
    )


LENGTH = 0.3
SHAPES_AT_TIP = np.array([[1e-3, 2e-4, 0.03], [-2e-4, 4e-4, 0.05]])


def parted(errors):
    """Return by how much the covariance of errors (errors, 3) grows for a chain that is late."""
    weights = np.array([1.0, 1.0, LENGTH])
    parts = np.empty((len(errors), 2, 3))
    part_shapes(weights * errors, weights * SHAPES_AT_TIP, parts)
    return np.einsum('esi,esj->ij', parts, parts) / np.outer(weights, weights)


def test_an_error_in_two_shapes_is_larger_beside_its_direction_and_as_large_along_it():
    error = np.array([[0.9, -0.5]]) @ SHAPES_AT_TIP
    weights = np.array([1.0, 1.0, LENGTH])
    added, along = parted(error) * np.outer(weights, weights), (weights * error)[0]
    assert added @ along == pytest.approx(np.zeros(3), abs=1e-15)
    deviation = np.cross(*(weights * SHAPES_AT_TIP))  # of neither
    assert added @ deviation == pytest.approx(np.zeros(3), abs=1e-15)
    across = np.cross(along, deviation) / np.linalg.norm(np.cross(along, deviation))
    sizes = np.array([0.9, 0.5]) * (weights * SHAPES_AT_TIP @ across)
    assert across @ added @ across == pytest.approx(np.sum(sizes**2), rel=1e-9)


def test_an_error_that_is_in_no_shape_or_in_one_alone_stays_as_it_is():
    weights = np.array([1.0, 1.0, LENGTH])
    none = np.cross(*(weights * SHAPES_AT_TIP)) / weights
    for errors in (none[None], 0.7 * SHAPES_AT_TIP[1:], np.zeros((1, 3))):
        assert parted(errors) == pytest.approx(np.zeros((3, 3)), abs=1e-15)
