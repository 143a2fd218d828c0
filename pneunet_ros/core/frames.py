"""Frame ids, axes and the sign of angles.

`pneunet_base`: origin at the clamp (s = 0), x = E1 along the straight arm at the clamp, y = E2 in
the bending plane, right-handed; angles are counter-clockwise about z.
"""

from __future__ import annotations

import math
from typing import TypeVar

from pneunet_ros.core.arrays import Array

BASE_FRAME = 'pneunet_base'
Coordinate = TypeVar('Coordinate', float, Array)


def rotate(angle: float, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
    """Turn vectors of the plane counter-clockwise by `angle` (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def planar_heading(x: float, y: float, z: float, w: float) -> float:
    """Angle (rad) in the plane of the x axis of a frame turned by a quaternion; NaN for none."""
    size = x * x + y * y + z * z + w * w
    if not 0.25 < size < 4.0:  # no rotation, such as all zeros: no heading was measured
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def heading_quaternion(theta: float) -> tuple[float, float]:
    """(z, w) of the unit quaternion whose x axis is the tangent at angle `theta` (rad)."""
    return math.sin(0.5 * theta), math.cos(0.5 * theta)
