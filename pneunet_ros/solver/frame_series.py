"""Solve many rods in sequence on one mesh, each from its own or its neighbor's solution.

For fits: the shapes at stations and their sensitivity to every column of the record of the rod,
from which the sensitivity to any parameter follows by the chain rule.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import newton, panel_counts, prepare, unloaded_nodes
from pneunet_ros.solver.columns import set_ends, write
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.linearization import station_changes
from pneunet_ros.solver.panel import C1, C2, C3, C4, GAUSS_POINTS
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.sensitivity import sensitivities
from pneunet_ros.solver.settings import ACCEPTED

Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


class FrameSolutions(NamedTuple):
    """Solutions of all frames on one mesh, filled by the kernels below.

    counts (sections,) panels; arclength (stations,) m; nodes (n, panels + 1, 6), solutions where
    `known` (n,); fields (n, 6, stations); detail (n,) m: from `resolution`; stable (n,).
    """

    counts: Integers
    arclength: Array
    nodes: Array
    known: Flags
    fields: Array
    detail: Array
    stable: Flags


@kernel
def most_panels(
    rods: Rods, loads: Array, decay_lengths: float, turn: float, most: int
) -> Integers:
    """Return a number of panels per section that suffices for all rods, by `panel_counts`."""
    counts = np.zeros(rods.sections.shape[1], dtype=np.int64)
    ends = np.empty(col.END_WIDTH)
    for rod in range(len(loads)):
        set_ends(rods.clamp[rod], loads[rod], ends)
        needed = panel_counts(
            rods.length, rods.sections[rod], rods.rotation[rod], ends, decay_lengths, turn, most
        )
        for k in range(len(counts)):
            counts[k] = max(counts[k], needed[k])
    return counts


@kernel
def start_at_points(
    rods: Rods, loads: Array, frames: FrameSolutions, arclength: Array, points: Array
) -> None:
    """Start frames at the shape through points (n, 2, targets) m; NaN where none is seen.

    arclength (targets,) m: one at the clamp is not used. Fills nodes and known of the frames in
    which a point is seen.
    """
    nodes = frames.nodes
    panels = np.empty((nodes.shape[1] - 1, col.PANEL_WIDTH))
    ends = np.empty(col.END_WIDTH)
    at, heading = np.empty(arclength.size + 2), np.empty(arclength.size + 2)
    for rod in range(len(nodes)):
        clamp = rods.clamp[rod, col.CLAMP_ANGLE]
        count = headings_through(arclength, points[rod], clamp, at, heading)
        if count == 0:
            continue
        set_ends(rods.clamp[rod], loads[rod], ends)
        rotation = rods.rotation[rod]
        prepare(rods.length, rods.sections[rod], rods.knots, rotation, ends, frames.counts, panels)
        start_along(panels, ends, at[:count], heading[:count], nodes[rod])
        frames.known[rod] = True


@inner
def headings_through(
    arclength: Array, points: Array, clamp: float, at: Array, heading: Array
) -> int:
    """Fill the arclengths (m) and headings (rad) of an arm through points (2, targets) m.

    The heading at the middle of a chord is that of the chord. Returns the number of filled entries
    of (targets + 2,); 0 if no point is seen.
    """
    at[0] = last = x = y = turns = 0.0
    heading[0] = before = clamp
    count = 1
    for target in range(arclength.size):
        x_there, y_there = points[0, target], points[1, target]
        if arclength[target] <= 0.0 or not math.isfinite(x_there + y_there):
            continue
        chord = math.atan2(y_there - y, x_there - x)
        turns -= 2.0 * math.pi * round((chord - before) / (2.0 * math.pi))
        at[count], heading[count] = 0.5 * (arclength[target] + last), chord + turns
        last, x, y, before = arclength[target], x_there, y_there, chord
        count += 1
    if count == 1:
        return 0
    at[count] = last
    slope = (heading[count - 1] - heading[count - 2]) / (at[count - 1] - at[count - 2])
    heading[count] = heading[count - 1] + slope * (last - at[count - 1])
    return count + 1


@inner
def start_along(panels: Array, ends: Array, at: Array, heading: Array, nodes: Array) -> None:
    """Set nodes to a shape: heading (n,) rad at these arclengths (n,) m.

    The moment is in equilibrium with the load at the free end.
    """
    force_x, force_y = ends[col.END_X], ends[col.END_Y]
    moment = before = s_before = 0.0
    piece = 0
    for p in range(len(panels) + 1):
        row = panels[min(p, len(panels) - 1)]
        start, length = row[col.PANEL_START], row[col.PANEL_LENGTH]
        if p == len(panels):
            start += length
        for i in range(1 + GAUSS_POINTS if p < len(panels) else 1):
            s = start + (0.0, C1, C2, C3, C4)[i] * length
            while piece < at.size - 2 and s >= at[piece + 1]:
                piece += 1
            slope = (heading[piece + 1] - heading[piece]) / (at[piece + 1] - at[piece])
            theta = heading[piece] + slope * (min(s, at[at.size - 1]) - at[piece])
            across = force_y * math.cos(theta) - force_x * math.sin(theta)
            if p + i > 0:
                moment += 0.5 * (across + before) * (s - s_before)
            if i == 0:
                nodes[p, col.NODE_MOMENT] = moment
            nodes[p, i] = theta
            before, s_before = across, s
    for p in range(len(panels) + 1):
        nodes[p, col.NODE_MOMENT] = ends[col.END_MOMENT] + (moment - nodes[p, col.NODE_MOMENT])


@kernel
def solve_frames(
    rods: Rods,
    loads: Array,
    frames: FrameSolutions,
    first: int,
    most_iterations: int,
    tolerance: float,
) -> int:
    """Solve the rods from `first` on; return the first that Newton's method did not solve.

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
    """Write sensitivities at stations to out (n, causes, 6, stations), and the stability.

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
