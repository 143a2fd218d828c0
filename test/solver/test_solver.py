"""The kernels: one Newton method twice, rods at random, meshes, and Python without numba."""

from __future__ import annotations

import ast
from collections import Counter
import dataclasses
import json
import math
from pathlib import Path
import re
import shutil
import subprocess
import sys

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.kernels.jit import HAVE_NUMBA
from pneunet_ros.effects.effect import Load
from pneunet_ros.effects.stiffening import Stiffening
from pneunet_ros.model import equilibrium
from pneunet_ros.model.equilibrium import solve_rod
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.solver import collocation, collocation_numpy
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.solver.branches.energy_descent import loaded_guess
from pneunet_ros.solver.columns import (
    FIELD_COUNT,
    NODE_MOMENT,
    NODE_THETA,
    PANEL_START,
    SLOPE_WIDTH,
)
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.panel import curvature_change, sine_cosine
from pneunet_ros.solver.settings import ACCEPTED, SOLVER
import pytest
from support.example_arms import PAPER_ARM, paper_arm, plain_arm, TABLE_1, two_sections
from support.random_rods import random_case
from support.rod_equations import fine_stations, violations

FIELDS = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')


def problem_at(case):
    """Mesh the rod of a random case; it is not yet solved."""
    rods = case.arm.rods(np.array([case.pressure]))
    return BoundaryValueProblem(rods, case.force, case.moment)


# ---- one Newton method, twice -------------------------------------------------------------------


@pytest.mark.parametrize('seed', range(60))
def test_compiled_and_numpy_newton_agree(seed):
    problem = problem_at(random_case(seed))
    assert problem.solve(None) == ''
    panels, ends = problem.panels, problem.ends
    noise = np.random.default_rng(seed).normal(size=problem.nodes.shape)
    start = problem.nodes * (1 + 1e-3 * noise)
    quick, plain = start.copy(), start.copy()
    residual, _ = collocation.newton(panels, ends, quick, 25, SOLVER.tolerance)
    twin, _ = collocation_numpy.newton(panels, ends, plain, 25, SOLVER.tolerance)
    assert residual <= ACCEPTED
    assert twin <= ACCEPTED
    assert quick[:, :NODE_MOMENT] == pytest.approx(plain[:, :NODE_MOMENT], abs=1e-10)
    in_radians = collocation.scale_of_moments(panels)
    assert in_radians * quick[:, NODE_MOMENT] == pytest.approx(
        in_radians * plain[:, NODE_MOMENT], abs=1e-10
    )


@pytest.mark.parametrize('seed', range(20))
def test_compiled_and_numpy_residuals_agree_away_from_equilibrium(seed):
    problem = problem_at(random_case(seed))
    draw = np.random.default_rng(seed)
    collocation.unloaded_nodes(problem.panels, problem.ends, problem.nodes)
    problem.nodes += draw.normal(size=problem.nodes.shape) * ([0.1] * 5 + [1e-4])
    panels, ends, nodes = problem.panels, problem.ends, problem.nodes
    scale = collocation.scale_of_moments(panels)
    slopes = np.empty((panels.shape[0], SLOPE_WIDTH))
    worst = collocation.residual_pass(panels, ends, nodes, slopes, scale)
    residual, _ = collocation_numpy.equations(panels, ends, nodes)
    residual[6::6] *= scale
    residual[-1] *= scale
    assert worst == pytest.approx(np.abs(residual).max(), rel=1e-10)


@pytest.mark.parametrize('seed', range(20))
def test_the_matrix_of_newton_is_the_derivative_of_the_equations(seed):
    problem = problem_at(random_case(seed))
    problem.solve(None)
    panels, ends, nodes = problem.panels, problem.ends, np.array(problem.nodes)
    _, matrix = collocation_numpy.equations(panels, ends, nodes)
    direction = np.random.default_rng(seed).normal(size=nodes.shape) * ([1.0] * 5 + [1e-3])

    def moved(step):
        return collocation_numpy.equations(panels, ends, nodes + step * direction)[0]

    flat = np.concatenate([direction[:-1].ravel(), direction[-1, [NODE_THETA, NODE_MOMENT]]])
    found = matrix @ flat
    expected = (moved(-1e-6) - moved(1e-6)) / 2e-6
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(found).max())


