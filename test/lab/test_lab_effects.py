"""Effects of the virtual lab: without richness they are the model's, with richness they are more.

The two share no line: a chain against the model's solver, small steps of time against its exact
answers, on the arm of the paper.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import quantities, seconds_between
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Load
from pneunet_ros.lab.lab_effects import LAB_EFFECTS
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Strings
from pneunet_ros.lab.scenario import lab_effect, Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.equilibrium import solve_rod
import pytest
from support.example_arms import paper_arm
from support.lab_pairs import lab_arm_of, NOISELESS
from support.lab_run import readings_at_frames
from support.refusals import refused

PROTOCOL = Strings(
    pressures=(0.0, 20e3, 45e3, 60e3, 30e3, 50e3, 10e3),
    pull_a=(0.25, 0.2, 0.15, 0.15, 0.17, 0.15, 0.2),
    pull_b=(0.0, 0.03, 0.1, 0.2, 0.1, 0.12, 0.02),
    duration=13.2,  # so that every corner is at the time of a reading
    ramp=0.8,
)
SIZES = {
    'pressure_gain': {'gain': 1.05},
    'pressure_offset': {'offset': 800.0},
    'force_misalignment': {'angle': 0.08},
    'pressure_lag': {'time_constant': 0.4},
    'hysteresis': {'width': 3000.0},
    'creep': {'amplitude': 0.15, 'time_constant': 3.0},
    'softening': {'loss': 0.2},
    'stiffening': {'coefficient': 2e-4},
    'extensibility': {'axial_stiffness': 20.0},
    'pressure_elongation': {'strain_per_pascal': 1e-6, 'strain_per_pascal_squared': 5e-12},
    'gravity': {'weight_x': 0.4, 'weight_y': -1.5},
    'clamp_compliance': {'compliance': 12.0},
    'load_offset': {'offset': 0.006},
    'camera_scale': {'factor': 1.03},
    'camera_rotation': {'angle': 0.03},
    'contact': {'force': -0.03, 'arclength': 0.7},
    'camera_tilt': {'tilt_x': 0.4, 'tilt_y': -0.3},
    'lens_distortion': {'radial': -10.0, 'middle_x': 0.05, 'middle_y': 0.01},
}
CLOSE = 2e-6  # m; 3e-7 of it is the error of a chain of 448 elements


def scenario(effects, frames=2.0):
    # Readings are taken at the times of frames, too.
    return Scenario(
        name='agreement',
        arm=lab_arm_of(paper_arm()),
        effects=effects,
        protocol=PROTOCOL,
        noise=NOISELESS,
        rates=Rates(pressure=40.0, wrench=40.0, frames=frames),
    )


def modelled(recording, effects):
    """Return x, y (frames, targets) that the model claims, driven by the readings."""
    arm = paper_arm(tuple(effects))
    history, before, start, claims = None, 0, None, []
    reading, forces, _ = readings_at_frames(recording)
    frames = dict(zip(reading.tolist(), range(recording.stamp_ns.size), strict=True))
    for index, stamp in enumerate(recording.reading_stamp_ns.tolist()):
        force = forces[frames[index]] if index in frames else np.zeros(2)
        load = arm.sense(
            Load(
                pressure=float(recording.pressure[index]),
                force_x=float(force[0]),
                force_y=float(force[1]),
            )
        )
        if history is None:
            history, before = arm.initial_history(load.pressure), stamp
        history, chamber = arm.actuate(history, seconds_between(before, stamp), load.pressure)
        before = stamp
        if index in frames:
            rods = arm.rods(np.array([chamber]), history, load.row)
            shape = solve_rod(arm, rods, load, start, arm.target_arclength)
            assert shape.converged
            start = shape.solution
            claims.append(arm.see(shape.x, shape.y))
    return np.moveaxis(np.array(claims), 1, 0)


def difference(recording, model_effects):
    x, y = modelled(recording, model_effects)
    return np.abs([recording.x - x, recording.y - y]).max()


def test_the_lab_knows_every_effect_of_the_model_by_its_names():
    for name, effect in EFFECTS.items():
        ours = {item.name for item in quantities(LAB_EFFECTS[name])}
        assert {item.name for item in quantities(effect)} == ours - {'richness'}


def test_every_effect_of_the_lab_is_compared_with_the_model():
    """All but a delay, which has a test below, and inertia, which test_moving_arm compares."""
    assert {*SIZES, 'camera_delay', 'inertia'} == {*LAB_EFFECTS}


@pytest.mark.parametrize('name', SIZES)
def test_a_plain_effect_agrees_with_the_model(name):
    plain = simulate(scenario((lab_effect(name, SIZES[name]),)))
    assert difference(plain, (EFFECTS[name](**SIZES[name]),)) < CLOSE
    assert difference(plain, ()) > 50 * CLOSE


def test_all_effects_together_agree_with_the_model():
    plain = simulate(scenario(tuple(lab_effect(name, values) for name, values in SIZES.items())))
    assert difference(plain, [EFFECTS[name](**values) for name, values in SIZES.items()]) < CLOSE


@pytest.mark.parametrize('name', SIZES)
def test_a_rich_effect_is_another_but_not_a_larger_one(name):
    def seen(**parameters):
        recording = simulate(scenario((lab_effect(name, parameters),), frames=10.0))
        return np.stack([recording.x, recording.y]), recording.pressure, recording.wrench_force

    neutral, plain, rich = seen(), seen(**SIZES[name]), seen(**SIZES[name], richness=1.0)
    # In what it changes at all: what is seen, what is read of pressure or of force.
    effect, more = (
        [np.sqrt(np.mean((b - a) ** 2)) for a, b in zip(first, second, strict=True)]
        for first, second in ((neutral, plain), (plain, rich))
    )
    changed = int(np.argmax(np.array(effect) > 0.0))
    assert 0.005 * effect[changed] < more[changed] < 0.5 * effect[changed]


@pytest.mark.parametrize('name', [name for name in LAB_EFFECTS if name != 'inertia'])
def test_a_neutral_effect_does_nothing_however_rich(name):
    bare = simulate(scenario(()))
    rich = simulate(scenario((lab_effect(name, {'richness': 2.0}),)))
    for item in ('x', 'y', 'pressure', 'wrench_force'):
        assert getattr(rich, item) == pytest.approx(getattr(bare, item), abs=1e-12)


def test_late_frames_show_what_others_do_at_later_stamps():
    bare = simulate(scenario((), frames=10.0))
    late, rich = (
        simulate(scenario((lab_effect('camera_delay', {'delay': 0.1, **more}),), frames=10.0))
        for more in ({}, {'richness': 1.0})
    )
    for one in (late, rich):
        np.testing.assert_array_equal(one.x, bare.x)
        np.testing.assert_array_equal(one.reading_stamp_ns, bare.reading_stamp_ns)
    assert set((late.stamp_ns - bare.stamp_ns).tolist()) == {100_000_000}
    drift = (rich.stamp_ns - bare.stamp_ns) * 1e-9
    assert drift[[0, -1]] == pytest.approx([0.07, 0.13], abs=1e-3)
    assert np.all(np.diff(drift) > 0.0)


def test_an_arm_remembers_what_was_done_to_it():
    effects = tuple(lab_effect(name, SIZES[name]) for name in ('hysteresis', 'creep', 'softening'))
    first = simulate(scenario(effects))
    later = dataclasses.replace(first.scenario, start=15.0)
    again = simulate(later, first.memory)
    assert np.abs(again.x - first.x).max() > 1e-4
    assert again.stamp_ns[0] - first.stamp_ns[0] == 15_000_000_000
    # Creep is gone after an hour. The play stays where it is, and what is soft stays soft.
    rested = simulate(dataclasses.replace(later, start=3600.0), first.memory)
    assert rested.memory.past['softening'] == pytest.approx((60e3 - 1500.0,) * 2, rel=0.1)
    with refused(RequestError, 'wrong_order'):
        simulate(later, again.memory)


def test_unconditioned_and_softened_arm_differ_below_the_largest_pressure_alone():
    recording = simulate(scenario((lab_effect('softening', SIZES['softening']),), frames=10.0))
    bare = simulate(scenario((), frames=10.0))
    moved = np.abs(recording.x - bare.x).max(axis=1)
    unconditioned = np.maximum.accumulate(bare.truth.pressure) == bare.truth.pressure
    assert moved[unconditioned].max() < 1e-9
    assert np.median(moved[~unconditioned]) > 1e-4


@pytest.mark.parametrize(
    ('name', 'parameters', 'words'),
    [
        ('gravitation', {}, 'unknown effect gravitation; known effects: pressure_offset, '),
        ('gravity', {'weight': 1.0}, 'has no parameter weight; it has richness, weight_x'),
        ('softening', {'loss': 2.0}, r'effects.softening.loss = 2.0 is not within \[0.0, 0.9\]'),
        ('creep', {'richness': -1.0}, 'effects.creep.richness = -1.0 is not within'),
    ],
)
def test_what_is_no_effect_of_the_lab_is_said(name, parameters, words):
    with pytest.raises(RequestError, match=words):
        lab_effect(name, parameters)


def test_the_effect_inertia_leaves_the_other_number_of_the_motion_and_can_be_undone():
    block = LabMotion(tip_mass=0.005, damping_time=0.04)
    plain = dataclasses.replace(scenario(()), motion=block)
    damped = plain.with_effects({'inertia': {'damping_time': 0.02}})
    assert damped.effective_motion == dataclasses.replace(block, damping_time=0.02)
    undone = damped.with_effects({'inertia': {'damping_time': 0.0}})
    assert undone.effective_motion == undone.motion == block
    alone = scenario(()).with_effects({'inertia': {'tip_mass': 0.004}})
    assert alone.effective_motion == LabMotion(tip_mass=0.004, damping_time=0.0)
    assert alone.with_effects({'inertia': {'tip_mass': 0.0}}).effective_motion is None


def test_an_effect_whose_history_was_not_recorded_does_not_start_anew():
    first = simulate(scenario(()))
    later = dataclasses.replace(
        scenario((lab_effect('softening', SIZES['softening']),)), start=first.memory.time
    )
    with refused(RequestError, 'other_arm'):
        simulate(later, first.memory)
    without_history = dataclasses.replace(
        scenario((lab_effect('gravity', SIZES['gravity']),)), start=first.memory.time
    )
    assert simulate(without_history, first.memory).memory.past == {'gravity': ()}
