"""How the solved rod answers to small changes: one linear solve for any number of causes.

The first three causes are the loads F1, F2 and M. Every further cause is a change of the panels
and of the ends, such as a change of pressure or of a model parameter makes.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.solver.collocation import load_panel, scale_of_moments
from pneunet_ros.solver.panel import (
    A1,
    A2,
    A3,
    A4,
    C1,
    C2,
    C3,
    C4,
    dot,
    Four,
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

Array = npt.NDArray[np.float64]
LOADS = 3


@inlined
def force_slope(h: float, axial: float, u: Four, stretched: Four, t: Four, v: Four) -> Four:
    """Change h dM' at the Gauss points with a force of axial and transverse parts t, v."""
    return (
        -h * (axial * t[0] * u[0] + stretched[0] * v[0]),
        -h * (axial * t[1] * u[1] + stretched[1] * v[1]),
        -h * (axial * t[2] * u[2] + stretched[2] * v[2]),
        -h * (axial * t[3] * u[3] + stretched[3] * v[3]),
    )


@inlined
def bent(
    h: float, law: Law, moment: float, d: float, e: float, change: Array, moment_changed: float
) -> float:
    """Change of h (kappa - kappa0) at a Gauss point with moment, law and panel length."""
    mu = (moment - law[1]) * change[1] - law[0] * change[2] - change[3] * d * d * d
    return change[0] * d + h * e * (moment_changed + mu / law[0])


