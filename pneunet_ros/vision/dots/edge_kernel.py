"""Sums over the pixels near the edge of an ellipse, for one step of its fit."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, summing

Integers = npt.NDArray[np.int64]

# Unknowns: shift of the center; size, two changes of shape; blur; motion; plateau and its slopes.
# The first eight move the edge.
UNKNOWNS, MOVING = 11, 8
# Columns after them: residual of a pixel, and derivative of its grey level with respect to a shift
# of the edge.
LEFT, EDGE = 11, 12
# The pixels near an edge are stored in blocks: BLOCK numbers for each of these columns, one column
# after the other in one array, so that loops over the pixels are vectorized. The derivative of a
# pixel by the plateau is its coverage; the columns up to DRAWN are sums over moments.
BLOCK = 256
COVERED = 8
FURTHER, X, Y, LEVEL, SECTOR, SHARE, BARE, HEIGHT, WEIGHT, WEIGHTED = range(13, 23)
DRAWN, LINES = 14, 23
# The pixels that can be near an edge, one per row: px from the initial center, grey level, the
# sector and the fraction of the way to the next one, and px outside of the current edge.
RIM_X, RIM_Y, RIM_LEVEL, RIM_SECTOR, RIM_SHARE, RIM_OUTSIDE = range(6)
RIM_LINES = 6
MOST_MOMENTS = 13  # of an exposure
# Table of the normal distribution: entries per standard deviation, and number of standard
# deviations.
STEPS, FARTHEST = 64, 8
SIXTH = 1.0 / 6.0  # a division takes as long as ten multiplications


def normal_table() -> Array:
    """Return distribution and density of the normal distribution at steps, (steps, 2)."""
    x = np.arange(-FARTHEST * STEPS, FARTHEST * STEPS + 1) / STEPS
    below = [0.5 * math.erfc(-it / math.sqrt(2.0)) for it in x]
    return np.column_stack([below, np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)])


NORMAL = normal_table()


def exposure_tables(most: int) -> tuple[Array, Array]:
    """Return times within an exposure, -1/2 to 1/2, and their weights, (most + 1, most) each.

    Row n has n times, by Gauss-Legendre quadrature.
    """
    times, parts = np.zeros((2, most + 1, most))
    for count in range(1, most + 1):
        nodes, weights = np.polynomial.legendre.leggauss(count)
        times[count, :count], parts[count, :count] = 0.5 * nodes, 0.5 * weights
    return times, parts


TIMES, PARTS = exposure_tables(MOST_MOMENTS)


@inlined
def normal_at(x: float) -> tuple[float, float]:
    """Return the tail probability of a normal distribution above x, and its density, to 1e-13.

    Taylor series from the nearest step; the derivatives are Hermite polynomials. Free of branches,
    so that a loop over pixels is vectorized.
    """
    x = min(max(x, -float(FARTHEST)), float(FARTHEST))
    step = int((x + FARTHEST) * STEPS + 0.5)
    near = step / STEPS - FARTHEST
    off, square = x - near, near * near
    first, second = -0.5 * near, SIXTH * (square - 1.0)
    third, fourth = 0.25 * SIXTH * near * (3.0 - square), square * (square - 6.0) + 3.0
    below, density = NORMAL[step, 0], NORMAL[step, 1]
    area = off * (1.0 + off * (first + off * (second + off * third)))
    more = off * (4.0 * third + off * 0.25 * SIXTH * fourth)
    slope = 1.0 + off * (2.0 * first + off * (3.0 * second + more))
    return 1.0 - below - density * area, density * slope


@inlined
def distance_outside(xx: float, xy: float, yy: float, across: float, down: float) -> float:
    """Return the distance of a point outside an ellipse, px; xx, xy, yy: its inverse axes.

    across, down: the point relative to the unit circle.
    """
    ratio = math.sqrt(max(across * across + down * down, 1e-12))
    out_x, out_y = xx * across + xy * down, xy * across + yy * down
    # The center has no normal; it is far inside the edge.
    return (ratio - 1.0) * ratio / max(math.sqrt(out_x * out_x + out_y * out_y), 1e-18)


@inner
def linearize_edge(
    rim: Array,
    many: int,
    given: Array,
    believed: Array,
    moments: int,
    reach: float,
    blocks: Array,
    sums: tuple[Array, Array],
    background: Array,
) -> tuple[int, float]:
    """Accumulate the normal equations of an ellipse over its pixels.

    rim (lines, pixels), as in `Rim`, the first `many` of them; given (GIVEN,), the present
    ellipse; believed (sectors,); moments of an exposure; reach: distance from the edge within
    which pixels count, px. Fills blocks (blocks, LINES * BLOCK) with the pixels near the edge, and
    sums: the weighted products (UNKNOWNS + 1, UNKNOWNS + 1) of the
    derivatives and the residual (lower half), and the background (sectors,). background (sectors,
    2): scratch. Returns the number of pixels near the edge, and their weight.
    """
    product, behind = sums
    count = believed.size
    near = collect_near(rim, many, given, reach, blocks)
    background[:] = 0.0
    for block in range(0, near, BLOCK):
        lines, size = blocks[block // BLOCK], min(near - block, BLOCK)
        lines[: DRAWN * BLOCK] = 0.0
        for moment in range(moments):
            draw_moment(lines, size, given, TIMES[moments, moment], PARTS[moments, moment])
        mix_light(lines, size, given)
        add_background(lines, size, background)
    for sector in range(count):
        before, after = (sector - 1) % count, (sector + 1) % count
        around = 0.5 * (background[before, 1] + background[after, 1])
        level = 0.5 * (background[before, 0] + background[after, 0])
        behind[sector] = (background[sector, 0] + level) / max(
            background[sector, 1] + around, 1e-6
        )
    product[:] = 0.0
    total = 0.0
    for block in range(0, near, BLOCK):
        lines, size = blocks[block // BLOCK], min(near - block, BLOCK)
        total += weigh(lines, size, behind, believed)
        add_products(lines, size, product)
    return near, total


@inner
def collect_near(rim: Array, many: int, given: Array, reach: float, blocks: Array) -> int:
    """Collect the pixels of a rim near an edge in blocks, and return their number."""
    xx, xy, yy, off_u, off_v = given[0], given[1], given[2], given[9], given[10]
    all_x, all_y, outside = rim[RIM_X], rim[RIM_Y], rim[RIM_OUTSIDE]
    for pixel in range(many):
        x, y = all_x[pixel] - off_u, all_y[pixel] - off_v
        outside[pixel] = distance_outside(xx, xy, yy, xx * x + xy * y, xy * x + yy * y)
    near = 0
    for pixel in range(many):
        if abs(outside[pixel]) < reach:
            lines, place = blocks[near // BLOCK], near % BLOCK
            lines[X * BLOCK + place] = all_x[pixel] - off_u
            lines[Y * BLOCK + place] = all_y[pixel] - off_v
            lines[LEVEL * BLOCK + place] = rim[RIM_LEVEL, pixel]
            lines[SECTOR * BLOCK + place] = rim[RIM_SECTOR, pixel]
            lines[SHARE * BLOCK + place] = rim[RIM_SHARE, pixel]
            near += 1
    return near


@inner
def draw_moment(lines: Array, size: int, given: Array, time: float, part: float) -> None:
    """Add the pixel coverage by an ellipse in a block at one moment of the exposure.

    time, part: the moment and its share of the exposure.
    """
    xx, xy, yy = given[0], given[1], given[2]
    sharp, way_u, way_v = 1.0 / given[3], time * given[4], time * given[5]
    for place in range(size):
        px, py = lines[X * BLOCK + place] - way_u, lines[Y * BLOCK + place] - way_v
        across, down = xx * px + xy * py, xy * px + yy * py
        square = max(across * across + down * down, 1e-12)
        ratio = math.sqrt(square)
        out_x, out_y = xx * across + xy * down, xy * across + yy * down
        # The center has no normal; it is far inside the edge.
        normal = 1.0 / max(math.sqrt(out_x * out_x + out_y * out_y), 1e-18)
        stretch = ratio * normal
        distance = (ratio - 1.0) * stretch * sharp
        above, density = normal_at(distance)
        density *= part * sharp
        move_u, move_v = density * normal * out_x, density * normal * out_y
        stretched = density * stretch
        turned = stretched / square
        lines[place] += move_u
        lines[BLOCK + place] += move_v
        lines[2 * BLOCK + place] += stretched
        lines[3 * BLOCK + place] += turned * (across * across - down * down)
        lines[4 * BLOCK + place] += 2.0 * turned * across * down
        lines[5 * BLOCK + place] += density * distance
        lines[6 * BLOCK + place] += time * move_u
        lines[7 * BLOCK + place] += time * move_v
        lines[COVERED * BLOCK + place] += part * above
        lines[EDGE * BLOCK + place] += density
        lines[FURTHER * BLOCK + place] += part * ratio


@inner
def mix_light(lines: Array, size: int, given: Array) -> None:
    """Add plateau and slopes of the light to the pixels of a block; leaves residuals."""
    plateau, slope_u, slope_v = given[6], given[7], given[8]
    for place in range(size):
        x, y = lines[X * BLOCK + place], lines[Y * BLOCK + place]
        covered = lines[COVERED * BLOCK + place]
        beyond = 1.0 / lines[FURTHER * BLOCK + place]
        bare = 1.0 - covered
        lever = covered + bare * (1.0 - beyond)
        tilt = slope_u * x + slope_v * y
        lines[9 * BLOCK + place], lines[10 * BLOCK + place] = lever * x, lever * y
        lines[LEFT * BLOCK + place] = (
            lines[LEVEL * BLOCK + place] - plateau * covered - lever * tilt
        )
        lines[BARE * BLOCK + place] = bare
        lines[HEIGHT * BLOCK + place] = plateau + tilt * beyond


@inner
def add_background(lines: Array, size: int, background: Array) -> None:
    """Add the background grey levels of the pixels of a block, by sector."""
    count = len(background)
    for place in range(size):
        share, bare = lines[SHARE * BLOCK + place], lines[BARE * BLOCK + place]
        first = int(lines[SECTOR * BLOCK + place])
        after = (first + 1) % count
        said, known = bare * lines[LEFT * BLOCK + place], bare * bare
        background[first, 0] += (1.0 - share) * said
        background[first, 1] += (1.0 - share) * known
        background[after, 0] += share * said
        background[after, 1] += share * known


@inner
def weigh(lines: Array, size: int, behind: Array, believed: Array) -> float:
    """Subtract the background from the pixels of a block, and return the sum of their weights."""
    count, total = behind.size, 0.0
    for place in range(size):
        first, share = int(lines[SECTOR * BLOCK + place]), lines[SHARE * BLOCK + place]
        after = (first + 1) % count
        level = behind[first] + share * (behind[after] - behind[first])
        weight = believed[first] + share * (believed[after] - believed[first])
        lines[WEIGHT * BLOCK + place] = weight
        lines[HEIGHT * BLOCK + place] -= level
        lines[LEFT * BLOCK + place] -= lines[BARE * BLOCK + place] * level
        total += weight
    for place in range(size):
        lines[EDGE * BLOCK + place] *= lines[HEIGHT * BLOCK + place]
    for unknown in range(MOVING):
        for place in range(size):
            lines[unknown * BLOCK + place] *= lines[HEIGHT * BLOCK + place]
    return total


@summing
def add_products(lines: Array, size: int, product: Array) -> None:
    """Add the weighted products of derivatives and residuals over a block."""
    weights, weighted = lines[WEIGHT * BLOCK :], lines[WEIGHTED * BLOCK :]
    for row in range(UNKNOWNS + 1):
        first = lines[row * BLOCK :]
        for place in range(size):
            weighted[place] = weights[place] * first[place]
        for column in range(row + 1):
            second, total = lines[column * BLOCK :], 0.0
            for place in range(size):
                total += weighted[place] * second[place]
            product[row, column] += total


@inner
def add_edges(lines: Array, size: int, step: Array, edges: Array) -> None:
    """Add the residuals of the pixels of a block after a step to edges (sectors, 2).

    Per sector: the residual times the sensitivity of the pixel to the edge, and the sensitivity
    squared.
    """
    count = len(edges)
    for unknown in range(UNKNOWNS):
        way = step[unknown]
        for place in range(size):
            lines[LEFT * BLOCK + place] -= way * lines[unknown * BLOCK + place]
    for place in range(size):
        first, edge = int(lines[SECTOR * BLOCK + place]), lines[EDGE * BLOCK + place]
        share, left = lines[SHARE * BLOCK + place], lines[LEFT * BLOCK + place]
        after = (first + 1) % count
        edges[first, 0] += (1.0 - share) * edge * left
        edges[first, 1] += (1.0 - share) * edge * edge
        edges[after, 0] += share * edge * left
        edges[after, 1] += share * edge * edge
