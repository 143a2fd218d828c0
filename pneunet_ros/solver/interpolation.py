"""Interpolation of the solved rod between its Gauss points: position, tangent, curvature, moment.

Collocation is most accurate at the joints. Between them, every panel is integrated again at eight
inner points. The angle gives the moment, the moment the curvature, and the curvature a better
angle, which finally gives moment and position.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.collocation import rotation_at
from pneunet_ros.solver.columns import four, panel_force, powers, read_panel, set_four
from pneunet_ros.solver.panel import (
    curvature_change,
    dot,
    GAUSS_ABSCISSAE,
    GAUSS_POINTS,
    panel_fields,
    resolve,
    sine_cosine,
    times,
    W,
)

POINTS = np.concatenate([[0.0], GAUSS_ABSCISSAE, [1.0]])
LAST = POINTS.size - 1
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
    """Compute kappa - kappa0 of panel p at POINTS, into the first six entries of a row of out.

    Returns the displacement over the panel in x and y, by the quadrature of the collocation.
    """
    h, law, mechanics, _ = read_panel(panels, p)
    node, values = nodes[p], out[row]
    sine, cosine, _, _, stretch, _, d, _ = panel_fields(
        h, law, mechanics, four(node, col.NODE_GAUSS), node[col.NODE_MOMENT]
    )
    set_four(values, 1, d)
    values[0], _ = curvature_change(node[col.NODE_MOMENT], law)
    values[LAST], _ = curvature_change(nodes[p + 1, col.NODE_MOMENT], law)
    weighted = times(W, stretch)
    return h * dot(weighted, cosine), h * dot(weighted, sine)


# Rows of the scratch of `panel_series`: intrinsic rotation, correction of the first angle, moment,
# sine, cosine; then the four that are integrated, in the order of the series.
ROTATION, CORRECTION, MOMENTS, SINE, COSINE, WAY_X, WAY_Y, SLOPE, BEND = range(9)
ROWS = 9


@inlined
def integrate(weights: Array, values: Array, out: Array) -> None:
    """Add the integral of values at points to out, by weights (points, out.size)."""
    for j in range(len(weights)):
        value = values[j]
        for k in range(weights.shape[1]):  # the inner loop becomes vector instructions
            out[k] += value * weights[j, k]


@inlined
def close(series: Array, field: int, end: float) -> None:
    """Add a straight line so that the series of a panel ends at this value."""
    for k in range(INNER + 1):
        end -= series[field, k]
    series[field, 0] += 0.5 * end
    series[field, 1] += 0.5 * end


@inner
def panel_series(
    panels: Array,
    nodes: Array,
    p: int,
    knots: Array,
    rotation: Array,
    piece: int,
    work: Array,
    series: Array,
) -> float:
    """Integrate x', y', M' and kappa - kappa0 over panel p, as powers of v, into series (4, 9).

    v = -1 at the start of the panel and 1 at its end. The small difference at its end from the
    values of the collocation, which are most accurate there, is distributed over the panel. The
    table of curvature is searched from `piece` on; work (9, 8) is scratch. Returns the error (rad)
    of the angle: that of the collocation against the integral of its own curvature.
    """
    h, law, mechanics, _ = read_panel(panels, p)
    axial, rest, n1, n2, q1, q2 = mechanics
    node, following = nodes[p], nodes[p + 1]
    start = panels[p, col.PANEL_START]
    joint, piece = rotation_at(start, knots, rotation, piece)
    for i in range(INNER):
        here, piece = rotation_at(start + INNER_ABSCISSAE[i] * h, knots, rotation, piece)
        work[ROTATION, i] = node[col.NODE_THETA] + here - joint
        work[MOMENTS, i] = node[col.NODE_MOMENT]
        work[CORRECTION, i] = 0.0
    way_x, way_y = panel_bending(panels, nodes, p, work, BEND)
    for j in range(POINTS.size):
        bend = h * work[BEND, j]
        for i in range(INNER):
            work[CORRECTION, i] -= bend * TO_INNER[j, i]
    for i in range(INNER):
        sine, cosine = sine_cosine(work[ROTATION, i] - work[CORRECTION, i])
        u = INNER_ABSCISSAE[i]
        along, across = resolve(sine, cosine, n1 - u * q1, n2 - u * q2)
        work[SINE, i], work[COSINE, i] = sine, cosine
        work[SLOPE, i] = -h * (rest + axial * along) * across
    integrate(TO_INNER_AGAIN, work[SLOPE], work[MOMENTS])
    for i in range(INNER):
        change, _ = curvature_change(work[MOMENTS, i], law)
        work[BEND, i] = h * change
    integrate(TO_INNER_AGAIN, work[BEND], work[CORRECTION])
    worst = 0.0
    for i in range(INNER):
        d = work[CORRECTION, i]  # small: the error is d^4 / 24
        worst = max(worst, abs(d))
        c, s = 1.0 - 0.5 * d * d, d - d * d * d / 6.0
        sine = work[SINE, i] * c + work[COSINE, i] * s
        cosine = work[COSINE, i] * c - work[SINE, i] * s
        u = INNER_ABSCISSAE[i]
        along, across = resolve(sine, cosine, n1 - u * q1, n2 - u * q2)
        stretch = h * (rest + axial * along)
        work[WAY_X, i], work[WAY_Y, i] = stretch * cosine, stretch * sine
        work[SLOPE, i] = -stretch * across
    for field in range(len(series)):
        for k in range(INNER + 1):
            series[field, k] = 0.0
        integrate(TO_SERIES, work[WAY_X + field], series[field])
    bend = following[col.NODE_THETA] - node[col.NODE_THETA] - panels[p, col.PANEL_ROTATION_END]
    missing = bend
    for k in range(INNER + 1):
        missing -= series[col.SERIES_BEND, k]
    close(series, col.SERIES_X, way_x)
    close(series, col.SERIES_Y, way_y)
    close(series, col.SERIES_MOMENT, following[col.NODE_MOMENT] - node[col.NODE_MOMENT])
    close(series, col.SERIES_BEND, bend)
    return max(worst, abs(missing))


@kernel
def resolution(panels: Array, nodes: Array, knots: Array, rotation: Array) -> float:
    """Return the size (m) of the finest detail, tiny on a sufficiently fine mesh.

    The size is the largest contribution of the Legendre term of degree five to the position, over
    all panels. With a cubic moment law, the curvature can have detail that is invisible in the
    position and at the Gauss points; the error of the angle between them, times the length of the
    rod, is then included.
    """
    worst, missed = 0.0, 0.0
    work = np.empty((ROWS, INNER))
    series = np.empty((col.SERIES_COUNT, INNER + 1))
    piece = 0
    for p in range(len(panels)):
        panel = panels[p]
        h = panel[col.PANEL_LENGTH]
        x, y = 0.0, 0.0
        for i in range(POINTS.size):
            theta = nodes[p + 1, col.NODE_THETA] if i == LAST else nodes[p, col.NODE_THETA + i]
            sine, cosine = sine_cosine(theta)
            n1, n2 = panel_force(panel, POINTS[i])
            axial, _ = resolve(sine, cosine, n1, n2)
            stretch = (panel[col.PANEL_STRETCH] + panel[col.PANEL_AXIAL] * axial) * FROM_VALUES[
                LAST, i
            ]
            x += stretch * cosine
            y += stretch * sine
        worst = max(worst, max(abs(x), abs(y)) * h / LEADING_OF_LEGENDRE)
        if panel[col.PANEL_CUBIC] > 0.0:
            _, piece = rotation_at(panel[col.PANEL_START], knots, rotation, piece)
            missed += panel_series(panels, nodes, p, knots, rotation, piece, work, series)
    return max(worst, missed * knots[-1])


@kernel
def least_stretch(panels: Array, nodes: Array) -> float:
    """Return the least stretch of a solved rod, at the Gauss points."""
    least = np.inf
    for p in range(len(panels)):
        row = panels[p]
        for i in range(GAUSS_POINTS):
            n1, n2 = panel_force(row, GAUSS_ABSCISSAE[i])
            sine, cosine = sine_cosine(nodes[p, col.NODE_GAUSS + i])
            axial, _ = resolve(sine, cosine, n1, n2)
            least = min(least, row[col.PANEL_STRETCH] + row[col.PANEL_AXIAL] * axial)
    return float(least)


@inlined
def series_at(series: Array, field: int, v: float) -> float:
    """Return the value of a series of a panel."""
    value = 0.0
    for k in range(INNER, -1, -1):
        value = value * v + series[field, k]
    return value


@kernel
def at_stations(
    panels: Array, nodes: Array, knots: Array, rotation: Array, arclength: Array, out: Array
) -> float:
    """Fill the fields at stations of increasing `arclength` (m), (6, stations).

    Returns the error (rad) of the angle up to the last of them: the sum of the errors that
    `panel_series` finds on every panel.
    """
    count = len(panels)
    work = np.empty((ROWS, INNER))
    series = np.empty((col.SERIES_COUNT, INNER + 1))
    p, piece, reached, missed = -1, 0, 0, 0.0
    x, y, following_x, following_y = 0.0, 0.0, 0.0, 0.0
    h, law, _, _ = read_panel(panels, 0)
    start, joint = 0.0, 0.0
    for i in range(arclength.size):
        s = arclength[i]
        while p < 0 or (p < count - 1 and s >= panels[p + 1, col.PANEL_START]):
            p += 1
            x, y = following_x, following_y
            h, law, _, _ = read_panel(panels, p)
            start = panels[p, col.PANEL_START]
            joint, reached = rotation_at(start, knots, rotation, reached)
            missed += panel_series(panels, nodes, p, knots, rotation, reached, work, series)
            for k in range(INNER + 1):
                following_x += series[col.SERIES_X, k]
                following_y += series[col.SERIES_Y, k]
        v = 2.0 * (s - start) / h - 1.0
        way_x, way_y, gained, bend = 0.0, 0.0, 0.0, 0.0  # exactly, at a joint
        if s > start:
            way_x, way_y = series_at(series, col.SERIES_X, v), series_at(series, col.SERIES_Y, v)
            gained, bend = (
                series_at(series, col.SERIES_MOMENT, v),
                series_at(series, col.SERIES_BEND, v),
            )
        rotated, piece = rotation_at(s, knots, rotation, piece)
        _, c1, c2, c3, c4 = powers(rotation[piece])
        t = s - knots[piece]
        intrinsic = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4))
        moment = nodes[p, col.NODE_MOMENT] + gained
        change, _ = curvature_change(moment, law)
        out[col.X, i] = way_x + x
        out[col.Y, i] = way_y + y
        out[col.THETA, i] = nodes[p, col.NODE_THETA] + rotated - joint + bend
        out[col.CURVATURE, i] = intrinsic + change
        out[col.INTRINSIC_CURVATURE, i] = intrinsic
        out[col.MOMENT, i] = moment
    return missed
