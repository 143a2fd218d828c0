"""Fit an ellipse to the edge of a blob, pixel by pixel: the compiled part of `centroid`."""

from __future__ import annotations

from dataclasses import astuple, dataclass
import functools
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.core.settings import numbers_type, tuning

Integers = npt.NDArray[np.int64]

# An ellipse, before and after the fit: center u, v px; symmetric axes (xx, xy, yy) px, which map
# the unit circle to it; blur px.
CENTER_U, CENTER_V, AXIS_XX, AXIS_XY, AXIS_YY, WIDTH = range(6)
# Only before: how well its size and shape (of its radius) and its blur (px) are known, one sigma.
SHAPE_STD, WIDTH_STD = 6, 7
# Only after: std of the center px, grey levels of plateau and background; share near the ellipse
# of the edge that can be seen, and share exactly on it of all the edge; share of what is within
# that is as bright as the plateau.
ERROR, PLATEAU, BEHIND, NEAR_EDGE, ON_EDGE, WITHIN = range(6, 12)
FITTED = 12

# What is searched: way of the center; size, two changes of shape; blur; plateau and its slopes.
UNKNOWNS = 9
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded
PEAK = 1.0 / math.sqrt(2.0 * math.pi)  # of the normal density
SIGMA = 1.4826  # standard deviation over the median of what is off, of Gaussian noise


@dataclass(frozen=True, slots=True, kw_only=True)
class EllipseSettings:
    """How an ellipse is fitted to the edge of a blob."""

    sectors: int = tuning(16, 'around a blob, each with a background and an edge of its own')
    passes: int = tuning(8, 'of the fit, at most')
    done: float = tuning(0.003, 'step of the center after which the fit ends', unit='px')
    inward: float = tuning(2.5, 'from the edge, pixels that are looked at', unit='blur')
    outward: float = tuning(3.0, 'the same, outside', unit='blur')
    margin: float = tuning(1.0, 'the same, added', unit='px')
    shift: float = tuning(1.5, 'an edge may be off where the fit begins', unit='px')
    least_blur: float = tuning(0.29, 'of an edge: a pixel is a square', unit='px')
    most_blur: float = tuning(3.5, 'of an edge', unit='px')
    tilt_std: float = tuning(0.015, 'slope of the light over a blob', unit='contrast / radius')
    largest_step: float = tuning(1.5, 'of the center in a pass', unit='px')
    largest_change: float = tuning(0.25, 'of size and shape in a pass', unit='radius')
    widest_step: float = tuning(0.3, 'of the blur in a pass', unit='px')
    least_axis: float = tuning(0.5, 'half the smallest axis, at least', unit='px')
    plateau_share: float = tuning(0.3, 'of the pixels within, brighter than the first plateau')
    cut: float = tuning(2.5, 'an edge off the outline takes no part', unit='usual distance')
    least_off: float = tuning(0.02, 'usual distance of edges from the outline', unit='px')
    knows: float = tuning(0.3, 'error of the place of an edge that tells anything', unit='px')
    told: float = tuning(0.5, 'share of the sectors in which an edge can be seen, at least')
    within: float = tuning(0.9, 'share of a pixel that a blob covers where it is its inside')
    plain: float = tuning(0.3, 'inside of a blob, darker than the plateau at most', unit='height')
    on_edge: float = tuning(0.03, 'distance of an edge that is on the outline', unit='px')
    near_edge: float = tuning(0.12, 'distance of an edge that is near the outline', unit='px')
    near_edge_share: float = tuning(0.02, 'the same, added', unit='radius')
    model_error: float = tuning(
        0.004, 'of the center, for what no blob exactly is', unit='px', source='measured'
    )


EllipseNumbers = numbers_type(EllipseSettings, 'EllipseNumbers')
ELLIPSE = EllipseSettings()


@functools.lru_cache
def ellipse_numbers(settings: EllipseSettings) -> Any:
    """Return settings as kernels take them."""
    return EllipseNumbers(*astuple(settings))


@inlined
def _inverse(xx: float, xy: float, yy: float) -> tuple[float, float, float]:
    """Return the inverse of a symmetric matrix."""
    determinant = xx * yy - xy * xy
    return yy / determinant, -xy / determinant, xx / determinant


@inlined
def _seen_from(
    xx: float, xy: float, yy: float, x: float, y: float
) -> tuple[float, float, float, float, float, float, float]:
    """See a place (px from the center) from an ellipse, given by its inverse axes.

    Return the place on the unit circle that it belongs to, how many times further out it is, the
    outline's normal there, px of the outline per unit, and px outside of it.
    """
    across, down = xx * x + xy * y, xy * x + yy * y
    ratio = max(math.sqrt(across * across + down * down), 1e-6)
    across, down = across / ratio, down / ratio
    normal_x, normal_y = xx * across + xy * down, xy * across + yy * down
    # At the very center there is no normal; it is far inside then.
    stretch = 1.0 / max(math.sqrt(normal_x * normal_x + normal_y * normal_y), 1e-12)
    return (
        across, down, ratio, normal_x * stretch, normal_y * stretch, stretch,
        (ratio - 1.0) * stretch,
    )  # fmt: skip


