"""Sums over the pixels near the edge of an ellipse, of which a step of its fit is made."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner

Integers = npt.NDArray[np.int64]

# What is searched: way of the center; size, two changes of shape; blur; way of motion; plateau and
# its slopes. The first eight move the edge.
UNKNOWNS, MOVING = 11, 8
# Columns after them: what is left of a pixel, and how its grey level changes as the edge moves.
LEFT, EDGE, COLUMNS = 11, 12, 13
MOST_MOMENTS = 13  # of an exposure
# The table of the normal distribution, in standard deviations: places in each, and how many.
STEPS, FARTHEST = 64, 8
SIXTH = 1.0 / 6.0  # a division takes as long as ten products


def normal_table() -> Array:
    """Return distribution and density of the normal distribution at steps, (steps, 2)."""
    x = np.arange(-FARTHEST * STEPS, FARTHEST * STEPS + 1) / STEPS
    below = [0.5 * math.erfc(-it / math.sqrt(2.0)) for it in x]
    return np.column_stack([below, np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)])


NORMAL = normal_table()


def exposure_tables(most: int) -> tuple[Array, Array]:
    """Return times of an exposure from -1/2 to 1/2, and their shares of it, (most + 1, most) each.

    Line n holds n of them, by Gauss and Legendre.
    """
    times, parts = np.zeros((2, most + 1, most))
    for count in range(1, most + 1):
        nodes, weights = np.polynomial.legendre.leggauss(count)
        times[count, :count], parts[count, :count] = 0.5 * nodes, 0.5 * weights
    return times, parts


TIMES, PARTS = exposure_tables(MOST_MOMENTS)


class Linearized(NamedTuple):
    """Sums over the pixels near the edges of some ellipses, as these are drawn now.

    products (m, UNKNOWNS + 1, UNKNOWNS + 1): of the derivatives and what is left, weighted;
    weights (m,); behind (m, sectors): grey levels of the background; edges (m, sectors, COLUMNS):
    derivatives, what is left and how much an edge tells, each times the latter; covered (pixels,):
    how much ellipses cover of each pixel, 0 where that does not count.
    """

    products: Array
    weights: Array
    behind: Array
    edges: Array
    covered: Array


@inlined
def normal_at(x: float) -> tuple[float, float]:
    """Return the share of a normal distribution above x, and its density there, to 1e-13.

    Taylor's series from the nearest step; the derivatives are Hermite's polynomials.
    """
    if x >= FARTHEST:
        return 0.0, 0.0
    if x <= -FARTHEST:
        return 1.0, 0.0
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


@inner
def linearize_edge(
    pixels: tuple[Array, Array, Array, Array],
    sectors: Integers,
    piece: tuple[int, int, int],
    given: Array,
    believed: Array,
    moments: int,
    reach: tuple[float, float, float],
    sums: tuple[Array, Array, Array, Array],
    scratch: tuple[Array, Array, Integers, Array],
) -> float:
    """Sum up over the pixels of an ellipse what a step of its fit needs; returns their weight.

    pixels, (pixels,) each: x, y px, level, and how far each is on its way to the next sector;
    sectors (pixels,): counted over all ellipses; piece: first pixel, the one behind the last, and
    the first sector of this ellipse. given (11,), as it is now: inverse axes xx, xy, yy 1/px, blur
    px, way in an exposure u, v px, plateau, slopes of the light u, v, way of the center so far
    u, v px; believed (sectors,); moments of an exposure. reach: how far from an edge pixels count,
    inward and outward in blurs, and px added. Fills `sums`, those of `Linearized` but the weights,
    of one ellipse.
    """
    all_x, all_y, levels, shares = pixels
    product, behind, by_sector, covered_of = sums
    columns, places, near, background = scratch
    count = believed.size
    xx, xy, yy = given[0], given[1], given[2]
    blur, way_u, way_v = given[3], given[4], given[5]
    plateau, slope_u, slope_v = given[6], given[7], given[8]
    off_u, off_v = given[9], given[10]
    sharp = 1.0 / blur
    nearest, farthest = -reach[0] * blur - reach[2], reach[1] * blur + reach[2]
    background[:] = 0.0
    used = 0
    for pixel in range(piece[0], piece[1]):
        x, y = all_x[pixel] - off_u, all_y[pixel] - off_v
        low, high = math.inf, -math.inf
        covered = further = edge = 0.0
        by_u = by_v = by_size = by_along = by_aslant = by_blur = by_way_u = by_way_v = 0.0
        for moment in range(moments):
            time, part = TIMES[moments, moment], PARTS[moments, moment]
            px, py = x - time * way_u, y - time * way_v
            across, down = xx * px + xy * py, xy * px + yy * py
            square = max(across * across + down * down, 1e-12)
            ratio = math.sqrt(square)
            out_x, out_y = xx * across + xy * down, xy * across + yy * down
            # At the very center there is no normal; it is far inside then.
            normal = 1.0 / max(math.sqrt(out_x * out_x + out_y * out_y), 1e-18)
            stretch = ratio * normal
            outside = (ratio - 1.0) * stretch
            low, high = min(low, outside), max(high, outside)
            if moments == 1 and (outside <= nearest or outside >= farthest):
                break
            further += part * ratio
            distance = outside * sharp
            above, density = normal_at(distance)
            covered += part * above
            density *= part * sharp
            edge += density
            move_u, move_v = density * normal * out_x, density * normal * out_y
            stretched = density * stretch
            turned = stretched / square
            by_u += move_u
            by_v += move_v
            by_size += stretched
            by_along += turned * (across * across - down * down)
            by_aslant += 2.0 * turned * across * down
            by_blur += density * distance
            by_way_u += time * move_u
            by_way_v += time * move_v
        if high <= nearest or low >= farthest:
            covered_of[pixel] = 0.0
            continue
        column = columns[used]
        column[0], column[1], column[2], column[3] = by_u, by_v, by_size, by_along
        column[4], column[5], column[6], column[7] = by_aslant, by_blur, by_way_u, by_way_v
        covered_of[pixel] = covered
        bare = 1.0 - covered
        lever = covered + bare * (1.0 - 1.0 / further)
        tilt = slope_u * x + slope_v * y
        column[8], column[9], column[10] = covered, lever * x, lever * y
        column[LEFT] = levels[pixel] - plateau * covered - lever * tilt
        column[EDGE] = edge
        places[used, 0], places[used, 1] = bare, plateau + tilt / further
        share = shares[pixel]
        first = sectors[pixel] - piece[2]
        after = (first + 1) % count
        background[first, 0] += (1.0 - share) * bare * column[LEFT]
        background[first, 1] += (1.0 - share) * bare * bare
        background[after, 0] += share * bare * column[LEFT]
        background[after, 1] += share * bare * bare
        places[used, 2], near[used] = share, first
        used += 1
    for sector in range(count):
        before, after = (sector - 1) % count, (sector + 1) % count
        around = 0.5 * (background[before, 1] + background[after, 1])
        level = 0.5 * (background[before, 0] + background[after, 0])
        behind[sector] = (background[sector, 0] + level) / max(
            background[sector, 1] + around, 1e-6
        )
    product[:], by_sector[:] = 0.0, 0.0
    total = 0.0
    for place in range(used):
        column, first, share = columns[place], near[place], places[place, 2]
        after = (first + 1) % count
        level = behind[first] + share * (behind[after] - behind[first])
        height = places[place, 1] - level
        for unknown in range(MOVING):
            column[unknown] *= height
        column[LEFT] -= places[place, 0] * level
        column[EDGE] *= height
        one, other = believed[first], believed[after]
        weight = one + share * (other - one)
        total += weight
        for row in range(UNKNOWNS + 1):
            weighted = weight * column[row]
            for unknown in range(UNKNOWNS + 1):
                product[row, unknown] += weighted * column[unknown]
        for part, sector in (
            ((1.0 - share) * column[EDGE], first),
            (share * column[EDGE], after),
        ):
            for unknown in range(COLUMNS):
                by_sector[sector, unknown] += part * column[unknown]
    return total
