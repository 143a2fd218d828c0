"""Solve a batch of rods on one mesh: the innermost loops run over rods, as vector instructions.

The tables are those of `solver.columns`, each entry once per rod of a block, flat. All rods take
full Newton steps until the slowest has converged; a rod that does not converge keeps its residual,
and the single solver solves it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import ONES, prepare
from pneunet_ros.solver.columns import set_ends, write
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.panel import (
    dot,
    Four,
    free_end,
    linear_panel,
    panel_residual,
    substitute,
    times,
    W,
)
from pneunet_ros.solver.rod import Rods

B = 16  # rods of a block: their work fits the cache
# The sweep over the panels: free state, particular state, how far along the free one.
FREE_THETA, FREE_MOMENT, HELD_THETA, HELD_MOMENT, ALONG = range(5)
SWEEP_WIDTH = 5


@inlined
def from_panel(table: Array, p: int, width: int) -> Array:
    """Return a table of all panels from panel p on."""
    start = p * width * B
    return table[start:]


@inlined
def four(table: Array, first: int, k: int) -> Four:
    """Return the entries of rod k at the four Gauss points."""
    i = first * B + k
    return table[i], table[i + B], table[i + 2 * B], table[i + 3 * B]


@inlined
def set_four(table: Array, first: int, k: int, values: Four) -> None:
    """Write the entries of rod k at the four Gauss points."""
    i = first * B + k
    table[i], table[i + B], table[i + 2 * B], table[i + 3 * B] = values


@inlined
def end_load(ends: Array, k: int) -> Four:
    """Return transverse offset, F1, F2 and M of the load on the free end of rod k."""
    offset, moment = ends[col.LOAD_OFFSET * B + k], ends[col.END_MOMENT * B + k]
    return offset, ends[col.END_X * B + k], ends[col.END_Y * B + k], moment


@inner
def residuals(
    panels: Array, ends: Array, nodes: Array, slopes: Array, scale: Array, worst: Array
) -> None:
    """Write the residual of every rod (rad) to `worst`, and compute slopes for the Newton step."""
    count = panels.size // (col.PANEL_WIDTH * B)
    last = from_panel(nodes, count, col.NODE_WIDTH)
    for k in range(B):
        end_moment, _ = free_end(end_load(ends, k), last[col.NODE_THETA * B + k])
        given = nodes[col.NODE_THETA * B + k] - ends[col.CLAMP_ANGLE * B + k]
        at_clamp = abs(given - ends[col.CLAMP_COMPLIANCE * B + k] * nodes[col.NODE_MOMENT * B + k])
        worst[k] = at_clamp + abs(last[col.NODE_MOMENT * B + k] - end_moment) * scale[k]
    for p in range(count):
        row = from_panel(panels, p, col.PANEL_WIDTH)
        node = from_panel(nodes, p, col.NODE_WIDTH)
        following = from_panel(nodes, p + 1, col.NODE_WIDTH)
        out = from_panel(slopes, p, col.SLOPE_WIDTH)
        for k in range(B):
            turn_1, turn_2, turn_3, turn_4 = four(row, col.PANEL_ROTATION, k)
            r, theta_b, moment_b, of_moment, of_theta = panel_residual(
                row[col.PANEL_LENGTH * B + k],
                (row[col.PANEL_FLEXIBILITY * B + k], row[col.PANEL_OFFSET * B + k], 0.0),
                (
                    row[col.PANEL_AXIAL * B + k],
                    row[col.PANEL_STRETCH * B + k],
                    row[col.PANEL_FORCE_X * B + k],
                    row[col.PANEL_FORCE_Y * B + k],
                    row[col.PANEL_LOSS_X * B + k],
                    row[col.PANEL_LOSS_Y * B + k],
                ),
                (turn_1, turn_2, turn_3, turn_4, row[col.PANEL_ROTATION_END * B + k]),
                node[col.NODE_THETA * B + k],
                four(node, col.NODE_GAUSS, k),
                node[col.NODE_MOMENT * B + k],
            )
            theta_gap = theta_b - following[col.NODE_THETA * B + k]
            moment_gap = moment_b - following[col.NODE_MOMENT * B + k]
            set_four(out, col.SLOPE_RESIDUAL, k, r)
            out[col.SLOPE_THETA_GAP * B + k], out[col.SLOPE_MOMENT_GAP * B + k] = (
                theta_gap,
                moment_gap,
            )
            set_four(out, col.SLOPE_OF_MOMENT, k, of_moment)
            set_four(out, col.SLOPE_OF_THETA, k, of_theta)
            r1, r2, r3, r4 = r
            size = abs(r1) + abs(r2) + abs(r3) + abs(r4) + abs(theta_gap)
            worst[k] = worst[k] + (size + abs(moment_gap) * scale[k])


@inner
def full_steps(
    ends: Array, nodes: Array, slopes: Array, steps: Array, scale: Array, sweep: Array
) -> None:
    """Take one full Newton step of every rod; `steps` and `sweep` (5, rods) are scratch."""
    count = slopes.size // (col.SLOPE_WIDTH * B)
    last = from_panel(nodes, count, col.NODE_WIDTH)
    for k in range(B):
        give = ends[col.CLAMP_COMPLIANCE * B + k]
        norm = 1.0 / np.sqrt(give * give + scale[k] * scale[k])
        sweep[FREE_THETA * B + k], sweep[FREE_MOMENT * B + k] = give * norm, norm
        given = ends[col.CLAMP_ANGLE * B + k] + give * nodes[col.NODE_MOMENT * B + k]
        sweep[HELD_THETA * B + k] = given - nodes[col.NODE_THETA * B + k]
        sweep[HELD_MOMENT * B + k] = 0.0
    for p in range(count):
        row = from_panel(slopes, p, col.SLOPE_WIDTH)
        out = from_panel(steps, p, col.STEP_WIDTH)
        for k in range(B):
            slope = four(row, col.SLOPE_OF_MOMENT, k)
            triangle, x, flexibility, b = linear_panel(slope, four(row, col.SLOPE_OF_THETA, k))
            _, _, _, _, flexibility_b = flexibility
            to_theta, to_moment = times(flexibility_b, slope), times(W, slope)
            z = substitute(triangle, four(row, col.SLOPE_RESIDUAL, k))
            y = substitute(triangle, ONES)
            x = substitute(triangle, x)
            set_four(out, col.STEP_RESIDUAL, k, z)
            set_four(out, col.STEP_PER_THETA, k, y)
            set_four(out, col.STEP_PER_MOMENT, k, x)
            v0, v1 = sweep[FREE_THETA * B + k], sweep[FREE_MOMENT * B + k]
            w0, w1 = sweep[HELD_THETA * B + k], sweep[HELD_MOMENT * B + k]
            out[col.STEP_FREE_THETA * B + k], out[col.STEP_FREE_MOMENT * B + k] = v0, v1
            out[col.STEP_HELD_THETA * B + k], out[col.STEP_HELD_MOMENT * B + k] = w0, w1
            f1, f2 = 1.0 + dot(to_theta, y), b + dot(to_theta, x)
            g1, g2 = dot(to_moment, y), 1.0 + dot(to_moment, x)
            w2 = row[col.SLOPE_THETA_GAP * B + k] + dot(to_theta, z) + f1 * w0 + f2 * w1
            w3 = row[col.SLOPE_MOMENT_GAP * B + k] + dot(to_moment, z) + g1 * w0 + g2 * w1
            v2, v3 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
            s = scale[k]
            shrink = 1.0 / np.sqrt(v2 * v2 + v3 * v3 * s * s)
            v2, v3 = v2 * shrink, v3 * shrink
            along = w2 * v2 + w3 * v3 * s * s
            out[col.STEP_ALONG * B + k], out[col.STEP_SHRINK * B + k] = along, shrink
            sweep[FREE_THETA * B + k], sweep[FREE_MOMENT * B + k] = v2, v3
            sweep[HELD_THETA * B + k] = w2 - along * v2
            sweep[HELD_MOMENT * B + k] = w3 - along * v3
    for k in range(B):
        v0, v1 = sweep[FREE_THETA * B + k], sweep[FREE_MOMENT * B + k]
        w0, w1 = sweep[HELD_THETA * B + k], sweep[HELD_MOMENT * B + k]
        end_moment, end_slope = free_end(end_load(ends, k), last[col.NODE_THETA * B + k])
        t = (end_moment - last[col.NODE_MOMENT * B + k] - w1 - end_slope * w0) / (
            v1 + end_slope * v0
        )
        last[col.NODE_THETA * B + k] = last[col.NODE_THETA * B + k] + w0 + t * v0
        last[col.NODE_MOMENT * B + k] = last[col.NODE_MOMENT * B + k] + w1 + t * v1
        sweep[ALONG * B + k] = t
    for p in range(count - 1, -1, -1):
        out = from_panel(steps, p, col.STEP_WIDTH)
        node = from_panel(nodes, p, col.NODE_WIDTH)
        for k in range(B):
            t = (sweep[ALONG * B + k] - out[col.STEP_ALONG * B + k]) * out[col.STEP_SHRINK * B + k]
            sweep[ALONG * B + k] = t
            d0 = out[col.STEP_HELD_THETA * B + k] + t * out[col.STEP_FREE_THETA * B + k]
            d1 = out[col.STEP_HELD_MOMENT * B + k] + t * out[col.STEP_FREE_MOMENT * B + k]
            n1, n2, n3, n4 = four(node, col.NODE_GAUSS, k)
            z1, z2, z3, z4 = four(out, col.STEP_RESIDUAL, k)
            y1, y2, y3, y4 = four(out, col.STEP_PER_THETA, k)
            x1, x2, x3, x4 = four(out, col.STEP_PER_MOMENT, k)
            moved = (
                n1 + z1 + y1 * d0 + x1 * d1,
                n2 + z2 + y2 * d0 + x2 * d1,
                n3 + z3 + y3 * d0 + x3 * d1,
                n4 + z4 + y4 * d0 + x4 * d1,
            )
            node[col.NODE_THETA * B + k] = node[col.NODE_THETA * B + k] + d0
            set_four(node, col.NODE_GAUSS, k, moved)
            node[col.NODE_MOMENT * B + k] = node[col.NODE_MOMENT * B + k] + d1


@kernel
def newton_batch(
    rods: Rods,
    loads: Array,
    counts: npt.NDArray[np.int64],
    starts: Array,
    most_iterations: int,
    tolerance: float,
    out: Array,
    reached: Array,
) -> None:
    """Solve all rods under loads (rods, 3) of F1, F2, M on one mesh, a block of them at a time.

    The first guesses are in starts (6 (panels + 1), rods), the nodes go to `out` of the same
    shape, and the residuals (rad; here the sum over the equations) to `reached` (rods,).
    """
    count = len(starts) // col.NODE_WIDTH - 1
    panels = np.empty(count * col.PANEL_WIDTH * B)
    panels_of_one = np.empty((count, col.PANEL_WIDTH))
    nodes = np.empty((count + 1) * col.NODE_WIDTH * B)
    slopes = np.empty(count * col.SLOPE_WIDTH * B)
    steps = np.empty(count * col.STEP_WIDTH * B)
    end, ends, sweep = (
        np.empty(col.END_WIDTH),
        np.empty(col.END_WIDTH * B),
        np.empty(SWEEP_WIDTH * B),
    )
    scale, worst = np.empty(B), np.empty(B)
    for first in range(0, len(loads), B):
        for k in range(B):
            rod = min(first + k, len(loads) - 1)
            sections, rotation = rods.sections[rod], rods.rotation[rod]
            set_ends(rods.clamp[rod], loads[rod], end)
            prepare(rods.length, sections, rods.knots, rotation, end, counts, panels_of_one)
            for p in range(count):
                for column in range(col.PANEL_WIDTH):
                    panels[(p * col.PANEL_WIDTH + column) * B + k] = panels_of_one[p, column]
            scale[k] = 0.0
            for section in range(len(sections)):
                scale[k] = max(scale[k], rods.length / abs(sections[section, col.RIGIDITY]))
            for column in range(col.END_WIDTH):
                ends[column * B + k] = end[column]
        for row in range(len(starts)):
            for k in range(B):
                nodes[row * B + k] = starts[row, min(first + k, len(loads) - 1)]
        residuals(panels, ends, nodes, slopes, scale, worst)
        for _ in range(most_iterations):
            settled = True
            for k in range(B):
                settled = settled and worst[k] <= tolerance
            if settled:
                break
            full_steps(ends, nodes, slopes, steps, scale, sweep)
            residuals(panels, ends, nodes, slopes, scale, worst)
        block = min(B, len(loads) - first)
        for k in range(block):
            reached[first + k] = worst[k]
        for row in range(len(starts)):
            for k in range(block):
                out[row, first + k] = nodes[row * B + k]


@kernel
def evaluate_batch(
    rods: Rods,
    loads: Array,
    counts: npt.NDArray[np.int64],
    nodes: Array,
    arclength: Array,
    fields: Array,
    detail: Array,
    missed: Array,
) -> None:
    """Write stations of rods to fields (6, rods, stations), `resolution` to `detail` (m).

    The error (rad) of each between its nodes is written into `missed`.
    """
    count = len(nodes) // col.NODE_WIDTH - 1
    panels = np.empty((count, col.PANEL_WIDTH))
    own = np.empty((count + 1, col.NODE_WIDTH))
    end = np.empty(col.END_WIDTH)
    out = np.empty((col.FIELD_COUNT, arclength.size))
    for rod in range(len(loads)):
        for p in range(count + 1):
            for column in range(col.NODE_WIDTH):
                own[p, column] = nodes[p * col.NODE_WIDTH + column, rod]
        rotation = rods.rotation[rod]
        set_ends(rods.clamp[rod], loads[rod], end)
        prepare(rods.length, rods.sections[rod], rods.knots, rotation, end, counts, panels)
        missed[rod] = at_stations(panels, own, rods.knots, rotation, arclength, out)
        write(out, fields[:, rod])
        detail[rod] = resolution(panels, own, rods.knots, rotation)
