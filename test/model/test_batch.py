"""Many rods at once give what each gives alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.batch import solve_many
from pneunet_ros.model.equilibrium import solve_rod
from pneunet_ros.solver.columns import FIELDS
import pytest
from support.refusals import refused

ARM = load_model(share_path('config/paper_arm.yaml'))
MECHANICS = (
    EFFECTS['extensibility'](axial_stiffness=40.0),
    EFFECTS['gravity'](weight_y=-1.0),
    EFFECTS['clamp_compliance'](compliance=5.0),
    EFFECTS['load_offset'](offset=0.003),
)


def loads(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    force = np.array([0.175, 0.07]) * random.uniform(0.9, 1.1, (count, 2))
    return random.uniform(29e3, 33e3, count), force, random.uniform(-1e-4, 1e-4, count)


@pytest.mark.parametrize('effects', [(), MECHANICS], ids=['bare', 'mechanics'])
def test_each_rod_is_the_one_solved_alone(effects) -> None:
    arm = replace(ARM, effects=effects)
    pressure, force, moment = loads(70)
    shapes = solve_many(
        arm, pressure, force, moment, start=solve(arm, 31e3, (0.175, 0.07)), stations=23
    )
    assert shapes.converged.all()
    assert shapes.residual.max() < 1e-6
    for which in range(pressure.size):
        alone = solve(
            arm, pressure[which], (force[which, 0], force[which, 1]), moment[which], stations=23
        )
        for name in FIELDS:
            np.testing.assert_allclose(
                getattr(shapes, name)[which],
                getattr(alone, name),
                rtol=0.0,
                atol=1e-5,  # of the curvature, on another mesh
                err_msg=name,
            )
        np.testing.assert_allclose(shapes.x[which], alone.x, rtol=0.0, atol=1e-8)


def test_a_cubic_law_is_solved_rod_by_rod() -> None:
    arm = replace(ARM, effects=(EFFECTS['stiffening'](coefficient=1e-4),))
    start = solve(arm, 31e3, (0.175, 0.07))
    shapes = solve_many(arm, [30e3, 32e3], [[0.17, 0.07], [0.18, 0.06]], start=start)
    alone = solve(arm, 32e3, (0.18, 0.06))
    assert shapes.converged.all()
    np.testing.assert_allclose(shapes.y[1], alone.y, rtol=0.0, atol=1e-9)


def test_rods_with_a_past_are_those_solved_alone() -> None:
    effects = (EFFECTS['creep'](amplitude=0.2, time_constant=5.0), EFFECTS['softening'](loss=0.3))
    arm = replace(ARM, effects=effects)
    history, histories = arm.initial_history(20e3), []
    pressures = np.array([31e3, 34e3, 31e3])
    for pressure in pressures:
        history, _ = arm.actuate(history, 2.0, float(pressure))
        histories.append(history)
    past = tuple(np.array(item) for item in zip(*histories, strict=True))
    start = solve(arm, 31e3, (0.175, 0.07))
    shapes = solve_many(arm, pressures, [[0.175, 0.07]] * 3, start=start, history=past)
    assert shapes.converged.all()
    for which, pressure in enumerate(pressures):
        rods = arm.rods(np.array([pressure]), histories[which])
        load = Load(pressure=pressure, force_x=0.175, force_y=0.07)
        alone = solve_rod(arm, rods, load, None, shapes.arclength)
        np.testing.assert_allclose(shapes.y[which], alone.y, rtol=0.0, atol=1e-8)
    assert abs(shapes.y[0, -1] - shapes.y[2, -1]) > 5e-5  # the same load, another past


def test_a_rod_far_from_the_start_is_solved_or_says_so() -> None:
    start = solve(ARM, 31e3, (0.175, 0.07))
    shapes = solve_many(
        ARM, [31e3, 90e3, 60e3], [[0.175, 0.07], [0.1, 0.0], [-0.02, 0.2]], start=start
    )
    assert shapes.converged.tolist() == [True, False, True]
    assert np.isnan(shapes.x[1]).all()
    assert np.isfinite(shapes.x[2]).all()


def test_a_rod_pushed_past_buckling_is_the_one_that_stays_bent() -> None:
    """Newton's method follows the arm that is pressed straight, which no arm does."""
    shapes = solve_many(ARM, [500.0], [[-0.03, 0.0]], start=solve(ARM, 500.0))
    alone = solve(ARM, 500.0, (-0.03, 0.0))
    assert alone.stable
    np.testing.assert_allclose((shapes.x[0, -1], shapes.y[0, -1]), alone.tip[:2], atol=1e-7)


@pytest.mark.parametrize('force, moment', [(1e12, 0.0), (1e20, 0.0), (0.1, 1e30), (0.1, 1e300)])
def test_a_load_beyond_all_numbers_has_no_shape(force, moment) -> None:
    start = solve(ARM, pressure=30e3)
    alone = solve(ARM, pressure=50e3, force=(force, 0.04), moment=moment)
    beside = solve_many(ARM, [50e3, 30e3], [(force, 0.04), (0.1, 0.0)], [moment, 0.0], start=start)
    assert not alone.converged
    assert beside.converged.tolist() == [False, True]
    assert not np.isfinite(beside.x[0]).any()


def test_misuse_is_refused() -> None:
    start = solve(ARM, 31e3)
    with refused(RequestError, 'wrong_shape'):
        solve_many(ARM, [1e3, 2e3, 3e3], [[0.1, 0.0]] * 2, start=start)
    with refused(RequestError, 'not_finite'):
        solve_many(ARM, [np.nan], [[0.1, 0.0]], start=start)
    with refused(RequestError, 'no_equilibrium'):
        solve_many(ARM, [1e3], [[0.1, 0.0]], start=solve(ARM, 90e3))
