"""Distortion of points and its inverse as compiled kernels; `lens` says what it is.

A lens is twelve numbers here: fx, fy, cx, cy (px), k1, k2, p1, p2, k3, k4, k5, k6. `limit` is the
radius, in normalized coordinates, within which its Jacobian is positive definite.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import inlined, kernel

FARTHEST = 1e3  # normalized; 0.06 degrees from a right angle to the axis
MOST_ITERATIONS = 60
MOST_HALVINGS = 40
DONE_PX = 1e-11
ACCEPTED_PX = 1e-9


@inlined
def distort(x: float, y: float, c: Array) -> tuple[float, float, float, float, float]:
    """Compute the distorted coordinates of (x, y), and the Jacobian: xx, xy = yx, yy."""
    q = x * x + y * y
    above = 1.0 + q * (c[4] + q * (c[5] + q * c[8]))
    below = 1.0 + q * (c[9] + q * (c[10] + q * c[11]))
    radial = above / below
    slope = c[4] + q * (2.0 * c[5] + q * 3.0 * c[8])
    slope = 2.0 * (slope - radial * (c[9] + q * (2.0 * c[10] + q * 3.0 * c[11]))) / below
    p1, p2 = c[6], c[7]
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (q + 2.0 * x * x),
        y * radial + p1 * (q + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@kernel
def distort_points(points: Array, c: Array, limit: float) -> None:
    """Replace normalized points (n, 2) by their pixels; NaN beyond the limit."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        points[i, 0] = points[i, 1] = np.nan
        if not (abs(x) < limit and abs(y) < limit and x * x + y * y < limit * limit):
            continue
        x, y, _, _, _ = distort(x, y, c)
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            points[i, 0] = c[0] * x + c[2]
            points[i, 1] = c[1] * y + c[3]


@kernel
def undistort_points(points: Array, c: Array, limit: float) -> None:
    """Replace pixels (n, 2) by their normalized points; NaN where there is none within the limit.

    Newton's method; steps are halved until they come nearer and stay within the limit.
    """
    for i in range(points.shape[0]):
        u, v = points[i, 0], points[i, 1]
        points[i, 0] = points[i, 1] = np.nan
        if not (abs(u - c[2]) < FARTHEST * c[0] and abs(v - c[3]) < FARTHEST * c[1]):
            continue
        goal_x, goal_y = (u - c[2]) / c[0], (v - c[3]) / c[1]
        shrink = min(1.0, 0.99 * limit / max(math.hypot(goal_x, goal_y), 1e-30))
        x, y = goal_x * shrink, goal_y * shrink
        at_x, at_y, xx, xy, yy = distort(x, y, c)
        miss_x, miss_y = goal_x - at_x, goal_y - at_y
        miss = (c[0] * miss_x) ** 2 + (c[1] * miss_y) ** 2
        for _ in range(MOST_ITERATIONS):
            if miss <= DONE_PX**2:
                break
            determinant = xx * yy - xy * xy
            step_x = (yy * miss_x - xy * miss_y) / determinant
            step_y = (xx * miss_y - xy * miss_x) / determinant
            nearer = False
            for _ in range(MOST_HALVINGS):
                new_x, new_y = x + step_x, y + step_y
                if new_x * new_x + new_y * new_y < limit * limit:
                    at_x, at_y, new_xx, new_xy, new_yy = distort(new_x, new_y, c)
                    miss_x, miss_y = goal_x - at_x, goal_y - at_y
                    new_miss = (c[0] * miss_x) ** 2 + (c[1] * miss_y) ** 2
                    if new_miss < miss:
                        nearer = True
                        break
                step_x *= 0.5
                step_y *= 0.5
            if not nearer:
                break
            x, y, xx, xy, yy, miss = new_x, new_y, new_xx, new_xy, new_yy, new_miss
        if miss <= ACCEPTED_PX**2:
            points[i, 0] = x
            points[i, 1] = y


@kernel
def magnify_points(points: Array, c: Array, limit: float, out: Array) -> None:
    """Compute the largest singular value of d normalized / d pixel at points (n, 2), into out."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        out[i] = np.nan
        if abs(x) < limit and abs(y) < limit and x * x + y * y < limit * limit:
            _, _, xx, xy, yy = distort(x, y, c)
            a, b, e, d = c[0] * xx, c[0] * xy, c[1] * xy, c[1] * yy
            largest = 0.5 * (math.hypot(a + d, e - b) + math.hypot(a - d, e + b))
            out[i] = largest / abs(a * d - b * e)
