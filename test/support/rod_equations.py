"""The rod's equations (Eqs 2-4, 8 and 10) in integral form, to hold a found shape against.

Nothing of the solver is used. Position, moment, curvature and angle are each computed anew from
the others, by fine quadrature between the places where anything jumps, and compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.shape import Shape

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)
ACROSS = np.array([[0.0, -1.0], [1.0, 0.0]])  # turns a vector counter-clockwise


@dataclass(frozen=True, kw_only=True)
class Violations:
    """By how much a shape fails its equations: position m, moment N m, curvature 1/m, angle."""

    position: float
    moment: float
    curvature: float
    angle: float


def parameter(arm: Arm, effect: str, name: str, neutral: float = 0.0) -> float:
    """Look up a parameter of an effect, neutral where the arm has no such effect."""
    return next((getattr(e, name) for e in arm.effects if e.name == effect), neutral)


def interpolated(pressure: np.ndarray, table: np.ndarray, at: float) -> np.ndarray:
    """Look up a table over pressure, linear between its rows and beyond them."""
    row = int(np.clip(np.searchsorted(pressure, at) - 1, 0, pressure.size - 2))
    share = (at - pressure[row]) / (pressure[row + 1] - pressure[row])
    return (1 - share) * np.asarray(table)[row] + share * np.asarray(table)[row + 1]


def fine_stations(arm: Arm, pressure: float, cells: int = 60) -> np.ndarray:
    """Edges of cells, Gauss points between them; a cell ends where curvature or law has a kink."""
    law = arm.moment_law
    split = arm.length * interpolated(law.pressure, law.split, pressure)
    kinks = np.unique(np.append(arm.length * arm.intrinsic_curvature.arclength, split))
    parts = [np.linspace(a, b, cells, endpoint=False) for a, b in pairwise(kinks)]
    edges = np.concatenate([*parts, [arm.length]])
    points = edges[:-1, None] + np.diff(edges)[:, None] * (POINTS + 1) / 2
    return np.append(np.hstack([edges[:-1, None], points]).ravel(), arm.length)


def solved_bending(moment: np.ndarray, rigidity: np.ndarray, cubic: float) -> np.ndarray:
    """Solve rigidity d (1 + cubic d^2) = moment for d, by Newton's method from above."""
    linear = moment / rigidity
    if cubic == 0:
        return linear
    d = np.minimum(np.abs(linear), np.cbrt(np.abs(linear) / cubic))
    for _ in range(8):
        d -= (d * (1 + cubic * d**2) - np.abs(linear)) / (1 + 3 * cubic * d**2)
    return np.copysign(d, linear)


def violations(arm: Arm, shape: Shape) -> Violations:
    """Hold a shape at `fine_stations` against the equations."""
    law, pressure = arm.moment_law, shape.pressure
    table = np.column_stack([law.split, law.rigidity, law.moment_offset])
    at = interpolated(law.pressure, table, pressure)
    split = arm.length * at[0]
    s, width = shape.arclength, POINTS.size + 1
    points = s[:-1].reshape(-1, width)[:, 1:]
    edges = np.append(s[:-1:width], s[-1])
    weights = np.diff(edges)[:, None] * WEIGHTS / 2

    def at_edges(values: np.ndarray) -> np.ndarray:
        return np.append(values[:-1:width], values[-1])

    def at_points(values: np.ndarray) -> np.ndarray:
        return values[:-1].reshape(-1, width)[:, 1:]

    def integral(values: np.ndarray) -> np.ndarray:
        return np.append(0.0, np.cumsum((weights * values).sum(axis=1)))

    force = np.array(shape.force)
    line = np.array([parameter(arm, 'gravity', 'weight_x'), parameter(arm, 'gravity', 'weight_y')])
    theta = at_points(shape.theta)
    tangent = np.stack([np.cos(theta), np.sin(theta)])
    carried = force[:, None, None] + line[:, None, None] * (arm.length - points)
    strain = parameter(arm, 'pressure_elongation', 'strain_per_pascal') * pressure
    strain += parameter(arm, 'pressure_elongation', 'strain_per_pascal_squared') * pressure**2
    stiffness = parameter(arm, 'extensibility', 'axial_stiffness', np.inf)
    stretch = 1 + strain + (carried * tangent).sum(axis=0) / stiffness
    x, y = integral(stretch * tangent[0]), integral(stretch * tangent[1])
    position = max(np.abs(x - at_edges(shape.x)).max(), np.abs(y - at_edges(shape.y)).max())

    # Eq 8 with line load: the moment of all that acts beyond s, about r(s), from positions alone.
    end = shape.theta[-1]
    reach = parameter(arm, 'load_offset', 'offset')
    tip_x, tip_y = x[-1] - reach * np.sin(end), y[-1] + reach * np.cos(end)
    px, py = at_points(shape.x), at_points(shape.y)
    beyond_x, beyond_y = integral(px), integral(py)
    rest = arm.length - edges
    moment = (
        shape.end_moment
        + (tip_x - x) * force[1]
        - (tip_y - y) * force[0]
        + (beyond_x[-1] - beyond_x - rest * x) * line[1]
        - (beyond_y[-1] - beyond_y - rest * y) * line[0]
    )
    second = points >= split
    rigidity = arm.weight * arm.length**2 * np.where(second, at[2], at[1])
    offset = arm.weight * arm.length * np.where(second, at[4], at[3])
    cubic = parameter(arm, 'stiffening', 'coefficient')
    bending = solved_bending(at_points(shape.moment) - offset, rigidity, cubic)
    intrinsic = arm.intrinsic_curvature.at(pressure, points / arm.length)
    clamp = arm.clamp_angle + parameter(arm, 'clamp_compliance', 'compliance') * moment[0]
    angle = clamp + integral(intrinsic + bending)
    return Violations(
        position=float(position),
        moment=float(np.abs(moment - at_edges(shape.moment)).max()),
        curvature=float(np.abs(intrinsic + bending - at_points(shape.curvature)).max()),
        angle=float(np.abs(angle - at_edges(shape.theta)).max()),
    )