# ---- parts of the equations ---------------------------------------------------------------------


def test_sine_and_cosine_are_those_of_the_library():
    for x in np.concatenate([np.linspace(-60, 60, 4001), [0.0, 1e-300, math.pi / 2, -math.pi]]):
        assert sine_cosine(x) == pytest.approx((math.sin(x), math.cos(x)), abs=1e-15)
    assert all(math.isnan(value) for value in sine_cosine(math.nan))


@pytest.mark.parametrize('rigidity', [1e-5, -1e-3, 1e-2])
@pytest.mark.parametrize('cubic', [0.0, 1e-8, 1e-4, 1.0])
def test_the_cubic_law_is_inverted(rigidity, cubic):
    for d in (-300.0, -1.0, -1e-6, 0.0, 1e-3, 20.0, 1e3):
        moment = 1e-3 + rigidity * d * (1 + cubic * d * d)
        found, slope = curvature_change(moment, (1 / rigidity, 1e-3, cubic))
        assert found == pytest.approx(d, rel=1e-9, abs=1e-9)
        assert slope == pytest.approx(1 / (rigidity * (1 + 3 * cubic * d * d)), rel=1e-8)


def test_meshes_end_where_the_law_jumps():
    shape = solve(paper_arm(), 50e3, (0.2, 0.1))
    first, second = shape.solution.counts
    joints = shape.solution.panels[:, PANEL_START]
    assert joints[first] == pytest.approx(0.15 * 0.112, rel=1e-12)
    assert joints.size == first + second


# ---- rods at random -----------------------------------------------------------------------------


def held_against_the_equations(seeds):
    """Solve these cases; whatever claims to have converged must satisfy the rod's equations."""
    outcomes = Counter()
    for seed in seeds:
        case = random_case(seed)
        load = Load(
            pressure=case.pressure,
            force_x=case.force[0],
            force_y=case.force[1],
            moment=case.moment,
        )
        rods = case.arm.rods(np.array([case.pressure]))
        at = fine_stations(case.arm, case.pressure, cells=30)
        shape = solve_rod(case.arm, rods, load, None, at)
        signs = ''.join('+' if alpha > 0 else '-' for alpha in case.arm.moment_law.rigidity[0])
        outcomes[signs, shape.converged] += 1
        if not shape.converged:
            assert all(np.isnan(getattr(shape, name)).all() for name in FIELDS)
            assert shape.status.startswith(('no equilibrium found', 'not resolved'))
            assert shape.solution is None
            continue
        assert shape.residual <= SOLVER.finest_detail, seed
        assert (shape.stable is None) is (signs != '++'), seed
        assert (shape.stable is False) is ('unstable' in shape.status), seed
        outcomes['unstable'] += shape.stable is False
        worst = violations(case.arm, shape)
        assert worst.position < 5e-8, seed
        assert worst.moment < 1e-8, seed
        assert worst.angle < shape.residual + 1e-9, seed  # rounding of the quadrature here
        assert worst.curvature < 1e-9, seed
    return outcomes


def test_300_random_rods_are_solved_and_right():
    outcomes = held_against_the_equations(range(300))
    assert outcomes.pop('unstable') == 0
    assert sum(outcomes.values()) == 300
    assert outcomes['++', False] == outcomes['--', False] == 0
    assert outcomes['+-', False] + outcomes['-+', False] <= 3


@pytest.mark.slow
def test_2000_random_rods_are_solved_and_right():
    outcomes = held_against_the_equations(range(2000))
    assert outcomes.pop('unstable') <= 2  # as said: descent in energy can end on a saddle
    assert sum(outcomes.values()) == 2000
    assert outcomes['++', False] == outcomes['--', False] == 0
    # Of the 1001 whose rigidity changes sign at l1, 7 have no way from the unloaded arm.
    assert outcomes['+-', False] + outcomes['-+', False] <= 10


