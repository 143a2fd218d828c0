"""The lab arm with mass: at rest as the chain, in motion as the beam of the textbooks."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.live import LiveLab, Valve
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.sensors import noiseless, Rates
from pneunet_ros.lab.simulation import simulate
import pytest
from support.refusals import refused

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")


def held(pressure=30e3, force=(0.1, 0.05), duration=0.2, **changes):
    """Return a scenario in which nothing changes."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    protocol = Corners(
        duration=duration,
        share=(0.0, 1.0),
        pressure=(pressure,) * 2,
        force_x=(force[0],) * 2,
        force_y=(force[1],) * 2,
    )
    rates = Rates(pressure=50.0, wrench=50.0, frames=20.0)
    return dataclasses.replace(
        scenario, protocol=protocol, rates=rates, noise=noiseless(), **changes
    )


def beam(scenario, stiffness):
    """Return the scenario with a uniform beam that is straight at all pressures."""
    arm = scenario.arm
    alpha = stiffness / (arm.weight * arm.length**2)
    arm = dataclasses.replace(
        arm, modes=np.zeros_like(arm.modes), rigidity=np.full_like(arm.rigidity, alpha)
    )
    return dataclasses.replace(scenario, arm=arm)


def tip(recording):
    return np.column_stack([recording.truth.x[:, -1], recording.truth.y[:, -1]])


@pytest.mark.parametrize(
    'effects',
    [
        {},
        {'gravity': {'weight_x': 0.3, 'weight_y': -0.8, 'richness': 1.0}},
        {'clamp_compliance': {'compliance': 8.0}},
        {'stiffening': {'coefficient': 2e-4}},
        {'load_offset': {'offset': 4e-3}},
        {'weak_chamber': {'rigidity_loss': 0.4, 'curvature_dip': 20.0}},
        {'push': {'force': 0.03, 'place': 0.7}},
    ],
    ids=lambda effects: ''.join(effects) or 'plain',
)
def test_at_rest_it_is_the_chain_in_equilibrium(effects):
    scenario = held().with_effects(effects)
    chain = simulate(scenario).truth
    moving = simulate(dataclasses.replace(scenario, motion=LabMotion())).truth
    assert np.abs(moving.x - chain.x).max() < 2e-5
    assert np.abs(moving.y - chain.y).max() < 2e-5
    assert np.abs(moving.theta - chain.theta).max() < 2e-3
    assert np.abs(moving.target_x - chain.target_x).max() < 2e-5
    # Beside l1, where the curvature jumps, a link is longer than an element of the chain.
    assert np.median(np.abs(moving.curvature - chain.curvature)) < 0.05


def test_its_weight_is_that_of_its_mass():
    scenario = held()
    weight = scenario.arm.weight / scenario.arm.length
    heavy = scenario.with_effects(
        {'gravity': {'weight_x': 0.6 * weight, 'weight_y': -0.8 * weight}}
    )
    motion = LabMotion(gravity_x=0.6, gravity_y=-0.8)
    moving = simulate(dataclasses.replace(scenario, motion=motion))
    assert np.abs(tip(moving) - tip(simulate(heavy))).max() < 2e-5
    assert moving.motion.specific_force[-1] == pytest.approx(
        STANDARD_GRAVITY * np.array([-0.6, 0.8])
    )


def test_a_pluck_rings_with_the_frequency_and_the_damping_of_the_beam():
    stiffness = 1.2e-2
    scenario = beam(held(0.0, (0.0, 0.0), duration=0.9), stiffness)
    arm = scenario.arm
    omega = 1.875104**2 * np.sqrt(stiffness * STANDARD_GRAVITY / (arm.weight * arm.length**3))
    damping = 0.05
    scenario = dataclasses.replace(
        scenario.with_effects({'push': {'force': 0.05, 'place': 0.95, 'ends': 0.1}}),
        rates=Rates(pressure=50.0, wrench=50.0, frames=1000.0),
        motion=LabMotion(damping_time=2.0 * damping / omega, links=20.0, timestep=2e-4),
    )
    recording = simulate(scenario)
    after = recording.truth.time > 0.16
    y, time = tip(recording)[after, 1], recording.truth.time[after]
    crossing = np.flatnonzero(np.diff(np.sign(y)))
    half = np.diff(time[crossing]).mean()
    assert np.pi / half == pytest.approx(omega * np.sqrt(1.0 - damping**2), rel=0.01)
    peaks = [np.abs(y[a:b]).max() for a, b in itertools.pairwise(crossing[:7])]
    decrement = np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    assert decrement / np.hypot(np.pi, decrement) == pytest.approx(damping, rel=0.04)
    velocity = np.gradient(y, time)[2:-2]
    measured = recording.motion.tip_velocity[after, 1][2:-2]
    assert np.abs(velocity - measured).max() < 0.02 * np.abs(measured).max()


