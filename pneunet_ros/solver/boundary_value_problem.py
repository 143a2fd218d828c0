"""Equilibrium of one rod under one load, from a cold start or from a neighboring solution."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.kernels.jit import is_compiled
from pneunet_ros.solver import collocation, collocation_numpy
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.branches.continuation import continue_in_load
from pneunet_ros.solver.branches.energy_descent import loaded_guess
from pneunet_ros.solver.interpolation import resolution
from pneunet_ros.solver.panel import GAUSS_ABSCISSAE, GAUSS_POINTS
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import (
    ACCEPTED,
    MOST_PANELS,
    NEWTON_ITERATIONS,
    SOLVER,
    SolverSettings,
)
from pneunet_ros.solver.solution import SolverNodes

ANGLES = col.NODE_GAUSS + GAUSS_POINTS  # columns of a node that hold angles
# Panels of a refined mesh, relative to the initial one: halving doubles them, rounding up adds a
# few.
REFINED = 1.5


def newton(
    panels: Array, ends: Array, nodes: Array, most_iterations: int, tolerance: float
) -> tuple[float, int]:
    """Solve for equilibrium by the compiled kernel, or by numpy without one.

    Arguments are those of `collocation.newton`.
    """
    bring = collocation.newton if is_compiled() else collocation_numpy.newton
    return bring(panels, ends, nodes, most_iterations, tolerance)


class BoundaryValueProblem:
    """One rod under one load, on a mesh that is refined until it resolves the solution.

    rods: records of the rod, of which the first counts; force (F1, F2) N and moment N m at the
    free end. `panels`, `ends` and `nodes` are tables of `solver.columns`, `residual` is in rad.
    """

    __slots__ = ('counts', 'ends', 'iterations', 'nodes', 'panels', 'residual', 'rods', 'settings')

    def __init__(
        self,
        rods: Rods,
        force: tuple[float, float],
        moment: float,
        settings: SolverSettings = SOLVER,
    ) -> None:
        self.rods = rods
        self.settings = settings
        (self.ends,) = col.join_ends(rods.clamp[:1], np.array([[*force, moment]]))
        self.residual = math.inf
        self.iterations = 0
        self.mesh(panels_needed(rods, self.ends, settings))

    def mesh(self, counts: npt.NDArray[np.int64]) -> None:
        """Split the rod into a number of panels per section."""
        self.counts = counts
        total = int(counts.sum())
        self.panels = np.empty((total, col.PANEL_WIDTH))
        self.nodes = np.zeros((total + 1, col.NODE_WIDTH))  # the last row is partly unused
        rods = self.rods
        collocation.prepare(
            rods.length,
            rods.sections[0],
            rods.knots,
            rods.rotation[0],
            self.ends,
            counts,
            self.panels,
        )

    def refine_as(self, known: SolverNodes, finest: float) -> None:
        """Refine the mesh where the mesh of a neighboring solution had to be refined.

        finest (m): the detail that a mesh must resolve.
        """
        settings = self.settings
        if len(known.panels) <= REFINED * len(self.panels):
            return
        panels, _, nodes = known.for_kernels()
        detail = resolution(panels, nodes, self.rods.knots, self.rods.rotation[0])
        if settings.coarser * detail > finest:
            self.mesh(2 * self.counts)

    def start_from(self, known: SolverNodes) -> None:
        """Start from a known solution."""
        if known.counts == tuple(self.counts.tolist()):
            self.nodes[:] = known.nodes
            return
        # Another mesh: interpolate the rotation that the load adds to the intrinsic one.
        s, rotation = gauss_stations(known.panels)
        theta = known.nodes[:, :ANGLES].ravel()[: s.size]
        here, rotation_here = gauss_stations(self.panels)
        added = np.interp(here, s, theta - rotation)
        self.nodes[:, :ANGLES].flat[: here.size] = rotation_here + added
        self.nodes[:, col.NODE_MOMENT] = np.interp(
            here[::ANGLES], s[::ANGLES], known.nodes[:, col.NODE_MOMENT]
        )

    def newton(self) -> bool:
        """Run Newton's method from the present nodes; return whether the equations hold."""
        settings = self.settings
        self.residual, steps = newton(
            self.panels, self.ends, self.nodes, NEWTON_ITERATIONS, settings.tolerance
        )
        self.iterations += steps
        return self.residual <= ACCEPTED

    def solve_cold(self, quick: bool = False) -> bool:
        """Solve from a cold start: by energy descent if possible, or by load continuation."""
        if np.all(self.panels[:, col.PANEL_FLEXIBILITY] > 0.0):
            loaded_guess(self.panels, self.ends, self.nodes)
            if self.newton():
                return True
        return not quick and self.continue_in_load()

    def continue_in_load(self) -> bool:
        """Follow the equilibrium from the unloaded rod; return whether the load was reached."""
        self.residual, steps = continue_in_load(
            newton, self.panels, self.ends, self.nodes, self.settings
        )
        self.iterations += steps
        return self.residual <= ACCEPTED

    def solve(self, start: SolverNodes | None, quick: bool = False) -> str:
        """Solve; return an empty sentence, or why there is no solution.

        quick: whether to give up if the solution would have to be followed along the load, in many
        small steps.
        """
        finest = self.settings.finest_detail * self.rods.length
        if start is not None:
            self.refine_as(start, finest)
            self.start_from(start)
        if (start is None or not self.newton()) and not self.solve_cold(quick):
            return f'no equilibrium found: residual {self.residual:.1e} rad after every attempt'
        knots, rotation = self.rods.knots, self.rods.rotation[0]
        while resolution(self.panels, self.nodes, knots, rotation) > finest:
            total = len(self.panels)
            if 2 * total > MOST_PANELS:
                return f'not resolved: the shape has detail finer than {total} panels'
            known = self.solution()
            self.mesh(2 * self.counts)
            self.start_from(known)
            if not self.newton() and not self.solve_cold(quick):
                return f'no equilibrium found on a finer mesh: residual {self.residual:.1e} rad'
        return ''

    def solution(self) -> SolverNodes:
        """Return the current nodes, frozen; the problem can continue on a new mesh only."""
        return SolverNodes(
            panels=freeze(self.panels),
            ends=freeze(self.ends.copy()),
            nodes=freeze(self.nodes),
            counts=tuple(self.counts.tolist()),
        )


