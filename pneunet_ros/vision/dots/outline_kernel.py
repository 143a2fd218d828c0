"""Fit ellipses to edges: a single loop that cuts out pixels, fits, and reports visible edges.

No intermediate arrays are stored.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.vision.dots.edge_kernel import (
    add_edges,
    BLOCK,
    COVERED,
    distance_outside,
    LEFT,
    LEVEL,
    linearize_edge,
    LINES,
    RIM_LEVEL,
    RIM_LINES,
    RIM_OUTSIDE,
    RIM_SECTOR,
    RIM_SHARE,
    RIM_X,
    RIM_Y,
    UNKNOWNS,
)

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Columns of an ellipse, before and after its fit; for their meaning see `ellipse_fit`.
U, V, XX, XY, YY, BLUR, WAY_U, WAY_V, LIGHT, BEHIND = range(10)
SHAPE_STD, BLUR_STD, WAY_STD, LIGHT_STD, SIZE_STD = range(10, 15)  # before the fit
ERROR, NEAR, ON, WITHIN, OUTSIDE = range(10, 15)  # after the fit
GREY_LEVELS = 256
PLAIN = 0.3  # of its height: the inside of a blob may be this much darker than modeled
LEAST_BLUR, MOST_BLUR = 0.29, 3.5  # px, of an edge; a pixel is a square of this standard deviation
LEAST_AXIS = 0.5  # px, half the smallest axis of an ellipse


@kernel
def fit_outlines(
    grey: Bytes,
    starts: Array,
    moments_of: Integers,
    settings: Any,
    rules: tuple[float, float],
    fitted: Array,
) -> None:
    """Fit ellipses from initial guesses; fills fitted (n, FITTED), NaN if a fit fails.

    starts (n, FITTED); moments_of (n,): number of moments of the exposure used for each; rules:
    variance of a rounded level, and sigma over the median.
    """
    count, most = int(settings.sectors), 0
    for number in range(starts.shape[0]):
        left, top, right, bottom = box_of(grey, starts[number], settings)
        most = max(most, (right - left) * (bottom - top))
    rim, blocks = np.empty((RIM_LINES, most)), np.empty((most // BLOCK + 1, LINES * BLOCK))
    now, behind, edges, stds = np.empty(10), np.empty(count), np.empty(count), np.empty(count)
    off, reached = np.empty(2), np.empty(count, np.bool_)
    for number in range(starts.shape[0]):
        start, moments = starts[number], moments_of[number]
        many = cut_rim(grey, start, settings, rim)
        if many < 2 * UNKNOWNS:
            continue
        reached[:] = False
        for pixel in range(many):
            sector, share = int(rim[RIM_SECTOR, pixel]), rim[RIM_SHARE, pixel]
            reached[sector] |= share < 1.0
            reached[(sector + 1) % count] |= share > 0.0
        now[:] = start[:10]
        if moments == 1:
            now[WAY_U] = now[WAY_V] = 0.0
        now[BLUR] = min(max(start[BLUR], LEAST_BLUR), MOST_BLUR)
        if math.isinf(start[LIGHT_STD]):
            now[LIGHT] = first_plateau(start, rim, many, settings)
        off[:] = 0.0
        error, near = fit_edge(
            rim, many, start, moments, reached, settings, rules, now, off, (behind, edges, stds),
            blocks,
        )  # fmt: skip
        if math.isnan(error):
            continue
        result = fitted[number]
        result[:10] = now
        result[U], result[V], result[ERROR] = start[U] + off[0], start[V] + off[1], error
        result[BEHIND] = median_where(behind, reached)
        result[WITHIN] = plain_within(result, blocks, near)
        edge_shares(result, edges, stds, reached, settings)


@inner
def box_of(grey: Bytes, start: Array, settings: Any) -> tuple[int, int, int, int]:
    """Return the bounding box of an ellipse in an image: left, top, right + 1, bottom + 1."""
    around = reach_of_edge(start, settings) + settings.shift
    reach_u = math.hypot(start[XX], start[XY]) + around
    reach_v = math.hypot(start[XY], start[YY]) + around
    height, width = grey.shape
    left = int(min(max(math.floor(start[U] - reach_u), 0.0), width))
    top = int(min(max(math.floor(start[V] - reach_v), 0.0), height))
    right = int(max(min(math.ceil(start[U] + reach_u), width - 1.0), -1.0)) + 1
    bottom = int(max(min(math.ceil(start[V] + reach_v), height - 1.0), -1.0)) + 1
    if right <= left or bottom <= top:
        return 0, 0, 0, 0
    return left, top, right, bottom


@inner
def reach_of_edge(one: Array, settings: Any) -> float:
    """Return the distance (px) from an ellipse within which its blurred, moving edge is seen."""
    reach: float = settings.around * one[BLUR] + 1.0  # a pixel is one wide
    return reach + 0.5 * math.hypot(one[WAY_U], one[WAY_V])


@inner
def cut_rim(grey: Bytes, start: Array, settings: Any, rim: Array) -> int:
    """Collect the pixels that may be near the edge of an ellipse, and return their number."""
    left, top, right, bottom = box_of(grey, start, settings)
    determinant = start[XX] * start[YY] - start[XY] * start[XY]
    xx, xy, yy = start[YY] / determinant, -start[XY] / determinant, start[XX] / determinant
    farthest = reach_of_edge(start, settings) + settings.shift
    count, many = int(settings.sectors), 0
    per_turn = count / (2.0 * math.pi)
    for row in range(top, bottom):
        at_y, outside = row - start[V], rim[RIM_OUTSIDE, many:]
        for column in range(right - left):
            at_x = column + left - start[U]
            across, down = xx * at_x + xy * at_y, xy * at_x + yy * at_y
            outside[column] = distance_outside(xx, xy, yy, across, down)
        for column in range(right - left):
            if not abs(outside[column]) < farthest:
                continue
            at_x = column + left - start[U]
            across, down = xx * at_x + xy * at_y, xy * at_x + yy * at_y
            around = math.atan2(down, across) * per_turn
            around += count if around < 0.0 else 0.0
            sector = min(int(around), count - 1)
            rim[RIM_X, many], rim[RIM_Y, many] = at_x, at_y
            rim[RIM_LEVEL, many] = grey[row, column + left]
            rim[RIM_SECTOR, many], rim[RIM_SHARE, many] = sector, around - sector
            many += 1
    return many


@inner
def first_plateau(start: Array, rim: Array, many: int, settings: Any) -> float:
    """Return a high quantile of the grey levels within an ellipse."""
    determinant = start[XX] * start[YY] - start[XY] * start[XY]
    xx, xy, yy = start[YY] / determinant, -start[XY] / determinant, start[XX] / determinant
    x, y, levels = rim[RIM_X], rim[RIM_Y], rim[RIM_LEVEL]
    counts = np.zeros(GREY_LEVELS, np.int64)
    size, brightest = 0, 0.0
    for pixel in range(many):
        brightest = max(brightest, levels[pixel])
        across, down = xx * x[pixel] + xy * y[pixel], xy * x[pixel] + yy * y[pixel]
        if distance_outside(xx, xy, yy, across, down) < -0.5:
            counts[int(levels[pixel])] += 1
            size += 1
    if size == 0:
        return brightest
    above = int(settings.plateau_share * size)
    for level in range(GREY_LEVELS - 1, 0, -1):
        above -= counts[level]
        if above < 0:
            return float(level)
    return 0.0


@inner
def plain_within(one: Array, blocks: Array, near: int) -> float:
    """Return the fraction of the inside of an ellipse with the modeled brightness.

    blocks: those of the pixels near its edge.
    """
    most = 0.0
    for pixel in range(near):
        most = max(most, blocks[pixel // BLOCK, COVERED * BLOCK + pixel % BLOCK])
    inside = plain = 0
    for pixel in range(near):
        lines, place = blocks[pixel // BLOCK], pixel % BLOCK
        covered = lines[COVERED * BLOCK + place]
        if covered > 0.5 * most:
            inside += 1
            least = (covered - PLAIN) * (one[LIGHT] - one[BEHIND])
            plain += lines[LEVEL * BLOCK + place] >= one[BEHIND] + least
    return plain / max(inside, 1)


@inner
def edge_shares(one: Array, edges: Array, stds: Array, reached: Mask, settings: Any) -> None:
    """Compute the fractions of the edge near the ellipse, on it, and clearly outside it."""
    radius = math.sqrt(one[XX] * one[YY] - one[XY] * one[XY])
    near = settings.near_edge + settings.near_edge_share * radius
    on = max(settings.on_edge, settings.on_edge_share * radius)
    visible = seen = exact = outside = there = 0
    for sector in range(edges.size):
        there += reached[sector]
        if stds[sector] >= settings.knows:
            continue
        unsure = 2.0 * stds[sector]
        visible += 1
        seen += abs(edges[sector]) < near + unsure
        exact += abs(edges[sector]) < on + unsure
        outside += edges[sector] > near + unsure
    one[NEAR] = seen / max(visible, 1) if 2 * visible >= there else 0.0
    one[ON], one[OUTSIDE] = exact / edges.size, outside / edges.size


@inner
def solve_step(normal: Array, gradient: Array, step: Array) -> float:
    """Solve the normal equations by Cholesky decomposition, in place.

    normal (UNKNOWNS, UNKNOWNS), its lower half; fills step (UNKNOWNS,). Returns the larger
    variance of the first two unknowns, for data of variance 1.
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
    """Return the median of the selected values; NaN if none is selected."""
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
    """Change an ellipse by a step (UNKNOWNS,), keeping its axes symmetric; whether it is valid.

    now (10,), off (2,), shape (3,), slopes (2,): of one ellipse; moves: during an exposure.
    """
    for axis in range(2):
        off[axis] += min(max(step[axis], -settings.shift), settings.shift)
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
    now[5] = min(max(now[5], LEAST_BLUR), MOST_BLUR)
    if moves:
        now[6] += min(max(step[6], -settings.shift), settings.shift)
        now[7] += min(max(step[7], -settings.shift), settings.shift)
    now[8] += step[8]
    slopes[0] += step[9]
    slopes[1] += step[10]
    smallest = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    whole: bool = smallest >= LEAST_AXIS
    return whole


