"""Many rods one after the other on one mesh, each from its own or its neighbor's solution.

For fits: beside the shapes at stations, their linear answer to every column of the record of the
rod, from which the answer to any parameter follows by the chain rule.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import kernel
from pneunet_ros.solver.collocation import ACCEPTED, newton, PANEL_WIDTH, prepare, unloaded_nodes
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.linearization import station_changes
from pneunet_ros.solver.sensitivity import LOADS, sensitivities

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
MOST_ITERATIONS = 12


@kernel
def follow(
    length: float,
    sections: Array,
    clamp: Array,
    knots: Array,
    turning: Array,
    loads: Array,
    counts: Integers,
    known: Flags,
    tolerance: float,
    first: int,
    nodes: Array,
    arclength: Array,
    fields: Array,
    detail: Array,
) -> int:
    """Solve the rods from `first` on; returns the first that Newton's method did not solve.

    sections (n, sections, 8), clamp (n, 3), turning (n, pieces, 5) and loads (n, 3) of F1, F2, M
    are the records; nodes (n, panels + 1, 6) come in where `known` and go out, fields (n, 6,
    stations) as of `at_stations` and detail (n,) as of `resolution` go out.
    """
    panels = np.empty((nodes.shape[1] - 1, PANEL_WIDTH))
    ends = np.empty(6)
    for rod in range(first, nodes.shape[0]):
        for i in range(3):
            ends[i], ends[3 + i] = clamp[rod, i], loads[rod, i]
        prepare(length, sections[rod], knots, turning[rod], ends, counts, panels)
        if not known[rod]:
            if rod == 0:
                unloaded_nodes(panels, ends, nodes[0])
            else:
                for p in range(nodes.shape[1]):
                    for i in range(6):
                        nodes[rod, p, i] = nodes[rod - 1, p, i]
        residual, _ = newton(panels, ends, nodes[rod], MOST_ITERATIONS, tolerance)
        if not residual <= ACCEPTED:
            return rod
        known[rod] = True
        at_stations(panels, nodes[rod], knots, turning[rod], arclength, fields[rod])
        detail[rod] = resolution(panels, nodes[rod])
    return nodes.shape[0]


@kernel
def answers(
    length: float,
    sections: Array,
    clamp: Array,
    knots: Array,
    turning: Array,
    loads: Array,
    counts: Integers,
    nodes: Array,
    knot_turning: Array,
    columns: Integers,
    steps: Array,
    arclength: Array,
    out: Array,
    stable: Flags,
) -> None:
    """Linear answer of solved rods at stations, into out (n, causes, 6, stations), and stability.

    The causes: F1, F2, M; a unit of each knot of the curvature's table (knot_turning (knots,
    pieces, 5) is its turning); each column of a section (columns (k, 2): section and column, steps
    (k,) for their difference).
    """
    panel_count = nodes.shape[1] - 1
    knot_count, column_count = knot_turning.shape[0], columns.shape[0]
    further = knot_count + column_count
    panels = np.empty((panel_count, PANEL_WIDTH))
    before, after = np.empty(panels.shape), np.empty(panels.shape)
    changes = np.zeros((further, panel_count, PANEL_WIDTH))
    end_changes = np.zeros((further, 6))
    turning_changes = np.zeros((further, turning.shape[1], turning.shape[2]))
    node_changes = np.empty((LOADS + further, panel_count + 1, 6))
    tip_changes = np.empty((LOADS + further, 3))
    ends, section = np.empty(6), np.empty(sections.shape[1:])
    for k in range(knot_count):
        turning_changes[k] = knot_turning[k]
    for rod in range(nodes.shape[0]):
        for i in range(3):
            ends[i], ends[3 + i] = clamp[rod, i], loads[rod, i]
        prepare(length, sections[rod], knots, turning[rod], ends, counts, panels)
        for k in range(knot_count):
            prepare(length, sections[rod], knots, knot_turning[k], ends, counts, after)
            for p in range(panel_count):
                for i in range(10, 15):
                    changes[k, p, i] = after[p, i]
        for k in range(column_count):
            section[:] = sections[rod]
            at, column = columns[k, 0], columns[k, 1]
            section[at, column] = sections[rod, at, column] - steps[k]
            prepare(length, section, knots, turning[rod], ends, counts, before)
            section[at, column] = sections[rod, at, column] + steps[k]
            prepare(length, section, knots, turning[rod], ends, counts, after)
            for p in range(panel_count):
                for i in range(PANEL_WIDTH):
                    difference = after[p, i] - before[p, i]
                    changes[knot_count + k, p, i] = difference * (0.5 / steps[k])
        stable[rod] = sensitivities(
            panels, ends, nodes[rod], changes, end_changes, node_changes, tip_changes
        )
        station_changes(
            panels,
            nodes[rod],
            knots,
            turning[rod],
            changes,
            turning_changes,
            node_changes,
            arclength,
            out[rod],
        )
