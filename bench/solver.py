"""Speed and accuracy of the rod solver, compared with scipy's solve_bvp in one interleaved run.

    python bench/solver.py [--json] [--repeats N]

Every method solves the rows of Table 1 from the same start: the solution at 2 % less F1, 2 % more
F2 and 500 Pa less. Times are medians of CPU over rows and repeats; ratios are medians of ratios
taken within one repeat, so that a noisy machine disturbs both sides. Our kernels and our calls
from Python are timed in a loop, as in a sweep; "once" is the first call after other work, which
finds nothing of its own in the caches of the processor. solve_bvp and our kernels find the rod
ready-made, `solve()` and `step` make it. Errors are against a reference that shares no code with
the solver: shooting with an adaptive eighth-order integrator, split at l1 and at every knot of
the curvature.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import dataclasses
import itertools
import json
from pathlib import Path
import platform
import statistics
import sys
import time

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.effects import EFFECTS
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import changes_on_mesh, linearized_ends
from pneunet_ros.model.perturbation import with_pressure_change
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.solver.branches.energy_descent import loaded_guess
from pneunet_ros.solver.collocation import newton, prepare
from pneunet_ros.solver.columns import (
    CLAMP_ANGLE,
    CLAMP_COMPLIANCE,
    LOAD_OFFSET,
    PANEL_WIDTH,
    START,
)
from pneunet_ros.solver.interpolation import resolution
from pneunet_ros.solver.sensitivity import sensitivities
from scipy.integrate import solve_bvp, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import root_scalar

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.example_arms import Row, TABLE_1

MECHANICS = {
    'extensibility': {'axial_stiffness': 40.0},
    'pressure_elongation': {'strain_per_pascal': 2e-7},
    'gravity': {'weight_x': 0.0, 'weight_y': -1.0},
    'clamp_compliance': {'compliance': 5.0},
    'load_offset': {'offset': 0.003},
}
CALLS = 100  # of a kernel per timing
PYTHON_CALLS = 20  # of what is called from Python


@kernel
def warm_loop(length, sections, knots, rotation, ends, counts, start, nodes, calls):
    """Prepare, solve and check the mesh, from the neighbor's nodes, `calls` times."""
    panels = np.empty((len(start) - 1, PANEL_WIDTH))
    worst = 0.0
    for _ in range(calls):
        nodes[:] = start
        prepare(length, sections, knots, rotation, ends, counts, panels)
        residual, _steps = newton(panels, ends, nodes, 25, 1e-13)
        worst = max(residual, worst) + 0.0 * resolution(panels, nodes, knots, rotation)
    return worst


@kernel
def cold_loop(length, sections, knots, rotation, ends, counts, nodes, calls):
    """Solve the same from nothing."""
    panels = np.empty((len(nodes) - 1, PANEL_WIDTH))
    worst = 0.0
    for _ in range(calls):
        prepare(length, sections, knots, rotation, ends, counts, panels)
        loaded_guess(panels, ends, nodes)
        residual, _steps = newton(panels, ends, nodes, 25, 1e-13)
        worst = max(residual, worst) + 0.0 * resolution(panels, nodes, knots, rotation)
    return worst


