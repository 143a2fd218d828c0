"""Fit ellipses to edges: each in one loop over its pixels and the passes of its fit.

The compiled twin of what `ellipse_fit` says in numpy, with the same numbers. It is several times
as fast, as nothing is written down between one operation and the next.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

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


@inner
def solve_step(normal: Array, gradient: Array, step: Array) -> float:
    """Solve the normal equations by Cholesky's decomposition, in place.

    normal (UNKNOWNS, UNKNOWNS), symmetric; fills step (UNKNOWNS,). Returns the larger of the
    variances of the first two unknowns, of what has the variance 1.
    """
    count = gradient.size
    for row in range(count):
        for column in range(row + 1):
            total = normal[row, column]
            for before in range(column):
                total -= normal[row, before] * normal[column, before]
            if row == column:
                normal[row, row] = math.sqrt(max(total, 1e-300))
            else:
                normal[row, column] = total / normal[column, column]
    larger = 0.0
    right = np.empty(count)
    for turn in range(3):
        for row in range(count):
            total = gradient[row] if turn == 2 else (1.0 if row == turn else 0.0)
            for before in range(row):
                total -= normal[row, before] * right[before]
            right[row] = total / normal[row, row]
        if turn < 2:
            square = 0.0
            for row in range(count):
                square += right[row] * right[row]
            larger = max(larger, square)
    for row in range(count - 1, -1, -1):
        total = right[row]
        for after in range(row + 1, count):
            total -= normal[after, row] * step[after]
        step[row] = total / normal[row, row]
    return larger


@inner
def median_where(values: Array, which: Mask) -> float:
    """Return the median of some values, NaN of none."""
    some = np.empty(values.size)
    count = 0
    for place in range(values.size):
        if which[place]:
            value, at = values[place], count
            while at > 0 and some[at - 1] > value:
                some[at] = some[at - 1]
                at -= 1
            some[at] = value
            count += 1
    if count == 0:
        return math.nan
    median: float = 0.5 * (some[(count - 1) // 2] + some[count // 2])
    return median


@inner
def move_ellipse(
    now: Array, off: Array, shape: Array, slopes: Array, step: Array, moves: bool, settings: Any
) -> bool:
    """Change an ellipse by a step (UNKNOWNS,), as `ellipse_fit` does; return whether it is one.

    now (FITTED,), off (2,), shape (3,), slopes (2,): of one ellipse; moves: in an exposure.
    """
    for axis in range(2):
        off[axis] += min(max(step[axis], -settings.largest_step), settings.largest_step)
    most = settings.largest_change
    size, along = min(max(step[2], -most), most), min(max(step[3], -most), most)
    aslant = min(max(step[4], -most), most)
    shape[0] += size
    shape[1] += along
    shape[2] += aslant
    xx, xy, yy = now[2], now[3], now[4]
    a, b = xx * (1.0 + size + along) + xy * aslant, xx * aslant + xy * (1.0 + size - along)
    c, d = xy * (1.0 + size + along) + yy * aslant, xy * aslant + yy * (1.0 + size - along)
    square_xx, square_xy, square_yy = a * a + b * b, a * c + b * d, c * c + d * d
    root = abs(a * d - b * c)
    scale = math.sqrt(square_xx + square_yy + 2.0 * root)
    xx, xy, yy = (square_xx + root) / scale, square_xy / scale, (square_yy + root) / scale
    now[2], now[3], now[4] = xx, xy, yy
    now[5] += min(max(step[5], -settings.widest_step), settings.widest_step)
    now[5] = min(max(now[5], settings.least_blur), settings.most_blur)
    if moves:
        now[6] += min(max(step[6], -settings.smear_step), settings.smear_step)
        now[7] += min(max(step[7], -settings.smear_step), settings.smear_step)
    now[8] += step[8]
    slopes[0] += step[9]
    slopes[1] += step[10]
    smallest = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    smear = math.hypot(now[6], now[7])
    whole: bool = smallest >= settings.least_axis and smear <= settings.most_smear
    return whole


@kernel
def fit_edges(
    pixels: tuple[Array, Array, Array, Array],
    sectors: Integers,
    firsts: Integers,
    going: Integers,
    starts: Array,
    fit: tuple[Array, Array, Array, Array, Array],
    exposed: tuple[Integers, Mask],
    settings: Any,
    rules: tuple[float, float],
    found: tuple[Array, Array, Array, Array, Array],
) -> Mask:
    """Fit ellipses until they rest; which of those that were asked for (going,) do in the end.

    pixels, sectors, firsts (n + 1,): as `linearize_edge` has them, of all ellipses; going (m,):
    which ellipses; starts (n, FITTED); fit: now, off, shape, slopes and believed of
    `ellipse_fit.Fit`, which are changed; exposed: its moments and reached; rules: variance of a
    level that was rounded, and sigma over the median. Fills found, of those asked for: error (m,),
    behind, edges and stds (m, sectors) as in `ellipse_fit.Solution`, and covered (pixels,).
    """
    now, off, shape, slopes, believed = fit
    moments_of, reached = exposed
    errors, behind, edges, stds, covered = found
    count = believed.shape[1]
    most = 0
    for ellipse in going:
        most = max(most, firsts[ellipse + 1] - firsts[ellipse])
    columns, places = np.empty((most, COLUMNS)), np.empty((most, 4))
    scratch = columns, places, np.empty(most, np.int64), np.empty((count, 2))
    product, by_sector = np.empty((UNKNOWNS + 1, UNKNOWNS + 1)), np.empty((count, COLUMNS))
    normal, gradient = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    step, given = np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    std, wrong = np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    reach = settings.inward, settings.outward, settings.margin
    ended = np.zeros(going.size, np.bool_)
    clear = np.empty(count, np.bool_)
    for turn in range(going.size):
        ellipse = going[turn]
        one, start, moments = now[ellipse], starts[ellipse], moments_of[ellipse]
        piece = firsts[ellipse], firsts[ellipse + 1], ellipse * count
        for number in range(settings.passes):
            xx, xy, yy = one[2], one[3], one[4]
            determinant = xx * yy - xy * xy
            given[0], given[1], given[2] = yy / determinant, -xy / determinant, xx / determinant
            given[3:7] = one[5:9]
            given[7:9], given[9:11] = slopes[ellipse], off[ellipse]
            sums = product, behind[turn], by_sector, covered
            weights = linearize_edge(
                pixels, sectors, piece, given, believed[ellipse], moments, reach, sums, scratch
            )
            searched = UNKNOWNS if moments > 1 else UNKNOWNS - 2
            variance = product[LEFT, LEFT] / max(weights - searched, 4.0)
            variance = max(variance, rules[0])
            height = abs(one[8] - median_where(behind[turn], reached[ellipse]))
            radius = math.sqrt(determinant)
            std[0] = std[1] = math.inf
            std[2], std[3], std[4] = start[14], start[10], start[10]
            std[5], std[6], std[7], std[8] = start[11], start[12], start[12], start[13]
            std[9] = std[10] = settings.tilt_std * max(height, 1.0) / radius
            wrong[0] = wrong[1] = 0.0
            wrong[2:5], wrong[9:11] = shape[ellipse], slopes[ellipse]
            wrong[5:9] = one[5:9] - start[5:9]
            for row in range(UNKNOWNS):
                known = variance / (std[row] * std[row])
                for unknown in range(UNKNOWNS):
                    normal[row, unknown] = product[row, unknown]
                normal[row, row] += known + 1e-9
                gradient[row] = product[row, UNKNOWNS]
                if known > 0.0:
                    gradient[row] -= known * wrong[row]
            larger = variance * solve_step(normal, gradient, step)
            uneven = settings.uneven / max(height, 1.0)
            smear = math.hypot(one[6], one[7])
            smeared = settings.smear_error * smear * smear / radius
            errors[turn] = math.sqrt(larger + uneven * uneven + smeared * smeared)
            for sector in range(count):
                tells = max(by_sector[sector, EDGE], 1e-9)
                left = by_sector[sector, LEFT]
                for unknown in range(UNKNOWNS):
                    left -= by_sector[sector, unknown] * step[unknown]
                edges[turn, sector] = left / tells
                stds[turn, sector] = math.sqrt(variance / tells)
            whole = move_ellipse(
                one, off[ellipse], shape[ellipse], slopes[ellipse], step, moments > 1, settings
            )
            if not whole:
                break
            way = max(abs(step[0]), abs(step[1]))
            if (number > 1 and way < settings.done) or number == settings.passes - 1:
                ended[turn] = True
                break
            for sector in range(count):
                clear[sector] = stds[turn, sector] < settings.knows
            usual = rules[1] * median_where(np.abs(edges[turn]), clear)
            usual = 1.0 if math.isnan(usual) else max(usual, settings.least_off)
            for sector in range(count):
                ratio = abs(edges[turn, sector]) / (settings.cut * usual)
                if number == 0:
                    believed[ellipse, sector] = 1.0 / (1.0 + 4.0 * ratio * ratio)
                else:
                    believed[ellipse, sector] = (1.0 - min(ratio, 1.0) ** 2) ** 2
    return ended
