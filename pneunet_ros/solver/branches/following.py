"""Follow a rod from a neighbor: the usual case, in one kernel.

From one reading to the next, the solution is nearly always near the previous one, on the same
mesh. Otherwise, `boundary_value_problem` solves the rod with the same functions.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import newton, panel_counts, prepare
from pneunet_ros.solver.interpolation import at_stations, least_stretch, resolution
from pneunet_ros.solver.sensitivity import sensitivities
from pneunet_ros.solver.settings import ACCEPTED


@kernel
def follow(
    length: float,
    sections: Array,
    knots: Array,
    rotation: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    decay_per_panel: float,
    turn_per_panel: float,
    most_panels: int,
    most_iterations: int,
    tolerance: float,
    finest: float,
    coarser: float,
    shortest: float,
    arclength: Array,
    panels: Array,
    nodes: Array,
    fields: Array,
) -> tuple[bool, float, int]:
    """Solve a rod from the panels and nodes of a neighbor, in place, on the same mesh.

    counts (sections,): the panels of the mesh on each section; finest (m): the detail that the
    mesh must resolve; coarser, shortest: as in `SolverSettings`. Fills panels, nodes and the
    fields (6, stations) at stations of increasing arclength (m). Returns whether the rod is in
    equilibrium (stable, if stability is defined), the residual (rad), and the number of Newton
    steps. If the first is False, another mesh or another start is needed.
    """
    needed = panel_counts(
        length, sections, rotation, ends, decay_per_panel, turn_per_panel, most_panels
    )
    same, refined = True, True
    for k in range(len(sections)):
        same = same and counts[k] == needed[k]
        refined = refined and counts[k] == 2 * needed[k]
    if not same and not refined:
        return False, np.inf, 0
    # As `BoundaryValueProblem.refine_as` decides.
    if not same and not coarser * resolution(panels, nodes, knots, rotation) > finest:
        return False, np.inf, 0
    prepare(length, sections, knots, rotation, ends, counts, panels)
    residual, iterations = newton(panels, ends, nodes, most_iterations, tolerance)
    if not residual <= ACCEPTED or resolution(panels, nodes, knots, rotation) > finest:
        return False, residual, iterations
    if not least_stretch(panels, nodes) >= shortest:
        return False, residual, iterations
    positive = True
    for k in range(len(sections)):
        positive = positive and sections[k, col.RIGIDITY] > 0.0
    if positive:
        count = len(panels)
        no_panels, no_ends = np.empty((0, count, col.PANEL_WIDTH)), np.empty((0, col.END_WIDTH))
        changes = np.empty((col.LOADS, count + 1, col.NODE_WIDTH))
        tip = np.empty((col.LOADS, col.TIP_WIDTH))
        if not sensitivities(panels, ends, nodes, no_panels, no_ends, changes, tip):
            return False, residual, iterations
    missed = at_stations(panels, nodes, knots, rotation, arclength, fields)
    return True, max(residual, missed), iterations