def test_a_turning_base_bends_the_arm_by_its_inertia():
    # So stiff that it follows without swinging: tip = 11/120 rho alpha l^5 / EI behind.
    stiffness = 2.0
    scenario = beam(held(0.0, (0.0, 0.0), duration=0.4), stiffness)
    arm = scenario.arm
    motion = LabMotion(turn_angle=(0.0, 1.5), damping_time=1e-3, links=20.0, timestep=2e-4)
    recording = simulate(
        dataclasses.replace(
            scenario, motion=motion, rates=Rates(pressure=50.0, wrench=50.0, frames=500.0)
        )
    )
    rate = recording.motion.base_rate
    acceleration = np.gradient(rate, recording.truth.time)
    density = arm.weight / STANDARD_GRAVITY / arm.length
    expected = -11.0 / 120.0 * density * acceleration * arm.length**5 / stiffness
    found = tip(recording)[:, 1]
    middle = slice(20, -20)
    assert np.abs(expected).max() > 4e-6
    assert np.abs(found - expected)[middle].max() < 0.05 * np.abs(expected).max()
    assert recording.motion.base_angle[-1] == pytest.approx(1.5, abs=1e-3)


def test_a_base_that_turns_takes_gravity_with_it():
    weight = 0.17 / 0.112
    motion = LabMotion(gravity_y=-1.0, turn_angle=(0.0, -0.5 * np.pi), damping_time=0.2)
    scenario = held(duration=3.0)
    turned = simulate(dataclasses.replace(scenario, motion=motion))
    # Turned clockwise by a quarter: down is along the arm.
    hanging = simulate(held().with_effects({'gravity': {'weight_x': weight}}))
    assert np.abs(tip(turned)[-1] - tip(hanging)[-1]).max() < 2e-4
    assert turned.motion.specific_force[-1] == pytest.approx([-STANDARD_GRAVITY, 0.0], abs=1e-2)


def led(lab, times, pressure, load=None):
    """Return tips (n, 2) m of a live arm at times (s), its valve told a pressure (Pa)."""
    state, tips = lab.begin(), []
    for time in times:
        state = lab.step(state, float(time), pressure, load)
        state, shape = lab.shape(state)
        x, y, _ = shape.points([lab.scenario.arm.reach])
        tips.append((x[0, 0], y[0, 0]))
    return np.array(tips)


def test_a_live_arm_rings_as_a_recorded_one():
    scenario = held(0.0, (0.0, 0.0), duration=1.0)
    protocol = dataclasses.replace(
        scenario.protocol,
        share=(0.0, 0.1, 1.0),
        pressure=(0.0, 20e3, 20e3),
        force_x=(0.0,) * 3,
        force_y=(0.0,) * 3,
    )
    scenario = dataclasses.replace(scenario, protocol=protocol, motion=LabMotion(links=24.0))
    recorded = simulate(scenario)
    # Its valve fills at the rate of the ramp, and stops at once.
    lab = LiveLab(scenario=scenario, valve=Valve(time_constant=0.0, rate_limit=2e5))
    time = np.arange(1, 1000) * 1e-3
    finely, coarsely = led(lab, time, 20e3), led(lab, time[9::10], 20e3)
    assert np.abs(finely[9::10] - coarsely).max() < 1e-4
    expected = np.array([np.interp(recorded.truth.time, time, column) for column in finely.T]).T
    inside = (recorded.truth.time > 0.0) & (recorded.truth.time < 0.99)
    assert np.abs(tip(recorded) - expected)[inside].max() < 4e-4
    assert np.ptp(finely[300:], axis=0).max() > 5e-3


