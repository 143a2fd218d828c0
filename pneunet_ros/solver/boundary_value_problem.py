"""One rod under one load: from nothing or a neighbor to equilibrium, or to the reason why not."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.jit import HAVE_NUMBA
from pneunet_ros.solver import (
    collocation,
    collocation_numpy,
)
from pneunet_ros.solver import (
    energy_descent as chain,
)
from pneunet_ros.solver import (
    interpolation as stations,
)
from pneunet_ros.solver.panel import GAUSS_ABSCISSAE
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.solution import SolverNodes

# A panel is at most so many decay lengths sqrt(B/F) long, and turns at most so far (rad).
DECAY_PER_PANEL = 0.8
TURN_PER_PANEL = 0.5
FINEST_DETAIL = (
    1e-6  # of the length; larger in the last Legendre term means the mesh is too coarse
)
MOST_PANELS = 400
MOST_ITERATIONS = 25
CONTINUATION_STEPS = 20
newton = collocation.newton if HAVE_NUMBA else collocation_numpy.newton


class BoundaryValueProblem:
    """One rod under one load on a mesh that is refined until it carries the solution."""

    __slots__ = (
        'counts',
        'ends',
        'iterations',
        'nodes',
        'panels',
        'residual',
        'rods',
        'tolerance',
    )

    def __init__(
        self, rods: Rods, force: tuple[float, float], moment: float, tolerance: float
    ) -> None:
        self.rods = rods
        self.tolerance = tolerance
        self.ends = np.array([*rods.clamp[0], *force, moment])
        self.residual = math.inf
        self.iterations = 0
        self.mesh(
            collocation.panel_counts(
                rods.length,
                rods.sections[0],
                rods.turning[0],
                self.ends,
                DECAY_PER_PANEL,
                TURN_PER_PANEL,
                MOST_PANELS,
            )
        )

    def mesh(self, counts: npt.NDArray[np.int64]) -> None:
        """Cut the rod into so many panels per section."""
        self.counts = counts
        total = int(counts.sum())
        self.panels = np.empty((total, collocation.PANEL_WIDTH))
        self.nodes = np.zeros((total + 1, collocation.NODE_WIDTH))  # the last row is partly unused
        collocation.prepare(
            self.rods.length,
            self.rods.sections[0],
            self.rods.knots,
            self.rods.turning[0],
            self.ends,
            counts,
            self.panels,
        )

    def start_from(self, known: SolverNodes) -> None:
        """Take a known solution as the first guess."""
        if known.counts == tuple(self.counts.tolist()):
            self.nodes[:] = known.nodes
            return
        # Another mesh: carry over what the load added to the turning of the unloaded rod.
        s, turned = gauss_stations(known.panels)
        theta = known.nodes[:, :5].ravel()[: s.size]
        moment = known.nodes[:, 5]
        here, turned_here = gauss_stations(self.panels)
        self.nodes[:, :5].flat[: here.size] = turned_here + np.interp(here, s, theta - turned)
        self.nodes[:, 5] = np.interp(here[::5], s[::5], moment)

    def newton(self) -> bool:
        """Newton's method from the present nodes; whether the equations hold afterwards."""
        self.residual, steps = newton(
            self.panels, self.ends, self.nodes, MOST_ITERATIONS, self.tolerance
        )
        self.iterations += steps
        return self.residual <= collocation.ACCEPTED

    def cold(self, quick: bool = False) -> bool:
        """Solve from nothing: by descent in energy where there is one, else along the load."""
        if np.all(self.panels[:, 1] > 0.0):
            chain.loaded_guess(self.panels, self.ends, self.nodes)
            if self.newton():
                return True
        return not quick and self.continued()

    def continued(self) -> bool:
        """Follow the equilibrium from the unloaded rod as the load grows, in adaptive steps."""
        collocation.unloaded_nodes(self.panels, self.ends, self.nodes)
        panels = np.empty_like(self.panels)
        ends = self.ends.copy()
        reached, step = 0.0, 1.0 / CONTINUATION_STEPS
        while reached < 1.0:
            share = min(1.0, reached + step)
            before = self.nodes.copy()
            panels[:] = self.panels
            panels[:, 6:10] *= share
            ends[3:] = share * self.ends[3:]
            self.residual, steps = newton(panels, ends, self.nodes, 10, self.tolerance)
            self.iterations += steps
            if self.residual > collocation.ACCEPTED:
                self.nodes[:] = before
                step *= 0.5
                if step < 1e-4:
                    return False
                continue
            reached = share
            step *= 1.5 if steps <= 4 else 1.0
        return True

    def solve(self, start: SolverNodes | None, quick: bool = False) -> str:
        """Solve; returns an empty sentence, or why there is no solution.

        quick: give up where the solution had to be followed along the load, in many small steps.
        """
        if start is not None:
            self.start_from(start)
        if (start is None or not self.newton()) and not self.cold(quick):
            return f'no equilibrium found: residual {self.residual:.1e} rad after every attempt'
        while stations.resolution(self.panels, self.nodes) > FINEST_DETAIL * self.rods.length:
            total = self.panels.shape[0]
            if 2 * total > MOST_PANELS:
                return f'not resolved: the shape has detail finer than {total} panels'
            known = self.solution()
            self.mesh(2 * self.counts)
            self.start_from(known)
            if not self.newton() and not self.cold(quick):
                return f'no equilibrium found on a finer mesh: residual {self.residual:.1e} rad'
        return ''

    def solution(self) -> SolverNodes:
        """Return the present nodes, frozen; the attempt may go on only on a new mesh."""
        return SolverNodes(
            panels=freeze(self.panels),
            ends=freeze(self.ends.copy()),
            nodes=freeze(self.nodes),
            counts=tuple(self.counts.tolist()),
        )


def gauss_stations(panels: Array) -> tuple[Array, Array]:
    """Arclength of all joints and Gauss points, and how far the unloaded rod has turned there."""
    s = np.empty((panels.shape[0], 5))
    s[:, 0] = panels[:, 15]
    s[:, 1:] = panels[:, 15:16] + panels[:, :1] * GAUSS_ABSCISSAE
    turned = np.zeros_like(s)
    turned[:, 1:] = panels[:, 10:14]
    turned[1:] += np.cumsum(panels[:-1, 14])[:, None]
    end = panels[-1, 15] + panels[-1, 0]
    return np.append(s, end), np.append(turned, panels[:, 14].sum())
