"""Many rods of one mesh at once: the loops over rods are innermost and become vector instructions.

The arrays are those of `collocation` with a last axis over rods. Every rod takes full Newton steps
until the slowest has converged; a rod that does not is left with its residual, for the single
solver to take up.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.solver.collocation import (
    NODE_WIDTH,
    PANEL_WIDTH,
    prepare,
    SLOPE_WIDTH,
    STEP_WIDTH,
)
from pneunet_ros.solver.interpolation import at_stations, resolution
from pneunet_ros.solver.panel import (
    dot,
    linear_panel,
    panel_residual,
    sine_cosine,
    substitute,
    times,
    W,
)

Array = npt.NDArray[np.float64]
L = 16  # rods at a time: their work fits the cache


@inlined
def from_panel(table: Array, p: int, width: int) -> Array:
    """Return a table of all panels from panel p on."""
    start = p * width * L
    return table[start:]


@kernel
def residuals(
    panels: Array, ends: Array, nodes: Array, slopes: Array, scale: Array, worst: Array
) -> None:
    """Residual of every rod (rad) into `worst`, and the slopes for the Newton step."""
    count = panels.size // (PANEL_WIDTH * L)
    last = from_panel(nodes, count, NODE_WIDTH)
    for k in range(L):
        sine, cosine = sine_cosine(last[0 * L + k])
        end_moment = ends[5 * L + k] - ends[2 * L + k] * (
            ends[3 * L + k] * cosine + ends[4 * L + k] * sine
        )
        at_clamp = abs(nodes[0 * L + k] - ends[0 * L + k] - ends[1 * L + k] * nodes[5 * L + k])
        worst[k] = at_clamp + abs(last[5 * L + k] - end_moment) * scale[k]
    for p in range(count):
        row = from_panel(panels, p, PANEL_WIDTH)
        node = from_panel(nodes, p, NODE_WIDTH)
        following = from_panel(nodes, p + 1, NODE_WIDTH)
        out = from_panel(slopes, p, SLOPE_WIDTH)
        for k in range(L):
            r, theta_b, moment_b, slope, e = panel_residual(
                row[0 * L + k],
                (row[1 * L + k], row[2 * L + k], 0.0),
                (
                    row[4 * L + k],
                    row[5 * L + k],
                    row[6 * L + k],
                    row[7 * L + k],
                    row[8 * L + k],
                    row[9 * L + k],
                ),
                (
                    row[10 * L + k],
                    row[11 * L + k],
                    row[12 * L + k],
                    row[13 * L + k],
                    row[14 * L + k],
                ),
                node[0 * L + k],
                (node[1 * L + k], node[2 * L + k], node[3 * L + k], node[4 * L + k]),
                node[5 * L + k],
            )
            r5 = theta_b - following[0 * L + k]
            r6 = moment_b - following[5 * L + k]
            out[0 * L + k], out[1 * L + k], out[2 * L + k], out[3 * L + k] = r
            out[4 * L + k], out[5 * L + k] = r5, r6
            out[6 * L + k], out[7 * L + k], out[8 * L + k], out[9 * L + k] = slope
            out[10 * L + k], out[11 * L + k], out[12 * L + k], out[13 * L + k] = e
            size = abs(r[0]) + abs(r[1]) + abs(r[2]) + abs(r[3]) + abs(r5) + abs(r6) * scale[k]
            worst[k] = worst[k] + size


@kernel
def full_steps(
    ends: Array, nodes: Array, slopes: Array, steps: Array, scale: Array, v: Array
) -> None:
    """One full Newton step of every rod; `steps` and `v` (5, rods) are scratch."""
    count = slopes.size // (SLOPE_WIDTH * L)
    last = from_panel(nodes, count, NODE_WIDTH)
    for k in range(L):
        norm = 1.0 / np.sqrt(ends[1 * L + k] * ends[1 * L + k] + scale[k] * scale[k])
        v[0 * L + k], v[1 * L + k] = ends[1 * L + k] * norm, norm
        v[2 * L + k] = ends[0 * L + k] + ends[1 * L + k] * nodes[5 * L + k] - nodes[0 * L + k]
        v[3 * L + k] = 0.0
    for p in range(count):
        row = from_panel(slopes, p, SLOPE_WIDTH)
        out = from_panel(steps, p, STEP_WIDTH)
        for k in range(L):
            slope = (row[6 * L + k], row[7 * L + k], row[8 * L + k], row[9 * L + k])
            triangle, x, flexibility, b = linear_panel(
                slope, (row[10 * L + k], row[11 * L + k], row[12 * L + k], row[13 * L + k])
            )
            to_theta, to_moment = times(flexibility[4], slope), times(W, slope)
            z = substitute(
                triangle, (row[0 * L + k], row[1 * L + k], row[2 * L + k], row[3 * L + k])
            )
            y = substitute(triangle, (1.0, 1.0, 1.0, 1.0))
            x = substitute(triangle, x)
            out[0 * L + k], out[1 * L + k], out[2 * L + k], out[3 * L + k] = z
            out[4 * L + k], out[5 * L + k], out[6 * L + k], out[7 * L + k] = y
            out[8 * L + k], out[9 * L + k], out[10 * L + k], out[11 * L + k] = x
            v0, v1, w0, w1 = v[0 * L + k], v[1 * L + k], v[2 * L + k], v[3 * L + k]
            out[12 * L + k], out[13 * L + k], out[14 * L + k], out[15 * L + k] = v0, v1, w0, w1
            f1, f2 = 1.0 + dot(to_theta, y), b + dot(to_theta, x)
            g1, g2 = dot(to_moment, y), 1.0 + dot(to_moment, x)
            w2 = row[4 * L + k] + dot(to_theta, z) + f1 * w0 + f2 * w1
            w3 = row[5 * L + k] + dot(to_moment, z) + g1 * w0 + g2 * w1
            v2, v3 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
            s = scale[k]
            shrink = 1.0 / np.sqrt(v2 * v2 + v3 * v3 * s * s)
            v2, v3 = v2 * shrink, v3 * shrink
            along = w2 * v2 + w3 * v3 * s * s
            out[16 * L + k], out[17 * L + k] = along, shrink
            v[0 * L + k], v[1 * L + k] = v2, v3
            v[2 * L + k], v[3 * L + k] = w2 - along * v2, w3 - along * v3
    for k in range(L):
        sine, cosine = sine_cosine(last[0 * L + k])
        end_moment = ends[5 * L + k] - ends[2 * L + k] * (
            ends[3 * L + k] * cosine + ends[4 * L + k] * sine
        )
        end_slope = ends[2 * L + k] * (ends[4 * L + k] * cosine - ends[3 * L + k] * sine)
        given = end_moment - last[5 * L + k] - v[3 * L + k] - end_slope * v[2 * L + k]
        t = given / (v[1 * L + k] + end_slope * v[0 * L + k])
        last[0 * L + k] = last[0 * L + k] + v[2 * L + k] + t * v[0 * L + k]
        last[5 * L + k] = last[5 * L + k] + v[3 * L + k] + t * v[1 * L + k]
        v[4 * L + k] = t
    for p in range(count - 1, -1, -1):
        out = from_panel(steps, p, STEP_WIDTH)
        node = from_panel(nodes, p, NODE_WIDTH)
        for k in range(L):
            t = (v[4 * L + k] - out[16 * L + k]) * out[17 * L + k]
            v[4 * L + k] = t
            d0 = out[14 * L + k] + t * out[12 * L + k]
            d1 = out[15 * L + k] + t * out[13 * L + k]
            node[0 * L + k] = node[0 * L + k] + d0
            node[1 * L + k] = (
                node[1 * L + k] + out[0 * L + k] + out[4 * L + k] * d0 + out[8 * L + k] * d1
            )
            node[2 * L + k] = (
                node[2 * L + k] + out[1 * L + k] + out[5 * L + k] * d0 + out[9 * L + k] * d1
            )
            node[3 * L + k] = (
                node[3 * L + k] + out[2 * L + k] + out[6 * L + k] * d0 + out[10 * L + k] * d1
            )
            node[4 * L + k] = (
                node[4 * L + k] + out[3 * L + k] + out[7 * L + k] * d0 + out[11 * L + k] * d1
            )
            node[5 * L + k] = node[5 * L + k] + d1


@kernel
def newton_many(
    length: float,
    sections: Array,
    knots: Array,
    turning: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    starts: Array,
    most_iterations: int,
    tolerance: float,
    out: Array,
    reached: Array,
) -> None:
    """Solve many rods of one mesh, a block of them at a time.

    sections (rods, sections, 8), turning (rods, pieces, 5), ends (rods, 6). The first guesses are
    in starts (6 (panels + 1), rods), the nodes go to `out` of the same shape, and the residuals
    (rad; here the sum over the equations) to `reached` (rods,).
    """
    count = starts.shape[0] // NODE_WIDTH - 1
    panels = np.empty(count * PANEL_WIDTH * L)
    columns = panels.reshape(count, PANEL_WIDTH, L)
    nodes = np.empty((count + 1) * NODE_WIDTH * L)
    slopes = np.empty(count * SLOPE_WIDTH * L)
    steps = np.empty(count * STEP_WIDTH * L)
    end, v = np.empty(6 * L), np.empty(5 * L)
    scale, worst = np.empty(L), np.empty(L)
    for first in range(0, ends.shape[0], L):
        for k in range(L):
            rod = min(first + k, ends.shape[0] - 1)
            prepare(
                length, sections[rod], knots, turning[rod], ends[rod], counts, columns[:, :, k]
            )
            scale[k] = 0.0
            for section in range(sections.shape[1]):
                scale[k] = max(scale[k], length / abs(sections[rod, section, 1]))
            for column in range(6):
                end[column * L + k] = ends[rod, column]
        for row in range(starts.shape[0]):
            for k in range(L):
                nodes[row * L + k] = starts[row, min(first + k, ends.shape[0] - 1)]
        residuals(panels, end, nodes, slopes, scale, worst)
        for _ in range(most_iterations):
            if worst.max() <= tolerance:
                break
            full_steps(end, nodes, slopes, steps, scale, v)
            residuals(panels, end, nodes, slopes, scale, worst)
        block = min(L, ends.shape[0] - first)
        for k in range(block):
            reached[first + k] = worst[k]
        for row in range(starts.shape[0]):
            for k in range(block):
                out[row, first + k] = nodes[row * L + k]


@kernel
def evaluate_many(
    length: float,
    sections: Array,
    knots: Array,
    turning: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    nodes: Array,
    arclength: Array,
    fields: Array,
    detail: Array,
) -> None:
    """Stations of solved rods into fields (6, rods, stations), `resolution` into `detail`."""
    count = nodes.shape[0] // NODE_WIDTH - 1
    panels = np.empty((count, PANEL_WIDTH))
    own = np.empty((count + 1, NODE_WIDTH))
    out = np.empty((6, arclength.size))
    for rod in range(nodes.shape[1]):
        for p in range(count + 1):
            for column in range(NODE_WIDTH):
                own[p, column] = nodes[p * NODE_WIDTH + column, rod]
        prepare(length, sections[rod], knots, turning[rod], ends[rod], counts, panels)
        at_stations(panels, own, knots, turning[rod], arclength, out)
        fields[:, rod] = out
        detail[rod] = resolution(panels, own)
