"""The solved rod between its Gauss points: position, tangent, curvature and moment.

Collocation is most accurate at the joints. Between them every panel is integrated anew at eight
inner points: the moment from the angle, the curvature from the moment, the angle from the
curvature, and from that angle moment and position.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.solver.collocation import load_panel, turning_at
from pneunet_ros.solver.panel import (
    curvature_change,
    dot,
    GAUSS_ABSCISSAE,
    panel_fields,
    resolve,
    sine_cosine,
    times,
    W,
)

Array = npt.NDArray[np.float64]

POINTS = np.concatenate([[0.0], GAUSS_ABSCISSAE, [1.0]])
# FROM_VALUES[k] @ values = coefficient of u^k of the polynomial through the values at POINTS.
FROM_VALUES = np.linalg.inv(np.vander(POINTS, POINTS.size, increasing=True))
INNER = 8
_inner, _ = np.polynomial.legendre.leggauss(INNER)
INNER_ABSCISSAE = 0.5 * (_inner + 1.0)
_degrees = np.arange(1, POINTS.size + 1)
# values at POINTS @ TO_INNER = their integral from the start of a unit panel to the inner points.
TO_INNER = np.ascontiguousarray(
    ((INNER_ABSCISSAE[:, None] ** _degrees / _degrees) @ FROM_VALUES).T
)
# values at the inner points @ TO_SERIES = their integral from the start of a unit panel, as powers
# of v, which is -1 at the start and 1 at the end.
TO_SERIES = np.zeros((INNER, INNER + 1))
_degrees = np.arange(1, INNER + 1)
TO_SERIES[:, 1:] = np.linalg.inv(np.vander(_inner, INNER, increasing=True)).T * 0.5 / _degrees
TO_SERIES[:, 0] = -TO_SERIES[:, 1:] @ (-1.0) ** _degrees
TO_INNER_AGAIN = TO_SERIES @ np.vander(_inner, INNER + 1, increasing=True).T
LEADING_OF_LEGENDRE = 252.0  # of the shifted Legendre polynomial of degree five


@inlined
def panel_bending(
    panels: Array, nodes: Array, p: int, out: Array, row: int
) -> tuple[float, float]:
    """Compute kappa - kappa0 of panel p at POINTS, into the first six of a row of out.

    Returns the way over the panel in x and y, by the quadrature of the collocation.
    """
    h, law, mechanics, _ = load_panel(panels, p)
    node = nodes[p]
    theta = (node[1], node[2], node[3], node[4])
    sine, cosine, _, _, stretched, _, d, _ = panel_fields(h, law, mechanics, theta, node[5])
    out[row, 1], out[row, 2], out[row, 3], out[row, 4] = d
    out[row, 0] = curvature_change(node[5], law)[0]
    out[row, 5] = curvature_change(nodes[p + 1, 5], law)[0]
    weighted = times(W, stretched)
    return h * dot(weighted, cosine), h * dot(weighted, sine)


@kernel
def resolution(panels: Array, nodes: Array) -> float:
    """Size (m) of the finest detail that the mesh carries; not tiny: the mesh is too coarse.

    It is the largest contribution of the Legendre term of degree five to the position, over all
    panels. Where the moment law is cubic the curvature can have detail that the position hardly
    shows, and counts as well: by the angle it adds, times the length of the panel.
    """
    worst = 0.0
    bending = np.empty((1, 6))
    for p in range(panels.shape[0]):
        panel = panels[p]
        x, y = 0.0, 0.0
        for i in range(6):
            sine, cosine = sine_cosine(nodes[p + 1, 0] if i == 5 else nodes[p, i])
            axial, _ = resolve(
                sine, cosine, panel[6] - POINTS[i] * panel[8], panel[7] - POINTS[i] * panel[9]
            )
            stretched = (panel[5] + panel[4] * axial) * FROM_VALUES[5, i]
            x += stretched * cosine
            y += stretched * sine
        detail = max(abs(x), abs(y)) * panel[0]
        if panel[3] > 0.0:
            panel_bending(panels, nodes, p, bending, 0)
            bend = 0.0
            for i in range(6):
                bend += FROM_VALUES[5, i] * bending[0, i]
            detail = max(detail, abs(bend) * panel[0] * panel[0])
        worst = max(worst, detail / LEADING_OF_LEGENDRE)
    return worst


# Rows of the scratch of `panel_series`: angle of the unloaded rod, correction of the first angle,
# moment, sine, cosine; then the four that are integrated.
TURNED, CORRECTION, MOMENT, SINE, COSINE, ALONG_X, ALONG_Y, SLOPE, CHANGE = range(9)


@inlined
def integrate(weights: Array, values: Array, row: int, out: Array, to: int) -> None:
    """Add the integral of a row of values at the inner points to a row of out."""
    for j in range(INNER):
        value = values[row, j]
        for k in range(weights.shape[1]):  # the inner loop becomes vector instructions
            out[to, k] += value * weights[j, k]


@inlined
def close(series: Array, field: int, end: float) -> None:
    """Add a straight line so that a series of a panel has this value at its end."""
    for k in range(INNER + 1):
        end -= series[field, k]
    series[field, 0] += 0.5 * end
    series[field, 1] += 0.5 * end


@kernel
def panel_series(
    panels: Array,
    nodes: Array,
    p: int,
    knots: Array,
    turning: Array,
    piece: int,
    work: Array,
    series: Array,
) -> None:
    """Integrate x', y', M' and kappa - kappa0 over panel p, as powers of v, into series (4, 9).

    v = -1 at the start of the panel and 1 at its end. What little is missing at the end to the
    values of the collocation, which are best there, is spread over the panel. The table of
    curvature is searched from `piece` on; work (9, 8) is scratch.
    """
    h, law, mechanics, _ = load_panel(panels, p)
    axial, stretch, n1, n2, q1, q2 = mechanics
    start = panels[p, 15]
    joint, piece = turning_at(start, knots, turning, piece)
    for i in range(INNER):
        here, piece = turning_at(start + INNER_ABSCISSAE[i] * h, knots, turning, piece)
        work[TURNED, i] = nodes[p, 0] + here - joint
        work[MOMENT, i] = nodes[p, 5]
        work[CORRECTION, i] = 0.0
    way_x, way_y = panel_bending(panels, nodes, p, work, CHANGE)
    for j in range(6):
        bend = h * work[CHANGE, j]
        for i in range(INNER):
            work[CORRECTION, i] -= bend * TO_INNER[j, i]
    for i in range(INNER):
        sine, cosine = sine_cosine(work[TURNED, i] - work[CORRECTION, i])
        u = INNER_ABSCISSAE[i]
        along, across = resolve(sine, cosine, n1 - u * q1, n2 - u * q2)
        work[SINE, i], work[COSINE, i] = sine, cosine
        work[SLOPE, i] = -h * (stretch + axial * along) * across
    integrate(TO_INNER_AGAIN, work, SLOPE, work, MOMENT)
    for i in range(INNER):
        work[CHANGE, i] = h * curvature_change(work[MOMENT, i], law)[0]
    integrate(TO_INNER_AGAIN, work, CHANGE, work, CORRECTION)
    for i in range(INNER):
        d = work[CORRECTION, i]  # small: what is left out is d^4 / 24
        c, s = 1.0 - 0.5 * d * d, d - d * d * d / 6.0
        sine = work[SINE, i] * c + work[COSINE, i] * s
        cosine = work[COSINE, i] * c - work[SINE, i] * s
        u = INNER_ABSCISSAE[i]
        along, across = resolve(sine, cosine, n1 - u * q1, n2 - u * q2)
        stretched = h * (stretch + axial * along)
        work[ALONG_X, i], work[ALONG_Y, i] = stretched * cosine, stretched * sine
        work[SLOPE, i] = -stretched * across
    for field in range(4):
        for k in range(INNER + 1):
            series[field, k] = 0.0
        integrate(TO_SERIES, work, ALONG_X + field, series, field)
    moment_gained = nodes[p + 1, 5] - nodes[p, 5]
    bent = nodes[p + 1, 0] - nodes[p, 0] - panels[p, 14]
    close(series, 0, way_x)
    close(series, 1, way_y)
    close(series, 2, moment_gained)
    close(series, 3, bent)


@kernel
def at_stations(
    panels: Array, nodes: Array, knots: Array, turning: Array, arclength: Array, out: Array
) -> None:
    """x, y, theta, kappa, kappa0, M at increasing `arclength` (m), into out (6, stations)."""
    count = panels.shape[0]
    work = np.empty((9, INNER))
    series = np.empty((4, INNER + 1))
    p, piece, reached = -1, 0, 0
    x, y, following_x, following_y = 0.0, 0.0, 0.0, 0.0
    h, law, _, _ = load_panel(panels, 0)
    start, joint = 0.0, 0.0
    for i in range(arclength.size):
        s = arclength[i]
        while p < 0 or (p < count - 1 and s >= panels[p + 1, 15]):
            p += 1
            x, y = following_x, following_y
            h, law, _, _ = load_panel(panels, p)
            start = panels[p, 15]
            joint, reached = turning_at(start, knots, turning, reached)
            panel_series(panels, nodes, p, knots, turning, reached, work, series)
            for k in range(INNER + 1):
                following_x += series[0, k]
                following_y += series[1, k]
        v = 2.0 * (s - start) / h - 1.0
        for field in range(4):
            total = 0.0
            for k in range(INNER, -1, -1):
                total = total * v + series[field, k]
            out[field, i] = total if s > start else 0.0  # exactly, at a joint
        turned, piece = turning_at(s, knots, turning, piece)
        c, t = turning[piece], s - knots[piece]
        intrinsic = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))
        moment = nodes[p, 5] + out[2, i]
        out[0, i] += x
        out[1, i] += y
        out[2, i] = nodes[p, 0] + turned - joint + out[3, i]
        out[3, i] = intrinsic + curvature_change(moment, law)[0]
        out[4, i] = intrinsic
        out[5, i] = moment
