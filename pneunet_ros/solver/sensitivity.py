"""Sensitivity of the solved rod: one linear solve for any number of causes.

The first three causes are the loads F1, F2 and M. Every further cause is a change of the panels
and of the ends, for example by a change of pressure or of a model parameter.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import ONES, scale_of_moments
from pneunet_ros.solver.columns import end_load, four, panel_force, read_panel, set_four
from pneunet_ros.solver.panel import (
    add,
    C1,
    C2,
    C3,
    C4,
    dot,
    Four,
    free_end,
    gauss_integrals,
    GAUSS_POINTS,
    Law,
    linear_panel,
    panel_fields,
    panel_slopes,
    resolve,
    scaled,
    sine_cosine,
    substitute,
    times,
    W,
)

NOTHING = (0.0, 0.0, 0.0, 0.0)


@inlined
def slope_change(h: float, stretch: Four, u: Four, a: Four, v: Four) -> Four:
    """Return the change -h (a u + stretch v) of h M'; a: of stretch, v: of transverse force."""
    return scaled(-h, add(times(a, u), times(stretch, v)))


@inlined
def bending_change(
    h: float, law: Law, moment: float, d: float, e: float, change: Array, moment_changed: float
) -> float:
    """Return the change of h (kappa - kappa0) at a Gauss point by moment, law and panel length."""
    flexibility, offset, _ = law
    mu = (moment - offset) * change[col.PANEL_FLEXIBILITY] - flexibility * change[col.PANEL_OFFSET]
    mu -= change[col.PANEL_CUBIC] * d * d * d
    return change[col.PANEL_LENGTH] * d + h * e * (moment_changed + mu / flexibility)


@inlined
def strain_change(
    change: Array, axial: float, abscissa: float, sine: float, cosine: float, t: float
) -> tuple[float, float]:
    """Return the changes of stretch and transverse force at a Gauss point, at constant theta."""
    n1, n2 = panel_force(change, abscissa)
    along, across = resolve(sine, cosine, n1, n2)
    return change[col.PANEL_STRETCH] + change[col.PANEL_AXIAL] * t + axial * along, across


@inlined
def record_change(
    h: float,
    law: Law,
    axial: float,
    fields: tuple[Four, Four, Four, Four, Four, Four, Four, Four],
    change: Array,
) -> tuple[Four, float, float, Four]:
    """Return the residual at Gauss points and end (theta, moment) due to a change of a panel.

    fields: those of `panel_fields`. Also returns h stretch' at constant theta.
    """
    sine, cosine, t, u, stretch, moment, d, e = fields
    s1, s2, s3, s4 = sine
    c1, c2, c3, c4 = cosine
    t1, t2, t3, t4 = t
    a1, v1 = strain_change(change, axial, C1, s1, c1, t1)
    a2, v2 = strain_change(change, axial, C2, s2, c2, t2)
    a3, v3 = strain_change(change, axial, C3, s3, c3, t3)
    a4, v4 = strain_change(change, axial, C4, s4, c4, t4)
    a, v = (a1, a2, a3, a4), (v1, v2, v3, v4)
    longer = change[col.PANEL_LENGTH]
    slope = add(times(scaled(-longer, stretch), u), slope_change(h, stretch, u, a, v))
    g1, g2, g3, g4 = gauss_integrals(slope)
    m1, m2, m3, m4 = moment
    d1, d2, d3, d4 = d
    e1, e2, e3, e4 = e
    bend = (
        bending_change(h, law, m1, d1, e1, change, g1),
        bending_change(h, law, m2, d2, e2, change, g2),
        bending_change(h, law, m3, d3, e3, change, g3),
        bending_change(h, law, m4, d4, e4, change, g4),
    )
    residual = add(four(change, col.PANEL_ROTATION), gauss_integrals(bend))
    longer_stretch = add(scaled(longer, stretch), scaled(h, a))
    return residual, change[col.PANEL_ROTATION_END] + dot(W, bend), dot(W, slope), longer_stretch


