"""The lab's chain: its energy by differences, and its shapes against the model's solver."""

from __future__ import annotations

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.chain import Chain, free_shape, middle_joints
from pneunet_ros.lab.chain_kernels import ChainFrame, energy_of, joint
import pytest
from support.example_arms import paper_arm, TABLE_1
from support.lab_pairs import lab_arm_of
from support.refusals import refused

PRESSURE = np.array([row.pressure for row in TABLE_1])
FORCE = np.array([row.force for row in TABLE_1])
LAB_ARM = lab_arm_of(paper_arm())


def chain(elements=448, pressure=PRESSURE, force=FORCE, **changes):
    rigidity, split = LAB_ARM.stiffness(pressure)
    turned = LAB_ARM.turning_angle(middle_joints(LAB_ARM.length, elements))
    given = {
        'length': LAB_ARM.length,
        'clamp_angle': 0.0,
        'turning': np.diff(LAB_ARM.curvature_weights(pressure) @ turned, axis=1),
        'rigidity': rigidity,
        'split': split,
        'force': force,
        'moment': np.zeros(len(pressure)),
    }
    return Chain(**(given | changes))


def worst_tip(**options):
    found = free_shape(chain(**options))
    tips = np.array(
        [solve(paper_arm(), p, tuple(f)).tip for p, f in zip(PRESSURE, FORCE, strict=True)]
    )
    return max(
        np.abs(found.x[:, -1] - tips[:, 0]).max(), np.abs(found.y[:, -1] - tips[:, 1]).max()
    )


def test_the_tip_under_the_loads_of_table_1():
    assert worst_tip() < 5e-7


@pytest.mark.parametrize('split', [0.1, 0.1003, 0.137])
def test_convergence_is_of_second_order_wherever_l1_is(split):
    def tips(elements):
        found = free_shape(chain(elements, split=np.full(15, split * LAB_ARM.length)))
        return np.stack([found.x[:, -1], found.y[:, -1]])

    truth, counts = tips(3000), np.array([80, 113, 160, 226, 320])
    errors = [np.abs(tips(count) - truth).max() for count in counts]
    order, _ = np.polyfit(np.log(counts), np.log(errors), 1)
    assert order == pytest.approx(-2.0, abs=0.15)


def test_shape_and_curvature_along_the_arm():
    found = free_shape(chain())
    s = np.linspace(0.0, LAB_ARM.length, 57)
    x, y, theta = found.points(s)
    shape = solve(paper_arm(), PRESSURE[5], tuple(FORCE[5]))
    assert x[5] == pytest.approx(shape.x, abs=1e-6)
    assert y[5] == pytest.approx(shape.y, abs=1e-6)
    assert theta[5] == pytest.approx(shape.theta, abs=2e-5)
    away = np.abs(s - 0.1 * LAB_ARM.length) > 0.001  # from the jump at l1
    within = away & (s > 0.001) & (s < 0.111)
    assert found.curvature(s)[5][within] == pytest.approx(shape.curvature[within], abs=0.01)


def test_derivatives_of_the_energy_are_those_by_differences():
    random = np.random.default_rng(1)
    count = 9
    turning, rest = random.normal(0.0, 0.1, count + 1), random.normal(0.0, 0.05, count)
    line, load = random.normal(0.0, 0.05, (count, 2)), np.array([2e-4, 1e-4, 0.03, 0.2, 0.1, 1e-3])
    numbers = np.array([0.0125, 0.1, 9.0, 70.0, 0.03, 0.8, 3e-4, 1e-7, 0.006, 0.002])
    angles, factor = random.normal(0.0, 0.3, count + 2), random.uniform(0.5, 1.5, count + 1)

    def energy(at):
        parts = np.empty((3, count + 2))
        frame = ChainFrame(turning, factor, rest, line, load, numbers)
        value = energy_of(at, frame, 1.0, *parts)
        return value, parts

    _, (gradient, diagonal, beside) = energy(angles)
    for i, step in enumerate(1e-5 * np.eye(count + 2)):
        (up, more), (down, less) = energy(angles + step), energy(angles - step)
        assert gradient[i] == pytest.approx((up - down) / 2e-5, rel=1e-6, abs=1e-9)
        second = (more[0] - less[0]) / 2e-5
        assert diagonal[i] == pytest.approx(second[i], rel=1e-5, abs=1e-9)
        if i <= count:
            assert beside[i] == pytest.approx(second[i + 1], rel=1e-5, abs=1e-9)


def test_a_joint_at_l1_carries_one_moment_on_both_sides():
    _, moment, stiffness = joint(0.01, 1e-4, 1.5e-4, 1e-3, 2e-4, 2e-4, 1e-8)
    up, down = (joint(0.01 + d, 1e-4, 1.5e-4, 1e-3, 2e-4, 2e-4, 1e-8) for d in (1e-7, -1e-7))
    assert moment == pytest.approx((up[0] - down[0]) / 2e-7, rel=1e-6)
    assert stiffness == pytest.approx((up[1] - down[1]) / 2e-7, rel=1e-6)
    # Linear springs in series.
    linear = joint(0.01, 1e-4, 1.5e-4, 1e-3, 2e-4, 0.0, 0.0)
    assert linear[1] == pytest.approx(0.01 / (1e-4 / 1e-3 + 1.5e-4 / 2e-4), rel=1e-12)


def test_any_load_after_any_other_ends_at_rest():
    random = np.random.default_rng(3)
    pressure = random.uniform(0.0, 66e3, 200)
    force = np.column_stack([random.uniform(-0.1, 0.3, 200), random.uniform(-0.3, 0.3, 200)])
    many = chain(96, pressure=pressure, force=force)
    found = free_shape(many)
    numbers = np.array([many.element, *np.zeros(9)])
    for frame in range(200):
        parts = np.empty((3, 98))
        load = np.array([*many.rigidity[frame], many.split[frame], *force[frame], 0.0])
        tables = (many.turning, many.rigidity_factors, many.rest, many.line)
        of_frame = ChainFrame(*(table[frame] for table in tables), load, numbers)
        energy_of(found.angles[frame], of_frame, 1.0, *parts)
        assert np.abs(parts[0]).max() < 1e-10  # N m


def test_negative_rigidity_and_infinite_loads_are_refused():
    with refused(RequestError, 'singular_rigidity'):
        chain(rigidity=np.full((15, 2), -1e-4))
    with refused(RequestError, 'no_equilibrium'):
        free_shape(chain(force=np.where(np.arange(15)[:, None] == 3, np.inf, FORCE)))
