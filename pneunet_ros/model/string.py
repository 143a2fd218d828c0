"""A thread from the tip to a fixed eye or pulley, with known tension and unknown direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import millimeters
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import check_finite, check_pair, solve_load, tip_jacobian
from pneunet_ros.model.shape import Shape

MOST_STEPS = 30  # total number of Newton steps
LEAST_TENSION = 1.0 / 64.0  # smallest step of the tension, relative to all of it
EXACT = 1e-9  # of the tension


@dataclass(frozen=True, slots=True, kw_only=True)
class String:
    """A thread that pulls the tip towards an eye at x, y (m, base frame) with a tension (N)."""

    tension: float
    x: float
    y: float

    def __post_init__(self) -> None:
        """Reject a thread without tension, or without a valid eye."""
        if not (math.isfinite(self.tension) and self.tension > 0.0):
            raise RequestError(
                f'the tension of a string must be positive, not {self.tension}',
                reason='out_of_bounds',
            )
        if not (math.isfinite(self.x) and math.isfinite(self.y)):
            raise RequestError(
                f'the eye of a string must be two finite numbers, not {self.x}, {self.y}',
                reason='not_finite',
            )

    def pull(self, tip: Array) -> Array:
        """Return the force (..., 2) N on tips (..., 2) m; zero for a tip at the eye."""
        way = np.array([self.x, self.y]) - tip
        length = np.linalg.norm(way, axis=-1, keepdims=True)
        return np.asarray(self.tension * way / np.maximum(length, np.finfo(float).tiny))

    def slope(self, tip: Array) -> Array:
        """Return d pull / d tip, (2, 2) N/m."""
        way = np.array([self.x, self.y]) - tip
        length = float(np.hypot(*way))
        along = way / length
        return np.asarray(self.tension / length * (np.outer(along, along) - np.eye(2)))

    def check_clearance(self, x: Array, y: Array, radius: float) -> None:
        """Reject an eye nearer than a radius (m) to the arm, the line through points (m).

        x, y: (places,), or (shapes, places) of several shapes.
        """
        points = np.stack([np.atleast_2d(x), np.atleast_2d(y)], axis=-1)
        start, way = points[:, :-1], np.diff(points, axis=1)
        to_eye = np.array([self.x, self.y]) - start
        square = np.sum(way**2, axis=-1)
        share = np.clip(np.sum(to_eye * way, axis=-1) / np.where(square > 0.0, square, 1.0), 0, 1)
        distance = np.linalg.norm(to_eye - share[..., None] * way, axis=-1)
        if np.isfinite(distance).any() and float(np.nanmin(distance)) < radius:
            raise RequestError(
                f'the eye of the string at {millimeters(self.x):.4g}, {millimeters(self.y):.4g} '
                f'mm lies on the arm ({millimeters(float(np.nanmin(distance))):.2g} mm away from '
                'it); X and Y are the point where the thread leaves the eye or pulley, in the '
                'base frame at the clamp',
                reason='out_of_bounds',
            )


def solve_string(
    arm: Arm,
    pressure: float,
    string: String,
    force: tuple[float, float] = (0.0, 0.0),
    moment: float = 0.0,
) -> Shape:
    """Return the equilibrium of an arm with a string at its tip; its `force` is the total load.

    Args:
        arm: the calibrated arm.
        pressure: reading of the sensor, held constant; Pa gauge.
        string: the thread.
        force: F1, F2 on the free end as the sensor reads them, without that of the string, N.
        moment: on the free end, N m.

    Returns:
        The shape; if none was found, its arrays are NaN and `status` says why.

    Raises:
        RequestError: a value is not a finite number, or the eye lies on the arm.

    The direction of the string is found by Newton's method with the compliance of the tip; if this
    does not converge, the tension is increased in smaller steps.
    """
    check_finite(pressure=pressure, moment=moment)
    check_pair(force=force)
    other = arm.sense(Load(pressure=pressure, force_x=force[0], force_y=force[1], moment=moment))
    shape = solve_load(arm, other)
    share, step, steps = 0.0, 1.0, 0
    while shape.converged and share < 1.0 and steps < MOST_STEPS:
        reduced = String(tension=min(share + step, 1.0) * string.tension, x=string.x, y=string.y)
        found, used = settle(arm, other, reduced, shape)
        steps += used
        if found is not None:
            shape, share = found, share + step
        elif step <= LEAST_TENSION:
            break
        else:
            step *= 0.5
    if shape.converged:
        string.check_clearance(shape.x, shape.y, radius_of(arm))
    if shape.converged and share < 1.0:
        eye_in_reach = math.hypot(string.x, string.y) <= arm.reach
        raise RequestError(
            f'the arm has no equilibrium with a string of {string.tension:.3g} N: the search '
            f'ended at {share * string.tension:.3g} N'
            + (
                ', because its eye is within reach of the tip, which is pulled into it; X and Y '
                'are in the base frame at the clamp'
            )
            * eye_in_reach,
            reason='no_equilibrium',
        )
    return shape


def settle(arm: Arm, other: Load, string: String, start: Shape) -> tuple[Shape | None, int]:
    """Iterate from a nearby shape until the force equals that of the string; count the steps.

    other: the true load without that of the string.
    """
    shape, other_force = start, np.array([other.force_x, other.force_y])
    force = other_force + string.pull(np.array(shape.tip[:2]))
    for step in range(1, 1 + MOST_STEPS // 3):
        load = replace(other, force_x=float(force[0]), force_y=float(force[1]))
        shape = solve_load(arm, load, shape)
        if not shape.converged:
            return None, step
        tip = np.array(shape.tip[:2])
        residual = other_force + string.pull(tip) - force
        if float(np.hypot(*residual)) <= EXACT * string.tension:
            return shape, step
        per_force = tip_jacobian(arm, shape)[:2, 1:3]
        force = force + np.linalg.solve(np.eye(2) - string.slope(tip) @ per_force, residual)
    return None, MOST_STEPS // 3


def tip_amplification(string: String, tip: Array, jacobian: Array) -> Array:
    """Return the amplification of tip changes (x, y, theta) by the rotating string, (3, 3).

    jacobian (3, 4) of the tip under a constant force. Multiply the Jacobian, or a root of the
    covariance, by the result from the left.
    """
    turning = np.zeros((3, 3))
    turning[:, :2] = jacobian[:, 1:3] @ string.slope(tip[:2])
    return np.asarray(np.linalg.inv(np.eye(3) - turning))


def radius_of(arm: Arm) -> float:
    """Return the clearance (m) around the centerline: a hundredth of the length."""
    return 0.01 * arm.length
