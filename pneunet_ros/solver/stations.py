"""The solved rod between its Gauss points: position, tangent, curvature and moment.

On each panel the integrands (x', y', M', kappa - kappa0) are interpolated through the four Gauss
points and both joints, where collocation is most accurate, and integrated exactly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.solver.collocation import load_panel
from pneunet_ros.solver.compiled import kernel
from pneunet_ros.solver.panel import (
    curvature_change,
    GAUSS_ABSCISSAE,
    GAUSS_INTEGRATION,
    resolve,
    sine_cosine,
)

Array = npt.NDArray[np.float64]

POINTS = np.concatenate([[0.0], GAUSS_ABSCISSAE, [1.0]])
# FROM_VALUES[k] @ values = coefficient of u^k of the polynomial through the values at POINTS.
FROM_VALUES = np.linalg.inv(np.vander(POINTS, POINTS.size, increasing=True))
LEADING_OF_LEGENDRE = 252.0  # of the shifted Legendre polynomial of degree five


@kernel
def panel_integrands(panels: Array, nodes: Array, p: int, values: Array) -> None:
    """x', y' (stretched), M' and kappa - kappa0 of panel p at POINTS, into values (4, 6)."""
    h, law, mechanics, _ = load_panel(panels, p)
    axial, stretch, n1, n2, q1, q2 = mechanics
    for i in range(6):
        theta = nodes[p + 1, 0] if i == 5 else nodes[p, i]
        sine, cosine = sine_cosine(theta)
        t, u = resolve(sine, cosine, n1 - POINTS[i] * q1, n2 - POINTS[i] * q2)
        stretched = stretch + axial * t
        values[0, i] = stretched * cosine
        values[1, i] = stretched * sine
        values[2, i] = -stretched * u
    values[3, 0] = curvature_change(nodes[p, 5], law)[0]
    values[3, 5] = curvature_change(nodes[p + 1, 5], law)[0]
    for i in range(4):
        moment = nodes[p, 5]
        for j in range(4):
            moment += h * GAUSS_INTEGRATION[i, j] * values[2, 1 + j]
        values[3, 1 + i] = curvature_change(moment, law)[0]


@kernel
def resolution(panels: Array, nodes: Array) -> float:
    """Size (m) of the finest detail that the mesh carries; not tiny: the mesh is too coarse.

    It is the largest contribution of the Legendre term of degree five to the position, over all
    panels. Where the moment law is cubic the curvature can have detail that the position hardly
    shows, and counts as well: by the angle it adds, times the length of the panel.
    """
    worst = 0.0
    values = np.empty((4, 6))
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
            panel_integrands(panels, nodes, p, values)
            bend = 0.0
            for i in range(6):
                bend += FROM_VALUES[5, i] * values[3, i]
            detail = max(detail, abs(bend) * panel[0] * panel[0])
        worst = max(worst, detail / LEADING_OF_LEGENDRE)
    return worst


@kernel
def at_stations(
    panels: Array, nodes: Array, knots: Array, turning: Array, arclength: Array, out: Array
) -> None:
    """x, y, theta, kappa, kappa0, M at increasing `arclength` (m), into out (6, stations)."""
    count = panels.shape[0]
    values = np.empty((4, 6))
    series = np.empty((4, 6))
    p, piece = -1, 0
    x, y, following_x, following_y = 0.0, 0.0, 0.0, 0.0
    h, law, _, _ = load_panel(panels, 0)
    start = 0.0
    for i in range(arclength.size):
        s = arclength[i]
        while p < 0 or (p < count - 1 and s >= panels[p + 1, 15]):
            p += 1
            x, y = following_x, following_y
            h, law, _, _ = load_panel(panels, p)
            start = panels[p, 15]
            panel_integrands(panels, nodes, p, values)
            for field in range(4):
                for k in range(6):
                    total = 0.0
                    for j in range(6):
                        total += FROM_VALUES[k, j] * values[field, j]
                    series[field, k] = total * h / (k + 1.0)
            for k in range(6):
                following_x += series[0, k]
                following_y += series[1, k]
        u = (s - start) / h
        for field in range(4):
            total = 0.0
            for k in range(5, -1, -1):
                total = (total + series[field, k]) * u
            out[field, i] = total
        while piece < knots.size - 2 and s >= knots[piece + 1]:
            piece += 1
        # Turning of the unloaded rod from the joint: the joint may lie some pieces back.
        first = piece
        while first > 0 and start < knots[first]:
            first -= 1
        c, t = turning[piece], s - knots[piece]
        turned = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))
        intrinsic = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))
        c, t = turning[first], start - knots[first]
        turned -= c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))
        moment = nodes[p, 5] + out[2, i]
        out[0, i] += x
        out[1, i] += y
        out[2, i] = nodes[p, 0] + turned + out[3, i]
        out[3, i] = intrinsic + curvature_change(moment, law)[0]
        out[4, i] = intrinsic
        out[5, i] = moment


@kernel
def move(base: Array, size: float, change: Array, out: Array) -> None:
    """Set out = base + size change, for tables."""
    for i in range(base.shape[0]):
        for j in range(base.shape[1]):
            out[i, j] = base[i, j] + size * change[i, j]


@kernel
def station_changes(
    panels: Array,
    nodes: Array,
    knots: Array,
    turning: Array,
    panel_changes: Array,
    turning_changes: Array,
    node_changes: Array,
    arclength: Array,
    out: Array,
) -> None:
    """Change of x, y, theta, kappa, kappa0, M at stations, into out (causes, 6, stations).

    The causes are those of `sensitivity.sensitivities`: F1, F2, M and the further ones, for which
    panel_changes and turning_changes are given. Central difference of `at_stations` along the
    known change of the nodes; its step turns no joint by more than 1e-5 rad.
    """
    loads = node_changes.shape[0] - panel_changes.shape[0]
    sides = np.empty((2, 6, arclength.size))
    moved_panels, moved_nodes = np.empty(panels.shape), np.empty(nodes.shape)
    moved_turning = np.empty(turning.shape)
    for cause in range(node_changes.shape[0]):
        largest = 0.0
        for p in range(nodes.shape[0]):
            largest = max(largest, abs(node_changes[cause, p, 0]))
        step = 1e-5 / largest if largest > 0.0 else 1e-5
        for side in range(2):
            signed = step if side == 1 else -step
            move(nodes, signed, node_changes[cause], moved_nodes)
            if cause < loads:
                move(panels, 0.0, panels, moved_panels)
                move(turning, 0.0, turning, moved_turning)
            else:
                move(panels, signed, panel_changes[cause - loads], moved_panels)
                move(turning, signed, turning_changes[cause - loads], moved_turning)
            if cause < 2:
                for p in range(panels.shape[0]):
                    moved_panels[p, 6 + cause] += signed
            at_stations(moved_panels, moved_nodes, knots, moved_turning, arclength, sides[side])
        for field in range(6):
            for i in range(arclength.size):
                difference = sides[1, field, i] - sides[0, field, i]
                out[cause, field, i] = difference * (0.5 / step)