def stiffened(seed):
    """Return a random case whose law turns cubic within a small part of a panel."""
    case = random_case(seed)
    effects = [effect for effect in case.arm.effects if effect.name != 'stiffening']
    coefficient = float(10 ** np.random.default_rng(seed).uniform(-3, 0))
    effects.append(Stiffening(coefficient=coefficient))
    return dataclasses.replace(case, arm=dataclasses.replace(case.arm, effects=tuple(effects)))


def solve_finely(case, cells, settings=SOLVER):
    """Solve a case at stations so fine that the equations can be checked between the nodes."""
    rods = case.arm.rods(np.array([case.pressure]))
    load = Load(
        pressure=case.pressure, force_x=case.force[0], force_y=case.force[1], moment=case.moment
    )
    at = fine_stations(case.arm, case.pressure, cells=cells)
    return solve_rod(case.arm, rods, load, None, at, settings)


STEEP = (0, 31, 75, 97, 129, 135, 176, 240)  # of the last, no mesh carries the solution


@pytest.mark.parametrize('seed', STEEP)
def test_the_residual_sees_what_stands_between_the_gauss_points(seed):
    case = stiffened(seed)
    never_finer = dataclasses.replace(SOLVER, finest_detail=1.0)
    coarse, fine = solve_finely(case, 300, never_finer), solve_finely(case, 300)
    assert coarse.residual > SOLVER.finest_detail  # where Newton's method says 1e-13
    assert violations(case.arm, coarse).angle < coarse.residual
    if seed == STEEP[-1]:
        assert not fine.converged
        return
    assert fine.residual <= SOLVER.finest_detail
    assert violations(case.arm, fine).angle < fine.residual


@pytest.mark.parametrize('seed', range(12))
def test_random_shapes_do_not_depend_on_the_mesh(seed):
    case = random_case(seed)
    problem = problem_at(case)
    rods = problem.rods
    assert problem.solve(None) == ''
    at = np.linspace(0.0, case.arm.length, 57)
    fields = np.empty((2, FIELD_COUNT, at.size))
    for which in fields:
        at_stations(problem.panels, problem.nodes, rods.knots, rods.rotation[0], at, which)
        known = problem.solution()
        problem.mesh(4 * problem.counts)
        problem.start_from(known)
        assert problem.newton()
    assert fields[1, :2] == pytest.approx(fields[0, :2], abs=2e-8)
    assert fields[1, 2] == pytest.approx(fields[0, 2], abs=1e-6)


# ---- starts and meshes --------------------------------------------------------------------------


def test_a_start_with_another_mesh_is_carried_over():
    arm = paper_arm()
    cold = solve(arm, 60e3, (0.15, 0.25))
    far = solve(arm, 20e3, (0.01, 0.0))
    assert far.solution.counts != cold.solution.counts
    warm = solve(arm, 60e3, (0.15, 0.25), start=far)
    for name in FIELDS:
        assert getattr(warm, name) == pytest.approx(getattr(cold, name), abs=1e-10), name


def test_a_start_of_another_arm_is_as_good_as_any():
    far = solve(plain_arm(curvature=5.0), 20e3, (0.3, -0.2))
    cold = solve(paper_arm(), 60e3, (0.15, 0.25))
    warm = solve(paper_arm(), 60e3, (0.15, 0.25), start=far)
    assert warm.x == pytest.approx(cold.x, abs=1e-10)


def test_a_start_that_has_failed_is_no_start():
    failed = solve(paper_arm(), 200e3)
    assert failed.solution is None
    again = solve(paper_arm(), 60e3, (0.15, 0.25), start=failed)
    assert np.array_equal(again.x, solve(paper_arm(), 60e3, (0.15, 0.25)).x)


def test_a_warm_start_takes_fewer_steps():
    arm, row = paper_arm(), TABLE_1[8]
    near = solve(arm, row.pressure - 100.0, row.force)
    warm = solve(arm, row.pressure, row.force, start=near)
    assert warm.iterations <= 3
    assert solve(arm, row.pressure, row.force, start=warm).iterations == 0


