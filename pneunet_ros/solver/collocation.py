"""The boundary value problem of the rod by Gauss collocation and Newton's method.

The rod is cut into panels, always at a jump of the moment law. On each panel the field equations
hold at four Gauss points (order eight at the joints); the linearized panels are eliminated one by
one and joined by an orthonormalized sweep, which stays stable where shooting grows like exp(l
sqrt(F/B)). The turning of the unloaded rod is known in closed form and subtracted, so kinks of its
table do little harm.

`panels[p]` = length h, 1/B, M_O, cubic term, axial compliance, stretch at no force, force n1, n2
at the start, their loss over the panel, turning of the unloaded rod to the four Gauss points and
the end, arclength of the start. `nodes[p]` = theta at the start, theta at the Gauss points, moment
at the start; the last row of `nodes` holds theta and moment at the free end. `ends` = clamp angle,
clamp compliance, load offset, end force F1, F2, end moment.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.solver.panel import (
    C1,
    C2,
    C3,
    C4,
    dot,
    Law,
    linear_panel,
    Mechanics,
    panel_residual,
    sine_cosine,
    substitute,
    times,
    Turn,
    W,
)

Array = npt.NDArray[np.float64]

PANEL_WIDTH = 16
NODE_WIDTH = 6
SLOPE_WIDTH = 14
STEP_WIDTH = 18
TOLERANCE = 1e-13  # rad; the residual a Newton iteration aims at
FEWEST_PANELS = 6.0  # per length of the rod: the intrinsic curvature has detail of this size
ACCEPTED = 1e-10  # rad; the residual that still counts as equilibrium where rounding stops Newton


@kernel
def turning_at(s: float, knots: Array, turning: Array, piece: int) -> tuple[float, int]:
    """Return the angle (rad) the unloaded rod has turned at s; searches from `piece` on."""
    while piece < knots.size - 2 and s >= knots[piece + 1]:
        piece += 1
    t = s - knots[piece]
    c = turning[piece]
    return c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4]))), piece


@kernel
def panel_counts(
    length: float,
    sections: Array,
    turning: Array,
    ends: Array,
    decay_lengths: float,
    turn: float,
    most: int,
) -> npt.NDArray[np.int64]:
    """Panels per section: none longer than so many decay lengths sqrt(B/n), none turns further."""
    counts = np.empty(sections.shape[0], dtype=np.int64)
    bend = 0.0
    for piece in range(turning.shape[0]):
        bend = max(bend, abs(turning[piece, 1]))
    force = math.hypot(ends[3], ends[4])
    for k in range(sections.shape[0]):
        force += math.hypot(sections[k, 6], sections[k, 7]) * length
    for k in range(sections.shape[0]):
        stop = length if k + 1 == sections.shape[0] else sections[k + 1, 0]
        flexibility = abs(1.0 / sections[k, 1])
        per_length = max(
            math.sqrt(force * flexibility) / decay_lengths,
            (bend + abs(ends[5]) * flexibility) / turn,
            FEWEST_PANELS / length,
        )
        needed = math.ceil((stop - sections[k, 0]) * per_length)
        counts[k] = max(1, int(min(needed, most // sections.shape[0])))
    return counts


@kernel
def prepare(
    length: float,
    sections: Array,
    knots: Array,
    turning: Array,
    ends: Array,
    counts: npt.NDArray[np.int64],
    panels: Array,
) -> None:
    """Fill `panels` for a mesh of counts[k] equal panels on each section of the moment law.

    sections[k] = start, rigidity, moment offset, cubic term, axial compliance, rest strain, line
    load x, y.
    """
    n1, n2 = ends[3], ends[4]
    first = panels.shape[0]
    for k in range(sections.shape[0] - 1, -1, -1):
        section = sections[k]
        stop = length if k + 1 == sections.shape[0] else sections[k + 1, 0]
        h = (stop - section[0]) / counts[k]
        compliance = 1.0 / section[1]
        first -= counts[k]
        for j in range(counts[k] - 1, -1, -1):
            panel = panels[first + j]
            q1, q2 = h * section[6], h * section[7]
            n1 += q1
            n2 += q2
            panel[0] = h
            panel[1] = compliance
            panel[2] = section[2]
            panel[3] = section[3]
            panel[4] = section[4]
            panel[5] = 1.0 + section[5]
            panel[6], panel[7], panel[8], panel[9] = n1, n2, q1, q2
            panel[15] = section[0] + j * h
    piece, start = 0, 0.0
    for p in range(panels.shape[0]):
        panel = panels[p]
        s, h = panel[15], panel[0]
        t1, piece = turning_at(s + C1 * h, knots, turning, piece)
        t2, piece = turning_at(s + C2 * h, knots, turning, piece)
        t3, piece = turning_at(s + C3 * h, knots, turning, piece)
        t4, piece = turning_at(s + C4 * h, knots, turning, piece)
        t5, piece = turning_at(s + h, knots, turning, piece)
        panel[10], panel[11], panel[12] = t1 - start, t2 - start, t3 - start
        panel[13], panel[14] = t4 - start, t5 - start
        start = t5


@kernel
def unloaded_nodes(panels: Array, ends: Array, nodes: Array) -> None:
    """Set the unloaded rod: no moment, theta turns with the intrinsic curvature."""
    theta = ends[0]
    for p in range(panels.shape[0]):
        node, panel = nodes[p], panels[p]
        node[0] = theta
        for i in range(4):
            node[1 + i] = theta + panel[10 + i]
        node[5] = 0.0
        theta += panel[14]
    nodes[-1, 0] = theta
    nodes[-1, 5] = 0.0


@inlined
def load_panel(panels: Array, p: int) -> tuple[float, Law, Mechanics, Turn]:
    """Return the columns of one panel as the tuples the equations take."""
    row = panels[p]
    law = (row[1], row[2], row[3])
    mechanics = (row[4], row[5], row[6], row[7], row[8], row[9])
    turn = (row[10], row[11], row[12], row[13], row[14])
    return row[0], law, mechanics, turn


@kernel
def residual_pass(
    panels: Array, ends: Array, nodes: Array, slopes: Array, moment_scale: float
) -> float:
    """Residual of the rod in rad (moments times `moment_scale`); fills `slopes` for Newton."""
    count = panels.shape[0]
    sine, cosine = sine_cosine(nodes[count, 0])
    end_moment = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine)
    worst = max(
        abs(nodes[0, 0] - ends[0] - ends[1] * nodes[0, 5]),
        abs(nodes[count, 5] - end_moment) * moment_scale,
    )
    for p in range(count):
        h, law, mechanics, turn = load_panel(panels, p)
        node = nodes[p]
        theta = (node[1], node[2], node[3], node[4])
        r, theta_b, moment_b, k, e = panel_residual(
            h, law, mechanics, turn, node[0], theta, node[5]
        )
        r5 = theta_b - nodes[p + 1, 0]
        r6 = moment_b - nodes[p + 1, 5]
        row = slopes[p]
        row[0], row[1], row[2], row[3], row[4], row[5] = r[0], r[1], r[2], r[3], r5, r6
        row[6], row[7], row[8], row[9] = k
        row[10], row[11], row[12], row[13] = e
        worst = max(worst, abs(r[0]), abs(r[1]), abs(r[2]), abs(r[3]), abs(r5))
        worst = max(worst, abs(r6) * moment_scale)
        if not worst < 1e300:
            return np.inf
    return worst


@kernel
def newton_step(
    ends: Array, nodes: Array, slopes: Array, steps: Array, moment_scale: float
) -> None:
    """One full Newton step from the slopes of `residual_pass`; `steps` is scratch."""
    count = slopes.shape[0]
    s = moment_scale
    # The state at a joint is w + t v: v spans what the clamp leaves free, kept at unit length in
    # (rad, moment * s) and orthogonal to w, so that neither grows (Godunov's orthonormalization).
    norm = 1.0 / math.sqrt(ends[1] * ends[1] + s * s)
    v0, v1 = ends[1] * norm, norm
    w0, w1 = ends[0] + ends[1] * nodes[0, 5] - nodes[0, 0], 0.0
    for p in range(count):
        row, out = slopes[p], steps[p]
        k = (row[6], row[7], row[8], row[9])
        triangle, x, flexibility, b = linear_panel(k, (row[10], row[11], row[12], row[13]))
        v, wk = times(flexibility[4], k), times(W, k)
        z = substitute(triangle, (row[0], row[1], row[2], row[3]))
        y = substitute(triangle, (1.0, 1.0, 1.0, 1.0))
        x = substitute(triangle, x)
        out[0], out[1], out[2], out[3] = z
        out[4], out[5], out[6], out[7] = y
        out[8], out[9], out[10], out[11] = x
        out[12], out[13], out[14], out[15] = v0, v1, w0, w1
        f0, f1, f2 = row[4] + dot(v, z), 1.0 + dot(v, y), b + dot(v, x)
        g0, g1, g2 = row[5] + dot(wk, z), dot(wk, y), 1.0 + dot(wk, x)
        w0, w1 = f0 + f1 * w0 + f2 * w1, g0 + g1 * w0 + g2 * w1
        v0, v1 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
        shrink = 1.0 / math.sqrt(v0 * v0 + v1 * v1 * s * s)
        v0 *= shrink
        v1 *= shrink
        along = w0 * v0 + w1 * v1 * s * s
        w0 -= along * v0
        w1 -= along * v1
        out[16], out[17] = along, shrink
    sine, cosine = sine_cosine(nodes[count, 0])
    end_moment = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine)
    end_slope = ends[2] * (ends[4] * cosine - ends[3] * sine)
    t = (end_moment - nodes[count, 5] - w1 - end_slope * w0) / (v1 + end_slope * v0)
    nodes[count, 0] += w0 + t * v0
    nodes[count, 5] += w1 + t * v1
    for p in range(count - 1, -1, -1):
        out, node = steps[p], nodes[p]
        t = (t - out[16]) * out[17]
        d0 = out[14] + t * out[12]
        d1 = out[15] + t * out[13]
        node[0] += d0
        node[5] += d1
        for i in range(4):
            node[1 + i] += out[i] + out[4 + i] * d0 + out[8 + i] * d1


@kernel
def scale_of_moments(panels: Array) -> float:
    """Return what makes an angle of a moment: length over the smallest rigidity, 1/(N m)."""
    length = 0.0
    flexibility = 0.0
    for p in range(panels.shape[0]):
        length += panels[p, 0]
        flexibility = max(flexibility, abs(panels[p, 1]))
    return length * flexibility


@kernel
def blend(nodes: Array, share: float, other: Array, out: Array) -> None:
    """Set out to nodes with a share of other nodes."""
    for p in range(nodes.shape[0]):
        for i in range(nodes.shape[1]):
            out[p, i] = (1.0 - share) * nodes[p, i] + share * other[p, i]


@kernel
def newton(
    panels: Array, ends: Array, nodes: Array, most_iterations: int, tolerance: float
) -> tuple[float, int]:
    """Newton's method from the given nodes, in place; a step that does not help is halved.

    It stops at `tolerance` (rad), or where rounding lets no step help any more.
    Returns the residual (rad) and the number of steps. The nodes solve the equations only where
    the residual is at most ACCEPTED.
    """
    count = panels.shape[0]
    slopes = np.empty((count, SLOPE_WIDTH))
    steps = np.empty((count, STEP_WIDTH))
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
        while not following < residual and halvings < 8:
            if residual <= ACCEPTED:  # rounding: no step will help any more
                blend(before, 0.0, before, nodes)
                return residual, iteration
            blend(nodes, 0.5, before, nodes)
            following = residual_pass(panels, ends, nodes, slopes, scale)
            halvings += 1
        if not following < residual:
            return residual, iteration + 1
        residual = following
    return residual, most_iterations