@kernel
def fit_ellipses(grey: Bytes, starts: Array, numbers: EllipseSettings) -> Array:
    """Fit ellipses from where they are thought to be, (n, FITTED); NaN where there is none."""
    fitted = np.full_like(starts, np.nan)
    for number in range(len(starts)):
        _fit_ellipse(grey, starts[number], numbers, fitted[number])
    return fitted


@kernel
def _fit_ellipse(grey: Bytes, start: Array, numbers: EllipseSettings, fitted: Array) -> None:
    """Fit one; `fitted` (FITTED,) stays as it is where there is none."""
    sectors = numbers.sectors
    places, levels = _cut_rim(grey, start, numbers)
    if len(levels) < 2 * UNKNOWNS:
        return
    now = start.copy()
    now[WIDTH] = min(max(start[WIDTH], numbers.least_blur), numbers.most_blur)
    off = np.zeros(2)
    shape, slopes = np.zeros(3), np.zeros(2)
    now[PLATEAU] = _first_plateau(places, levels, start, numbers)
    believed = np.ones(sectors)
    pixels = np.zeros((len(levels), 3))  # covered, left after the blob, weight
    behind, edges = np.zeros(sectors), np.zeros((sectors, 2))
    by_unknowns = np.zeros(UNKNOWNS)
    for turn in range(numbers.passes):
        xx, xy, yy = _inverse(now[AXIS_XX], now[AXIS_XY], now[AXIS_YY])
        blur, plateau = now[WIDTH], now[PLATEAU]
        nearest = -numbers.inward * blur - numbers.margin
        farthest = numbers.outward * blur + numbers.margin
        # First what is covered, and the background of each sector.
        sums = np.zeros((sectors, 2))
        for pixel in range(len(levels)):
            x, y = places[pixel, 0] - off[0], places[pixel, 1] - off[1]
            _, _, ratio, _, _, _, outside = _seen_from(xx, xy, yy, x, y)
            if outside <= nearest or outside >= farthest:
                pixels[pixel, 2] = 0.0
                continue
            covered = 0.5 * math.erfc(outside / (math.sqrt(2.0) * blur))
            bare = 1.0 - covered
            # Uneven light tells on the blob from its center on, behind it from the edge on.
            lever = covered + bare * (1.0 - 1.0 / ratio)
            left = levels[pixel] - plateau * covered
            left -= lever * (slopes[0] * x + slopes[1] * y)
            pixels[pixel] = covered, left, 1.0
            first, share = int(places[pixel, 2]), places[pixel, 2] % 1.0
            second = (first + 1) % sectors
            sums[first, 0] += (1.0 - share) * bare * left
            sums[first, 1] += (1.0 - share) * bare * bare
            sums[second, 0] += share * bare * left
            sums[second, 1] += share * bare * bare
        for sector in range(sectors):
            before, after = sums[sector - 1], sums[(sector + 1) % sectors]
            most = sums[sector, 1] + 0.5 * (before[1] + after[1])
            behind[sector] = sums[sector, 0] + 0.5 * (before[0] + after[0])
            behind[sector] /= max(most, 1e-6)
        # Then the normal equations, and the same by sector.
        normal, gradient = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
        moves = np.zeros((sectors, UNKNOWNS + 2))
        squares = weights = 0.0
        for pixel in range(len(levels)):
            if pixels[pixel, 2] == 0.0:
                continue
            x, y = places[pixel, 0] - off[0], places[pixel, 1] - off[1]
            across, down, ratio, out_x, out_y, stretch, outside = _seen_from(xx, xy, yy, x, y)
            covered = pixels[pixel, 0]
            bare = 1.0 - covered
            first, share = int(places[pixel, 2]), places[pixel, 2] % 1.0
            second = (first + 1) % sectors
            background = (1.0 - share) * behind[first] + share * behind[second]
            left = pixels[pixel, 1] - bare * background
            height = plateau - background + (slopes[0] * x + slopes[1] * y) / ratio
            by_edge = height * PEAK / blur * math.exp(-0.5 * (outside / blur) ** 2)
            stretched = by_edge * stretch
            lever = covered + bare * (1.0 - 1.0 / ratio)
            by_unknowns[0], by_unknowns[1] = by_edge * out_x, by_edge * out_y
            by_unknowns[2] = stretched
            by_unknowns[3] = stretched * (across * across - down * down)
            by_unknowns[4] = 2.0 * stretched * across * down
            by_unknowns[5] = by_edge * outside / blur
            by_unknowns[6], by_unknowns[7], by_unknowns[8] = covered, lever * x, lever * y
            weight = (1.0 - share) * believed[first] + share * believed[second]
            squares += weight * left * left
            weights += weight
            for row in range(UNKNOWNS):
                weighted = weight * by_unknowns[row]
                gradient[row] += weighted * left
                for column in range(row + 1):
                    normal[row, column] += weighted * by_unknowns[column]
            for sector, part in ((first, 1.0 - share), (second, share)):
                moved = part * by_edge
                for row in range(UNKNOWNS):
                    moves[sector, row] += moved * by_unknowns[row]
                moves[sector, UNKNOWNS] += moved * left
                moves[sector, UNKNOWNS + 1] += moved * by_edge
        variance = max(squares / max(weights - UNKNOWNS, 4.0), QUANTIZATION)
        height = plateau - np.median(behind)
        covariance = _with_expectations(
            normal, gradient, variance, height, now, start, shape, slopes, numbers
        )
        step = covariance @ gradient
        for sector in range(sectors):
            tells = max(moves[sector, UNKNOWNS + 1], 1e-9)
            there = moves[sector, UNKNOWNS] - np.dot(moves[sector, :UNKNOWNS], step)
            edges[sector, 0], edges[sector, 1] = there / tells, math.sqrt(variance / tells)
        way = max(abs(step[0]), abs(step[1]))
        if not _move(now, off, shape, slopes, step, numbers):
            return
        if turn > 1 and way < numbers.done:
            break
        _believe(edges, turn == 0, numbers, believed)
    fitted[:] = now
    fitted[CENTER_U], fitted[CENTER_V] = start[CENTER_U] + off[0], start[CENTER_V] + off[1]
    larger = variance * max(covariance[0, 0], covariance[1, 1])
    fitted[ERROR] = math.sqrt(larger + numbers.model_error**2)
    fitted[BEHIND] = np.median(behind)
    inside = (pixels[:, 2] > 0.0) & (pixels[:, 0] > numbers.within)
    plain = levels >= now[PLATEAU] - numbers.plain * (now[PLATEAU] - fitted[BEHIND])
    fitted[WITHIN] = np.sum(inside & plain) / max(np.sum(inside), 1)
    radius = math.sqrt(now[AXIS_XX] * now[AXIS_YY] - now[AXIS_XY] ** 2)
    near = numbers.near_edge + numbers.near_edge_share * radius
    told, seen = _seen_on_edge(edges, near, numbers)
    fitted[NEAR_EDGE] = seen / told if told >= numbers.told * sectors else 0.0
    fitted[ON_EDGE] = _seen_on_edge(edges, numbers.on_edge, numbers)[1] / sectors