def test_a_mesh_does_not_depend_on_where_the_search_began():
    refined = 0
    for seed in range(40):
        case = random_case(seed, negative=False)
        arm, pressure, (force_x, force_y) = case.arm, case.pressure, case.force
        cold = solve(arm, pressure, case.force, case.moment)
        if not cold.converged:
            continue
        counts = problem_at(case).counts
        refined += sum(cold.solution.counts) > counts.sum()
        for share in (0.9, 1.02):
            force = share * force_x, share * force_y
            near = solve(arm, pressure, force, case.moment, start=cold)
            warm = solve(
                arm, pressure, case.force, case.moment, start=near if near.converged else cold
            )
            assert warm.solution.counts == cold.solution.counts
    assert refined > 3


def test_what_was_refined_is_not_solved_on_the_coarse_mesh_again(monkeypatch):
    arm, force = wiggly_arm(8), (0.1, 0.05)
    near = solve(arm, 50e3, force)
    solved = []
    newton = BoundaryValueProblem.newton
    monkeypatch.setattr(
        BoundaryValueProblem,
        'newton',
        lambda self: solved.append(len(self.panels)) or newton(self),
    )
    cold = solve(arm, 51e3, force)
    assert len(solved) > 1
    assert solved[0] < solved[-1] == len(cold.solution.panels)
    solved.clear()
    warm = solve(arm, 51e3, force, start=near)
    # One kernel follows a rod on the mesh of its neighbor; there is none where plain Python runs.
    assert solved == ([] if jit.is_compiled() else [len(cold.solution.panels)])
    assert warm.solution.counts == cold.solution.counts
    assert warm.x == pytest.approx(cold.x, abs=1e-12)


def test_what_is_followed_is_what_is_solved(monkeypatch):
    """The kernel for what mostly happens, beside the parts of it in Python."""
    followed = 0
    for seed in range(30):
        case = random_case(seed)
        arm, pressure, (force_x, force_y) = case.arm, case.pressure, case.force
        near = solve(arm, pressure, (0.98 * force_x, 0.98 * force_y), case.moment)
        if not near.converged:
            continue
        warm = solve(arm, pressure, case.force, case.moment, start=near)
        with monkeypatch.context() as patch:
            patch.setattr(equilibrium, 'is_compiled', lambda: False)
            parts = solve(arm, pressure, case.force, case.moment, start=near)
        followed += warm.converged
        assert warm.status == parts.status
        assert warm.iterations == parts.iterations
        np.testing.assert_array_equal(warm.x, parts.x)
        assert warm.residual == parts.residual or not warm.converged
    assert followed > 15


def test_the_chain_finds_a_start_close_to_the_solution():
    rods = paper_arm().rods(np.array([60e3]))
    problem = BoundaryValueProblem(rods, (0.15, 0.25), 0.0)
    loaded_guess(problem.panels, problem.ends, problem.nodes)
    guess = problem.nodes.copy()
    assert problem.newton()
    assert guess[:, :5] == pytest.approx(problem.nodes[:, :5], abs=0.02)


def wiggly_arm(waves):
    """Make an arm whose intrinsic curvature goes up and down so many times along it."""
    place = np.linspace(0, 1, 16 * waves + 1)
    curvature = 150.0 * np.sin(2 * np.pi * waves * place)
    arm = plain_arm(law=two_sections(1e-3, 5e-4))
    table = IntrinsicCurvature(
        pressure=[0.0, 100e3], arclength=place, curvature=[curvature, curvature]
    )
    return type(arm)(
        name='wiggly',
        length=arm.length,
        weight=arm.weight,
        intrinsic_curvature=table,
        moment_law=arm.moment_law,
        sensors=arm.sensors,
    )


@pytest.mark.parametrize('waves', [3, 8])
def test_a_wiggly_field_gets_the_mesh_it_needs(waves):
    arm = wiggly_arm(waves)
    load = Load(pressure=0.0, force_x=0.1, force_y=0.1)
    rods = arm.rods(np.array([0.0]))
    shape = solve_rod(arm, rods, load, None, fine_stations(arm, 0.0, cells=8))
    assert shape.converged
    worst = violations(arm, shape)
    assert worst.position < 1e-8
    assert worst.angle < 1e-6
    detail = resolution(shape.solution.panels, shape.solution.nodes, rods.knots, rods.rotation[0])
    assert 0.0 < detail <= SOLVER.finest_detail * arm.length