@pytest.mark.parametrize('inertia', [0.0, 1.0])
def test_a_string_points_to_its_pulley_under_the_weight_of_the_arm(inertia):
    motion = LabMotion(gravity_y=-1.0, tip_mass=0.01, inertia=inertia)
    scenario = held(force=(0.15, 0.0), duration=0.1, motion=motion)
    pulled = simulate(scenario.with_effects({'pulley': {'eye_x': 0.3, 'eye_y': 0.1}}))
    string = np.array([0.3, 0.1]) - tip(pulled)[0]
    assert pulled.truth.force[0] == pytest.approx(0.15 * string / np.hypot(*string), abs=2e-4)


def test_a_mass_at_the_tip_hangs_where_the_load_is_tied():
    motion = LabMotion(gravity_y=-1.0, tip_mass=0.01, turn_angle=(0.4, 0.4))
    scenario = held(35e3, duration=0.1, motion=motion)
    arm = dataclasses.replace(scenario.arm, tip_cap=0.015)
    scenario = dataclasses.replace(scenario, arm=arm).with_effects(
        {'load_offset': {'offset': 0.01}}
    )
    still = dataclasses.replace(scenario, motion=dataclasses.replace(motion, inertia=0.0))
    assert np.abs(tip(simulate(scenario)) - tip(simulate(still))).max() < 2e-5


def test_a_live_base_turns_and_its_accelerometer_with_it():
    turn = LabMotion(
        gravity_y=-1.0, turn_share=(0.0, 0.5, 1.0), turn_angle=(0.0, 1.0, 0.0), inertia=0.0
    )
    scenario = held(20e3, (0.0, 0.0), duration=1.0)
    rates = dataclasses.replace(scenario.rates, imu=100.0)
    scenario = dataclasses.replace(scenario, motion=turn, rates=rates)
    recorded = simulate(scenario)
    lab = LiveLab(scenario=scenario, valve=Valve(time_constant=0.0, rate_limit=1e9))
    tips = led(lab, 3.0 + recorded.truth.time, 20e3)
    assert np.abs(tips - tip(recorded)).max() < 1e-6
    state = lab.step(lab.begin(), 3.5, 20e3)
    read = lab.reading(state, np.random.default_rng(0)).imu
    down = STANDARD_GRAVITY * np.array([-np.sin(1.0), -np.cos(1.0)])
    assert read == pytest.approx([*-down, 0.0, 0.0], abs=1e-9)


def test_a_peg_pushes_as_hard_as_a_push_there_would():
    scenario = held(5e3, (0.0, 0.0), duration=1.2)
    protocol = dataclasses.replace(
        scenario.protocol,
        share=(0.0, 0.5, 1.0),
        pressure=(5e3, 40e3, 40e3),
        force_x=(0.0,) * 3,
        force_y=(0.0,) * 3,
    )
    scenario = dataclasses.replace(scenario, protocol=protocol)
    motion = LabMotion(damping_time=0.1, peg_x=0.07, peg_y=0.045, peg_radius=0.006)
    touched = simulate(dataclasses.replace(scenario, motion=motion))
    force, place = touched.motion.contact_force[-1], float(touched.motion.contact_place[-1])
    assert np.isnan(touched.motion.contact_place[0])
    heading = np.interp(place, touched.truth.arclength, touched.truth.theta[-1])
    normal = np.array([-np.sin(heading), np.cos(heading)])
    size = float(force @ normal)
    assert size < -5e-3 and np.hypot(*force) == pytest.approx(-size, rel=0.02)
    share = place / scenario.arm.length
    pushed = simulate(scenario.with_effects({'push': {'force': size, 'place': share}}))
    free = simulate(scenario)
    moved = np.hypot(*(tip(free) - tip(pushed))[-1])
    assert np.hypot(*(tip(touched) - tip(pushed))[-1]) < 0.03 * moved


