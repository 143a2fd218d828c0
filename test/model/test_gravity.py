"""The arm's own weight in the plane of bending, and that of a mass at its tip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, save_model, solve, solve_many
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects.gravity import Gravity as LineLoad
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from scipy.integrate import solve_bvp
from support.example_arms import heavy, LENGTH, paper_arm, TIP_MASS, WIDE
from support.refusals import refused

WEIGHT = 0.17  # N


def straight(stiffness: float, direction: object) -> Arm:
    """Return a straight arm of one stiffness (N m^2)."""
    rest = IntrinsicCurvature(
        pressure=[0.0, 6e4], arclength=[0.0, 0.5, 1.0], curvature=[[0.0] * 3] * 2
    )
    return heavy(
        direction,
        moment_law=LinearLaw(bending_stiffness=stiffness),
        intrinsic_curvature=rest,
        covariance=None,
        domain=None,
    )


def test_a_stiff_cantilever_sags_as_euler_and_bernoulli_say():
    stiffness = 1.0
    shape = solve(straight(stiffness, [0.0, -1.0]), pressure=0.0)
    line, tip = WEIGHT / LENGTH, TIP_MASS * STANDARD_GRAVITY
    sag = line * LENGTH**4 / (8.0 * stiffness) + tip * LENGTH**3 / (3.0 * stiffness)
    assert shape.tip[1] == pytest.approx(-sag, rel=1e-6)


@pytest.mark.parametrize('direction', [[0.0, -1.0], [0.6, -0.8], [-0.2, 0.9]])
def test_a_soft_one_is_the_heavy_elastica(direction):
    stiffness = 4e-4
    shape = solve(straight(stiffness, direction), pressure=0.0)
    assert shape.converged
    line, tip = WEIGHT / LENGTH, TIP_MASS * STANDARD_GRAVITY
    gx, gy = direction

    def slopes(s, y):
        below = line * (LENGTH - s) + tip
        across = below * (gy * np.cos(y[0]) - gx * np.sin(y[0]))
        return np.stack([y[1], -across / stiffness, np.cos(y[0]), np.sin(y[0])])

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, LENGTH, shape.arclength.size)
    guess = np.stack([shape.theta, np.gradient(shape.theta, s), shape.x, shape.y])
    truth = solve_bvp(slopes, ends, s, 0.98 * guess, tol=1e-9, max_nodes=20000)
    assert truth.success
    at = truth.sol(s)
    assert np.abs(np.stack([shape.x, shape.y]) - at[2:]).max() < 1e-8
    assert shape.theta == pytest.approx(at[0], abs=1e-6)


def test_weight_out_of_the_plane_changes_no_bit():
    plain = paper_arm()
    beside = heavy('out_of_plane')
    for pressure, force in ((0.0, (0.0, 0.0)), (31e3, (0.175, 0.07))):
        one, other = solve(plain, pressure, force), solve(beside, pressure, force)
        assert np.array_equal(one.x, other.x) and np.array_equal(one.moment, other.moment)


def test_the_weight_acts_as_the_effect_of_that_line_load_does():
    arm = heavy([0.0, -1.0], tip_mass=0.0)
    effect = paper_arm((LineLoad(weight_y=-WEIGHT / LENGTH),))
    one, other = solve(arm, 31e3, (0.1, 0.05)), solve(effect, 31e3, (0.1, 0.05))
    assert np.array_equal(one.x, other.x) and np.array_equal(one.theta, other.theta)


@pytest.mark.parametrize('effects', [(), (LoadOffset(offset=0.004),)])
def test_a_mass_at_the_tip_acts_as_its_weight_in_the_end_load_does(effects):
    weight = TIP_MASS * STANDARD_GRAVITY
    one = solve(heavy([0.0, -1.0], effects=effects), 31e3, (0.1, 0.05))
    light = heavy([0.0, -1.0], tip_mass=0.0, effects=effects)
    other = solve(light, 31e3, (0.1, 0.05 - weight))
    assert one.x == pytest.approx(other.x, abs=1e-12)
    assert one.force == (0.1, 0.05)  # what the surroundings apply


def test_many_at_once_and_all_frames_of_a_recording_are_the_same():
    arm = heavy([0.6, -0.8])
    start = solve(arm, 30e3)
    pressures = np.array([28e3, 31e3])
    many = solve_many(arm, pressures, np.zeros((2, 2)), start=start)
    frames = ForwardModel(arm.target_arclength)
    assert frames.solve(arm, Inputs(pressure=pressures, loads=np.zeros((2, 3)))).all()
    for index, pressure in enumerate(pressures.tolist()):
        alone = solve(arm, pressure)
        assert many.x[index] == pytest.approx(alone.x, abs=1e-9)
        targets = np.interp(arm.target_arclength, alone.arclength, alone.x)
        assert frames.points[index, 0] == pytest.approx(targets, abs=2e-5)


def estimate(arm: Arm, pressure: float = 31e3) -> ShapeEstimate:
    """Return what the estimator says of an arm without a wrench."""
    settings = EstimatorSettings(wrench_required=False)
    reading = PressureReading(stamp_ns=1, pressure=pressure)
    _, outcome = Estimator(arm=arm, settings=settings).step(EstimatorState(), reading)
    assert isinstance(outcome, ShapeEstimate)
    return outcome


def test_the_jacobian_is_that_of_differences():
    arm = heavy([0.6, -0.8], domain=WIDE)
    found, step = estimate(arm), 1.0
    sides = [np.array(solve(arm, 31e3 + sign * step).tip) for sign in (-1.0, 1.0)]
    assert found.jacobian[:, 0] == pytest.approx((sides[1] - sides[0]) / (2 * step), rel=1e-5)
    for axis, force in enumerate(((1e-5, 0.0), (0.0, 1e-5))):
        sides = [
            np.array(solve(arm, 31e3, (sign * force[0], sign * force[1])).tip)
            for sign in (-1.0, 1.0)
        ]
        slope = (sides[1] - sides[0]) / 2e-5
        assert found.jacobian[:, 1 + axis] == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(
    ('name', 'std'), [('motion.tip_mass', 1e-4), ('gravity.x', 1e-3), ('arm.weight', 1e-3)]
)
def test_errors_of_weight_and_direction_reach_the_covariance(name, std):
    arm = heavy([0.6, -0.7], domain=WIDE)
    arm = replace(arm, sensors=replace(arm.sensors, pressure_std=1e-6))
    uncertain = replace(arm, covariance=ModelCovariance(quantities=(name,), factor=[[std]]))
    sides = [np.array(solve(arm.with_changes({name: sign * std}), 31e3).tip) for sign in (-1, 1)]
    moved = 0.5 * (sides[1] - sides[0])
    linear = estimate(uncertain).tip_covariance
    assert np.sqrt(np.diag(linear)) == pytest.approx(np.abs(moved), rel=0.02)


def test_a_model_file_keeps_weight_and_direction(tmp_path):
    arm = heavy([0.0, -1.0], covariance=None)
    save_model(arm, tmp_path / 'arm.yaml')
    read = load_model(tmp_path / 'arm.yaml')
    assert (read.gravity, read.motion) == (arm.gravity, arm.motion)
    assert np.array_equal(solve(read, 31e3).x, solve(arm, 31e3).x)


@pytest.mark.parametrize(
    'direction',
    ['0, down', 'nan', [0.0, -9.81], [0.0], [float('nan'), 1.0], [True, 0.0], 1.0, {'x': 1}],
)
def test_what_is_no_direction_is_refused(direction):
    with refused(ModelError, 'no_direction'):
        gravity_of(direction)


def test_a_direction_may_be_written_as_text():
    assert gravity_of('[0.6, -0.8]') == gravity_of((0.6, -0.8)) == gravity_of('0.6 -0.8')
    assert gravity_of('out_of_plane').direction == 'out_of_plane'
    assert gravity_of('imu').direction == 'imu'
    assert gravity_of('/world').source == 'world'