@kernel
def sensitivities(
    panels: Array,
    ends: Array,
    nodes: Array,
    panel_changes: Array,
    end_changes: Array,
    node_changes: Array,
    tip_changes: Array,
) -> bool:
    """Compute changes of nodes and tip (x, y, theta) per cause; return the stability.

    panel_changes (further causes, panels, 16) and end_changes (further causes, 6) are inputs;
    node_changes (3 + further causes, panels + 1, 6) and tip_changes (3 + further causes, 3) are
    outputs. Stable: no admissible bending leaves the energy unchanged before the free end
    (Jacobi's condition); valid for positive rigidity under dead load.
    """
    count, causes = len(panels), col.LOADS + len(panel_changes)
    scale = scale_of_moments(panels)
    free = np.empty((count, col.FREE_WIDTH))
    held = np.empty((causes, count, col.HELD_WIDTH))
    held_theta, held_moment = np.zeros(causes), np.zeros(causes)

    give = ends[col.CLAMP_COMPLIANCE]
    norm = 1.0 / math.sqrt(give * give + scale * scale)
    v0, v1 = give * norm, norm
    stable = True
    for cause in range(causes):
        tip_changes[cause, col.X], tip_changes[cause, col.Y] = 0.0, 0.0
    for cause in range(col.LOADS, causes):
        end = end_changes[cause - col.LOADS]
        held_theta[cause] = (
            end[col.CLAMP_ANGLE] + end[col.CLAMP_COMPLIANCE] * nodes[0, col.NODE_MOMENT]
        )
    for p in range(count):
        h, law, mechanics, _ = read_panel(panels, p)
        axial, _, _, _, _, _ = mechanics
        node, row = nodes[p], free[p]
        fields = panel_fields(h, law, mechanics, four(node, col.NODE_GAUSS), node[col.NODE_MOMENT])
        sine, cosine, t, u, stretch, _, _, e = fields
        k = panel_slopes(h, axial, t, u, stretch)
        triangle, x, flexibility, b = linear_panel(k, scaled(h, e))
        to_1, to_2, to_3, to_4, to_end = flexibility
        to_theta, to_moment = times(to_end, k), times(W, k)
        y = substitute(triangle, ONES)
        x = substitute(triangle, x)
        set_four(row, col.FREE_PER_THETA, y)
        set_four(row, col.FREE_PER_MOMENT, x)
        for i in range(GAUSS_POINTS):
            row[col.FREE_WAY_X + i] = h * W[i] * (axial * u[i] * cosine[i] - stretch[i] * sine[i])
            row[col.FREE_WAY_Y + i] = h * W[i] * (axial * u[i] * sine[i] + stretch[i] * cosine[i])
            stable = stable and y[i] * v0 + x[i] * v1 > 0.0
        row[col.FREE_THETA], row[col.FREE_MOMENT] = v0, v1
        f1, f2 = 1.0 + dot(to_theta, y), b + dot(to_theta, x)
        g1, g2 = dot(to_moment, y), 1.0 + dot(to_moment, x)
        v0, v1 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
        stable = stable and v0 > 0.0
        shrink = 1.0 / math.sqrt(v0 * v0 + v1 * v1 * scale * scale)
        v0 *= shrink
        v1 *= shrink
        row[col.FREE_SHRINK] = shrink
        for cause in range(causes):
            if cause == col.END_LOAD_MOMENT:  # acts at the end only
                z, theta_gap, moment_gap = NOTHING, 0.0, 0.0
            elif cause < col.LOADS:
                tangent, normal = cosine, scaled(-1.0, sine)
                if cause != col.FORCE_X:
                    tangent, normal = sine, cosine
                slope = slope_change(h, stretch, u, scaled(axial, tangent), normal)
                r = (dot(to_1, slope), dot(to_2, slope), dot(to_3, slope), dot(to_4, slope))
                theta_gap, moment_gap = dot(to_end, slope), dot(W, slope)
                z = substitute(triangle, r)
                extension = times(tangent, W)
                tip_changes[cause, col.X] += h * axial * dot(extension, cosine)
                tip_changes[cause, col.Y] += h * axial * dot(extension, sine)
            else:
                change = panel_changes[cause - col.LOADS, p]
                r, theta_gap, moment_gap, longer = record_change(h, law, axial, fields, change)
                z = substitute(triangle, r)
                longer = times(W, longer)
                tip_changes[cause, col.X] += dot(longer, cosine)
                tip_changes[cause, col.Y] += dot(longer, sine)
            out = held[cause, p]
            w0, w1 = held_theta[cause], held_moment[cause]
            set_four(out, col.HELD_GAUSS, z)
            out[col.HELD_THETA], out[col.HELD_MOMENT] = w0, w1
            w0, w1 = (
                theta_gap + dot(to_theta, z) + f1 * w0 + f2 * w1,
                moment_gap + dot(to_moment, z) + g1 * w0 + g2 * w1,
            )
            along_free = w0 * v0 + w1 * v1 * scale * scale
            out[col.HELD_ALONG] = along_free
            held_theta[cause], held_moment[cause] = w0 - along_free * v0, w1 - along_free * v1
    sine_end, cosine_end = sine_cosine(nodes[count, col.NODE_THETA])
    _, end_slope = free_end(end_load(ends), nodes[count, col.NODE_THETA])
    stable = stable and v1 + end_slope * v0 > 0.0
    for cause in range(causes):
        if cause == col.FORCE_X:
            given = -ends[col.LOAD_OFFSET] * cosine_end
        elif cause < col.END_LOAD_MOMENT:
            given = -ends[col.LOAD_OFFSET] * sine_end
        elif cause == col.END_LOAD_MOMENT:
            given = 1.0
        else:
            end = end_changes[cause - col.LOADS]
            across = ends[col.END_X] * cosine_end + ends[col.END_Y] * sine_end
            given = end[col.END_MOMENT] - end[col.LOAD_OFFSET] * across
            given -= ends[col.LOAD_OFFSET] * (
                end[col.END_X] * cosine_end + end[col.END_Y] * sine_end
            )
        along = (given - held_moment[cause] - end_slope * held_theta[cause]) / (
            v1 + end_slope * v0
        )
        changes = node_changes[cause]
        changes[count, col.NODE_THETA] = held_theta[cause] + along * v0
        changes[count, col.NODE_MOMENT] = held_moment[cause] + along * v1
        tip_changes[cause, col.THETA] = changes[count, col.NODE_THETA]
        for p in range(count - 1, -1, -1):
            out, row = held[cause, p], free[p]
            along = (along - out[col.HELD_ALONG]) * row[col.FREE_SHRINK]
            d0 = out[col.HELD_THETA] + along * row[col.FREE_THETA]
            d1 = out[col.HELD_MOMENT] + along * row[col.FREE_MOMENT]
            changes[p, col.NODE_THETA], changes[p, col.NODE_MOMENT] = d0, d1
            for i in range(GAUSS_POINTS):
                per_theta, per_moment = (
                    row[col.FREE_PER_THETA + i] * d0,
                    row[col.FREE_PER_MOMENT + i] * d1,
                )
                moved = out[col.HELD_GAUSS + i] + per_theta + per_moment
                changes[p, col.NODE_GAUSS + i] = moved
                tip_changes[cause, col.X] += row[col.FREE_WAY_X + i] * moved
                tip_changes[cause, col.Y] += row[col.FREE_WAY_Y + i] * moved
    return stable