@kernel
def jacobian_loop(panels, ends, nodes, panel_changes, end_changes, node_changes, tip, calls):
    """Sensitivities of nodes and tip to F1, F2, M and pressure."""
    for _ in range(calls):
        sensitivities(panels, ends, nodes, panel_changes, end_changes, node_changes, tip)


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rod:
    """One rod of the reference under a force; what does not depend on the force is ready-made.

    kappa0: the intrinsic curvature over arclength in m; pieces: start, end and record of each
    section of the moment law; angle, compliance: of the clamp; offset (m): of the load.
    """

    length: float
    knots: np.ndarray
    force: np.ndarray
    kappa0: Callable[[np.ndarray], np.ndarray]
    pieces: list[tuple[float, float, np.ndarray]]
    angle: float
    compliance: float
    offset: float

    def slopes(self, section: np.ndarray, s, theta, moment):
        """theta', M', x', y' (Eq 4 with stretch and line load)."""
        _, rigidity, offset, _, axial, strain, load_x, load_y = section
        n1 = self.force[0] + load_x * (self.length - s)
        n2 = self.force[1] + load_y * (self.length - s)
        cosine, sine = np.cos(theta), np.sin(theta)
        stretched = 1.0 + strain + axial * (n1 * cosine + n2 * sine)
        return (
            self.kappa0(s) + (moment - offset) / rigidity,
            -stretched * (n2 * cosine - n1 * sine),
            stretched * cosine,
            stretched * sine,
        )

    def end_moment(self, theta: float) -> float:
        """Moment that the offset load puts on the free end."""
        return -self.offset * (self.force[0] * np.cos(theta) + self.force[1] * np.sin(theta))

    def reference(self, guess: float) -> np.ndarray:
        """Tip (x, y, theta) by shooting from a guess of the moment at the clamp."""
        knots = self.knots

        def end_state(moment: float) -> np.ndarray:
            state = np.array([self.angle + self.compliance * moment, moment, 0.0, 0.0])
            for start, stop, section in self.pieces:
                inside = knots[(knots > start) & (knots < stop)]
                marks = [start, *inside, stop]
                for a, b in itertools.pairwise(marks):
                    state = solve_ivp(
                        lambda s, y, section=section: np.array(
                            self.slopes(section, s, y[0], y[1])
                        ),
                        (a, b), state, method='DOP853', rtol=1e-13, atol=1e-15,
                    ).y[:, -1]  # fmt: skip
            return state

        def miss(moment: float) -> float:
            state = end_state(moment)
            return state[1] - self.end_moment(state[0])

        root = root_scalar(miss, x0=guess, x1=guess * (1.0 + 1e-6), xtol=1e-15, rtol=1e-15).root
        return end_state(root)[[2, 3, 0]]

    def bvp(self, tolerance: float, mesh: np.ndarray, guess: np.ndarray):
        """Solve the textbook way: solve_bvp, a set of unknowns per section, mapped to [0, 1]."""
        pieces, length = self.pieces, self.length
        unit = 1e-3  # N m; lengths in l

        def equations(u, y):
            out = np.empty_like(y)
            for k, (start, stop, section) in enumerate(pieces):
                row, h = 4 * k, stop - start
                slopes = self.slopes(section, start + u * h, y[row], unit * y[row + 1])
                out[row] = h * slopes[0]
                out[row + 1] = h / unit * slopes[1]
                out[row + 2] = h / length * slopes[2]
                out[row + 3] = h / length * slopes[3]
            return out

        def conditions(a, b):
            joints = [
                b[4 * k : 4 * k + 4] - a[4 * k + 4 : 4 * k + 8] for k in range(len(pieces) - 1)
            ]
            clamp = [a[0] - self.angle - self.compliance * unit * a[1], a[2], a[3]]
            free = [b[-3] - self.end_moment(b[-4]) / unit]
            return np.concatenate([clamp, *joints, free])

        return solve_bvp(equations, conditions, mesh, guess, tol=tolerance, max_nodes=10_000)


def rod_of(arm: Arm, pressure: float, force: np.ndarray) -> Rod:
    """Return the rod of an arm at a pressure (Pa) and force (2,) N."""
    rods, field = arm.rods(np.array([pressure])), arm.intrinsic_curvature
    sections, clamp = rods.sections[0], rods.clamp[0]
    stops = [*sections[1:, START], arm.length]
    return Rod(
        length=arm.length,
        knots=arm.knots,
        force=force,
        kappa0=CubicSpline(
            field.arclength * arm.length, field.at(pressure, field.arclength).copy()
        ),
        pieces=[(s[START], stop, s) for s, stop in zip(sections, stops, strict=True)],
        angle=float(clamp[CLAMP_ANGLE]),
        compliance=float(clamp[CLAMP_COMPLIANCE]),
        offset=float(clamp[LOAD_OFFSET]),
    )


def best_of(call: Callable[[], object], calls: int = 1) -> float:
    """Seconds of CPU per call, one timing.

    By the clock on the wall a long call would be interrupted by other processes, and a short one
    not: of a busy machine that would speak for the short one.
    """
    begun = time.process_time()
    call()
    return (time.process_time() - begun) / calls


def repeat(call: Callable[[], object]) -> None:
    """Call it as often as is timed at once."""
    for _ in range(PYTHON_CALLS):
        call()


