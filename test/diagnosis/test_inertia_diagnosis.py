"""Inertia as a name: recordings of an arm that MuJoCo moves, in some of which it swings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.calibration.checks.frames_in_motion import frames_in_motion
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.inertia import Swings, with_inertia
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.diagnosis.settings import CONFIRMATION, DEFAULTS
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inference.adequacy import SIGNIFICANT_FALL
from pneunet_ros.model.motion import Motion
import pytest
from support.lab_run import run_of, true_model

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
pytestmark = pytest.mark.lengthy

TIP_MASS, DAMPING_TIME = 0.002, 0.03
NOISE = true_model(load_scenario(share_path('scenarios/unloaded_ramp.yaml'))).sensors


def scenario_of(name: str) -> Scenario:
    """Return a shipped scenario."""
    return load_scenario(share_path(f'scenarios/{name}.yaml'))


MASS = {'inertia': {'tip_mass': TIP_MASS, 'damping_time': DAMPING_TIME}}


def moved(name: str, seed: int, **protocol: float) -> RecordingData:
    """Return a recording of the arm of a shipped scenario, with its mass."""
    given = scenario_of(name)
    given = replace(
        given,
        name=f'{name} {seed}',
        seed=seed,
        protocol=replace(given.protocol, **protocol),
        rates=Rates(pressure=25.0, wrench=25.0, frames=10.0),
        motion=LabMotion(timestep=2e-3),
    )
    run = run_of(simulate(given.with_effects(MASS)))
    return run.without_load() if name.startswith('unloaded') else run


@cache
def runs() -> tuple[tuple[RecordingData, ...], tuple[RecordingData, ...]]:
    """Return training and held-out recordings; in one of each the pressure steps."""
    training = (
        moved('unloaded_ramp', 1, duration=40.0),
        moved('unloaded_staircase', 2, duration=40.0, ramp=0.1, rest=1.0),
        moved('dead_weights', 3, duration=40.0),
    )
    held_out = (
        moved('unloaded_staircase', 4, duration=30.0, ramp=0.15, rest=1.5),
        moved('random_mix', 5, duration=40.0),
    )
    return training, held_out


@cache
def diagnosed() -> Diagnosis:
    """Return the diagnosis of the model without motion."""
    return diagnose(true_model(scenario_of('unloaded_ramp')), *runs(), seed=3)


def test_steps_of_an_arm_with_mass_are_called_inertia():
    found = diagnosed()
    assert found.answer == 'named'
    assert [item.name for item in found.effects] == ['inertia']
    numbers = found.effects[0].parameters
    assert numbers['tip_mass'].value == pytest.approx(TIP_MASS, rel=0.05)
    assert numbers['damping_time'].value == pytest.approx(DAMPING_TIME, rel=0.05)
    assert found.effects[0].probability == 1.0 - CONFIRMATION.wrong
    assert found.after.arm.inertia.damping_time == numbers['damping_time'].value
    assert found.before.held_out.rms > 5.0 * found.after.held_out.rms
    assert found.closed > 0.98
    assert found.detectable['inertia'].observable


def test_held_out_swings_that_fall_by_nothing_are_no_name():
    random = np.random.default_rng(1)
    still = 1e-4 * random.standard_normal((30, 2, 5))
    rest = (np.arange(30) < 10,)

    def fall(share: float) -> float:
        left = np.where(rest[0][:, None, None], still, share * still)
        return Swings((still,), (left,), (np.zeros_like(still),), rest).fall(1e-4)

    assert fall(1.0) == 0.0
    assert fall(1.01) < 0.0 < SIGNIFICANT_FALL < fall(0.9)
    assert fall(0.9) == pytest.approx(0.19 * 200, rel=0.2)


def test_who_does_not_want_the_name_or_knows_it_gets_none():
    found, every = diagnosed(), [run for part in runs() for run in part]
    swings = frames_in_motion(every, found.before.arm).moving
    nowhere = [np.zeros(len(run.stamp_ns), np.bool_) for run in every]
    known = replace(found, settings=replace(DEFAULTS, withheld=('inertia',)))
    assert with_inertia(known, *runs(), swings, NOISE) is known
    assert with_inertia(found, *runs(), swings, NOISE) is found  # `after` has motion
    still = replace(found, after=found.before, effects=(), answer='none')
    assert not with_inertia(still, *runs(), nowhere, NOISE).detectable['inertia'].observable
    one = [runs()[0][1]]  # in which the pressure steps
    swings = frames_in_motion(one, found.before.arm).moving
    unexplained = with_inertia(replace(still, answer='unknown'), one, (), swings, NOISE)
    assert (unexplained.answer, unexplained.effects) == ('unknown', ())
    assert 'inertia' in unexplained.notes[-1]


def test_an_effect_that_moves_an_arm_is_as_its_block():
    model = true_model(scenario_of('unloaded_ramp'))
    effect = Inertia(tip_mass=TIP_MASS, damping_time=DAMPING_TIME)
    by_effect = replace(model, effects=(effect,))
    block = Motion(tip_mass=TIP_MASS, damping_time=DAMPING_TIME)
    assert by_effect.inertia == replace(model, motion=block).inertia == block
    assert replace(by_effect, effects=()).inertia is None
    moved = by_effect.with_changes({'effects.inertia.damping_time': 0.01})
    assert moved.inertia.damping_time == pytest.approx(DAMPING_TIME + 0.01)
    assert np.array_equal(by_effect.clamp_record, replace(model, motion=block).clamp_record)