def panels_needed(
    rods: Rods, ends: Array, settings: SolverSettings = SOLVER
) -> npt.NDArray[np.int64]:
    """Return the panels per section of the first of these records under a load (ends, (6,))."""
    counts: npt.NDArray[np.int64] = collocation.panel_counts(
        rods.length,
        rods.sections[0],
        rods.rotation[0],
        ends,
        settings.decay_per_panel,
        settings.turn_per_panel,
        MOST_PANELS,
    )
    return counts


def gauss_stations(panels: Array) -> tuple[Array, Array]:
    """Return the arclength of all joints and Gauss points, and the intrinsic rotation there."""
    start, length = panels[:, col.PANEL_START], panels[:, col.PANEL_LENGTH]
    end = panels[:, col.PANEL_ROTATION_END]
    s, rotation = np.empty((len(panels), ANGLES)), np.zeros((len(panels), ANGLES))
    s[:, col.NODE_THETA] = start
    s[:, col.NODE_GAUSS :] = start[:, None] + length[:, None] * GAUSS_ABSCISSAE
    rotation[:, col.NODE_GAUSS :] = panels[:, col.PANEL_ROTATION : col.PANEL_ROTATION_END]
    rotation[1:] += np.cumsum(end[:-1])[:, None]
    return np.append(s, start[-1] + length[-1]), np.append(rotation, end.sum())
