"""Frames that show an arm swing are left out where statics are asked, and named; no others are."""

from __future__ import annotations

import dataclasses
from functools import cache
import math

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.checks.frames_in_motion import (
    check_runs_at_rest,
    frames_in_motion,
    slowest_period,
    without_motion,
)
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.softening import Softening
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.vibration import vibration
from pneunet_ros.offline.check import check_recording
from pneunet_ros.offline.uses import UseRequest
from pneunet_ros.recordings.lab_files import write_lab
import pytest
from support.lab_run import run_of, true_model
from support.refusals import refused

MOTION = LabMotion(timestep=2e-3)
PLUCKS = {'push': {'force': 0.03, 'place': 0.9, 'begins': 3.0, 'ends': 3.6, 'every': 9.0}}
SECONDS = {'unloaded_ramp': 30.0, 'unloaded_staircase': 30.0, 'dead_weights': 60.0}


def recording_of(name: str, motion: LabMotion | None, effects: dict, ramp: float = 0.1):
    """Return a recording of the virtual lab, with quick steps."""
    scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
    protocol = dataclasses.replace(scenario.protocol, duration=SECONDS.get(name, 60.0))
    if name != 'unloaded_ramp':
        protocol = dataclasses.replace(protocol, ramp=ramp)
    changed = dataclasses.replace(scenario, protocol=protocol, motion=motion)
    return simulate(changed.with_effects(effects))


@cache
def plucked() -> LabRecording:
    """Return a recording of an unloaded ramp with plucks."""
    return recording_of('unloaded_ramp', MOTION, PLUCKS)


@cache
def swinging() -> tuple[dict[str, RecordingData], Arm]:
    """Return an unloaded ramp with plucks, quick steps without and with weights, and the truth."""
    pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
    made = {
        'unloaded_ramp': plucked(),
        'unloaded_staircase': recording_of('unloaded_staircase', MOTION, {}),
        'dead_weights': recording_of('dead_weights', MOTION, {}),
    }
    truth = true_model(dataclasses.replace(made['dead_weights'].scenario, effects=()))
    return {name: run_of(one) for name, one in made.items()}, truth


def rigidity(arm: Arm) -> np.ndarray:
    """Return EI (N m^2) at the pressures that were recorded under load."""
    return arm.moment_law.sections(np.array([10e3, 30e3, 50e3]), arm.length, arm.weight)[:, :, 1]


def test_what_swings_is_named_by_its_frequency_and_decay():
    runs, truth = swinging()
    found = frames_in_motion(list(runs.values()), truth)
    modes = vibration(truth, solve(truth, 0.5 * truth.pressure_range[1]))
    assert found.hertz == pytest.approx(modes.hertz, rel=0.15)  # it goes with the pressure
    rate = 0.5 * MOTION.damping_time * (2.0 * math.pi * found.hertz) ** 2
    assert 1.0 / found.decay_time == pytest.approx(rate, rel=0.2)
    assert found.frames == sum(len(run.stamp_ns) for run in runs.values())
    assert 0.3 * found.frames < found.count < 0.9 * found.frames
    assert found.sentence.startswith(f'{found.count} of {found.frames} frames')


def test_the_rest_of_it_gives_the_stiffness_and_no_advice():
    runs, truth = swinging()
    unloaded = [runs['unloaded_ramp'], runs['unloaded_staircase']]
    frame = load_model(share_path('config/paper_arm.yaml'))
    frame = dataclasses.replace(frame, target_arclength=truth.target_arclength)
    found = calibrate(unloaded, [runs['dead_weights']], frame, compare=False)
    assert found.joint.converged
    assert rigidity(found.arm) == pytest.approx(rigidity(truth), rel=0.015)
    assert found.motion is not None
    assert found.notes[0] == found.motion.left_out
    assert not any('clock' in note or 'sign' in note for note in found.notes[1:])


def test_recordings_that_only_swing_are_named_and_nothing_else_is():
    runs, truth = swinging()
    staircase = runs['unloaded_staircase']
    moving = frames_in_motion([staircase], truth).moving[0]
    only = staircase.subset(np.flatnonzero(moving))
    with refused(RecordingError, 'in_motion'):
        calibrate([only], [], truth, compare=False)