@kernel
def _cut_rim(grey: Bytes, start: Array, numbers: EllipseSettings) -> tuple[Array, Array]:
    """Collect the pixels that can be near the edge of an ellipse.

    Return where they are (n, 3), px from its center and by sectors around it, and how bright (n,).
    """
    xx, xy, yy = start[AXIS_XX], start[AXIS_XY], start[AXIS_YY]
    more = numbers.shift + numbers.margin
    outward, inward = numbers.outward * start[WIDTH] + more, numbers.inward * start[WIDTH] + more
    u, v = start[CENTER_U], start[CENTER_V]
    reach_u, reach_v = (
        math.sqrt(xx * xx + xy * xy) + outward,
        math.sqrt(xy * xy + yy * yy) + outward,
    )
    left, right = max(math.floor(u - reach_u), 0), min(math.ceil(u + reach_u), grey.shape[1] - 1)
    top, bottom = max(math.floor(v - reach_v), 0), min(math.ceil(v + reach_v), grey.shape[0] - 1)
    room = max(right - left + 1, 0) * max(bottom - top + 1, 0)
    places, levels = np.empty((room, 3)), np.empty(room)
    xx, xy, yy = _inverse(xx, xy, yy)
    count = 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            x, y = column - u, row - v
            across, down, _, _, _, _, outside = _seen_from(xx, xy, yy, x, y)
            if -inward < outside < outward:
                around = math.atan2(down, across) * numbers.sectors / (2.0 * math.pi)
                places[count, 0], places[count, 1] = x, y
                places[count, 2] = (around + numbers.sectors) % numbers.sectors
                levels[count] = grey[row, column]
                count += 1
    return places[:count], levels[:count]


