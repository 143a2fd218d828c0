"""The measured pose of the tip: a target at the tip, and a heading with a sigma of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.map_estimation import Posterior
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.core.errors import RequestError
from pneunet_ros.measurement.tip_pose import heading_residual, with_tip_target
import pytest
from support.refusals import refused
from test_beam import bench, NOISE, recorded, STRIP, WEIGHTS

HEADING = 0.01  # rad
SENSORS = replace(NOISE, heading_std=HEADING)


def posed(places=(0.0, 0.15), seed: int = 0, *, position: bool = True, turn: float = 0.0):
    """Return a recording of targets at these places, and of the pose of the tip."""
    run = recorded(places=places, seed=seed)
    random = np.random.default_rng([seed, 1])
    pose = np.array([STRIP.shape((0.0, force))[:, 0] for force in WEIGHTS])
    pose += random.normal(0.0, [NOISE.target_std, NOISE.target_std, HEADING], pose.shape)
    pose[:, 2] += turn
    if not position:
        pose[:, :2] = np.nan
    return replace(run, tip_pose=pose)


def frame(places=(0.0, 0.15)):
    return replace(bench(places=places), sensors=SENSORS)


def stiffness_of(found) -> tuple[float, float]:
    return found.arm.moment_law.bending_stiffness, float(np.sqrt(found.joint.covariance[-1, -1]))


def test_its_position_is_a_target_and_its_heading_a_number_more():
    found = calibrate([], [posed()], frame())
    assert found.joint.converged
    value, std = stiffness_of(found)
    assert value == pytest.approx(STRIP.stiffness, abs=4.0 * std)
    assert found.arm.target_arclength.tolist() == [0.0, 0.15]  # the dots that are painted
    assert found.joint.dof == 4 * (2 * 3 + 1)
    assert found.joint.chi_squared / found.joint.dof < 2.0
    without = calibrate([], [posed().without_tip_pose()], frame())
    assert std < 0.5 * stiffness_of(without)[1]


def test_a_heading_alone_is_worth_something():
    clamp_and_tip = (0.0, 0.3)
    found = calibrate([], [posed(clamp_and_tip, position=False)], frame(clamp_and_tip))
    without = calibrate([], [recorded(places=clamp_and_tip)], frame(clamp_and_tip))
    assert found.joint.parameters.shapes == without.joint.parameters.shapes + 1
    assert found.joint.dof == without.joint.dof + 4
    assert stiffness_of(found)[0] == pytest.approx(STRIP.stiffness, rel=0.03)


def test_a_whole_turn_is_no_turn():
    one, other = (calibrate([], [posed(turn=turn)], frame()) for turn in (0.0, 2.0 * np.pi))
    assert stiffness_of(one)[0] == pytest.approx(stiffness_of(other)[0], rel=1e-9)
    assert heading_residual(np.array([3.1, np.nan]), np.array([-3.1, 0.0]))[0] == pytest.approx(
        6.2 - 2.0 * np.pi
    )


def test_the_pose_alone_is_enough():
    run = posed()
    run = replace(run, x=np.full_like(run.x, np.nan), y=np.full_like(run.y, np.nan))
    found = calibrate([], [run], frame())
    assert stiffness_of(found)[0] == pytest.approx(STRIP.stiffness, rel=0.03)


def test_without_a_sigma_one_is_assumed_and_said():
    found = calibrate([], [posed()], replace(frame(), sensors=NOISE))
    assert found.arm.sensors.heading_std == 0.02
    assert found.noise.sources['heading_std'].startswith('assumed')


def test_a_target_at_the_tip_is_seen_where_it_was_seen():
    run = posed((0.0, 0.3))
    x, y = np.array(run.x), np.array(run.y)
    x[1, 1] = y[1, 1] = np.nan
    arm, (joined,) = with_tip_target(frame((0.0, 0.3)), [replace(run, x=x, y=y)])
    assert arm.target_arclength.tolist() == [0.0, 0.3]
    assert joined.x[0, 1] == x[0, 1]
    assert joined.x[1, 1] == run.tip_pose[1, 0]


def test_the_gradient_is_that_of_the_cost():
    arm, runs = with_tip_target(frame(), [posed()])
    some = Parameters(
        frame=arm,
        pressure=np.array([0.0]),
        arclength=np.linspace(0.0, 1.0, 4),
        hyperparameters=Hyperparameters(amplitude=10.0, std=2.0, length_scale=0.3),
        law=None,
    )
    arm = replace(arm, moment_law=replace(arm.moment_law, bending_stiffness=0.02))
    posterior = Posterior(replace(some, frame=arm), runs, SENSORS, arm.target_arclength)
    random = np.random.default_rng(3)
    scaled = np.zeros(posterior.prior.mean.size)
    scaled[:4] = 0.1 * random.standard_normal(4)
    here = posterior.linearize(scaled)
    for _ in range(3):
        step = np.zeros(scaled.size)
        step[:4] = 1e-4 * random.standard_normal(4)
        sides = [posterior.cost(scaled + s * step, here) for s in (-1.0, 1.0)]
        assert (scaled - here.gradient) @ step == pytest.approx(
            0.5 * (sides[1] - sides[0]), rel=2e-3
        )


def test_a_calibration_goes_on_with_the_same_targets():
    first = calibrate([], [posed()], frame())
    later = calibrate([], [posed(seed=4)], frame(), earlier=first.posterior)
    assert stiffness_of(later)[1] < stiffness_of(first)[1]
    bare = calibrate([], [recorded(places=(0.0, 0.15))], frame())
    with refused(RequestError, 'wrong_targets'):
        calibrate([], [posed()], frame(), earlier=bare.posterior)
