"""Load continuation: from the unloaded to the loaded rod in adaptive load steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import unloaded_nodes
from pneunet_ros.solver.settings import ACCEPTED, SolverSettings

FIRST_LOAD_STEP = 0.05  # of the load: initial step, adapted later
LEAST_LOAD_STEP = 1e-4  # of the load: smallest step after repeated halving
# Largest number of Newton steps at one load, before the load step is halved.
LOAD_STEP_ITERATIONS = 10
EASY_ITERATIONS = 4  # steps of Newton's method up to which the load step may grow
LOAD_STEP_GROWTH = 1.5  # of an easy load step

Newton = Callable[[Array, Array, Array, int, float], tuple[float, int]]


def continue_in_load(
    newton: Newton, panels: Array, ends: Array, nodes: Array, settings: SolverSettings
) -> tuple[float, int]:
    """Follow the equilibrium as the load grows from zero, updating the nodes in place.

    Returns the residual (rad) and the number of Newton steps; the full load was reached only if
    the residual is at most ACCEPTED.
    """
    unloaded_nodes(panels, ends, nodes)
    panels_now, ends_now = panels.copy(), ends.copy()
    forces, loads = (
        slice(col.PANEL_FORCE_X, col.PANEL_LOSS_Y + 1),
        slice(col.END_X, col.END_MOMENT + 1),
    )
    reached, step, total = 0.0, FIRST_LOAD_STEP, 0
    residual = np.inf
    while reached < 1.0:
        share = min(1.0, reached + step)
        before = nodes.copy()
        panels_now[:, forces] = share * panels[:, forces]
        ends_now[loads] = share * ends[loads]
        residual, steps = newton(
            panels_now, ends_now, nodes, LOAD_STEP_ITERATIONS, settings.tolerance
        )
        total += steps
        if residual <= ACCEPTED:
            reached = share
            step *= LOAD_STEP_GROWTH if steps <= EASY_ITERATIONS else 1.0
            continue
        nodes[:] = before
        step *= 0.5
        if step < LEAST_LOAD_STEP:
            break
    return residual, total