@kernel
def _first_plateau(places: Array, levels: Array, start: Array, numbers: EllipseSettings) -> float:
    """Return a grey level that only some of the pixels within an ellipse are above."""
    xx, xy, yy = _inverse(start[AXIS_XX], start[AXIS_XY], start[AXIS_YY])
    within = np.empty(len(levels))
    count = 0
    for pixel in range(len(levels)):
        outside = _seen_from(xx, xy, yy, places[pixel, 0], places[pixel, 1])[6]
        if outside < -0.5:
            within[count] = levels[pixel]
            count += 1
    if count == 0:
        return float(levels.max())
    order = np.sort(within[:count])
    return float(order[count - 1 - int(numbers.plateau_share * count)])


@kernel
def _with_expectations(
    normal: Array,
    gradient: Array,
    variance: float,
    height: float,
    now: Array,
    start: Array,
    shape: Array,
    slopes: Array,
    numbers: EllipseSettings,
) -> Array:
    """Add what is known before the fit to the normal equations; return the inverse of these."""
    radius = math.sqrt(now[AXIS_XX] * now[AXIS_YY] - now[AXIS_XY] ** 2)
    tilt_std = numbers.tilt_std * max(abs(height), 1.0) / radius
    for row in range(UNKNOWNS):
        std, off = math.inf, 0.0
        if 2 <= row <= 4:
            std, off = start[SHAPE_STD], shape[row - 2]
        elif row == 5:
            std, off = start[WIDTH_STD], now[WIDTH] - start[WIDTH]
        elif row >= 7:
            std, off = tilt_std, slopes[row - 7]
        known = variance / (std * std)
        normal[row, row] += known + 1e-9
        gradient[row] -= known * off
        for column in range(row):
            normal[column, row] = normal[row, column]
    return np.asarray(np.linalg.inv(normal))


@kernel
def _move(
    now: Array, off: Array, shape: Array, slopes: Array, step: Array, numbers: EllipseSettings
) -> bool:
    """Change an ellipse by a step; its axes stay symmetric. Return whether it still is one."""
    for axis in range(2):
        off[axis] += min(max(step[axis], -numbers.largest_step), numbers.largest_step)
    for row in range(3):
        most = numbers.largest_change
        step[2 + row] = min(max(step[2 + row], -most), most)
        shape[row] += step[2 + row]
    size, along, aslant = step[2], step[3], step[4]
    xx, xy, yy = now[AXIS_XX], now[AXIS_XY], now[AXIS_YY]
    a, b = xx * (1.0 + size + along) + xy * aslant, xx * aslant + xy * (1.0 + size - along)
    c, d = xy * (1.0 + size + along) + yy * aslant, xy * aslant + yy * (1.0 + size - along)
    # The symmetric root of the matrix times its transpose.
    square_xx, square_xy, square_yy = a * a + b * b, a * c + b * d, c * c + d * d
    root = abs(a * d - b * c)
    scale = math.sqrt(square_xx + square_yy + 2.0 * root)
    now[AXIS_XX], now[AXIS_XY] = (square_xx + root) / scale, square_xy / scale
    now[AXIS_YY] = (square_yy + root) / scale
    now[WIDTH] += min(max(step[5], -numbers.widest_step), numbers.widest_step)
    now[WIDTH] = min(max(now[WIDTH], numbers.least_blur), numbers.most_blur)
    now[PLATEAU] += step[6]
    slopes += step[7:]
    middle = 0.5 * (now[AXIS_XX] + now[AXIS_YY])
    smallest = middle - math.hypot(0.5 * (now[AXIS_XX] - now[AXIS_YY]), now[AXIS_XY])
    return bool(smallest >= numbers.least_axis)


@kernel
def _believe(edges: Array, gently: bool, numbers: EllipseSettings, believed: Array) -> None:
    """Set the weight of sectors: those whose edge is off the outline take no part.

    gently: at first the outline is not yet where it belongs.
    """
    known = np.abs(edges[edges[:, 1] < numbers.knows, 0])
    usual = 1.0
    if len(known) > 0:
        usual = max(SIGMA * np.median(known), numbers.least_off)
    for sector in range(len(believed)):
        ratio = abs(edges[sector, 0]) / (numbers.cut * usual)
        if gently:
            believed[sector] = 1.0 / (1.0 + 4.0 * ratio * ratio)
        else:
            believed[sector] = (1.0 - min(ratio, 1.0) ** 2) ** 2


@kernel
def _seen_on_edge(edges: Array, most: float, numbers: EllipseSettings) -> tuple[int, int]:
    """Return in how many sectors an edge can be seen, and is `most` px off the ellipse or less."""
    told = seen = 0
    for sector in range(len(edges)):
        off, std = edges[sector]
        if std < numbers.knows:
            told += 1
            if abs(off) < most + 2.0 * std:
                seen += 1
    return told, seen
