"""Find white areas in a grey image and measure each one: the compiled part of `detection`.

An area is grown from a pixel by `flooding`, first at the level that tells white from dark, then at
half height between its plateau and its `background`, and goes on the scales of `weighing`.

`picture` = (bytes, layout); `look` = (level of white, or -1: as much above the background as the
least contrast; limits; length of the longest area, px);
`limits` = (smallest, largest, elongation, hole, brightest plateau, least contrast);
`work` = (runs, heads, histogram, frame).
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.jit import inlined, kernel, part
from pneunet_ros.vision.background import (
    background_at,
    background_plane,
    Box,
    Bytes,
    frame_around,
    grey_at,
    Integers,
    Layout,
    most_in_frame,
    Picture,
    Pixel,
    surroundings,
)
from pneunet_ros.vision.centroid import AREA, Array, COLUMNS, CONTRAST, MAJOR, MINOR, U, V, weigh
from pneunet_ros.vision.connected_components import (
    box_of,
    close_holes,
    flood,
    forget,
    marked,
    NOWHERE,
    plain_area,
)

Limits = tuple[float, float, float, float, int, float]
Look = tuple[int, Limits, int]
Work = tuple[Integers, Integers, Integers, Integers]

TILE = 32  # px, side of the tiles for which `measure_all` takes the background anew
MOST_AREAS = 1000


@inlined
def work_space(longest: int) -> Work:
    """Return room for the runs of an area that is `longest` px long."""
    rows = 2 * longest + 1
    return (
        np.empty((4 * rows, 4), np.int32),
        np.full(rows, -1, np.int32),
        np.empty(256, np.int32),
        np.empty((3, most_in_frame(rows)), np.int32),
    )


@inlined
def grow(
    data: Bytes,
    layout: Layout,
    start: Pixel,
    level: int,
    most: int,
    work: Work,
    top: int,
    marks: Bytes,
    corner: Pixel,
) -> tuple[int, int, bool]:
    """Fill the runs of the white area of a pixel; return as `flood` does, and whether it is plain.

    A plain area has no hole.
    """
    runs, heads = work[0], work[1]
    count, pixels = plain_area(data, layout, start, level, most, runs, heads, top)
    if pixels >= 0:
        met = corner != NOWHERE and marked(runs, count, marks, corner)
        return count, -1 if met else pixels, True
    forget(runs, heads, top, 0, count)
    count, pixels = flood(
        data, layout, start, level, True, most, runs, heads, top, 0, marks, corner
    )
    return count, pixels, False


@inlined
def cut_off(box: Box, layout: Layout) -> bool:
    """Whether the image cuts off what is in a box."""
    left, right, upper, lower = box
    return left < 2 or upper < 2 or right > layout[0] - 3 or lower > layout[1] - 3


@part
def measure(
    data: Bytes,
    layout: Layout,
    limits: Limits,
    start: Pixel,
    level: int,
    background: tuple[int, int],
    work: Work,
    marks: Bytes,
    corner: Pixel,
    out: Array,
) -> bool:
    """Measure the area to which a pixel that is at `level` or brighter belongs.

    Writes a row of COLUMNS into `out`; False where the area cannot be a target.
    """
    smallest, largest, elongation, hole, brightest, contrast = limits
    runs, heads, histogram, frame = work
    top = start[1] - heads.size // 2
    most = int(2.0 * largest) + 100
    count, pixels, _ = grow(data, layout, start, level, most, work, top, marks, corner)
    if pixels < 0.5 * smallest:
        forget(runs, heads, top, 0, count)
        return False

    framed = frame_around(data, layout, box_of(runs, count), start, frame)
    background = surroundings(frame, framed, background, histogram)
    # The plateau, and from it the level at which the area is as large as it is without blur.
    histogram[:] = 0
    peak = -1
    x = y = 0
    for k in range(count):
        for column in range(runs[k, 1], runs[k, 2] + 1):
            g = grey_at(data, layout, column, runs[k, 0])
            histogram[g] += 1
            if g > peak:
                peak, x, y = g, column, int(runs[k, 0])
    plateau = peak
    brighter = histogram[peak]
    while 8 * brighter < pixels:
        plateau -= 1
        brighter += histogram[plateau]
    forget(runs, heads, top, 0, count)
    if plateau - background[0] < contrast or plateau > brightest:
        return False
    half = (background[0] + plateau + 1) // 2
    # How many pixels are between a fifth and four fifths of the height tells how wide the edge is.
    light = background[0] + 4 * (plateau - background[0]) // 5
    fifth = background[0] + (plateau - background[0]) // 5
    dim = min(max(fifth, level), light - 1)
    edge = 0.0
    for g in range(dim, light):
        edge += histogram[g]
    edge *= (plateau - background[0]) / (light - dim)
    bright, pixels, plain = grow(data, layout, (x, y), half, most, work, top, marks, NOWHERE)
    if pixels < 0.5 * smallest:
        forget(runs, heads, top, 0, bright)
        return False
    count = bright
    if not plain:
        count = close_holes(data, layout, half, hole, runs, heads, top, bright, marks)
    box = box_of(runs, count)
    found = not cut_off(box, layout) and max(box[1] - box[0], box[3] - box[2]) <= heads.size // 2
    if found:
        framed = frame_around(data, layout, box, (x, y), frame)
        ground = background_plane(frame, framed, background)
        found = weigh(
            data, layout, (x, y), half, plateau, edge, ground, runs, heads, top, bright, count,
            out,
        )  # fmt: skip
    forget(runs, heads, top, 0, count)
    return (
        found
        and smallest <= out[AREA] <= largest
        and out[MAJOR] <= elongation * out[MINOR]
        and out[CONTRAST] >= contrast
    )


@kernel
def measure_nearest(picture: Picture, look: Look, reach: float, size: float, out: Array) -> None:
    """Do for Python what `nearest_areas` does for kernels."""
    nearest_areas(picture, look, reach, size, out)


@part
def nearest_areas(picture: Picture, look: Look, reach: float, size: float, out: Array) -> None:
    """Replace each row of `out`, which begins with a place (u, v), by the area nearest to it.

    size: diameter that is expected, px. NaN where no area that can be a target has its center
    within `reach` px.
    """
    data, layout = picture
    low, limits, longest = look
    width, height = layout[0], layout[1]
    half = math.ceil(reach + size)
    work = work_space(longest)
    measured = np.empty(COLUMNS)
    rings = math.ceil(reach)
    marks = np.empty((2 * rings + 1, 2 * rings + 1), np.uint8)
    for i in range(len(out)):
        u, v = out[i, U], out[i, V]
        out[i, :] = np.nan
        # Written so that NaN is outside, too.
        if not (-reach <= u <= width + reach and -reach <= v <= height + reach):
            continue
        x, y = round(u), round(v)
        background = background_at(data, layout, x, y, half, work[2])
        level = low if low >= 0 else background[0] + math.ceil(limits[5])
        marks[:, :] = 0
        corner = (x - rings, y - rings)
        nearest = reach
        ring = 0
        # A center lies within its area: rings further out than the nearest hold no nearer one.
        while ring <= rings and ring - 0.5 <= nearest:
            for row in range(max(y - ring, 0), min(y + ring, height - 1) + 1):
                step = 1 if abs(row - y) == ring else max(2 * ring, 1)
                for column in range(x - ring, x + ring + 1, step):
                    if not 0 <= column < width or grey_at(data, layout, column, row) < level:
                        continue
                    if marks[row - corner[1], column - corner[0]]:
                        continue
                    if not measure(
                        data, layout, limits, (column, row), level, background, work,
                        marks, corner, measured,
                    ):  # fmt: skip
                        continue
                    distance = math.hypot(measured[U] - u, measured[V] - v)
                    if distance <= nearest:
                        nearest = distance
                        out[i, :] = measured
            ring += 1


@kernel
def measure_all(picture: Picture, look: Look, out: Array) -> int:
    """Fill `out` with all areas that can be targets; return how many, -1 where it is too small."""
    data, layout = picture
    low, limits, longest = look
    half = max(24, math.ceil(2.0 * math.sqrt(limits[1] / math.pi)))
    width, height = layout[0], layout[1]
    work = work_space(longest)
    marks = np.zeros((height, width), np.uint8)
    measured = np.empty(COLUMNS)
    found = 0
    for upper in range(0, height, TILE):
        for left in range(0, width, TILE):
            x, y = left + TILE // 2, upper + TILE // 2
            background = background_at(data, layout, x, y, half, work[2])
            level = low if low >= 0 else background[0] + math.ceil(limits[5])
            # Even the smallest area has a pixel with even row and column.
            for row in range(upper, min(upper + TILE, height), 2):
                for column in range(left, min(left + TILE, width), 2):
                    if grey_at(data, layout, column, row) < level or marks[row, column]:
                        continue
                    if not measure(
                        data, layout, limits, (column, row), level, background, work,
                        marks, (0, 0), measured,
                    ):  # fmt: skip
                        continue
                    if found == len(out):
                        return -1
                    out[found, :] = measured
                    found += 1
    return found
