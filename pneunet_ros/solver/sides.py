"""Solutions on both sides of a solution along a tangent, for the error of a linearization.

`sensitivities` gives the tangent, Newton's method the rods on both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel, not_literal
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import newton
from pneunet_ros.solver.columns import write
from pneunet_ros.solver.interpolation import at_stations
from pneunet_ros.solver.sensitivity import sensitivities
from pneunet_ros.solver.settings import ACCEPTED

FIRST_LOAD = not_literal(col.FORCE_X)
UNSTABLE, STABLE, NOT_DEFINED = range(3)  # stability of the same kind


class Response(NamedTuple):
    """A solved rod and its response to loads and further causes, in the form used by the kernels.

    panels, ends and nodes of the solution; knots (pieces + 1,) m and rotation (pieces, 5): as in
    `Rods`. panel_changes (further, panels, 16), end_changes (further, 6) and rotation_changes
    (further, pieces, 5) of the record, per further cause; node_changes (3 + further, panels + 1,
    6) of the solution, per load and per further cause.
    """

    panels: Array
    ends: Array
    nodes: Array
    knots: Array
    rotation: Array
    panel_changes: Array
    end_changes: Array
    rotation_changes: Array
    node_changes: Array


class SideNodes(NamedTuple):
    """The rods on both sides of a solution: panels, nodes and rotation (2, ...)."""

    panels: Array
    nodes: Array
    rotation: Array

    @classmethod
    def of(cls, response: Response) -> SideNodes:
        """Return storage for the rods on both sides of a solution."""
        return cls(
            panels=np.empty((2, *response.panels.shape)),
            nodes=np.empty((2, *response.nodes.shape)),
            rotation=np.empty((2, *response.rotation.shape)),
        )


@inner
def add_changes(amounts: Array, first: int, changes: Array, out: Array) -> None:
    """Add changes (causes, i, j), times the amounts of the first causes, to out (i, j)."""
    for cause in range(len(changes)):
        amount = amounts[first + cause]
        for i in range(out.shape[0]):
            for j in range(out.shape[1]):
                out[i, j] += amount * changes[cause, i, j]


@inner
def move(known: Array, share: float, way: Array, out: Array) -> None:
    """Set out to a table plus a share of a direction."""
    for i in range(known.shape[0]):
        for j in range(known.shape[1]):
            out[i, j] = known[i, j] + share * way[i, j]


@inner
def largest_turn(one: Array, other: Array) -> float:
    """Return the largest difference of the angles (rad) of two tables of nodes."""
    largest = 0.0
    for p in range(len(one)):
        for i in range(col.NODE_MOMENT):
            largest = max(largest, abs(one[p, i] - other[p, i]))
    return largest


@inner
def settle(
    panels: Array,
    ends: Array,
    nodes: Array,
    reach: float,
    kind: int,
    most_iterations: int,
    tolerance: float,
) -> bool:
    """Solve the rod from the end of a tangent; return whether it is a neighbor of the start.

    False if Newton's method moves further than the tangent, reach (rad), or to a rod of different
    stability.
    """
    predicted = np.empty_like(nodes)
    write(nodes, predicted)
    residual, _ = newton(panels, ends, nodes, most_iterations, tolerance)
    if not residual <= ACCEPTED or largest_turn(nodes, predicted) > reach + ACCEPTED:
        return False
    if kind == NOT_DEFINED:
        return True
    count = len(panels)
    no_panels, no_ends = np.empty((0, count, col.PANEL_WIDTH)), np.empty((0, col.END_WIDTH))
    changes, tip = np.empty((col.LOADS, count + 1, col.NODE_WIDTH)), np.empty((col.LOADS, 3))
    stable = sensitivities(panels, ends, nodes, no_panels, no_ends, changes, tip)
    return stable == (kind == STABLE)


@inner
def solve_sides(
    response: Response,
    direction: Array,
    kind: int,
    steps: Array,
    most_iterations: int,
    tolerance: float,
    sides: SideNodes,
) -> int:
    """Solve the rods on both sides of a solution; returns the index of the step, or -1.

    direction (3 + further,): the amount of each cause in a step of one; kind: the stability of the
    solution. Uses the first of the steps at which both sides have an equilibrium of this kind.
    """
    panels, ends, nodes, rotation = (
        response.panels,
        response.ends,
        response.nodes,
        response.rotation,
    )
    end_changes = response.end_changes
    count = len(panels)
    panel_way, node_way = np.zeros_like(panels), np.zeros_like(nodes)
    rotation_way = np.zeros_like(rotation)
    end_way, side_ends = np.zeros_like(ends), np.empty_like(ends)
    add_changes(direction, col.LOADS, response.panel_changes, panel_way)
    add_changes(direction, FIRST_LOAD, response.node_changes, node_way)
    add_changes(direction, col.LOADS, response.rotation_changes, rotation_way)
    for cause in range(len(end_changes)):
        for i in range(ends.size):
            end_way[i] += direction[col.LOADS + cause] * end_changes[cause, i]
    for cause in range(col.LOADS):
        end_way[col.END_X + cause] += direction[cause]
    largest, turned = 0.0, 0.0
    for p in range(count):
        panel_way[p, col.PANEL_FORCE_X] += direction[col.FORCE_X]
        panel_way[p, col.PANEL_FORCE_Y] += direction[col.FORCE_Y]
        for scale in (col.PANEL_LENGTH, col.PANEL_FLEXIBILITY):
            largest = max(largest, abs(panel_way[p, scale] / panels[p, scale]))
    for p in range(count + 1):
        for i in range(col.NODE_MOMENT):
            turned = max(turned, abs(node_way[p, i]))
    for which in range(steps.size):
        step = steps[which]
        if not step * largest < 1.0:
            continue  # a length or a rigidity would change sign
        both = True
        for side in range(2):
            share = step if side else -step
            for i in range(ends.size):
                side_ends[i] = ends[i] + share * end_way[i]
            move(panels, share, panel_way, sides.panels[side])
            move(nodes, share, node_way, sides.nodes[side])
            move(rotation, share, rotation_way, sides.rotation[side])
            both = both and settle(
                sides.panels[side],
                side_ends,
                sides.nodes[side],
                step * turned,
                kind,
                most_iterations,
                tolerance,
            )
        if both:
            return which
    return -1


@kernel
def second_difference(
    response: Response, sides: SideNodes, arclength: Array, factor: float, out: Array
) -> None:
    """Set out (3, n) to factor (r(+) + r(-) - 2 r(0)): x, y, theta at increasing places (m)."""
    knots, fields = response.knots, np.empty((col.FIELD_COUNT, arclength.size))
    at_stations(response.panels, response.nodes, knots, response.rotation, arclength, fields)
    for field in range(len(out)):  # x, y, theta
        for i in range(arclength.size):
            out[field, i] = -2.0 * fields[field, i]
    for side in range(2):
        panels, nodes, rotation = sides.panels[side], sides.nodes[side], sides.rotation[side]
        at_stations(panels, nodes, knots, rotation, arclength, fields)
        for field in range(len(out)):
            for i in range(arclength.size):
                out[field, i] += fields[field, i]
    for field in range(len(out)):
        for i in range(arclength.size):
            out[field, i] *= factor