def test_detail_finer_than_any_mesh_is_said():
    shape = solve(wiggly_arm(200), 0.0, (0.1, 0.1))
    assert not shape.converged
    assert np.isnan(shape.x).all()


def test_steep_boundary_layers_are_solved():
    # METHODS: shooting grows like exp(l sqrt(F/B)), here exp(35).
    law = two_sections(1e-5, 1e-5)
    shape = solve(plain_arm(curvature=20.0, law=law), 0.0, (1.0, 0.3))
    assert shape.converged
    assert shape.stable
    assert shape.theta[20:35] == pytest.approx(math.atan2(0.3, 1.0), abs=1e-4)


# ---- without numba ------------------------------------------------------------------------------

WITHOUT_NUMBA = f"""
import json, sys
from pneunet_ros import load_model, solve, solve_tip
from pneunet_ros.core.kernels.jit import HAVE_NUMBA
assert not HAVE_NUMBA
arm = load_model({str(PAPER_ARM)!r})
shape = solve(arm, 44.9e3, (0.15, 0.125))
tip = solve_tip(arm, 44.9e3, shape.tip[:2])
print(json.dumps([shape.x.tolist(), shape.curvature.tolist(), shape.status, tip.force]))
assert 'numba' not in sys.modules
"""


def test_without_numba_the_numbers_are_the_same(foreign_environment):
    assert HAVE_NUMBA
    root = str(PAPER_ARM.parent.parent)
    environment = {**foreign_environment, 'PYTHONPATH': root, 'PNEUNET_NO_NUMBA': '1'}
    command = [sys.executable, '-W', 'error', '-c', WITHOUT_NUMBA]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    x, curvature, status, force = json.loads(done.stdout)
    shape = solve(paper_arm(), 44.9e3, (0.15, 0.125))
    assert x == pytest.approx(shape.x, abs=1e-12)
    assert curvature == pytest.approx(shape.curvature, abs=1e-8)
    assert status == shape.status
    assert force == pytest.approx((0.15, 0.125), abs=1e-9)


def test_predict_without_numba_gives_the_same_numbers(foreign_environment):
    root = str(PAPER_ARM.parent.parent)
    arguments = ['predict', '--pressure', '31000', '--force', '0.175', '0.07', '--json']
    command = [sys.executable, '-W', 'error', '-m', 'pneunet_ros.cli', *arguments]
    answers = []
    for switch in ({}, {'PNEUNET_NO_NUMBA': '1'}):
        environment = {**foreign_environment, 'PYTHONPATH': root, **switch}
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        answers.append(json.loads(done.stdout))
    one, other = answers
    assert one.keys() == other.keys()
    for name in (*FIELDS, 'arclength', 'force'):
        assert one[name] == pytest.approx(other[name], rel=1e-9, abs=1e-11), name
    for row, twin in zip(one['jacobian'], other['jacobian'], strict=True):
        assert row == pytest.approx(twin, rel=1e-6)
    assert one['tip_std'] == pytest.approx(other['tip_std'], rel=1e-6)


# ---- kernels kept on disk -----------------------------------------------------------------------


def test_a_kernel_without_numba_says_nothing_of_what_is_not_finite():
    def inverse(x: np.float64) -> np.float64:
        return np.float64(1.0) / x

    with pytest.raises(RuntimeWarning):
        inverse(np.float64(0.0))
    assert jit.without_warnings(inverse)(np.float64(0.0)) == math.inf


def toy_of_kernels(folder: Path) -> Path:
    """Return a package with a kernel that calls another, and the compiler of this one."""
    toy = folder / 'toy'
    (toy / 'core' / 'kernels').mkdir(parents=True)
    for module in ('kernels/jit', 'kernels/links', 'interrupt'):
        text = (Path(jit.__file__).parents[1] / f'{module}.py').read_text()
        (toy / 'core' / f'{module}.py').write_text(text.replace('pneunet_ros', 'toy'))
    (toy / 'whole.py').write_text(
        'from toy.core.kernels.jit import kernel\n'
        'from toy.piece import piece\n\n\n'
        '@kernel\ndef whole(x: float) -> float:\n    return 2.0 * piece(x)\n\n\n'
        'print(whole(1.0), sum(whole.stats.cache_hits.values()))\n'
    )
    return toy


