"""Moments of the areas within contours, contour by contour."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel

Integers = npt.NDArray[np.int64]


@kernel
def fill_moments(
    corners: npt.NDArray[np.int32], sizes: Integers, table: Array, length: Array
) -> None:
    """Compute the moments of the pixels within contours, and the number of pixels on each.

    corners (all, 2): of all contours in sequence, `sizes` (n,) of each. table (n, 6): area, center
    u, v and moments uu, uv, vv, NaN for a hairline; areas of holes are negative; length (n,).
    """
    first = 0
    for number in range(sizes.size):
        after = first + sizes[number]
        from_x, from_y = corners[first, 0], corners[first, 1]
        twice = by_x = by_y = by_xx = by_xy = by_yy = way = pixels = 0.0
        x, y = float(corners[after - 1, 0] - from_x), float(corners[after - 1, 1] - from_y)
        for corner in range(first, after):
            x2, y2 = float(corners[corner, 0] - from_x), float(corners[corner, 1] - from_y)
            cross = x2 * y - x * y2  # contours of areas turn from +v to +u
            twice += cross
            by_x += cross * (x + x2)
            by_y += cross * (y + y2)
            by_xx += cross * (x * x + x * x2 + x2 * x2)
            by_xy += cross * (2.0 * (x * y + x2 * y2) + x * y2 + x2 * y)
            by_yy += cross * (y * y + y * y2 + y2 * y2)
            step_x, step_y = abs(x2 - x), abs(y2 - y)
            way += math.sqrt(step_x * step_x + step_y * step_y)
            pixels += max(step_x, step_y)
            x, y = x2, y2
        area = 0.5 * twice
        # The contour passes through the middle of pixels: half a pixel is outside.
        outer = 0.5 * way + 1.0
        length[number] = pixels
        table[number, 0] = area + outer if area > 0.0 else area + outer - 2.0
        first = after
        if area == 0.0:
            table[number, 1:] = math.nan
            continue
        u, v = by_x / (6.0 * area), by_y / (6.0 * area)
        larger = (area + outer) / area
        table[number, 1], table[number, 2] = u + from_x, v + from_y
        table[number, 3] = larger * (by_xx / (12.0 * area) - u * u)
        table[number, 4] = larger * (by_xy / (24.0 * area) - u * v)
        table[number, 5] = larger * (by_yy / (12.0 * area) - v * v)