@inlined
def strained(
    i: int,
    abscissa: float,
    sine: Four,
    cosine: Four,
    axial_force: Four,
    change: Array,
    axial: float,
) -> tuple[float, float]:
    """Change of stretch and of transverse force at Gauss point i, theta held."""
    t, u = resolve(
        sine[i], cosine[i], change[6] - abscissa * change[8], change[7] - abscissa * change[9]
    )
    return change[5] + change[4] * axial_force[i] + axial * t, u


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
    """Change of nodes and tip (x, y, theta) per cause; returns whether the rod is stable.

    panel_changes (further causes, panels, 16) and end_changes (further causes, 6) come in;
    node_changes (3 + further causes, panels + 1, 6) and tip_changes (3 + further causes, 3) go
    out. Stable means: no bending that the clamp allows leaves the energy unchanged before the free
    end (Jacobi's condition), valid for positive rigidity under dead load.
    """
    count, causes = panels.shape[0], LOADS + panel_changes.shape[0]
    scale = scale_of_moments(panels)
    # y, x at the Gauss points; d(x, y) of the panel per d theta; v; by how much v was shortened
    free = np.empty((count, 19))
    held = np.empty((causes, count, 7))  # z at the Gauss points, w at the start, what went along v
    w = np.zeros((causes, 2))

    norm = 1.0 / math.sqrt(ends[1] * ends[1] + scale * scale)
    v0, v1 = ends[1] * norm, norm
    stable = True
    for cause in range(causes):
        tip_changes[cause, 0], tip_changes[cause, 1] = 0.0, 0.0
    for cause in range(LOADS, causes):
        end = end_changes[cause - LOADS]
        w[cause, 0] = end[0] + end[1] * nodes[0, 5]
    for p in range(count):
        h, law, mechanics, _ = load_panel(panels, p)
        axial = mechanics[0]
        node = nodes[p]
        theta = (node[1], node[2], node[3], node[4])
        sine, cosine, t, u, stretched, moment, d, e = panel_fields(
            h, law, mechanics, theta, node[5]
        )
        k = panel_slopes(h, axial, t, u, stretched)
        triangle, x, flexibility, b = linear_panel(k, scaled(h, e))
        to_theta, to_moment = times(flexibility[4], k), times(W, k)
        y = substitute(triangle, (1.0, 1.0, 1.0, 1.0))
        x = substitute(triangle, x)
        row = free[p]
        for i in range(4):
            row[i], row[4 + i] = y[i], x[i]
            row[8 + i] = h * W[i] * (axial * u[i] * cosine[i] - stretched[i] * sine[i])
            row[12 + i] = h * W[i] * (axial * u[i] * sine[i] + stretched[i] * cosine[i])
            stable = stable and y[i] * v0 + x[i] * v1 > 0.0
        row[16], row[17] = v0, v1
        f1, f2 = 1.0 + dot(to_theta, y), b + dot(to_theta, x)
        g1, g2 = dot(to_moment, y), 1.0 + dot(to_moment, x)
        v0, v1 = f1 * v0 + f2 * v1, g1 * v0 + g2 * v1
        stable = stable and v0 > 0.0
        shrink = 1.0 / math.sqrt(v0 * v0 + v1 * v1 * scale * scale)
        v0 *= shrink
        v1 *= shrink
        row[18] = shrink
        for cause in range(causes):
            if cause == 2:  # the end moment acts at the end only
                z, r5, r6 = (0.0, 0.0, 0.0, 0.0), 0.0, 0.0
            elif cause < 2:
                if cause == 0:
                    slope = force_slope(h, axial, u, stretched, cosine, scaled(-1.0, sine))
                    extension = times(cosine, W)
                else:
                    slope = force_slope(h, axial, u, stretched, sine, cosine)
                    extension = times(sine, W)
                r = (
                    dot(flexibility[0], slope),
                    dot(flexibility[1], slope),
                    dot(flexibility[2], slope),
                    dot(flexibility[3], slope),
                )
                r5, r6 = dot(flexibility[4], slope), dot(W, slope)
                z = substitute(triangle, r)
                tip_changes[cause, 0] += h * axial * dot(extension, cosine)
                tip_changes[cause, 1] += h * axial * dot(extension, sine)
            else:
                change = panel_changes[cause - LOADS, p]
                a1, b1 = strained(0, C1, sine, cosine, t, change, axial)
                a2, b2 = strained(1, C2, sine, cosine, t, change, axial)
                a3, b3 = strained(2, C3, sine, cosine, t, change, axial)
                a4, b4 = strained(3, C4, sine, cosine, t, change, axial)
                slope = (
                    -change[0] * stretched[0] * u[0] - h * (a1 * u[0] + stretched[0] * b1),
                    -change[0] * stretched[1] * u[1] - h * (a2 * u[1] + stretched[1] * b2),
                    -change[0] * stretched[2] * u[2] - h * (a3 * u[2] + stretched[2] * b3),
                    -change[0] * stretched[3] * u[3] - h * (a4 * u[3] + stretched[3] * b4),
                )
                turned = (
                    bent(h, law, moment[0], d[0], e[0], change, dot(A1, slope)),
                    bent(h, law, moment[1], d[1], e[1], change, dot(A2, slope)),
                    bent(h, law, moment[2], d[2], e[2], change, dot(A3, slope)),
                    bent(h, law, moment[3], d[3], e[3], change, dot(A4, slope)),
                )
                r = (
                    change[10] + dot(A1, turned),
                    change[11] + dot(A2, turned),
                    change[12] + dot(A3, turned),
                    change[13] + dot(A4, turned),
                )
                r5, r6 = change[14] + dot(W, turned), dot(W, slope)
                z = substitute(triangle, r)
                longer = times(
                    W,
                    (
                        change[0] * stretched[0] + h * a1,
                        change[0] * stretched[1] + h * a2,
                        change[0] * stretched[2] + h * a3,
                        change[0] * stretched[3] + h * a4,
                    ),
                )
                tip_changes[cause, 0] += dot(longer, cosine)
                tip_changes[cause, 1] += dot(longer, sine)
            out = held[cause, p]
            w0, w1 = w[cause, 0], w[cause, 1]
            out[0], out[1], out[2], out[3] = z
            out[4], out[5] = w0, w1
            w0, w1 = (
                r5 + dot(to_theta, z) + f1 * w0 + f2 * w1,
                r6 + dot(to_moment, z) + g1 * w0 + g2 * w1,
            )
            out[6] = w0 * v0 + w1 * v1 * scale * scale
            w[cause, 0], w[cause, 1] = w0 - out[6] * v0, w1 - out[6] * v1
    sine_end, cosine_end = sine_cosine(nodes[count, 0])
    end_slope = ends[2] * (ends[4] * cosine_end - ends[3] * sine_end)
    stable = stable and v1 + end_slope * v0 > 0.0
    for cause in range(causes):
        if cause == 0:
            given = -ends[2] * cosine_end
        elif cause == 1:
            given = -ends[2] * sine_end
        elif cause == 2:
            given = 1.0
        else:
            end = end_changes[cause - LOADS]
            given = end[5] - end[2] * (ends[3] * cosine_end + ends[4] * sine_end)
            given -= ends[2] * (end[3] * cosine_end + end[4] * sine_end)
        along = (given - w[cause, 1] - end_slope * w[cause, 0]) / (v1 + end_slope * v0)
        changes = node_changes[cause]
        changes[count, 0] = w[cause, 0] + along * v0
        changes[count, 5] = w[cause, 1] + along * v1
        tip_changes[cause, 2] = changes[count, 0]
        for p in range(count - 1, -1, -1):
            out, row = held[cause, p], free[p]
            along = (along - out[6]) * row[18]
            d0 = out[4] + along * row[16]
            d1 = out[5] + along * row[17]
            changes[p, 0], changes[p, 5] = d0, d1
            for i in range(4):
                moved = out[i] + row[i] * d0 + row[4 + i] * d1
                changes[p, 1 + i] = moved
                tip_changes[cause, 0] += row[8 + i] * moved
                tip_changes[cause, 1] += row[12 + i] * moved
    return stable