@inner
def fit_edge(
    rim: Array,
    many: int,
    start: Array,
    moments: int,
    reached: Mask,
    settings: Any,
    rules: tuple[float, float],
    now: Array,
    off: Array,
    found: tuple[Array, Array, Array],
    blocks: Array,
) -> tuple[float, int]:
    """Fit an ellipse until it converges.

    rim, many, blocks: as in `linearize_edge`; start (FITTED,). Updates now (10,) and off (2,), the
    displacement of the center. Fills found: behind (sectors,), grey levels of the background;
    edges, stds (sectors,) px: distance of an edge outside of the outline, and its std. Returns the
    error of the center, px (NaN if the fit does not converge), and the number of pixels in the
    blocks.
    """
    behind, edges, stds = found
    count = behind.size
    product = np.empty((UNKNOWNS + 1, UNKNOWNS + 1))
    normal, gradient = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    step, given = np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    std, wrong = np.empty(UNKNOWNS), np.zeros(UNKNOWNS)
    shape, slopes, by_sector = np.zeros(3), np.zeros(2), np.empty((count, 2))
    believed, clear = np.ones(count), np.empty(count, np.bool_)
    for number in range(settings.passes):
        xx, xy, yy = now[XX], now[XY], now[YY]
        determinant = xx * yy - xy * xy
        given[0], given[1], given[2] = yy / determinant, -xy / determinant, xx / determinant
        given[3:7], given[7:9], given[9:11] = now[5:9], slopes, off
        smear = math.hypot(now[WAY_U], now[WAY_V])
        reach = reach_of_edge(now, settings)
        near, weights = linearize_edge(
            rim, many, given, believed, moments, reach, blocks, (product, behind), by_sector
        )
        searched = UNKNOWNS if moments > 1 else UNKNOWNS - 2
        variance = max(product[LEFT, LEFT] / max(weights - searched, 4.0), rules[0])
        height = abs(now[LIGHT] - median_where(behind, reached))
        radius = math.sqrt(determinant)
        std[0] = std[1] = math.inf
        std[2], std[3], std[4] = start[SIZE_STD], start[SHAPE_STD], start[SHAPE_STD]
        std[5], std[6], std[7] = start[BLUR_STD], start[WAY_STD], start[WAY_STD]
        std[8] = start[LIGHT_STD]
        std[9] = std[10] = settings.tilt_std * max(height, 1.0) / radius
        wrong[2:5], wrong[9:11] = shape, slopes
        wrong[5:9] = now[5:9] - start[5:9]
        for row in range(UNKNOWNS):
            known = variance / (std[row] * std[row])
            for unknown in range(row + 1):
                normal[row, unknown] = product[row, unknown]
            normal[row, row] += known + 1e-9
            gradient[row] = product[UNKNOWNS, row]
            if known > 0.0:
                gradient[row] -= known * wrong[row]
        larger = variance * solve_step(normal, gradient, step)
        uneven = settings.uneven / max(height, 1.0)
        smeared = settings.smear_error * smear * smear / radius
        by_sector[:] = 0.0
        for block in range(0, near, BLOCK):
            add_edges(blocks[block // BLOCK], min(near - block, BLOCK), step, by_sector)
        for sector in range(count):
            information = max(by_sector[sector, 1], 1e-9)
            edges[sector] = by_sector[sector, 0] / information
            stds[sector] = math.sqrt(variance / information)
        if not move_ellipse(now, off, shape, slopes, step, moments > 1, settings):
            return math.nan, near
        way = max(abs(step[0]), abs(step[1]))
        if (number > 1 and way < settings.done) or number == settings.passes - 1:
            error = math.sqrt(larger + uneven * uneven + smeared * smeared)
            return error, near
        for sector in range(count):
            clear[sector] = stds[sector] < settings.knows
        usual = rules[1] * median_where(np.abs(edges), clear)
        usual = 1.0 if math.isnan(usual) else max(usual, settings.least_off)
        for sector in range(count):
            ratio = abs(edges[sector]) / (settings.cut * usual)
            if number == 0:
                believed[sector] = 1.0 / (1.0 + 4.0 * ratio * ratio)
            else:
                believed[sector] = (1.0 - min(ratio, 1.0) ** 2) ** 2
    return math.nan, 0
