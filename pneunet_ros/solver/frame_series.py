"""Many rods one after the other on one mesh, each from its own or its neighbor's solution.

For fits: beside the shapes at stations, their sensitivity to every column of the record of the
rod, from which the sensitivity to any parameter follows by the chain rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import newton, prepare, unloaded_nodes
from pneunet_ros.solver.columns import set_ends, write
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.linearization import station_changes
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.sensitivity import sensitivities
from pneunet_ros.solver.settings import ACCEPTED

Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


class FrameSolutions(NamedTuple):
    """Solutions of all frames on one mesh, filled by the kernels below.

    counts (sections,) panels; arclength (stations,) m; nodes (n, panels + 1, 6), solutions where
    `known` (n,); fields (n, 6, stations); detail (n,) m as of `resolution`; stable (n,).
    """

    counts: Integers
    arclength: Array
    nodes: Array
    known: Flags
    fields: Array
    detail: Array
    stable: Flags


@kernel
def solve_frames(
    rods: Rods,
    loads: Array,
    frames: FrameSolutions,
    first: int,
    most_iterations: int,
    tolerance: float,
) -> int:
    """Solve the rods from `first` on; returns the first that Newton's method did not solve.

    loads (n, 3) of F1, F2, M. Fills nodes, known, fields and detail of the frames.
    """
    nodes = frames.nodes
    panels = np.empty((nodes.shape[1] - 1, col.PANEL_WIDTH))
    ends = np.empty(col.END_WIDTH)
    for rod in range(first, len(nodes)):
        rotation = rods.rotation[rod]
        set_ends(rods.clamp[rod], loads[rod], ends)
        prepare(rods.length, rods.sections[rod], rods.knots, rotation, ends, frames.counts, panels)
        if not frames.known[rod]:
            if rod == 0:
                unloaded_nodes(panels, ends, nodes[rod])
            else:
                write(nodes[rod - 1], nodes[rod])
        residual, _ = newton(panels, ends, nodes[rod], most_iterations, tolerance)
        if not residual <= ACCEPTED:
            return rod
        frames.known[rod] = True
        at_stations(panels, nodes[rod], rods.knots, rotation, frames.arclength, frames.fields[rod])
        frames.detail[rod] = resolution(panels, nodes[rod], rods.knots, rotation)
    return len(nodes)


@kernel
def linearize_frames(
    rods: Rods,
    loads: Array,
    frames: FrameSolutions,
    knot_rotation: Array,
    columns: Integers,
    steps: Array,
    out: Array,
) -> None:
    """Sensitivity of solved rods at stations, into out (n, causes, 6, stations), and stability.

    The causes: F1, F2, M; a unit of each knot of the curvature's table (knot_rotation (knots,
    pieces, 5) is its intrinsic rotation); each column of a section (columns (k, 2): section and
    column, steps (k,) for their difference).
    """
    nodes, counts = frames.nodes, frames.counts
    panel_count = nodes.shape[1] - 1
    knot_count, column_count = len(knot_rotation), len(columns)
    further = knot_count + column_count
    panels = np.empty((panel_count, col.PANEL_WIDTH))
    before, after = np.empty(panels.shape), np.empty(panels.shape)
    changes = np.zeros((further, panel_count, col.PANEL_WIDTH))
    end_changes = np.zeros((further, col.END_WIDTH))
    rotation_changes = np.zeros((further, rods.rotation.shape[1], rods.rotation.shape[2]))
    node_changes = np.empty((col.LOADS + further, panel_count + 1, nodes.shape[2]))
    tip_changes = np.empty((col.LOADS + further, col.TIP_WIDTH))
    ends, section = np.empty(col.END_WIDTH), np.empty((rods.sections.shape[1], col.SECTION_WIDTH))
    for k in range(knot_count):
        write(knot_rotation[k], rotation_changes[k])
    for rod in range(len(nodes)):
        sections, rotation = rods.sections[rod], rods.rotation[rod]
        set_ends(rods.clamp[rod], loads[rod], ends)
        prepare(rods.length, sections, rods.knots, rotation, ends, counts, panels)
        for k in range(knot_count):
            prepare(rods.length, sections, rods.knots, knot_rotation[k], ends, counts, after)
            for p in range(panel_count):
                for i in range(col.PANEL_ROTATION, col.PANEL_ROTATION_END + 1):
                    changes[k, p, i] = after[p, i]
        for k in range(column_count):
            write(sections, section)
            at, column = columns[k, col.PLACE_SECTION], columns[k, col.PLACE_COLUMN]
            section[at, column] = sections[at, column] - steps[k]
            prepare(rods.length, section, rods.knots, rotation, ends, counts, before)
            section[at, column] = sections[at, column] + steps[k]
            prepare(rods.length, section, rods.knots, rotation, ends, counts, after)
            for p in range(panel_count):
                for i in range(col.PANEL_WIDTH):
                    difference = after[p, i] - before[p, i]
                    changes[knot_count + k, p, i] = difference * (0.5 / steps[k])
        frames.stable[rod] = sensitivities(
            panels, ends, nodes[rod], changes, end_changes, node_changes, tip_changes
        )
        station_changes(
            panels,
            nodes[rod],
            rods.knots,
            rotation,
            changes,
            rotation_changes,
            node_changes,
            frames.arclength,
            out[rod],
        )
