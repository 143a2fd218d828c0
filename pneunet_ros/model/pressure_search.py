"""Search for the pressure that gives a wanted tip position, or a wanted force at a fixed tip."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import functools
import math

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import check_finite, check_pair, solve
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.shape import Shape

SCANNED = 33  # pressures over the range: of the branches of the search the best one is refined
EXACT = 1e-6  # of the range of pressures, and of the largest force


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
    check_pair(tip=tip)
    at = shape_by_pressure(
        lambda pressure, start: solve(arm, pressure, force, moment, start=start)
    )
    return nearest_shape(readings(arm), at, lambda shape: math.dist(shape.tip[:2], tip))


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
        If there are several such pressures, the lowest is returned.

    Raises:
        RequestError: a value is not a finite number, or no pressure of the calibrated range gives
            that force; the message states the nearest force.
    """
    check_finite(force=force)
    check_pair(tip=tip)
    at = shape_by_pressure(
        lambda pressure, start: solve_tip(arm, pressure, tip, moment, start=start)
    )

    def missed(pressure: float) -> float:
        """Return by how much the force is too large (N); zero if it is exact, else NaN."""
        error = math.hypot(*at(pressure).force) - force
        return 0.0 if abs(error) <= EXACT * arm.force_scale else error

    for low, high in sign_changes(missed, readings(arm)):
        pressure = find_zero(missed, low, high)
        if pressure is not None:
            return pressure, at(pressure)
    pressure, found = nearest_shape(
        readings(arm), at, lambda shape: abs(math.hypot(*shape.force) - force)
    )
    raise RequestError(
        f'no pressure within the calibrated range gives {force:.4g} N at '
        f'({millimeters(tip[0]):.4g}, {millimeters(tip[1]):.4g}) mm: the nearest is '
        f'{math.hypot(*found.force):.4g} N, at {kilopascals(pressure):.4g} kPa',
        reason='not_reached',
    )


def readings(arm: Arm) -> list[float]:
    """Return readings of the sensor (Pa) over the calibrated range; sensing is affine."""
    low, high = arm.table_range
    sensed_low, sensed_high = (arm.sense(Load(pressure=one)).pressure for one in (low, high))
    gain = (sensed_high - sensed_low) / (high - low)
    limits = [low + (true - sensed_low) / gain for true in arm.pressure_range]
    scanned: list[float] = np.linspace(min(limits), max(limits), SCANNED).tolist()
    return scanned


def shape_by_pressure(
    solve_at: Callable[[float, Shape | None], Shape],
) -> Callable[[float], Shape]:
    """Return the shape as a function of pressure; each is solved once, from the previous shape."""
    previous: Shape | None = None

    @functools.cache
    def at(pressure: float) -> Shape:
        nonlocal previous
        shape = solve_at(pressure, previous)
        previous = shape if shape.converged else None
        return shape

    return at


def sign_changes(
    value: Callable[[float], float], grid: Sequence[float]
) -> Iterator[tuple[float, float]]:
    """Yield intervals in which a continuous function changes its sign, the lowest first.

    Two sign changes between grid neighbors are found through the extremum there.
    """
    values: list[float] = []
    for index, place in enumerate(grid):
        values.append(value(place))
        if index and values[-2] * values[-1] <= 0.0:
            yield grid[index - 1], place
        elif index > 1 and 0.0 < values[-2] / values[-1] < 1.0 > values[-2] / values[-3] > 0.0:
            extremum = minimize_between(value, grid, index - 1, math.copysign(1.0, values[-2]))
            if values[-2] * value(extremum) <= 0.0:
                yield grid[index - 2], extremum


def minimize_between(
    value: Callable[[float], float], grid: Sequence[float], index: int, side: float = 1.0
) -> float:
    """Minimize `side` times a function between the neighbors of a grid point."""
    from scipy.optimize import minimize_scalar  # slow to import, and rarely needed

    found = minimize_scalar(
        lambda place: np.nan_to_num(side * value(place), nan=math.inf),
        bounds=(grid[max(index - 1, 0)], grid[min(index + 1, len(grid) - 1)]),
        method='bounded',
        options={'xatol': EXACT * (grid[-1] - grid[0])},
    )
    return float(found.x)


def find_zero(value: Callable[[float], float], low: float, high: float) -> float | None:
    """Return the zero of a function between two signs; None if the function jumps there."""
    from scipy.optimize import brentq  # slow to import, and rarely needed

    try:
        place = float(brentq(value, low, high))
    except ValueError:  # NaN: it is not defined everywhere between
        return None
    return place if value(place) == 0.0 else None


def nearest_shape(
    grid: Sequence[float], at: Callable[[float], Shape], distance: Callable[[Shape], float]
) -> tuple[float, Shape]:
    """Return the shape with the smallest distance, at a pressure within a grid (Pa)."""

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
    at(grid[best])
    pressure = min(grid[best], minimize_between(distance_at, grid, best), key=distance_at)
    return pressure, at(pressure)
