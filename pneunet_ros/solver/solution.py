"""The converged unknowns of the rod equations."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolverNodes:
    """The converged unknowns of the rod equations, from which a neighboring solve starts.

    `panels`, `ends` and `nodes` are tables of `solver.columns`; `counts` are the panels
    of each section of the moment law.
    """

    panels: Array
    ends: Array
    nodes: Array
    counts: tuple[int, ...]

    def for_kernels(self) -> tuple[Array, Array, Array]:
        """Return copies of panels, ends and nodes, as a kernel is compiled for that may write.

        Tables within other kernels may be written, and a kernel is compiled again for tables that
        may not.
        """
        return self.panels.copy(), self.ends.copy(), self.nodes.copy()
