"""Solve the boundary value problem of the rod by Gauss collocation and Newton's method.

The rod is cut into panels, always at a jump of the moment law. On each panel the field equations
hold at four Gauss points (order eight at the joints); the linearized panels are eliminated one by
one and joined by an orthonormalized sweep, which stays stable where shooting grows like exp(l
sqrt(F/B)). The intrinsic rotation is known in closed form and subtracted, so kinks in its table
hardly matter. The tables `panels`, `nodes`, `ends`, ... are those of `solver.columns`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel, not_literal
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.columns import end_load, four, powers, read_panel, set_four
from pneunet_ros.solver.panel import (
    C1,
    C2,
    C3,
    C4,
    dot,
    free_end,
    GAUSS_POINTS,
    linear_panel,
    panel_residual,
    substitute,
    times,
    W,
)
from pneunet_ros.solver.settings import ACCEPTED, FEWEST_PANELS, NEWTON_HALVINGS

ONES = (1.0, 1.0, 1.0, 1.0)
FIRST_PIECE = not_literal(0)


@inner
def rotation_at(s: float, knots: Array, rotation: Array, piece: int) -> tuple[float, int]:
    """Return the intrinsic rotation (rad) from the clamp to s; searches from `piece` on."""
    while piece < knots.size - 2 and s >= knots[piece + 1]:
        piece += 1
    t = s - knots[piece]
    c0, c1, c2, c3, c4 = powers(rotation[piece])
    return c0 + t * (c1 + t * (c2 + t * (c3 + t * c4))), piece


@kernel
def panel_counts(
    length: float,
    sections: Array,
    rotation: Array,
    ends: Array,
    decay_lengths: float,
    turn: float,
    most: int,
) -> npt.NDArray[np.int64]:
    """Return the panels per section, limited in decay lengths sqrt(B/n) and in rotation."""
    counts = np.empty(len(sections), dtype=np.int64)
    bend = 0.0
    for piece in range(len(rotation)):
        bend = max(bend, abs(rotation[piece, col.CURVATURE_AT_KNOT]))
    force = math.hypot(ends[col.END_X], ends[col.END_Y])
    for k in range(len(sections)):
        force += math.hypot(sections[k, col.LOAD_X], sections[k, col.LOAD_Y]) * length
    for k in range(len(sections)):
        stop = length if k + 1 == len(sections) else sections[k + 1, col.START]
        flexibility = abs(1.0 / sections[k, col.RIGIDITY])
        per_length = max(
            math.sqrt(force * flexibility) / decay_lengths,
            (bend + abs(ends[col.END_MOMENT]) * flexibility) / turn,
            FEWEST_PANELS / length,
        )
        needed = math.ceil((stop - sections[k, col.START]) * per_length)
        counts[k] = max(1, int(min(needed, most // len(sections))))
    return counts


@kernel
def prepare(
    length: float,
    sections: Array,
    knots: Array,
    rotation: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    panels: Array,
) -> None:
    """Fill `panels` for a mesh of counts[k] equal panels on each section of the moment law."""
    n1, n2 = ends[col.END_X], ends[col.END_Y]
    first = len(panels)
    for k in range(len(sections) - 1, -1, -1):
        section = sections[k]
        stop = length if k + 1 == len(sections) else sections[k + 1, col.START]
        h = (stop - section[col.START]) / counts[k]
        flexibility = 1.0 / section[col.RIGIDITY]
        first -= counts[k]
        for j in range(counts[k] - 1, -1, -1):
            panel = panels[first + j]
            q1, q2 = h * section[col.LOAD_X], h * section[col.LOAD_Y]
            n1 += q1
            n2 += q2
            panel[col.PANEL_LENGTH] = h
            panel[col.PANEL_FLEXIBILITY] = flexibility
            panel[col.PANEL_OFFSET] = section[col.MOMENT_OFFSET]
            panel[col.PANEL_CUBIC] = section[col.CUBIC]
            panel[col.PANEL_AXIAL] = section[col.AXIAL_COMPLIANCE]
            panel[col.PANEL_STRETCH] = 1.0 + section[col.REST_STRAIN]
            panel[col.PANEL_FORCE_X], panel[col.PANEL_FORCE_Y] = n1, n2
            panel[col.PANEL_LOSS_X], panel[col.PANEL_LOSS_Y] = q1, q2
            panel[col.PANEL_START] = section[col.START] + j * h
    piece, start = FIRST_PIECE, 0.0
    for p in range(len(panels)):
        panel = panels[p]
        s, h = panel[col.PANEL_START], panel[col.PANEL_LENGTH]
        r1, piece = rotation_at(s + C1 * h, knots, rotation, piece)
        r2, piece = rotation_at(s + C2 * h, knots, rotation, piece)
        r3, piece = rotation_at(s + C3 * h, knots, rotation, piece)
        r4, piece = rotation_at(s + C4 * h, knots, rotation, piece)
        end, piece = rotation_at(s + h, knots, rotation, piece)
        set_four(panel, col.PANEL_ROTATION, (r1 - start, r2 - start, r3 - start, r4 - start))
        panel[col.PANEL_ROTATION_END] = end - start
        start = end


@kernel
def unloaded_nodes(panels: Array, ends: Array, nodes: Array) -> None:
    """Set the nodes to the unloaded rod: zero moment, theta follows the intrinsic curvature."""
    theta = ends[col.CLAMP_ANGLE]
    for p in range(len(panels)):
        node, panel = nodes[p], panels[p]
        node[col.NODE_THETA] = theta
        for i in range(GAUSS_POINTS):
            node[col.NODE_GAUSS + i] = theta + panel[col.PANEL_ROTATION + i]
        node[col.NODE_MOMENT] = 0.0
        theta += panel[col.PANEL_ROTATION_END]
    nodes[-1, col.NODE_THETA] = theta
    nodes[-1, col.NODE_MOMENT] = 0.0


@inner
def residual_pass(
    panels: Array, ends: Array, nodes: Array, slopes: Array, moment_scale: float
) -> float:
    """Return the residual in rad (moments times `moment_scale`); fills `slopes` for Newton."""
    count = len(panels)
    end_moment, _ = free_end(end_load(ends), nodes[count, col.NODE_THETA])
    given = nodes[0, col.NODE_THETA] - ends[col.CLAMP_ANGLE]
    worst = max(
        abs(given - ends[col.CLAMP_COMPLIANCE] * nodes[0, col.NODE_MOMENT]),
        abs(nodes[count, col.NODE_MOMENT] - end_moment) * moment_scale,
    )
    for p in range(count):
        h, law, mechanics, turn = read_panel(panels, p)
        node, following, row = nodes[p], nodes[p + 1], slopes[p]
        theta, moment = node[col.NODE_THETA], node[col.NODE_MOMENT]
        r, theta_b, moment_b, of_moment, of_theta = panel_residual(
            h, law, mechanics, turn, theta, four(node, col.NODE_GAUSS), moment
        )
        theta_gap = theta_b - following[col.NODE_THETA]
        moment_gap = moment_b - following[col.NODE_MOMENT]
        set_four(row, col.SLOPE_RESIDUAL, r)
        row[col.SLOPE_THETA_GAP], row[col.SLOPE_MOMENT_GAP] = theta_gap, moment_gap
        set_four(row, col.SLOPE_OF_MOMENT, of_moment)
        set_four(row, col.SLOPE_OF_THETA, of_theta)
        r1, r2, r3, r4 = r
        worst = max(worst, abs(r1), abs(r2), abs(r3), abs(r4), abs(theta_gap))
        worst = max(worst, abs(moment_gap) * moment_scale)
        if not worst < 1e300:
            return np.inf
    return worst


@inner
def newton_step(
    ends: Array, nodes: Array, slopes: Array, steps: Array, moment_scale: float
) -> None:
    """Take one full Newton step from the slopes of `residual_pass`; `steps` is scratch."""
    count = len(slopes)
    s = moment_scale
    # The state at a joint is w + t v: v spans the freedom left by the clamp, kept at unit length
    # in (rad, moment * s) and orthogonal to w, so that neither grows (Godunov's
    # orthonormalization).
    give, clamp = ends[col.CLAMP_COMPLIANCE], nodes[0]
    norm = 1.0 / math.sqrt(give * give + s * s)
    v0, v1 = give * norm, norm
    w0, w1 = ends[col.CLAMP_ANGLE] + give * clamp[col.NODE_MOMENT] - clamp[col.NODE_THETA], 0.0
    for p in range(count):
        row, out = slopes[p], steps[p]
        k = four(row, col.SLOPE_OF_MOMENT)
        triangle, x, flexibility, b = linear_panel(k, four(row, col.SLOPE_OF_THETA))
        _, _, _, _, flexibility_b = flexibility
        to_theta, to_moment = times(flexibility_b, k), times(W, k)
        z = substitute(triangle, four(row, col.SLOPE_RESIDUAL))
        y = substitute(triangle, ONES)
        x = substitute(triangle, x)
        set_four(out, col.STEP_RESIDUAL, z)
        set_four(out, col.STEP_PER_THETA, y)
        set_four(out, col.STEP_PER_MOMENT, x)
        out[col.STEP_FREE_THETA], out[col.STEP_FREE_MOMENT] = v0, v1
        out[col.STEP_HELD_THETA], out[col.STEP_HELD_MOMENT] = w0, w1
        f0, g0 = (
            row[col.SLOPE_THETA_GAP] + dot(to_theta, z),
            row[col.SLOPE_MOMENT_GAP] + dot(to_moment, z),
        )
        f1, f2 = 1.0 + dot(to_theta, y), b + dot(to_theta, x)
        g1, g2 = dot(to_moment, y), 1.0 + dot(to_moment, x)
        w0, w1 = f0 + f1 * w0 + f2 * w1, g0 + g1 * w0 + g2 * w1
        v0, v1 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
        shrink = 1.0 / math.sqrt(v0 * v0 + v1 * v1 * s * s)
        v0 *= shrink
        v1 *= shrink
        along = w0 * v0 + w1 * v1 * s * s
        w0 -= along * v0
        w1 -= along * v1
        out[col.STEP_ALONG], out[col.STEP_SHRINK] = along, shrink
    last = nodes[count]
    end_moment, end_slope = free_end(end_load(ends), last[col.NODE_THETA])
    t = (end_moment - last[col.NODE_MOMENT] - w1 - end_slope * w0) / (v1 + end_slope * v0)
    last[col.NODE_THETA] += w0 + t * v0
    last[col.NODE_MOMENT] += w1 + t * v1
    for p in range(count - 1, -1, -1):
        out, node = steps[p], nodes[p]
        t = (t - out[col.STEP_ALONG]) * out[col.STEP_SHRINK]
        d0 = out[col.STEP_HELD_THETA] + t * out[col.STEP_FREE_THETA]
        d1 = out[col.STEP_HELD_MOMENT] + t * out[col.STEP_FREE_MOMENT]
        node[col.NODE_THETA] += d0
        node[col.NODE_MOMENT] += d1
        for i in range(GAUSS_POINTS):
            per_theta, per_moment = (
                out[col.STEP_PER_THETA + i] * d0,
                out[col.STEP_PER_MOMENT + i] * d1,
            )
            node[col.NODE_GAUSS + i] += out[col.STEP_RESIDUAL + i] + per_theta + per_moment


@inner
def scale_of_moments(panels: Array) -> float:
    """Return the scale from moment to angle: length over the smallest rigidity, 1/(N m)."""
    length = 0.0
    flexibility = 0.0
    for p in range(len(panels)):
        length += panels[p, col.PANEL_LENGTH]
        flexibility = max(flexibility, abs(panels[p, col.PANEL_FLEXIBILITY]))
    return length * flexibility


@inner
def blend(nodes: Array, share: float, other: Array, out: Array) -> None:
    """Interpolate between two sets of nodes."""
    for p in range(len(nodes)):
        for i in range(nodes.shape[1]):
            out[p, i] = (1.0 - share) * nodes[p, i] + share * other[p, i]


@kernel
def newton(
    panels: Array, ends: Array, nodes: Array, most_iterations: int, tolerance: float
) -> tuple[float, int]:
    """Run Newton's method from the given nodes, in place, with step halving.

    Stops at `tolerance` (rad), or when rounding prevents any further improvement. Returns the
    residual (rad) and the number of steps. The nodes solve the equations only if the residual is
    at most ACCEPTED.
    """
    count = len(panels)
    slopes = np.empty((count, col.SLOPE_WIDTH))
    steps = np.empty((count, col.STEP_WIDTH))
    before = np.empty_like(nodes)
    scale = scale_of_moments(panels)
    residual = residual_pass(panels, ends, nodes, slopes, scale)
    for iteration in range(most_iterations):
        if residual <= tolerance:
            return residual, iteration
        blend(nodes, 0.0, nodes, before)
        newton_step(ends, nodes, slopes, steps, scale)
        following = residual_pass(panels, ends, nodes, slopes, scale)
        halvings = 0
        while not following < residual and halvings < NEWTON_HALVINGS:
            if residual <= ACCEPTED:  # rounding: no further step helps
                blend(before, 0.0, before, nodes)
                return residual, iteration
            blend(nodes, 0.5, before, nodes)
            following = residual_pass(panels, ends, nodes, slopes, scale)
            halvings += 1
        if not following < residual:
            return residual, iteration + 1
        residual = following
    return residual, most_iterations
