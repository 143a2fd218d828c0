"""The converged unknowns of the rod equations."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolverNodes:
    """The converged unknowns of the rod equations, a start for neighboring solves.

    `panels`, `ends` and `nodes` are tables of `solver.columns`; `counts` are the panels
    of each section of the moment law.
    """

    panels: Array
    ends: Array
    nodes: Array
    counts: tuple[int, ...]

    def for_kernels(self) -> tuple[Array, Array, Array]:
        """Return writable copies of panels, ends and nodes for kernels.

        Tables within other kernels are writable, and a kernel would be recompiled for read-only
        tables.
        """
        return self.panels.copy(), self.ends.copy(), self.nodes.copy()
