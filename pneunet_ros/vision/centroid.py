"""Where the center of an area is, how large it is and how long: moments of weights.

The center is the centroid of weights. At the edge of the ellipse that has the moments of the area
the weight is what the grey value says, without any clamping, so that noise has no preferred
direction. Elsewhere it is 1 in the area and 0 outside: pixels there have noise and know nothing
of the center.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, part
from pneunet_ros.vision.background import Bytes, grey_at, Integers, Layout, Pixel

Array = npt.NDArray[np.float64]
Ground = tuple[float, float, float, float, float, float]  # see `background_plane`

# Columns of a measured area.
U, V, AREA, MAJOR, MINOR, ANGLE, STD, CONTRAST = range(8)
COLUMNS = 8

# Half the thickness of the edge in which grey values count: of its width, and px. Tuned on drawn
# dots: thinner loses blurred edges, thicker gathers noise.
WIDER = 0.65
MARGIN = 0.5


@inlined
def moments_of(
    runs: Integers, count: int, inside: Pixel
) -> tuple[float, float, float, float, float, float]:
    """Return the moments of runs about a pixel: 1, x, y, xx, xy, yy."""
    # All are integers or, those with a middle, quarters of them: there is no rounding.
    m = mx = my = mxx = mxy = myy = 0.0
    for k in range(count):
        row, first, last = int(runs[k, 0]), int(runs[k, 1]), int(runs[k, 2])
        n = float(last - first + 1)
        middle = 0.5 * (first + last) - inside[0]
        y = float(row - inside[1])
        m += n
        mx += n * middle
        my += n * y
        mxx += n * (middle * middle + (n * n - 1.0) / 12.0)
        mxy += n * middle * y
        myy += n * y * y
    return m, mx, my, mxx, mxy, myy


@part
def weigh(
    data: Bytes,
    layout: Layout,
    inside: Pixel,
    half: int,
    plateau: int,
    edge: float,
    ground: Ground,
    runs: Integers,
    heads: Integers,
    top: int,
    bright: int,
    count: int,
    out: Array,
) -> bool:
    """Write center, moments and standard error of the area that runs are; False without one.

    The first `bright` runs are at `half` or brighter, the others are closed holes. `edge` is how
    many pixels the whole rise from background to plateau takes.
    """
    x0, y0 = inside
    level, slope_x, slope_y, variance, frame_xx, frame_yy = ground
    height = plateau - level
    if variance < 0.0 or height <= 0.0:
        return False
    m, mx, my, mxx, mxy, myy = moments_of(runs, count, inside)
    cx, cy = mx / m, my / m
    xx, xy, yy = mxx / m - cx * cx, mxy / m - cx * cy, myy / m - cy * cy
    radius = math.sqrt(m / math.pi)
    width = min(max(edge / (2.0 * math.pi * radius), 1.0), 4.0)
    reach = (WIDER * width + MARGIN) / radius
    outer = (1.0 + reach) * (1.0 + reach)
    inner = max(1.0 - reach, 0.0) * max(1.0 - reach, 0.0)
    determinant = xx * yy - xy * xy
    if determinant <= 0.01:
        return False
    # x^2 a + 2 x y b + y^2 c = 1 is the ellipse with these moments.
    a, b, c = 0.25 * yy / determinant, -0.25 * xy / determinant, 0.25 * xx / determinant
    tall = math.sqrt(outer / (c - b * b / a))
    per_height, per_a = 1.0 / height, 1.0 / a
    flat = c - b * b * per_a
    n_xx = n_yy = 0.0
    for row in range(
        max(math.ceil(y0 + cy - tall), 0), min(math.floor(y0 + cy + tall), layout[1] - 1) + 1
    ):
        y = row - y0 - cy
        shift = -b * y * per_a
        rest = flat * y * y
        far = math.sqrt(max(outer - rest, 0.0) * per_a)
        near = math.sqrt((inner - rest) * per_a) if inner > rest else -1.0
        latest = heads[row - top] if 0 <= row - top < heads.size else -1
        first, last = (runs[latest, 1], runs[latest, 2]) if latest >= 0 else (1, 0)
        one_run = latest < bright and (latest < 0 or runs[latest, 3] < 0)
        iy = float(row - y0)
        base = level + slope_y * iy
        w = wx = wxx = n = 0.0
        begin = max(math.ceil(x0 + cx + shift - far), 0)
        end = min(math.floor(x0 + cx + shift + far), layout[0] - 1)
        # The edge lies left and right of the inner ellipse, where the row meets that.
        left_end, right_begin = end, end + 1
        if near >= 0.0:
            left_end = math.floor(x0 + cx + shift - near)
            right_begin = max(math.ceil(x0 + cx + shift + near), left_end + 1)
        for side in range(2):
            for x in range(right_begin if side else begin, (end if side else left_end) + 1):
                g = grey_at(data, layout, x, row)
                member = first <= x <= last
                # Other white does not count, and a closed hole counts as it is.
                counts = member or g < half
                if not one_run:
                    k = latest
                    while k >= 0 and not runs[k, 1] <= x <= runs[k, 2]:
                        k = runs[k, 3]
                    member = k >= 0
                    counts = k < bright and (member or g < half)
                ix = float(x - x0)
                weight = (g - base - slope_x * ix) * per_height - (1.0 if member else 0.0)
                weight *= 1.0 if counts else 0.0
                w += weight
                wx += weight * ix
                wxx += weight * ix * ix
                n += 1.0
                n_xx += (ix - cx) * (ix - cx)
        n_yy += n * y * y
        m += w
        mx += wx
        my += w * iy
        mxx += wxx
        mxy += wx * iy
        myy += w * iy * iy
    if m <= 0.0:
        return False
    cx, cy = mx / m, my / m
    # A pixel is a square, which adds its own moment.
    xx = mxx / m - cx * cx - 1.0 / 12.0
    yy = myy / m - cy * cy - 1.0 / 12.0
    xy = mxy / m - cx * cy
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    if middle - spread <= 0.0:
        return False
    # Noise of the edge pixels, and of the slopes of the background under them.
    noise = max(n_xx + n_xx * n_xx / frame_xx, n_yy + n_yy * n_yy / frame_yy) * variance
    out[U], out[V], out[AREA] = x0 + cx, y0 + cy, m
    out[MAJOR] = 4.0 * math.sqrt(middle + spread)
    out[MINOR] = 4.0 * math.sqrt(middle - spread)
    out[ANGLE] = 0.5 * math.atan2(2.0 * xy, xx - yy)
    out[STD] = math.sqrt(noise) / (height * m)
    out[CONTRAST] = height
    return True