def test_what_rests_before_its_load_is_there_is_no_loaded_recording():
    runs, truth = swinging()
    dead = runs['dead_weights']
    cut = dataclasses.replace(dead.subset(np.arange(26)), name='cut off while it swings')
    unloaded = [runs['unloaded_ramp'], runs['unloaded_staircase']]
    assert not cut.is_idle(truth.sensors)
    _, loaded, motion = check_runs_at_rest(unloaded, [cut, dead], truth)
    assert motion is not None
    assert [one.name for one in loaded] == [dead.name]
    assert motion.lost == (cut.name,)
    assert f'nothing is left of {cut.name} ({motion.idle} frames' in motion.left_out
    assert 0 < motion.idle < len(cut.stamp_ns)


def test_an_arm_remembers_what_is_left_out():
    """It softened at the high pressures of a recording of which no frame is at rest."""
    runs, truth = swinging()
    staircase = runs['unloaded_staircase']
    moving = frames_in_motion([staircase], truth).moving[0]
    only = dataclasses.replace(staircase.subset(np.flatnonzero(moving)), name='only swings')
    ramp = runs['unloaded_ramp']
    later = only.reading_stamp_ns[-1] + 10**9 - ramp.reading_stamp_ns[0]
    ramp = dataclasses.replace(
        ramp, stamp_ns=ramp.stamp_ns + later, reading_stamp_ns=ramp.reading_stamp_ns + later
    ).subset(np.arange(100))
    arm = dataclasses.replace(truth, effects=(Softening(loss=0.3),))
    (kept,), motion = without_motion(arm, [only, ramp])
    assert [one.name for one in kept] == [ramp.name] and motion.lost == (only.name,)
    known = inputs_of(arm, [only, ramp])[1].subset(np.flatnonzero(~motion.moving[1]))
    left = inputs_of(arm, kept)[0]
    assert np.allclose(left.pressure, known.pressure)
    assert np.allclose(left.histories[0], known.histories[0])
    alone, beside = inputs_of(arm, [ramp])[0], inputs_of(arm, [only, ramp])[1]
    assert not np.allclose(alone.histories[0], beside.histories[0])


def test_check_says_the_same_of_a_load_that_only_swings(tmp_path):
    pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
    scenario = load_scenario(share_path('scenarios/dead_weights.yaml'))
    pull = Corners(
        duration=4.0,
        share=(0.0, 0.4, 0.41, 1.0),
        pressure=(2e4,) * 4,
        force_x=(0.0,) * 4,
        force_y=(0.0, 0.0, 0.2, 0.2),
    )
    rates = dataclasses.replace(scenario.rates, frames=20.0)
    made = simulate(dataclasses.replace(scenario, protocol=pull, motion=MOTION, rates=rates))
    path = tmp_path / 'pulled.mcap'
    write_lab(made, path, overwrite=False, on_progress=lambda: None)
    truth = true_model(dataclasses.replace(made.scenario, effects=()))
    uses = check_recording(path, UseRequest(arm=truth))['uses']
    for use in (uses['calibrate loaded'], uses['diagnose']):
        assert not use['usable']
        assert use['reason'].reason == 'in_motion'


def test_check_says_it_first_and_proposes_a_free_decay(tmp_path):
    pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
    made = plucked()
    path = tmp_path / 'plucked.mcap'
    write_lab(made, path, overwrite=False, on_progress=lambda: None)
    truth = true_model(dataclasses.replace(made.scenario, effects=()))
    found = check_recording(path, UseRequest(arm=truth))
    assert found['in_motion']['count'] > 0
    assert found['in_motion']['hertz'] == pytest.approx(1.2, rel=0.1)
    assert found['uses']['calibrate unloaded']['usable']