class Case:
    """One row of Table 1 with everything prepared that a method starts from."""

    def __init__(self, arm: Arm, row: Row) -> None:
        self.arm = arm
        self.pressure, self.force = row.pressure, np.array(row.force)
        before = self.force * [0.98, 1.02]
        self.near = solve(arm, self.pressure - 500.0, (before[0], before[1]))
        self.shape = solve(arm, self.pressure, row.force, start=self.near)
        assert self.shape.solution is not None and self.near.solution is not None
        self.rods, change = with_pressure_change(arm, self.pressure)
        attempt = BoundaryValueProblem(self.rods, row.force, 0.0)
        attempt.start_from(self.near.solution)
        self.start, self.counts, self.ends = attempt.nodes.copy(), attempt.counts, attempt.ends
        self.nodes = np.empty_like(self.start)
        solution = self.shape.solution
        self.panel_changes, self.end_changes = changes_on_mesh(solution, change)
        self.node_changes, self.tip, _ = linearized_ends(
            solution, self.panel_changes, self.end_changes
        )
        self.bvp_start = {}
        for tolerance in (1e-6, 1e-3):
            rod = rod_of(arm, self.pressure - 500.0, before)
            mesh = np.linspace(0.0, 1.0, 11)
            guess = np.zeros((4 * self.rods.sections.shape[1], mesh.size))
            for share in (0.25, 0.5, 0.75, 1.0):  # far from the solution solve_bvp gets lost
                part = dataclasses.replace(rod, force=share * before)
                result = part.bvp(tolerance, mesh, guess)
                mesh, guess = result.x, result.y
            self.bvp_start[tolerance] = (mesh, guess)
        self.rod = rod_of(arm, self.pressure, self.force)
        self.reference = self.rod.reference(float(self.shape.moment[0]))
        estimator = Estimator(arm=arm)
        self.estimator = estimator
        along, across = row.force
        self.wrench = WrenchReading(
            stamp_ns=1, force_x=along, force_y=across, moment=0.0, frame_id='pneunet_base'
        )
        state, _ = estimator.step(EstimatorState(solution=self.near.solution), self.wrench)
        self.state = state
        self.reading = PressureReading(stamp_ns=1, pressure=self.pressure)

    def record(self) -> tuple:
        """Return the record of the rod as the kernels take it."""
        rods = self.rods
        return rods.length, rods.sections[0], rods.knots, rods.rotation[0], self.ends, self.counts

    def methods(self) -> dict[str, Callable[[], float]]:
        """Every method as a call that returns its seconds per solve."""
        solution = self.shape.solution
        warm = (*self.record(), self.start, self.nodes)
        cold = (*self.record(), self.nodes)
        linear = (
            solution.panels, solution.ends, solution.nodes, self.panel_changes, self.end_changes,
            self.node_changes, self.tip,
        )  # fmt: skip
        force = (float(self.force[0]), float(self.force[1]))

        def solve_it() -> object:
            return solve(self.arm, self.pressure, force, start=self.near)

        def step() -> object:
            return self.estimator.step(self.state, self.reading)

        return {
            'solve_bvp 1e-6': lambda: best_of(lambda: self.rod.bvp(1e-6, *self.bvp_start[1e-6])),
            'solve_bvp 1e-3': lambda: best_of(lambda: self.rod.bvp(1e-3, *self.bvp_start[1e-3])),
            'kernel warm': lambda: best_of(lambda: warm_loop(*warm, CALLS), CALLS),
            'kernel cold': lambda: best_of(lambda: cold_loop(*cold, CALLS), CALLS),
            'Jacobian': lambda: best_of(lambda: jacobian_loop(*linear, CALLS), CALLS),
            'solve() once': lambda: best_of(solve_it),
            'step once': lambda: best_of(step),
            'solve()': lambda: best_of(lambda: repeat(solve_it), PYTHON_CALLS),
            'step': lambda: best_of(lambda: repeat(step), PYTHON_CALLS),
        }

    def errors(self) -> dict[str, float]:
        """Distance of the tip from the reference, m."""
        tips = {'kernel warm': np.array(self.shape.tip)}
        for tolerance in (1e-6, 1e-3):
            y = self.rod.bvp(tolerance, *self.bvp_start[tolerance]).y[-4:, -1]
            tips[f'solve_bvp {tolerance:.0e}'.replace('e-0', 'e-')] = np.array(
                [y[2] * self.arm.length, y[3] * self.arm.length, y[0]]
            )
        return {
            name: float(np.hypot(*(tip[:2] - self.reference[:2]))) for name, tip in tips.items()
        }


