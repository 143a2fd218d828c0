"""A rigid cap beyond the soft end: shapes, Jacobians, targets, by shooting and the lab."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, save_model, solve, solve_many
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import tip_jacobian
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
import pytest
from support.cantilever import Cantilever
from support.example_arms import paper_arm
from support.lab_run import true_model
from support.refusals import refused

TRUTH = Cantilever(
    length=0.1, stiffness=2e-4, curvature=6.0, weight=0.3, axial_stiffness=40.0, cap=0.02
)
FORCE, MOMENT = (0.05, 0.08), 1e-3


def capped(truth: Cantilever = TRUTH) -> Arm:
    """Return the model of a cantilever, two targets on its cap."""
    row = [truth.curvature] * 3
    return replace(
        paper_arm((Gravity(weight_y=-truth.weight), Extensibility(axial_stiffness=40.0))),
        length=truth.length,
        tip_cap=truth.cap,
        target_arclength=np.array([0.0, 0.05, 0.1, 0.11, 0.12]),
        moment_law=LinearLaw(bending_stiffness=truth.stiffness),
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, 6e4], arclength=[0.0, 0.5, 1.0], curvature=[row, row]
        ),
        covariance=None,
        domain=None,
    )


def test_the_load_acts_at_the_end_of_the_cap():
    shape = solve(capped(), pressure=3e4, force=FORCE, moment=MOMENT)
    assert shape.converged
    assert shape.arclength[-1] == pytest.approx(0.12)
    wanted = TRUTH.shape(FORCE, MOMENT, shape.arclength)
    assert np.stack([shape.x, shape.y, shape.theta]) == pytest.approx(wanted, abs=1e-9)
    cap = shape.arclength > 0.1
    assert np.abs(shape.curvature[cap]).max() < 1e-6
    assert not shape.intrinsic_curvature[cap].any()
    bare = replace(capped(), tip_cap=0.0, target_arclength=np.zeros(0))
    without = solve(bare, pressure=3e4, force=FORCE, moment=MOMENT)
    assert abs(shape.y[-1] - without.y[-1]) > 5e-3


def test_many_at_once_are_the_same():
    arm = capped()
    start = solve(arm, pressure=3e4, force=FORCE, moment=MOMENT)
    shapes = solve_many(arm, [3e4, 3e4], [FORCE, (0.02, 0.05)], [MOMENT, 0.0], start=start)
    assert shapes.x[0] == pytest.approx(start.x, abs=1e-10)
    assert shapes.y[1, -1] == pytest.approx(TRUTH.shape((0.02, 0.05))[1, 0], abs=1e-9)


def test_the_jacobian_is_that_of_the_tip_of_the_cap():
    arm = capped()
    found = tip_jacobian(arm, solve(arm, pressure=3e4, force=FORCE, moment=MOMENT))
    for column, step in ((1, (1e-4, 0.0, 0.0)), (2, (0.0, 1e-4, 0.0)), (3, (0.0, 0.0, 1e-6))):
        sides = [
            TRUTH.shape((FORCE[0] + s * step[0], FORCE[1] + s * step[1]), MOMENT + s * step[2])
            for s in (-1.0, 1.0)
        ]
        wanted = (sides[1] - sides[0])[:, 0] / (2.0 * max(step))
        assert found[:, column] == pytest.approx(wanted, rel=1e-5, abs=1e-6)


def test_targets_on_the_cap_lie_on_its_straight_line():
    arm, model = capped(), ForwardModel(capped().target_arclength)
    inputs = Inputs(pressure=np.array([3e4]), loads=np.array([[*FORCE, MOMENT]]))
    assert model.solve(arm, inputs).all()
    wanted = TRUTH.shape(FORCE, MOMENT, arm.target_arclength)
    assert model.points[0] == pytest.approx(wanted[:2], abs=1e-9)


def test_without_a_cap_nothing_changes_and_with_one_the_file_says_so(tmp_path):
    plain = paper_arm()
    assert plain.reach == plain.length
    assert plain.on_knots(plain.table.rotation) is plain.table.rotation
    arm = capped()
    save_model(arm, tmp_path / 'arm.yaml')
    assert load_model(tmp_path / 'arm.yaml').tip_cap == 0.02
    assert arm.with_changes({'arm.tip_cap': 0.01}).reach == pytest.approx(0.13)
    with refused(ModelError, 'not_increasing'):
        replace(arm, target_arclength=np.array([0.0, 0.13]))
    with refused(ModelError, 'out_of_bounds'):
        replace(arm, tip_cap=-0.01)


def test_an_effect_with_a_memory_takes_the_cap_along():
    arm = replace(
        paper_arm((Creep(amplitude=0.2, time_constant=5.0),)), tip_cap=0.01, covariance=None
    )
    rested = arm.rods(np.array([3e4]), arm.initial_history(3e4))
    assert rested.rotation == pytest.approx(arm.rods(np.array([3e4])).rotation, rel=1e-12)


def test_the_lab_makes_such_an_arm():
    scenario = load_scenario(share_path('scenarios/dead_weights.yaml'))
    targets = np.append(scenario.arm.targets, scenario.arm.length + 0.01)
    arm = replace(scenario.arm, tip_cap=0.012, targets=targets)
    scenario = replace(scenario, arm=arm, rates=replace(scenario.rates, frames=0.5))
    truth, model = simulate(scenario).truth, true_model(scenario)
    frames = np.arange(0, truth.time.size, 6)
    for frame in frames.tolist():
        shape = solve(model, float(truth.pressure[frame]), tuple(truth.force[frame].tolist()))
        found = np.array([shape.x[-1], shape.y[-1], shape.theta[-1]])
        wanted = [truth.x[frame, -1], truth.y[frame, -1], truth.theta[frame, -1]]
        assert found == pytest.approx(wanted, abs=1e-4)
    assert truth.arclength[-1] == pytest.approx(arm.reach)
    assert np.abs(truth.force).max() > 0.01
