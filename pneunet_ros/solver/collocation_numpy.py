"""The same collocation in plain numpy: one dense Newton matrix, solved with pivoting.

It shares no arithmetic with the kernel and is its cross-check. Where there is no numba the kernel
itself runs as plain Python, which is faster still on rods of a few panels.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.solver.panel import GAUSS_ABSCISSAE, GAUSS_INTEGRATION, GAUSS_WEIGHTS

Array = npt.NDArray[np.float64]


def curvature_change(moment: Array, panels: Array) -> tuple[Array, Array]:
    """Solve M = M_O + B d (1 + c d^2) for d in closed form; also d d/d M."""
    compliance, offset, cubic = (panels[:, column, None] for column in (1, 2, 3))
    mu = (moment - offset) * compliance
    root = np.sqrt(3.0 * np.where(cubic > 0.0, cubic, 1.0))
    bent = 2.0 / root * np.sinh(np.arcsinh(1.5 * root * mu) / 3.0)
    d = np.where(cubic > 0.0, bent, mu)
    return d, compliance / (1.0 + 3.0 * cubic * d**2)


def equations(panels: Array, ends: Array, nodes: Array) -> tuple[Array, Array]:
    """Residual of all equations and its matrix of derivatives, ordered like the nodes.

    Rows: clamp; per panel the four Gauss points, theta and moment at its end; free end.
    """
    count = panels.shape[0]
    h, axial, stretch = (panels[:, column, None] for column in (0, 4, 5))
    theta, theta_a, moment_a = nodes[:-1, 1:5], nodes[:-1, 0, None], nodes[:-1, 5, None]
    n1 = panels[:, 6, None] - GAUSS_ABSCISSAE * panels[:, 8, None]
    n2 = panels[:, 7, None] - GAUSS_ABSCISSAE * panels[:, 9, None]
    t = n1 * np.cos(theta) + n2 * np.sin(theta)
    u = n2 * np.cos(theta) - n1 * np.sin(theta)
    stretched = stretch + axial * t
    slope, slope_changed = -stretched * u, stretched * t - axial * u**2
    d, flexibility = curvature_change(moment_a + h * slope @ GAUSS_INTEGRATION.T, panels)

    size = 6 * count + 2
    residual, matrix = np.zeros(size), np.zeros((size, size))
    residual[0] = ends[0] + ends[1] * nodes[0, 5] - nodes[0, 0]
    matrix[0, 0], matrix[0, 5] = 1.0, -ends[1]
    for p in range(count):
        first, width = 6 * p, panels[p, 0]
        points = slice(first + 1, first + 5)
        following = (first + 6, first + 11 if p + 1 < count else first + 7)
        bending = width * GAUSS_INTEGRATION * flexibility[p]
        to_moment = width * GAUSS_INTEGRATION * slope_changed[p]
        residual[points] = (
            theta_a[p] + panels[p, 10:14] + width * GAUSS_INTEGRATION @ d[p] - theta[p]
        )
        matrix[points, first] = -1.0
        matrix[points, points] = np.eye(4) - bending @ to_moment
        matrix[points, first + 5] = -bending.sum(axis=1)
        weighted = width * GAUSS_WEIGHTS * flexibility[p]
        row = first + 5
        residual[row] = (
            theta_a[p, 0] + panels[p, 14] + width * GAUSS_WEIGHTS @ d[p] - nodes[p + 1, 0]
        )
        matrix[row, first] = -1.0
        matrix[row, points] = -weighted @ to_moment
        matrix[row, first + 5] = -weighted.sum()
        matrix[row, following[0]] = 1.0
        row = first + 6
        residual[row] = moment_a[p, 0] + width * GAUSS_WEIGHTS @ slope[p] - nodes[p + 1, 5]
        matrix[row, points] = -width * GAUSS_WEIGHTS * slope_changed[p]
        matrix[row, first + 5] = -1.0
        matrix[row, following[1]] = 1.0
    sine, cosine = np.sin(nodes[-1, 0]), np.cos(nodes[-1, 0])
    residual[-1] = ends[5] - ends[2] * (ends[3] * cosine + ends[4] * sine) - nodes[-1, 5]
    matrix[-1, -2] = ends[2] * (ends[4] * cosine - ends[3] * sine)
    matrix[-1, -1] = 1.0
    return residual, matrix


def newton(
    panels: Array, ends: Array, nodes: Array, most_iterations: int, tolerance: float
) -> tuple[float, int]:
    """Newton's method in place, as `collocation.newton`: residual (rad) and number of steps."""
    scale = float(panels[:, 0].sum() * np.abs(panels[:, 1]).max())
    in_radians = np.ones(6 * panels.shape[0] + 2)
    in_radians[6::6] = scale
    in_radians[-1] = scale
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
        for _ in range(9):
            nodes[:-1] = before[:-1] + size * step[:-2].reshape(-1, 6)
            nodes[-1, 0] = before[-1, 0] + size * step[-2]
            nodes[-1, 5] = before[-1, 5] + size * step[-1]
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
