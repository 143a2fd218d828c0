"""How bright pixels are, and what is behind an area: its level, its slopes and its noise.

`layout` = (width, height, step, channels, and weights of the first three channels in 1/32768, as
OpenCV has them).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.jit import inlined, part

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int32]
Layout = tuple[int, int, int, int, int, int, int]
Picture = tuple[Bytes, Layout]
Pixel = tuple[int, int]
Box = tuple[int, int, int, int]  # first and last column, first and last row

GAP = 3  # px between an area and the frame around it in which the background is measured
FRAME = 6  # px, thickness of that frame, of which every second row and column is looked at
FEWEST = 16  # pixels of a frame that tell anything
ONE, TWO = np.uintp(1), np.uintp(2)
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded


@inlined
def grey_at(data: Bytes, layout: Layout, x: int, y: int) -> int:
    """Return how bright a pixel is."""
    # Without sign, or a compiled kernel asks at every pixel whether to count from the end.
    i = np.uintp(y * layout[2] + x * layout[3])
    if layout[3] == 1:
        return int(data[i])
    first, second, third = int(data[i]), int(data[i + ONE]), int(data[i + TWO])
    return (first * layout[4] + second * layout[5] + third * layout[6] + 16384) >> 15


@inlined
def middle_and_scatter(histogram: Integers, pixels: int) -> tuple[int, int]:
    """Return the median of so many pixels, and how far below it the darkest sixth ends.

    The darker pixels tell the scatter: they have no bright neighbors among them.
    """
    level = 0
    darker = histogram[0]
    while darker <= pixels // 6 and level < 255:
        level += 1
        darker += histogram[level]
    sixth = level
    while darker <= pixels // 2 and level < 255:
        level += 1
        darker += histogram[level]
    return level, level - sixth


@part
def background_at(
    data: Bytes, layout: Layout, x: int, y: int, half: int, histogram: Integers
) -> tuple[int, int]:
    """Return median and scatter of some 80 pixels spread over +-`half` px."""
    stride = max(1, half // 4)
    histogram[:] = 0
    pixels = 0
    for row in range(max(0, y - half), min(layout[1], y + half + 1), stride):
        for column in range(max(0, x - half), min(layout[0], x + half + 1), stride):
            histogram[grey_at(data, layout, column, row)] += 1
            pixels += 1
    return middle_and_scatter(histogram, pixels)


@inlined
def most_in_frame(longest: int) -> int:
    """Return how many pixels the frame around a box of so many rows and columns has at most."""
    return 4 * (FRAME // 2 + 1) * ((longest + 2 * (GAP + FRAME)) // 2 + 1)


@part
def frame_around(data: Bytes, layout: Layout, box: Box, center: Pixel, frame: Integers) -> int:
    """Fill `frame` (3, n) with x, y from the center and grey values of the pixels around a box.

    Return how many they are: none where there is no room for them.
    """
    left, right = box[0] - GAP, box[1] + GAP
    upper, lower = box[2] - GAP, box[3] + GAP
    if most_in_frame(max(box[1] - box[0], box[3] - box[2]) + 1) > frame.shape[1]:
        return 0
    first, last = max(left - FRAME, 0), min(right + FRAME, layout[0] - 1)
    n = np.uintp(0)
    for row in range(max(upper - FRAME, 0), min(lower + FRAME, layout[1] - 1) + 1, 2):
        beside = upper <= row <= lower
        for side in range(2 if beside else 1):
            begin, end = first, last
            if beside and side == 0:
                end = min(left - 1, last)
            elif beside:
                begin = right + 1 + (right + 1 - first) % 2
            for column in range(begin, end + 1, 2):
                frame[0, n] = column - center[0]
                frame[1, n] = row - center[1]
                frame[2, n] = grey_at(data, layout, column, row)
                n += ONE
    return int(n)


@inlined
def surroundings(
    frame: Integers, pixels: int, background: tuple[int, int], histogram: Integers
) -> tuple[int, int]:
    """Return median and scatter of a frame, or `background` where it has too few pixels.

    A target stands on the arm, which may be much darker than what is behind it.
    """
    if pixels < FEWEST:
        return background
    histogram[:] = 0
    for i in range(pixels):
        histogram[np.uintp(frame[2, np.uintp(i)])] += 1
    return middle_and_scatter(histogram, pixels)


@part
def background_plane(
    frame: Integers, pixels: int, background: tuple[int, int]
) -> tuple[float, float, float, float, float, float]:
    """Fit level and slopes of the background to a frame.

    Return level at the center, slope along x and y, variance of a pixel (-1: too few to tell),
    and the sums of squares of x and y. What is far from the median, bright neighbors above all,
    is left out.
    """
    median, scatter = background
    clip = 4 + 3 * scatter
    kept = s_x = s_y = s_xx = s_xy = s_yy = s_g = s_gx = s_gy = s_gg = 0
    for i in range(pixels):
        at = np.uintp(i)
        g = frame[2, at] - median
        keep = 1 if -clip <= g <= clip else 0
        g *= keep
        x, y = frame[0, at] * keep, frame[1, at] * keep
        kept += keep
        s_x += x
        s_y += y
        s_xx += x * x
        s_xy += x * y
        s_yy += y * y
        s_g += g
        s_gx += g * x
        s_gy += g * y
        s_gg += g * g
    if kept < FEWEST:
        return 0.0, 0.0, 0.0, -1.0, 0.0, 0.0
    xx, yy = s_xx - s_x * s_x / kept, s_yy - s_y * s_y / kept
    xy = s_xy - s_x * s_y / kept
    gx, gy = s_gx - s_g * s_x / kept, s_gy - s_g * s_y / kept
    determinant = xx * yy - xy * xy
    slope_x = (yy * gx - xy * gy) / determinant
    slope_y = (xx * gy - xy * gx) / determinant
    left_over = s_gg - s_g * s_g / kept - slope_x * gx - slope_y * gy
    level = median + (s_g - slope_x * s_x - slope_y * s_y) / kept
    variance = max(left_over / (kept - 3), QUANTIZATION)
    return level, slope_x, slope_y, variance, xx, yy
