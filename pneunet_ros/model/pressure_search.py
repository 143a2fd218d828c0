"""Search for the pressure that gives a wanted tip position, or a wanted force at a fixed tip."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import check_finite, solve
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.shape import Shape

SCANNED = 33  # pressures over the range: of the branches of the search the best one is refined
EXACT = 1e-6  # of the range of pressures


def pressure_for_tip(
    arm: Arm,
    tip: tuple[float, float],
    force: tuple[float, float] = (0.0, 0.0),
    moment: float = 0.0,
) -> tuple[float, Shape]:
    """Find the pressure that brings the tip nearest to a point under a known load.

    Args:
        arm: the calibrated arm.
        tip: x, y of the wanted position of the free end, m, in the base frame.
        force: F1, F2 on the free end, N, in the base frame.
        moment: on the free end, N m.

    Returns:
        The sensor reading at that pressure, Pa gauge, and the shape. Pressure alone moves the tip
        along a curve, so the caller must check the distance from the wanted position.

    Raises:
        RequestError: a value is not a finite number, or the arm has no shape under this load.
    """
    check_finite(tip_x=tip[0], tip_y=tip[1])

    def solve_at(pressure: float, start: Shape | None) -> Shape:
        return solve(arm, pressure, force, moment, start=start)

    return nearest(arm, solve_at, lambda shape: math.dist(shape.tip[:2], tip))


def pressure_for_force(
    arm: Arm, force: float, tip: tuple[float, float], moment: float = 0.0
) -> tuple[float, Shape]:
    """Find the pressure at which an arm with a held tip exerts a wanted force.

    Args:
        arm: the calibrated arm.
        force: its magnitude, N.
        tip: x, y where the free end is held, m, in the base frame.
        moment: on the free end, N m.

    Returns:
        The sensor reading at that pressure, Pa gauge, and the shape; its `force` acts on the arm.
        If there are several such pressures, it is the lowest.

    Raises:
        RequestError: a value is not a finite number, or no pressure of the calibrated range gives
            that force; the message states the nearest force.
    """
    check_finite(force=force, tip_x=tip[0], tip_y=tip[1])

    def solve_at(pressure: float, start: Shape | None) -> Shape:
        return solve_tip(arm, pressure, tip, moment, start=start)

    pressure, found = nearest(arm, solve_at, lambda shape: abs(math.hypot(*shape.force) - force))
    reached = math.hypot(*found.force)
    if abs(reached - force) > max(1e-3 * force, arm.sensors.force_std):
        raise RequestError(
            f'no pressure within the calibrated range gives {force:.4g} N at '
            f'({millimeters(tip[0]):.4g}, {millimeters(tip[1]):.4g}) mm: the nearest is '
            f'{reached:.4g} N, at {kilopascals(pressure):.4g} kPa',
            reason='not_reached',
        )
    return pressure, found


def readings(arm: Arm) -> list[float]:
    """Return readings of the sensor (Pa) over the calibrated range; sensing is affine."""
    low, high = arm.table_range
    sensed_low, sensed_high = (arm.sense(Load(pressure=one)).pressure for one in (low, high))
    gain = (sensed_high - sensed_low) / (high - low)
    limits = [low + (true - sensed_low) / gain for true in arm.pressure_range]
    scanned: list[float] = np.linspace(min(limits), max(limits), SCANNED).tolist()
    return scanned


def nearest(
    arm: Arm, solve_at: Callable[[float, Shape | None], Shape], distance: Callable[[Shape], float]
) -> tuple[float, Shape]:
    """Return the shape at the calibrated pressure with the smallest distance.

    solve_at: the shape at a pressure, started from the previous shape if there is one.
    """
    grid = readings(arm)
    previous: Shape | None = None

    def at(pressure: float) -> Shape:
        nonlocal previous
        shape = solve_at(pressure, previous)
        previous = shape if shape.converged else None
        return shape

    def distance_at(pressure: float) -> float:
        shape = at(pressure)
        return distance(shape) if shape.converged else math.inf

    distances = [distance_at(pressure) for pressure in grid]
    best = int(np.argmin(distances))
    if not math.isfinite(distances[best]):
        raise RequestError(
            f'no shape at any pressure within the calibrated range: {at(grid[0]).status}',
            reason='no_equilibrium',
        )
    from scipy.optimize import minimize_scalar  # slow to import, and rarely needed

    sides = grid[max(best - 1, 0)], grid[min(best + 1, SCANNED - 1)]
    at(grid[best])
    refined = minimize_scalar(
        distance_at,
        bounds=sides,
        method='bounded',
        options={'xatol': EXACT * (grid[-1] - grid[0])},
    )
    pressure = float(refined.x) if refined.fun < distances[best] else grid[best]
    return pressure, at(pressure)