@pytest.mark.parametrize(
    'effects',
    [
        {},
        {'pressure_lag': {'time_constant': 0.3}},
        {'creep': {'amplitude': 0.1, 'time_constant': 8.0}},
        {'periodic_disturbance': {'amplitude': 0.05, 'period': 1.3}},
        {'slipping_base': {'slip_x': 0.002, 'slip_y': 0.001}},
        {'push': {'force': 0.03, 'begins': 5.0, 'ends': 9.0, 'every': 12.0, 'ramp': 0.1}},
    ],
)
def test_what_has_no_mass_is_not_in_motion(effects):
    names = ('unloaded_staircase', 'dead_weights', 'random_mix')
    made = [recording_of(name, None, effects, ramp=0.6) for name in names]
    runs, arm = (
        [run_of(one) for one in made],
        true_model(dataclasses.replace(made[0].scenario, effects=())),
    )
    kept, motion = without_motion(arm, runs)
    assert motion is None and all(one is two for one, two in zip(kept[0], runs, strict=True))


def test_without_stamps_nothing_is_in_motion():
    runs, truth = swinging()
    static = [dataclasses.replace(run, static=True) for run in runs.values()]
    assert frames_in_motion(static, truth) is None


def test_mass_cancels_in_how_slowly_an_arm_swings():
    assert slowest_period(0.112) == pytest.approx(2.0 * slowest_period(0.028))
    assert 1.0 / slowest_period(0.112) < 0.5


@pytest.mark.parametrize(('rate', 'tested'), [(15.0, True), (5.0, False)])
def test_a_recording_at_rest_hides_no_swing_in_another(rate, tested):
    runs, truth = swinging()
    scenario = load_scenario(share_path('scenarios/unloaded_ramp.yaml'))
    protocol = dataclasses.replace(scenario.protocol, duration=20.0)
    rates = dataclasses.replace(scenario.rates, frames=rate)
    ramp = run_of(simulate(dataclasses.replace(scenario, protocol=protocol, rates=rates)))
    (alone,) = frames_in_motion([runs['dead_weights']], truth).moving
    found = frames_in_motion([ramp, runs['dead_weights']], truth)
    assert np.mean(found.moving[1] == alone) > 0.99
    assert np.mean(found.moving[0]) < 0.2
    assert found.unchecked[0].all() == (not tested)
    assert ('could not be tested' in found.left_out) == (not tested)


@pytest.mark.parametrize('every', [10, 5])
def test_lost_frames_hide_no_swing(every):
    runs, truth = swinging()
    staircase = runs['unloaded_staircase']
    kept = np.flatnonzero(np.arange(len(staircase.stamp_ns)) % every)
    (moving,) = frames_in_motion([staircase], truth).moving
    found = frames_in_motion([staircase.subset(kept)], truth)
    assert np.mean(found.moving[0] == moving[kept]) > 0.97
    assert found.unchecked_count < 0.02 * kept.size


def test_rounded_targets_are_not_in_motion():
    """At rest they repeat: without rounding in their noise, no frame is at rest."""
    scenario = load_scenario(share_path('scenarios/unloaded_ramp.yaml')).with_effects(PLUCKS)
    noise = dataclasses.replace(scenario.noise, target_std=2e-5, drift_std=0.0)
    run = run_of(simulate(dataclasses.replace(scenario, noise=noise, motion=MOTION)))
    rounded = dataclasses.replace(run, x=np.round(run.x, 4), y=np.round(run.y, 4))
    arm = swinging()[1]
    exact, coarse = (frames_in_motion([one], arm).count for one in (run, rounded))
    assert 0.8 * exact < coarse < 1.1 * exact < 0.9 * len(run.stamp_ns)


def test_a_recording_with_one_reading_is_not_tested():
    runs, truth = swinging()
    staircase = runs['unloaded_staircase']
    few = staircase.subset(np.arange(20))
    one = dataclasses.replace(
        few,
        reading_stamp_ns=few.reading_stamp_ns[:1],
        pressure=few.pressure[:1],
        reading=np.zeros(20, np.int64),
    )
    found = frames_in_motion([staircase, one], truth)
    assert found.unchecked[1].all() and not found.moving[1].any()
