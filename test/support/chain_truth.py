"""A second solver of the rod: 4000 cells, trapezoidal rule, Newton on a banded matrix.

It is written from Eqs 2-4 and 10 alone, has a node where the moment law jumps, and shares no line
with the package's solver. Two meshes and Richardson's extrapolation leave errors of fourth order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.model.arm import Arm
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded

from support.rod_equations import interpolated, parameter, solved_bending


@dataclass(frozen=True, kw_only=True)
class Chain:
    """x, y (m), theta (rad), moment (N m) and curvature (1/m) at stations."""

    x: np.ndarray
    y: np.ndarray
    theta: np.ndarray
    moment: np.ndarray
    curvature: np.ndarray


class Cells:
    """A mesh with everything of Eqs 2-4 and 10 that does not depend on the unknowns."""

    def __init__(self, arm: Arm, pressure: float, cells: int) -> None:
        law, length = arm.moment_law, arm.length

        def at(table: np.ndarray) -> np.ndarray:
            return interpolated(law.pressure, np.asarray(table), pressure)

        split = float(at(law.split))
        first = round(cells * split)
        self.first = first
        self.s = length * np.concatenate(
            [np.linspace(0, split, first + 1)[:-1], np.linspace(split, 1, cells - first + 1)]
        )
        self.h = np.diff(self.s)
        section = (np.arange(cells) >= first).astype(int)
        self.rigidity = arm.weight * length**2 * at(law.rigidity)[section]
        self.offset = arm.weight * length * at(law.moment_offset)[section]
        self.cubic = parameter(arm, 'stiffening', 'coefficient')
        table = arm.intrinsic_curvature
        row = interpolated(table.pressure, table.curvature, pressure)
        self.intrinsic = CubicSpline(table.arclength, row)(self.s / length)
        self.compliance = 1 / parameter(arm, 'extensibility', 'axial_stiffness', np.inf)
        self.stretch = 1 + pressure * (
            parameter(arm, 'pressure_elongation', 'strain_per_pascal')
            + parameter(arm, 'pressure_elongation', 'strain_per_pascal_squared') * pressure
        )
        self.line = np.array(
            [parameter(arm, 'gravity', 'weight_x'), parameter(arm, 'gravity', 'weight_y')]
        )
        self.clamp = arm.clamp_angle, parameter(arm, 'clamp_compliance', 'compliance')
        self.reach = parameter(arm, 'load_offset', 'offset')
        self.rest = length - self.s

    def bending(self, moment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Curvature beside the intrinsic one at both ends of cells (2, cells); its slope in M."""
        ends = np.stack([moment[:-1], moment[1:]]) - self.offset
        d = solved_bending(ends, self.rigidity, self.cubic)
        return d, 1 / (self.rigidity * (1 + 3 * self.cubic * d**2))

    def forces(self, theta: np.ndarray, force: np.ndarray, share: float) -> tuple[np.ndarray, ...]:
        """Stretch, axial and transverse force at all nodes."""
        n = share * (force[:, None] + self.line[:, None] * self.rest)
        axial = n[0] * np.cos(theta) + n[1] * np.sin(theta)
        across = n[1] * np.cos(theta) - n[0] * np.sin(theta)
        return self.stretch + self.compliance * axial, axial, across


def newton(
    cells: Cells,
    theta: np.ndarray,
    moment: np.ndarray,
    force: np.ndarray,
    end: float,
    share: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve the trapezoidal equations under a share of the load, from a guess."""
    h, size = cells.h, 2 * theta.size
    clamp_angle, clamp_compliance = cells.clamp
    for _ in range(30):
        d, slope = cells.bending(moment)
        stretch, axial, across = cells.forces(theta, force, share)
        turn = stretch * axial - cells.compliance * across**2  # -d(stretch across)/d theta
        kappa = cells.intrinsic[:-1] + d[0] + cells.intrinsic[1:] + d[1]
        residual = np.empty(size)
        residual[0] = theta[0] - clamp_angle - clamp_compliance * moment[0]
        residual[1:-1:2] = np.diff(theta) - 0.5 * h * kappa
        residual[2:-1:2] = np.diff(moment) + 0.5 * h * (
            stretch[:-1] * across[:-1] + stretch[1:] * across[1:]
        )
        residual[-1] = (
            moment[-1]
            - share * end
            + cells.reach * share * (force[0] * np.cos(theta[-1]) + force[1] * np.sin(theta[-1]))
        )
        bands = np.zeros((5, size))  # bands[2 + row - column, column]
        bands[2, 0], bands[1, 1] = 1, -clamp_compliance
        bands[3, 0:-2:2], bands[1, 2::2] = -1, 1  # rows 2i + 1: theta
        bands[2, 1:-2:2], bands[0, 3::2] = -0.5 * h * slope[0], -0.5 * h * slope[1]
        bands[4, 0:-2:2], bands[2, 2::2] = -0.5 * h * turn[:-1], -0.5 * h * turn[1:]
        bands[3, 1:-2:2], bands[1, 3::2] = -1, 1  # rows 2i + 2: moment
        bands[3, -2] = (
            cells.reach * share * (force[1] * np.cos(theta[-1]) - force[0] * np.sin(theta[-1]))
        )
        bands[2, -1] = 1
        step = solve_banded((2, 2), bands, -residual)
        theta, moment = theta + step[0::2], moment + step[1::2]
        if np.abs(step[0::2]).max() < 1e-13:
            return theta, moment
    raise AssertionError('the chain has not converged')


def chain_at(
    arm: Arm, pressure: float, force: tuple[float, float], end: float, at: np.ndarray, count: int
) -> np.ndarray:
    """Solve one mesh; x, y, theta, moment and curvature at stations, (5, stations)."""
    cells = Cells(arm, pressure, count)
    moment = np.zeros(count + 1)
    kappa = 0.5 * cells.h * (cells.intrinsic[1:] + cells.intrinsic[:-1])
    theta = arm.clamp_angle + np.append(0.0, np.cumsum(kappa))
    for share in np.linspace(0.25, 1, 4):
        theta, moment = newton(cells, theta, moment, np.array(force), end, float(share))
    stretch, _, _ = cells.forces(theta, np.array(force), 1.0)
    d, _ = cells.bending(moment)

    def summed(values: np.ndarray) -> np.ndarray:
        return np.append(0.0, np.cumsum(0.5 * cells.h * (values[1:] + values[:-1])))

    x, y = summed(stretch * np.cos(theta)), summed(stretch * np.sin(theta))
    out = np.empty((5, at.size))
    for part, cell, inside in (
        (slice(0, cells.first + 1), slice(0, cells.first), at < cells.s[cells.first]),
        (slice(cells.first, None), slice(cells.first, None), at >= cells.s[cells.first]),
    ):
        s = cells.s[part]
        bent = np.append(d[0, cell], d[1, cell][-1])
        fields = np.stack(
            [x[part], y[part], theta[part], moment[part], cells.intrinsic[part] + bent]
        )
        out[:, inside] = CubicSpline(s, fields, axis=1)(at[inside])
    return out


def chain_truth(
    arm: Arm, pressure: float, force: tuple[float, float], at: np.ndarray, end: float = 0.0
) -> Chain:
    """Solve the rod at stations (m): 2000 and 4000 cells, Richardson's extrapolation."""
    coarse = chain_at(arm, pressure, force, end, at, 2000)
    fine = chain_at(arm, pressure, force, end, at, 4000)
    x, y, theta, moment, curvature = (4 * fine - coarse) / 3
    return Chain(x=x, y=y, theta=theta, moment=moment, curvature=curvature)
