"""Mass and damping from recordings of a lab arm that MuJoCo moves."""

from __future__ import annotations

import dataclasses
from functools import cache
import math

import numpy as np
from pneunet_ros.calibration.motion.motion_fit import (
    fit_motion,
    MotionFit,
    predicted_motion,
    standard_errors,
    without_swing,
)
from pneunet_ros.calibration.motion.motion_problem import DIFFERENCE_STEP, MotionProblem
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.fit.hypothesis import hypothesis
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.sensors import LabNoise, Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
import scipy
from support.lab_run import run_of, true_model
from support.refusals import refused

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")

TIP_MASS, DAMPING_TIME = 0.003, 0.03
LAB_NOISES = [field.name for field in dataclasses.fields(LabNoise)]


def swinging(pressure: tuple[float, ...], share: tuple[float, ...], **changes: object):
    """Return a scenario of 4 s in which the pressure goes through corners."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    nothing = (0.0,) * len(share)
    protocol = Corners(
        duration=4.0, share=share, pressure=pressure, force_x=nothing, force_y=nothing
    )
    return dataclasses.replace(
        scenario,
        protocol=protocol,
        rates=Rates(pressure=60.0, wrench=60.0, frames=20.0),
        motion=LabMotion(damping_time=DAMPING_TIME, tip_mass=TIP_MASS),
        **changes,
    )


STEPS = (20e3, 20e3, 45e3, 45e3, 15e3, 15e3), (0.0, 0.1, 0.13, 0.5, 0.53, 1.0)


@cache
def fitted() -> tuple[MotionFit, object]:
    """Return the fit to quick steps, and the model of the arm without motion."""
    scenario = swinging(*STEPS)
    arm = true_model(scenario)
    return fit_motion(arm, [run_of(simulate(scenario)).without_load()]), arm


def test_steps_of_pressure_give_mass_and_damping():
    fit, _ = fitted()
    assert fit.motion.tip_mass == pytest.approx(TIP_MASS, rel=0.03)
    assert fit.motion.damping_time == pytest.approx(DAMPING_TIME, rel=0.03)
    assert abs(fit.motion.tip_mass - TIP_MASS) < 3.0 * fit.tip_mass_std
    assert abs(fit.motion.damping_time - DAMPING_TIME) < 3.0 * fit.damping_time_std
    assert fit.motion.mass_error < 0.05
    assert fit.motion.damping_error < 0.05
    assert fit.moving_rms < 0.1 * fit.still_rms
    assert 0.5 * fit.frames < fit.in_motion < fit.frames


def test_what_else_is_not_known_exactly_is_fitted_beside_mass_and_damping():
    """A camera that is 50 ms late instead of 30 takes a tenth of the damping with it."""
    scenario = swinging(*STEPS).with_effects({'camera_delay': {'delay': 0.03}})
    bare = dataclasses.replace(true_model(scenario), effects=())
    run, known = run_of(simulate(scenario)).without_load(), hypothesis(CameraDelay, bare.size)
    arm, nearby = (
        dataclasses.replace(bare, effects=(CameraDelay(delay=0.05 + step * known.std[0]),))
        for step in (0.0, DIFFERENCE_STEP)
    )
    alone, beside = (
        fit_motion(arm, [run], start_motion=fitted()[0].motion, perturbed_arms=arms)
        for arms in ((), (nearby,))
    )
    assert alone.motion.damping_time < 0.93 * DAMPING_TIME
    assert beside.motion.damping_time == pytest.approx(DAMPING_TIME, rel=0.04)
    assert 0.05 + beside.shares[0] * known.std[0] == pytest.approx(0.03, abs=2e-3)


def test_on_a_slow_ramp_painted_targets_and_camera_do_not_pass_for_damping():
    """With targets taken to be where the arm file has them, the damping is 63 ms."""
    scenario = dataclasses.replace(
        swinging((5e3, 40e3), (0.0, 1.0)), seed=4, motion=LabMotion(damping_time=DAMPING_TIME)
    )
    protocol = dataclasses.replace(scenario.protocol, duration=20.0)
    scenario = dataclasses.replace(scenario, protocol=protocol)
    run, arm = run_of(simulate(scenario)).without_load(), true_model(scenario)
    fit = fit_motion(arm, [run], trusted_error=0.4)
    assert fit.damping_time_std < 1e-3
    assert abs(fit.motion.damping_time - DAMPING_TIME) < 3.0 * fit.damping_time_std


@pytest.mark.parametrize('until', [0.8, 1.0])
def test_an_arm_that_is_plucked_gives_them_from_its_decay(until):
    """Though it swings about the push more than behind it, so that frames of it are taken."""
    pushed = {'push': {'force': 0.02, 'place': 0.9, 'begins': 0.2, 'ends': until, 'every': 100.0}}
    scenario = swinging((20e3, 20e3), (0.0, 1.0)).with_effects(pushed)
    arm = true_model(dataclasses.replace(scenario, effects=()))
    run = run_of(simulate(scenario)).without_load()
    fit = fit_motion(arm, [run])
    assert fit.motion.tip_mass == pytest.approx(TIP_MASS, rel=0.02)
    assert fit.motion.damping_time == pytest.approx(DAMPING_TIME, rel=0.02)
    assert abs(fit.motion.damping_time - DAMPING_TIME) < 3.0 * fit.damping_time_std
    assert fit.moving_rms < 2.0 * math.sqrt(2.0) * arm.sensors.target_std
    _, (left,), _, _ = predicted_motion(arm, fit.motion, [run])
    assert np.sqrt(np.nanmean(left**2)) < 2.0 * arm.sensors.target_std


def test_a_swing_is_hardly_that_of_the_noise_of_the_readings():
    """That of the readings themselves, of a force sensor with 1 mN, is 1.1 mm beside the true."""
    swings = []
    for noise in (LabNoise(), LabNoise(**dict.fromkeys(LAB_NOISES, 0.0))):
        scenario = swinging((20e3, 20e3, 30e3, 30e3), (0.0, 0.3, 0.8, 1.0), noise=noise)
        protocol = dataclasses.replace(
            scenario.protocol, duration=8.0, force_y=(0.0, 0.01, 0.01, 0.02)
        )
        scenario = dataclasses.replace(scenario, protocol=protocol)
        run, arm = run_of(simulate(scenario)), true_model(scenario)
        motion = Motion(tip_mass=TIP_MASS, damping_time=DAMPING_TIME)
        swings.append(run.points - without_swing(arm, motion, [run])[0].points)
    assert np.sqrt(np.nanmean((swings[0] - swings[1]) ** 2)) < 2e-4


def heavier(times):
    """Return the arm of `fitted` as if it weighed so many times as much."""
    _, arm = fitted()
    law = arm.moment_law
    law = dataclasses.replace(
        law, rigidity=law.rigidity / times, moment_offset=law.moment_offset / times
    )
    return dataclasses.replace(arm, weight=times * arm.weight, moment_law=law)


def test_a_weight_that_is_too_large_is_named():
    run = run_of(simulate(swinging(*STEPS))).without_load()
    with refused(RequestError, 'wrong_weight'):
        fit_motion(heavier(3.0), [run], trusted_error=0.3)
    with refused(RequestError, 'wrong_weight'):
        fit_motion(heavier(2.0), [run])
    assert 0.0 <= fit_motion(heavier(2.0), [run], trusted_error=0.3).motion.tip_mass < 1e-4


def linear_problem(frames: int):
    """Return a problem of one target, ten frames per second, and an arm of 1 Hz."""

    class Run:
        stamp_ns = np.arange(frames) * 10**8
        reading = np.arange(frames)

    class Problem:
        runs, std = (Run(),), 1.0
        modes = type('Modes', (), {'frequency': np.array([2.0 * np.pi])})
        nuisance, covariance = None, None
        whitened = MotionProblem.whitened
        without_nuisance = MotionProblem.without_nuisance
        period = MotionProblem.period

    return Problem()


def test_errors_count_a_period_as_one_observation():
    jacobian = np.ones((80, 1))
    alike = np.repeat([1.0, -1.0, 1.0, -1.0], 20).reshape(40, 2, 1)
    apart = np.tile([1.0, -1.0], 40).reshape(40, 2, 1)
    longer = np.repeat([1.0, -1.0], 40).reshape(40, 2, 1)

    def error(residuals, mass):
        return standard_errors(linear_problem(40), jacobian, [residuals], mass)[0]

    assert error(alike, 0.0) == pytest.approx(0.5 * 2.0**0.25, rel=1e-9)
    assert error(apart, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert error(longer, 3.0) == pytest.approx(2.0**-0.5 * 2.0**0.25, rel=1e-9)
    assert error(alike, 3.0) == pytest.approx(0.0, abs=1e-12)


def test_errors_are_those_of_the_loss_of_the_search():
    """With the residuals as they are, they are 19 % too small for white noise."""
    random, sine = np.random.default_rng(1), np.sin(np.arange(800.0))
    found, stated = [], []
    for noise in random.standard_normal((200, 800)):
        fit = scipy.optimize.least_squares(
            lambda slope, noise=noise: noise - slope * sine, [0.0], loss='soft_l1'
        )
        residuals = [(noise - fit.x * sine).reshape(400, 2, 1)]
        found.append(fit.x[0])
        stated.append(standard_errors(linear_problem(400), fit.jac, residuals, 0.0)[0])
    assert np.mean(stated) == pytest.approx(np.std(found), rel=0.1)


def test_an_arm_may_rest_before_it_swings():
    """The first thousand readings, which were scanned, show a mass only if the arm moves."""
    scenario = swinging(STEPS[0], (0.0, 0.75, 0.7575, 0.875, 0.8825, 1.0))
    scenario = dataclasses.replace(
        scenario,
        protocol=dataclasses.replace(scenario.protocol, duration=16.0),
        rates=Rates(pressure=100.0, wrench=60.0, frames=20.0),
        motion=LabMotion(damping_time=DAMPING_TIME, tip_mass=4.0 * TIP_MASS),
    )
    fit = fit_motion(true_model(scenario), [run_of(simulate(scenario)).without_load()])
    assert fit.motion.tip_mass == pytest.approx(4.0 * TIP_MASS, rel=0.02)
    assert fit.motion.damping_time == pytest.approx(DAMPING_TIME, rel=0.03)


def test_a_late_camera_speaks_against_the_fit():
    scenario = swinging(*STEPS).with_effects({'camera_delay': {'delay': 0.025}})
    arm = dataclasses.replace(true_model(scenario), effects=())
    fit = fit_motion(arm, [run_of(simulate(scenario)).without_load()])
    assert fit.objection and fit.described == f'{fit.sentence}; but {fit.objection}'
    moving = fit.apply_to(arm)
    assert moving.sources['motion'] == fit.described
    right, _ = fitted()
    assert not right.objection and right.described == right.sentence


def test_an_arm_without_mass_whose_camera_is_late_has_no_wrong_weight():
    scenario = swinging(*STEPS).with_effects({'camera_delay': {'delay': 0.1}})
    scenario = dataclasses.replace(scenario, motion=None)
    arm = dataclasses.replace(true_model(scenario), effects=())
    with refused(RequestError, 'not_in_motion'):
        fit_motion(arm, [run_of(simulate(scenario)).without_load()])


@pytest.mark.parametrize('moved', [0.0, 5e-3])
def test_an_arm_at_rest_gives_no_motion(moved):
    """Even if its last frame is elsewhere."""
    scenario = dataclasses.replace(swinging((20e3, 20e3), (0.0, 1.0)), motion=None)
    arm, run = true_model(scenario), run_of(simulate(scenario)).without_load()
    y = run.y.copy()
    y[-1] += moved * (arm.target_arclength / arm.length) ** 2
    with refused(RequestError, 'not_in_motion'):
        fit_motion(arm, [dataclasses.replace(run, y=y)])


@pytest.mark.parametrize(
    ('pressure', 'share', 'effects'),
    [
        (*STEPS, {}),
        (
            (20e3, 20e3),
            (0.0, 1.0),
            {'push': {'force': 0.02, 'place': 0.9, 'begins': 0.2, 'ends': 0.8, 'every': 100.0}},
        ),
    ],
)
def test_the_error_of_the_mass_includes_that_of_the_stiffness(pressure, share, effects):
    scenario = swinging(pressure, share).with_effects(effects)
    arm = true_model(dataclasses.replace(scenario, effects=()))
    law = arm.moment_law
    names = [f'moment_law.rigidity.{row}.{part}' for row, part in np.ndindex(law.rigidity.shape)]
    factor = 0.05 * law.rigidity.reshape(-1, 1)
    stiff = dataclasses.replace(
        arm,
        moment_law=dataclasses.replace(law, rigidity=1.05 * law.rigidity),
        covariance=ModelCovariance(quantities=tuple(names), factor=factor),
    )
    fit = fit_motion(stiff, [run_of(simulate(scenario)).without_load()])
    assert fit.motion.tip_mass > 1.1 * TIP_MASS
    assert fit.motion.tip_mass - TIP_MASS == pytest.approx(fit.tip_mass_std, rel=0.05)
    assert fit.damping_time_std < 0.02 * DAMPING_TIME
    assert fit.motion.mass_error < 0.01
