"""Load continuation: from the unloaded rod to the loaded one in adaptive steps of the load."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import unloaded_nodes
from pneunet_ros.solver.settings import ACCEPTED, SolverSettings

Newton = Callable[[Array, Array, Array, int, float], tuple[float, int]]


def continue_in_load(
    newton: Newton, panels: Array, ends: Array, nodes: Array, settings: SolverSettings
) -> tuple[float, int]:
    """Follow the equilibrium as the load grows from nothing; the nodes are changed in place.

    Returns the residual (rad) and the number of Newton steps; the whole load was reached only
    where the residual is at most ACCEPTED.
    """
    unloaded_nodes(panels, ends, nodes)
    panels_now, ends_now = panels.copy(), ends.copy()
    forces, loads = (
        slice(col.PANEL_FORCE_X, col.PANEL_LOSS_Y + 1),
        slice(col.END_X, col.END_MOMENT + 1),
    )
    reached, step, total = 0.0, settings.first_load_step, 0
    residual = np.inf
    while reached < 1.0:
        share = min(1.0, reached + step)
        before = nodes.copy()
        panels_now[:, forces] = share * panels[:, forces]
        ends_now[loads] = share * ends[loads]
        residual, steps = newton(
            panels_now, ends_now, nodes, settings.load_step_iterations, settings.tolerance
        )
        total += steps
        if residual <= ACCEPTED:
            reached = share
            step *= settings.load_step_growth if steps <= settings.easy_iterations else 1.0
            continue
        nodes[:] = before
        step *= 0.5
        if step < settings.least_load_step:
            break
    return residual, total