def measure(arm: Arm, repeats: int) -> dict[str, object]:
    """Medians, ratios and errors for one arm over Table 1."""
    cases = [Case(arm, row) for row in TABLE_1[1:]]
    times: dict[str, list[float]] = {}
    ratios: dict[str, list[float]] = {}
    for repeat in range(repeats + 1):
        for case in cases:
            seconds = {name: method() for name, method in case.methods().items()}
            if repeat == 0:  # warm-up
                continue
            for name, value in seconds.items():
                times.setdefault(name, []).append(value)
            pairs = {
                'solve_bvp 1e-6 / kernel warm': ('solve_bvp 1e-6', 'kernel warm'),
                'solve_bvp 1e-3 / kernel warm': ('solve_bvp 1e-3', 'kernel warm'),
                'kernel cold / warm': ('kernel cold', 'kernel warm'),
                'Jacobian / kernel warm': ('Jacobian', 'kernel warm'),
                **{
                    f'solve_bvp 1e-3 / {name}': ('solve_bvp 1e-3', name)
                    for name in ('solve()', 'solve() once', 'step', 'step once')
                },
            }
            for name, (above, below) in pairs.items():
                ratios.setdefault(name, []).append(seconds[above] / seconds[below])
    errors = [case.errors() for case in cases]
    return {
        'median_us': {name: 1e6 * statistics.median(values) for name, values in times.items()},
        'ratio': {name: statistics.median(values) for name, values in ratios.items()},
        'tip_error_m': {name: max(row[name] for row in errors) for name in errors[0]},
        'worst_residual_rad': max(case.shape.residual for case in cases),
    }


def arms() -> dict[str, Arm]:
    """Return the shipped arm, a stiffer one, and the shipped one with every mechanical term."""
    soft = load_model(share_path('config/paper_arm.yaml'))
    law = dataclasses.replace(soft.moment_law, rigidity=9.0 * soft.moment_law.rigidity)
    effects = tuple(EFFECTS[name](**values) for name, values in MECHANICS.items())
    return {
        'soft': soft,
        'stiff': dataclasses.replace(soft, moment_law=law),
        'soft, all mechanics': dataclasses.replace(soft, effects=effects),
    }


TARGETS = {
    'solve_bvp 1e-6 / kernel warm': ('>=', 800.0, 400.0),
    'solve_bvp 1e-3 / kernel warm': ('>=', 300.0, 150.0),
    'kernel cold / warm': ('<=', 1.5, 1.5),
    'Jacobian / kernel warm': ('<=', 0.5, 0.5),
    'solve_bvp 1e-3 / solve()': ('>=', 25.0, 25.0),
    'solve_bvp 1e-3 / solve() once': ('>=', 25.0, 25.0),
    'solve_bvp 1e-3 / step': ('>=', 10.0, 10.0),
    'solve_bvp 1e-3 / step once': ('>=', 10.0, 10.0),
}


def show(results: dict[str, dict]) -> None:
    """Print the results as tables."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=110)
    for title, values in (('median time per solve, us', 'median_us'), ('ratio', 'ratio')):
        table = Table(title=title)
        table.add_column('')
        for name in results:
            table.add_column(name, justify='right')
        if values == 'ratio':
            table.add_column('target (all mechanics)', justify='right')
        for row in results['soft'][values]:
            cells = [f'{result[values][row]:.3g}' for result in results.values()]
            if values == 'ratio':
                sign, bare, full = TARGETS[row]
                cells.append(f'{sign} {bare:g}' + (f' ({full:g})' if full != bare else ''))
            table.add_row(row, *cells)
        console.print(table)
    for name, result in results.items():
        errors = ', '.join(f'{key} {value:.1e}' for key, value in result['tip_error_m'].items())
        console.print(f'{name}: largest tip error (m): {errors}')


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument(
        '--repeats', type=int, default=15, help='interleaved repeats (default: 15)'
    )
    arguments = command.parse_args()
    results = {name: measure(arm, arguments.repeats) for name, arm in arms().items()}
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        print(json.dumps({'bench': 'solver', **machine, 'results': results}))
    else:
        show(results)


if __name__ == '__main__':
    main()