def test_a_peg_pushes_an_arm_at_rest_evenly():
    scenario = held(1e3, (0.0, 0.0), duration=4.0)
    protocol = dataclasses.replace(
        scenario.protocol,
        share=(0.0, 0.5, 1.0),
        pressure=(1e3, 58e3, 58e3),
        force_x=(0.0,) * 3,
        force_y=(0.0,) * 3,
    )
    arm = dataclasses.replace(scenario.arm, clamp_angle=0.3)
    motion = LabMotion(damping_time=0.1, peg_x=0.08, peg_y=0.06, peg_radius=0.006)
    scenario = dataclasses.replace(scenario, arm=arm, protocol=protocol, motion=motion)
    recording = simulate(scenario)
    assert np.hypot(*recording.motion.tip_velocity[-20:, :2].T).max() < 1e-4
    force = np.hypot(*recording.motion.contact_force[-20:].T)
    assert np.ptp(force) < 0.02 * force.min() and force.min() > 0.03


def test_what_links_cannot_do_is_refused():
    for effects in (
        {'extensibility': {'axial_stiffness': 20.0}},
        {'pressure_elongation': {'strain_per_pascal': 1e-7}},
        {'touching_peg': {'stiffness': 100.0}},
        {'clamp_compliance': {'compliance': 8.0, 'richness': 1.0}},
    ):
        scenario = dataclasses.replace(held().with_effects(effects), motion=LabMotion())
        with refused(RequestError, 'not_for_mujoco'):
            simulate(scenario)
    step = LabMotion().timestep
    for motion, effects in (
        (LabMotion(damping_time=0.5 * step), {}),
        (None, {'inertia': {'tip_mass': 0.004}}),
    ):
        scenario = dataclasses.replace(held(), motion=motion).with_effects(effects)
        with refused(RequestError, 'not_for_mujoco'):
            simulate(scenario)
    simulate(dataclasses.replace(held(), motion=LabMotion(damping_time=step)))
    with refused(RequestError, 'touches_peg'):
        simulate(
            dataclasses.replace(held(), motion=LabMotion(peg_x=0.05, peg_y=0.0, peg_radius=0.01))
        )
    for reason, wrong in (
        ('not_increasing', {'turn_share': (0.0, 0.5)}),
        ('wrong_shape', {'turn_angle': (0.0, 1.0, 2.0)}),
        ('no_direction', {'gravity_x': 0.9, 'gravity_y': 0.9}),
        ('not_a_number', {'links': 8.5}),
    ):
        with refused(RequestError, reason):
            LabMotion(**wrong)


def test_the_verb_writes_the_same_recording_and_the_motion_beside_it(tmp_path, capsys):
    content = (share_path('scenarios/unloaded_staircase.yaml')).read_text(encoding='utf-8')
    (tmp_path / 'lab_arm.yaml').write_text(
        share_path('scenarios/lab_arm.yaml').read_text(encoding='utf-8'), encoding='utf-8'
    )
    file = tmp_path / 'quick.yaml'
    steps = 'protocol: {kind: staircase, duration: 3.0, rest: 0.5, ramp: 0.1, pressures: [4.e4]}\n'
    content = content[: content.index('protocol:')] + steps
    file.write_text(content + 'motion: {turn_angle: [0.0, 0.3], links: 12}\n', encoding='utf-8')
    output = tmp_path / 'quick.mcap'
    assert main(['simulate', str(file), '--output', str(output), '--json']) == 0
    said = json.loads(capsys.readouterr().out)
    assert said['scenario']['motion']['turn_angle'] == [0.0, 0.3]
    with np.load(tmp_path / 'quick.truth.npz') as truth:
        assert truth['tip_velocity'].shape == (truth['x'].shape[0], 3)
        assert np.abs(truth['tip_velocity']).max() > 0.05
    command = ['simulate', str(file), '--output', str(output), '--overwrite']
    assert main([*command, '--engine', 'chain', '--overwrite']) == 0
    file.write_text(content + 'motion: {mass: 1.0}\n', encoding='utf-8')
    assert main(command) == 2