def write_piece(toy: Path, kind: str, factor: float) -> None:
    """Write the kernel that is called."""
    (toy / 'piece.py').write_text(
        f'from toy.core.kernels.jit import {kind}\n\n\n'
        f'@{kind}\ndef piece(x: float) -> float:\n    return {factor} * x\n'
    )


def run_toy(
    toy: Path, environment: dict[str, str], program: str = 'import toy.whole'
) -> tuple[str, ...]:
    """Return what the kernel gives in a process of its own, and whether it was kept.

    Without bytecode: Python takes that of a file of the same size and second for this one's.
    """
    done = subprocess.run(
        [sys.executable, '-B', '-W', 'error', '-c', program],
        env={
            **environment,
            'PYTHONPATH': str(toy.parent),
            'NUMBA_CACHE_DIR': str(toy.parent / 'cache'),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return tuple(done.stdout.split())


def test_a_kernel_is_compiled_again_when_an_equation_in_another_file_changes(
    tmp_path, foreign_environment
):
    toy, answers = toy_of_kernels(tmp_path), []
    for kind, factor in (
        ('kernel', 3.0),
        ('kernel', 3.0),
        ('kernel', 5.0),
        ('inner', 6.0),
        ('inner', 7.0),
        ('inlined', 8.0),
        ('inlined', 9.0),
    ):
        write_piece(toy, kind, factor)
        (toy / 'beside.py').write_text(f'FACTOR = {len(answers)}  # no kernel knows it\n')
        answers.append(run_toy(toy, foreign_environment))
    assert answers == [
        ('6.0', '0'),
        ('6.0', '1'),
        ('10.0', '0'),
        ('12.0', '0'),
        ('14.0', '0'),
        ('16.0', '0'),
        ('18.0', '0'),
    ]


@pytest.mark.parametrize('kind', ['kernel', 'inner'])
def test_a_kept_kernel_calls_another_where_it_is(tmp_path, foreign_environment, kind):
    toy = toy_of_kernels(tmp_path)
    write_piece(toy, kind, 3.0)
    assert run_toy(toy, foreign_environment) == ('6.0', '0')
    pieces = list((tmp_path / 'cache').rglob('piece.piece-*'))
    assert {file.suffix for file in pieces} == {'.nbi', '.nbc'}
    for file in pieces:
        file.unlink()
    # The one that is left knows the other by its name alone, and has it compiled again.
    assert run_toy(toy, foreign_environment) == ('6.0', '1')
    assert {file.name for file in (tmp_path / 'cache').rglob('piece.piece-*')} == {
        file.name for file in pieces
    }
    for file in pieces:
        if file.suffix == '.nbc':
            file.write_bytes(b'')
    assert run_toy(toy, foreign_environment) == ('6.0', '1')


def test_a_kept_kernel_does_not_call_one_of_other_types(tmp_path, foreign_environment):
    """Of two processes that compile one kernel, one may keep its code in the file of the other."""
    toy = toy_of_kernels(tmp_path)
    write_piece(toy, 'kernel', 3.0)
    both = 'import toy.whole; toy.whole.piece(2)'
    assert run_toy(toy, foreign_environment, both) == ('6.0', '0')
    one, other = sorted((tmp_path / 'cache').rglob('piece.piece-*.nbc'))
    of_one = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(of_one)
    assert run_toy(toy, foreign_environment, both) == ('6.0', '1')


def test_kept_kernels_take_their_places_where_one_of_them_is_lost(tmp_path, foreign_environment):
    toy = toy_of_kernels(tmp_path)
    write_piece(toy, 'kernel', 3.0)
    whole = (toy / 'whole.py').read_text()
    (toy / 'whole.py').write_text(whole[: whole.index('print')])
    program = 'import toy.whole as w; print(w.whole(1.0), type(w.whole).__name__)'
    assert run_toy(toy, foreign_environment, program) == ('6.0', 'CPUDispatcher')
    for file in (tmp_path / 'cache').rglob('whole.whole-*.nbc'):
        file.unlink()
    use_plain_python = 'from toy.core.kernels import jit; jit.use_plain_python()\n'
    take_over = program.replace(' print', ' jit.use_compiled(); print')
    found = run_toy(toy, foreign_environment, use_plain_python + take_over)
    assert found == ('6.0', 'CPUDispatcher')


def test_the_fingerprint_is_of_the_files_with_kernels_alone_whatever_their_order(tmp_path):
    one, other = tmp_path / 'one', tmp_path / 'other'
    kernels = {name: f'from p.core.kernels.jit import kernel  # {name}\n' for name in 'abc'}
    for package, names in ((one, 'abc'), (other, 'cba')):
        (package / 'inner').mkdir(parents=True)
        for name in names:
            (package / 'inner' / f'{name}.py').write_text(kernels[name])
        (package / 'plain.py').write_text(f'NAME = {names!r}\n')
    assert jit.fingerprint(one) == jit.fingerprint(other)
    (other / 'inner' / 'b.py').write_text(kernels['b'] + 'CONSTANT = 2\n')
    assert jit.fingerprint(one) != jit.fingerprint(other)


def test_the_fingerprint_is_of_all_files_here_that_kernels_come_from(tmp_path):
    # A module that moved once left the fingerprint: it was looked for by its old name.
    package = tmp_path / 'package'
    shutil.copytree(Path(jit.__file__).parents[2], package, ignore=shutil.ignore_patterns('*.pyc'))
    decorated = re.compile(r'^\s*@(kernel|inner|inlined|summing)$', re.MULTILINE)
    files = {file for file in package.rglob('*.py') if decorated.search(file.read_text())}
    assert len(files) > 20
    compiling = {package / 'core' / 'kernels' / f'{name}.py' for name in ('jit', 'links')}
    whole = jit.fingerprint(package)
    for file in files | compiling | {package / 'solver' / 'settings.py'}:
        content = file.read_bytes()
        file.write_bytes(content + b'# changed\n')
        assert jit.fingerprint(package) != whole, file
        file.write_bytes(content)
    assert jit.fingerprint(package) == whole


def test_kernels_use_no_name_of_a_file_that_is_not_in_the_fingerprint():
    root = Path(jit.__file__).parents[3]
    hashed = {file for file in root.glob('pneunet_ros/**/*.py')
              if 'core.kernels.jit import' in file.read_text()}  # fmt: skip
    sources = {(file, *one) for file in hashed for one in used_by_kernels(file)}
    assert len(sources) > 50
    for file, module, name in sources:
        base = root.joinpath(*module.split('.'))
        (source, *_) = [
            path
            for path in (base / f'{name}.py', base.with_suffix('.py'), base / '__init__.py')
            if path.exists()
        ]
        assert source in hashed, (file, name)


def used_by_kernels(file):
    """Yield (module, name) of what kernels of a file and their constants import from us."""
    tree = ast.parse(file.read_text())
    imported = {alias.asname or alias.name: (node.module, alias.name)
                for node in tree.body if isinstance(node, ast.ImportFrom)
                and node.module.startswith('pneunet_ros') for alias in node.names}  # fmt: skip
    constants = {name.id: node.value for node in tree.body if isinstance(node, ast.Assign)
                 for name in ast.walk(node.targets[0]) if isinstance(name, ast.Name)}  # fmt: skip
    kernels = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
               and {ast.unparse(one) for one in node.decorator_list}
               & {'kernel', 'inner', 'inlined', 'summing'}]  # fmt: skip
    todo = [part for node in kernels for part in (*node.body, *node.args.defaults)]
    while todo:
        for node in ast.walk(todo.pop()):
            if isinstance(node, ast.Name):
                todo += [constants.pop(node.id)] if node.id in constants else []
                if node.id in imported:
                    yield imported[node.id]
