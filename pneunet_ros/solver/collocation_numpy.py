"""Newton's method of `collocation` in numpy, with one dense matrix and pivoting.

Used without numba, or until the kernels are compiled. The other kernels then run as plain Python,
which is fast enough for rods with a few panels. This solver shares no arithmetic with the compiled
one, so it also serves as a cross-check.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.panel import (
    GAUSS_ABSCISSAE,
    GAUSS_INTEGRATION,
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
)
from pneunet_ros.solver.settings import NEWTON_HALVINGS

ENDING = [col.NODE_THETA, col.NODE_MOMENT]  # the content of the last node
GAUSS = slice(col.NODE_GAUSS, col.NODE_GAUSS + GAUSS_POINTS)


def curvature_change(moment: Array, panels: Array) -> tuple[Array, Array]:
    """Solve M = M_O + B d (1 + c d^2) for d in closed form; also d d/d M."""
    columns = (col.PANEL_FLEXIBILITY, col.PANEL_OFFSET, col.PANEL_CUBIC)
    flexibility, offset, cubic = (panels[:, column, None] for column in columns)
    mu = (moment - offset) * flexibility
    root = np.sqrt(3.0 * np.where(cubic > 0.0, cubic, 1.0))
    bend = 2.0 / root * np.sinh(np.arcsinh(1.5 * root * mu) / 3.0)
    d = np.where(cubic > 0.0, bend, mu)
    return d, flexibility / (1.0 + 3.0 * cubic * d**2)


def equations(panels: Array, ends: Array, nodes: Array) -> tuple[Array, Array]:
    """Return the residual of all equations and its Jacobian, ordered like the nodes.

    Rows: clamp; per panel the four Gauss points, theta and moment at its end; free end.
    """
    count = len(panels)
    columns = (col.PANEL_LENGTH, col.PANEL_AXIAL, col.PANEL_STRETCH)
    h, axial, rest = (panels[:, column, None] for column in columns)
    theta, theta_a = nodes[:-1, GAUSS], nodes[:-1, col.NODE_THETA, None]
    moment_a = nodes[:-1, col.NODE_MOMENT, None]
    n1 = panels[:, col.PANEL_FORCE_X, None] - GAUSS_ABSCISSAE * panels[:, col.PANEL_LOSS_X, None]
    n2 = panels[:, col.PANEL_FORCE_Y, None] - GAUSS_ABSCISSAE * panels[:, col.PANEL_LOSS_Y, None]
    t = n1 * np.cos(theta) + n2 * np.sin(theta)
    u = n2 * np.cos(theta) - n1 * np.sin(theta)
    stretch = rest + axial * t
    slope, slope_changed = -stretch * u, stretch * t - axial * u**2
    d, flexibility = curvature_change(moment_a + h * slope @ GAUSS_INTEGRATION.T, panels)

    size = col.NODE_WIDTH * count + 2
    residual, matrix = np.zeros(size), np.zeros((size, size))
    give, clamp = ends[col.CLAMP_COMPLIANCE], nodes[0]
    residual[col.NODE_THETA] = (
        ends[col.CLAMP_ANGLE] + give * clamp[col.NODE_MOMENT] - clamp[col.NODE_THETA]
    )
    matrix[col.NODE_THETA, col.NODE_THETA], matrix[col.NODE_THETA, col.NODE_MOMENT] = 1.0, -give
    for p in range(count):
        panel, following = panels[p], nodes[p + 1]
        first, second, width = (
            col.NODE_WIDTH * p,
            col.NODE_WIDTH * (p + 1),
            panel[col.PANEL_LENGTH],
        )
        at_moment = first + col.NODE_MOMENT
        next_moment = second + (col.NODE_MOMENT if p + 1 < count else 1)
        points = slice(first + col.NODE_GAUSS, first + col.NODE_GAUSS + GAUSS_POINTS)
        bending = width * GAUSS_INTEGRATION * flexibility[p]
        to_moment = width * GAUSS_INTEGRATION * slope_changed[p]
        rotation = panel[col.PANEL_ROTATION : col.PANEL_ROTATION_END]
        residual[points] = theta_a[p] + rotation + width * GAUSS_INTEGRATION @ d[p] - theta[p]
        matrix[points, first] = -1.0
        matrix[points, points] = np.eye(GAUSS_POINTS) - bending @ to_moment
        matrix[points, at_moment] = -bending.sum(axis=1)
        weighted = width * GAUSS_WEIGHTS * flexibility[p]
        row = second - 1
        theta_b = theta_a[p].item() + panel[col.PANEL_ROTATION_END] + width * GAUSS_WEIGHTS @ d[p]
        residual[row] = theta_b - following[col.NODE_THETA]
        matrix[row, first] = -1.0
        matrix[row, points] = -weighted @ to_moment
        matrix[row, at_moment] = -weighted.sum()
        matrix[row, second] = 1.0
        row = second
        moment_b = moment_a[p].item() + width * GAUSS_WEIGHTS @ slope[p]
        residual[row] = moment_b - following[col.NODE_MOMENT]
        matrix[row, points] = -width * GAUSS_WEIGHTS * slope_changed[p]
        matrix[row, at_moment] = -1.0
        matrix[row, next_moment] = 1.0
    last, offset = nodes[-1], ends[col.LOAD_OFFSET]
    sine, cosine = np.sin(last[col.NODE_THETA]), np.cos(last[col.NODE_THETA])
    end_moment = ends[col.END_MOMENT] - offset * (
        ends[col.END_X] * cosine + ends[col.END_Y] * sine
    )
    residual[-1] = end_moment - last[col.NODE_MOMENT]
    matrix[-1, -2] = offset * (ends[col.END_Y] * cosine - ends[col.END_X] * sine)
    matrix[-1, -1] = 1.0
    return residual, matrix


def newton(
    panels: Array, ends: Array, nodes: Array, most_iterations: int, tolerance: float
) -> tuple[float, int]:
    """Run Newton's method in place, as `collocation.newton`: residual (rad), number of steps."""
    flexibility = np.abs(panels[:, col.PANEL_FLEXIBILITY]).max()
    in_radians = np.ones(col.NODE_WIDTH * len(panels) + 2)
    in_radians[col.NODE_WIDTH :: col.NODE_WIDTH] = panels[:, col.PANEL_LENGTH].sum() * flexibility
    in_radians[-1] = in_radians[-2]
    residual, matrix = equations(panels, ends, nodes)
    worst = float(np.abs(residual * in_radians).max())
    for iteration in range(most_iterations):
        if worst <= tolerance:
            return worst, iteration
        before = nodes.copy()
        try:
            step = np.linalg.solve(matrix, residual)
        except np.linalg.LinAlgError:
            return worst, iteration
        size = 1.0
        for _ in range(NEWTON_HALVINGS + 1):
            nodes[:-1] = before[:-1] + size * step[:-2].reshape(-1, col.NODE_WIDTH)
            nodes[-1, ENDING] = before[-1, ENDING] + size * step[-2:]
            residual, matrix = equations(panels, ends, nodes)
            following = float(np.abs(residual * in_radians).max())
            if following < worst:
                break
            size *= 0.5
        else:
            nodes[:] = before
            return worst, iteration
        worst = following
    return worst, most_iterations
