"""Frame ids, axes and the sign of angles.

`pneunet_base`: origin at the clamp (s = 0), x = E1 along the straight arm at the clamp, y = E2 in
the bending plane, right-handed; angles are counter-clockwise about z.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from pneunet_ros.core.arrays import Array

BASE_FRAME = 'pneunet_base'
Coordinate = TypeVar('Coordinate', float, Array)
Quaternion = tuple[float, float, float, float]  # x, y, z, w
UNTURNED: Quaternion = (0.0, 0.0, 0.0, 1.0)


def rotate(angle: float, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
    """Rotate in-plane vectors counter-clockwise by `angle` (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def planar_heading(x: float, y: float, z: float, w: float) -> float:
    """Return the in-plane angle (rad) of the x axis of a rotated frame; NaN if undefined."""
    if not is_rotation((x, y, z, w)):  # such as all zeros: the heading was not measured
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def heading_quaternion(theta: float) -> tuple[float, float]:
    """Return (z, w) of the unit quaternion whose x axis is the tangent at angle `theta` (rad)."""
    return math.sin(0.5 * theta), math.cos(0.5 * theta)


def is_rotation(quaternion: Quaternion) -> bool:
    """Whether a quaternion (x, y, z, w) has unit length up to rounding."""
    return 0.25 < sum(part * part for part in quaternion) < 4.0


def rotation_matrix(quaternion: Quaternion) -> Array:
    """Return the matrix (3, 3) that rotates vectors of a frame into its parent."""
    x, y, z, w = np.array(quaternion) / math.hypot(*quaternion)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def composition(first: Quaternion, then: Quaternion) -> Quaternion:
    """Return the composition of two rotations."""
    (x, y, z, w), (a, b, c, d) = first, then
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


def inverse_rotation(quaternion: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    x, y, z, w = quaternion
    return -x, -y, -z, w


def quaternion_of_angles(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return x, y, z, w of a frame rotated by yaw, then pitch, then roll (rad), about its axes."""
    (cr, cp, cy), (sr, sp, sy) = (
        [function(0.5 * angle) for angle in (roll, pitch, yaw)]
        for function in (math.cos, math.sin)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
