"""Measurement of dots with strong motion blur, by their contribution to the image of the arm.

Along its path, a dot adds the difference in brightness between paint and skin to the image. The
image is thus the contrast times the fraction of the exposure in which the dot covers a pixel, plus
the image of the moving arm without a dot. The latter is smooth along the arm and arbitrary across
it, because the sides of the arm are smeared into the background. It is fitted together with the
dot, as splines across the arm that change linearly along it, so that neither the sides of the arm
nor the background need to be known.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.dots.edge_kernel import MOST_MOMENTS, PARTS, TIMES
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_XY,
    AXIS_YY,
    BEHIND,
    CENTER_U,
    CENTER_V,
    ELLIPSE,
    ERROR,
    Mask,
    NEAR_EDGE,
    ON_EDGE,
    OUTSIDE,
    PLATEAU,
    QUANTIZATION,
    SIZE_STD,
    SMEAR_STD,
    SMEAR_U,
    SMEAR_V,
    WIDTH,
    WITHIN,
)
import scipy

SAME_PIXELS = 0.5  # px, shift of a center that hardly changes which pixels are used
FLAT = 1e-6  # added to the normal equations, because a spline without pixels is undetermined
# Unknowns of a dot, after its contrast: center (2), motion during the exposure (2), size.
OF_DOT = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class MovingDotSettings:
    """Settings of the fit of a dot that moves far during the exposure."""

    beyond: float = tuning(
        0.6,
        'width of the pixels used on either side of the path of a dot, and along it',
        unit='radius',
        source='sweep',
    )
    fit_std: float = tuning(
        0.1,
        'std of contrast, size and motion from other fits',
        unit='contrast, radius, way',
        source='sweep',
    )
    paint: float = tuning(
        0.01,
        'smallest error of the center, and std of the size, due to uneven paint',
        unit='radius',
        source='sweep',
    )
    differs: float = tuning(
        1.8, 'largest ratio of contrasts between a dot and its neighbors', source='sweep'
    )
    ends: float = tuning(
        0.69,
        'distance from the center of the last target at which the arm may end',
        unit='radius',
        source='a tenth of the target is cut off there',
    )


MOVING_DOTS = MovingDotSettings()
# Largest rms residual of a dot, relative to its contrast; measured: 0.03 for visible dots. No
# figure of acceptance/sweep.py moves when it is halved or doubled.
MOST_LEFT = 0.08


class MovingDot(NamedTuple):
    """A fitted dot.

    center and motion during the exposure, px; longer, size: motion and size relative to the
    expected ones; contrast, grey levels; std of the center per axis, px; left: rms residual, grey
    levels.
    """

    center: Array
    way: Array
    longer: float
    size: float
    contrast: float
    std: float
    left: float


class Known(NamedTuple):
    """The prior of a dot: mean and one sigma.

    contrast: grey levels, with infinite std if unknown; size, longer: relative to the outline; for
    the motion, one sigma of either component relative to its length.
    """

    contrast: float
    contrast_std: float
    size: float
    size_std: float
    longer: float
    way_std: float


def fit_moving_dot(
    grey: Bytes,
    outline: Array,
    along: Array,
    end: float,
    known: Known,
    settings: MovingDotSettings = MOVING_DOTS,
) -> MovingDot | None:
    """Fit a dot from an initial guess; None if there is none.

    outline (FITTED,): position, and appearance from its neighbors; along (2,): direction of the
    arm, a unit vector; end: distance (px) from the center at which the arm may end in this
    direction, infinite if it continues.
    """
    outline = outline.copy()
    dot = None
    for _ in range(ELLIPSE.passes):
        before = outline[[CENTER_U, CENTER_V]]
        dot = _fit_within(grey, outline, along, end, known, settings)
        if dot is None:
            return None
        outline[[CENTER_U, CENTER_V]] = dot.center
        if math.hypot(*(dot.center - before)) < SAME_PIXELS:
            break
    return dot


def _radius(outline: Array) -> float:
    """Return the radius of a circle with the area of an outline."""
    return math.sqrt(outline[AXIS_XX] * outline[AXIS_YY] - outline[AXIS_XY] ** 2)


class Pixels(NamedTuple):
    """Pixels around a dot, (n,) each but `inside`.

    x, y: px from the expected position; levels: brightness; arm (n, splines): basis of the image
    of the arm without a dot; inside (height, width): mask of the pixels.
    """

    x: Array
    y: Array
    levels: Array
    arm: Array
    inside: Mask


def _cut(
    grey: Bytes, outline: Array, along: Array, end: float, settings: MovingDotSettings
) -> Pixels:
    """Collect the pixels around a dot, and the splines across the arm."""
    radius, place = _radius(outline), outline[[CENTER_U, CENTER_V]]
    way, across = outline[[SMEAR_U, SMEAR_V]], np.array([-along[1], along[0]])
    around = (1.0 + settings.beyond) * radius + ELLIPSE.around * float(outline[WIDTH])
    width = around + 0.5 * abs(float(across @ way))
    first = -around - 0.5 * abs(float(along @ way))
    reach = math.hypot(width, first)
    low = np.maximum(np.ceil(place - reach), 0.0).astype(np.int64)
    high = np.maximum(np.floor(place + reach) + 1.0, 0.0).astype(np.int64)
    piece = grey[low[1] : high[1], low[0] : high[0]]
    y, x = np.mgrid[: piece.shape[0], : piece.shape[1]]
    x, y = x + (low[0] - place[0]), y + (low[1] - place[1])
    ahead, aside = along[0] * x + along[1] * y, across[0] * x + across[1] * y
    inside = (ahead >= first) & (ahead <= min(-first, end)) & (np.abs(aside) <= width)
    splines = _splines(aside[inside] / radius, width / radius)
    arm = np.concatenate([splines, splines * ahead[inside][:, None] / radius], axis=1)
    return Pixels(x[inside], y[inside], piece[inside].astype(np.float64), arm, inside)


def _fit_within(
    grey: Bytes,
    outline: Array,
    along: Array,
    end: float,
    known: Known,
    settings: MovingDotSettings,
) -> MovingDot | None:
    """Fit a dot to the pixels around an outline (FITTED,)."""
    pixels = _cut(grey, outline, along, end, settings)
    many = pixels.arm.shape[1]  # then contrast, center, motion and size
    count, spare = len(pixels.x), len(pixels.x) - many - 1 - OF_DOT
    if spare < many:
        return None
    drawn = outline[[SMEAR_U, SMEAR_V]]
    given = known.longer * drawn
    off, way, size, contrast = np.zeros(2), given.copy(), known.size, known.contrast
    std = np.full(many + 1 + OF_DOT, math.inf)  # the prior, without any for the center
    std[many], std[many + 5] = known.contrast_std, known.size_std
    std[many + 3 : many + 5] = known.way_std * math.hypot(*given)
    wanted = np.zeros(len(std))
    variance = 1.0
    for turn in range(ELLIPSE.passes):
        covered, moved = _draw(pixels.x - off[0], pixels.y - off[1], outline, way, size)
        columns = np.column_stack([pixels.arm, covered, contrast * moved])
        weights = variance / (std * std) + FLAT
        wanted[many], wanted[many + 5] = known.contrast, known.size - size
        wanted[many + 3 : many + 5] = given - way
        normal = columns.T @ columns + np.diag(weights)
        solution = np.linalg.solve(normal, columns.T @ pixels.levels + weights * wanted)
        left = pixels.levels - columns @ solution
        variance = max(float(left @ left) / spare, QUANTIZATION)
        contrast = float(solution[many])
        step = solution[many + 1 : many + 5]
        off, way, size = off + step[:2], way + step[2:], size + float(solution[many + 5])
        if contrast <= 0.0 or size <= 0.0:
            return None
        if turn > 1 and np.abs(step[:2]).max() < ELLIPSE.done:
            break
    else:
        return None
    inverse = np.linalg.inv(normal)
    of_center = slice(many + 1, many + 3)
    by_pixel = (inverse[of_center] @ columns.T) * (left * math.sqrt(count / spare))
    radius = _radius(outline)
    covariance = _covariance(by_pixel, pixels.inside, round(radius))
    covariance += variance * (inverse[of_center] * weights) @ inverse[:, of_center]
    white = variance * float(np.diagonal(inverse)[of_center].max())
    square = max(float(np.linalg.eigvalsh(covariance)[-1]), white)
    error = math.hypot(ELLIPSE.smear_error * float(way @ way) / radius, settings.paint * radius)
    return MovingDot(
        center=outline[[CENTER_U, CENTER_V]] + off,
        way=way,
        longer=float(way @ drawn / (drawn @ drawn)),
        size=size,
        contrast=contrast,
        std=math.hypot(math.sqrt(square), error),
        left=math.sqrt(variance),
    )


def _splines(places: Array, half: float) -> Array:
    """Return cubic B-splines (n, splines) at positions from -half to half, with knots 1 apart."""
    knots = np.arange(math.floor(-half) - 1, math.ceil(half) + 2)
    away = np.abs(places[:, None] - knots)
    inner = 2.0 / 3.0 - away**2 * (1.0 - 0.5 * away)
    return np.asarray(np.where(away < 1.0, inner, np.maximum(2.0 - away, 0.0) ** 3 / 6.0))


def _draw(x: Array, y: Array, outline: Array, way: Array, size: float) -> tuple[Array, Array]:
    """Return the exposure share of a dot at positions (n,), and its derivatives (n, OF_DOT).

    x, y (n,) px from its center; derivatives by center, motion and size.
    """
    xx, xy, yy = size * outline[[AXIS_XX, AXIS_XY, AXIS_YY]]
    determinant = xx * yy - xy * xy
    xx, xy, yy = yy / determinant, -xy / determinant, xx / determinant  # the inverse
    blur = outline[WIDTH]
    times, parts = TIMES[MOST_MOMENTS][:, None], PARTS[MOST_MOMENTS][:, None]
    px, py = x - times * way[0], y - times * way[1]
    across, down = xx * px + xy * py, xy * px + yy * py
    ratio = np.maximum(np.hypot(across, down), 1e-6)
    out_x, out_y = (xx * across + xy * down) / ratio, (xy * across + yy * down) / ratio
    normal = 1.0 / np.maximum(np.hypot(out_x, out_y), 1e-9)
    outside = (ratio - 1.0) * normal / blur
    covered = np.sum(parts * scipy.special.ndtr(-outside), axis=0)
    density = parts * np.exp(-0.5 * outside * outside) / (math.sqrt(2.0 * math.pi) * blur)
    by_u, by_v = density * out_x * normal, density * out_y * normal
    by_size = density * ratio * normal / size
    moved = [by_u, by_v, times * by_u, times * by_v, by_size]
    return covered, np.column_stack([it.sum(axis=0) for it in moved])


def _covariance(by_pixel: Array, inside: Mask, together: int) -> Array:
    """Return the covariance (2, 2) of a center from the influence of each pixel (2, pixels).

    inside (height, width): mask of these pixels. Residuals are correlated over some pixels,
    because the background is not noise: the covariance sums the products of all pairs within
    `together` px, with weights that fall with distance (Bartlett's weights; Newey and West,
    Conley).
    """
    maps = np.zeros((2, *inside.shape))
    maps[:, inside] = by_pixel
    weights = 1.0 - np.abs(np.arange(-together, together + 1)) / (together + 1.0)
    sums = [
        cv2.sepFilter2D(it, -1, weights, weights, borderType=cv2.BORDER_CONSTANT) for it in maps
    ]
    covariance = np.array([[np.sum(one * other) for one in sums] for other in maps])
    return np.asarray(0.5 * (covariance + covariance.T))


def prior_from_neighbors(
    dots: list[MovingDot], settings: MovingDotSettings = MOVING_DOTS
) -> Known:
    """Return the prior of a dot from its neighbors."""
    contrast = float(np.median([dot.contrast for dot in dots]))
    sizes = np.array([dot.size for dot in dots])
    ways = np.array([dot.longer for dot in dots])
    return Known(
        contrast=contrast,
        contrast_std=settings.fit_std * contrast,
        size=float(np.median(sizes)),
        size_std=max(_spread(sizes), settings.paint),
        longer=float(np.median(ways)),
        way_std=max(_spread(ways), settings.fit_std),
    )


def _spread(values: Array) -> float:
    """Return the rms deviation of values from their median."""
    return float(np.sqrt(np.mean((values - np.median(values)) ** 2)))


def prior_alone(outline: Array, contrast: float, settings: MovingDotSettings) -> Known:
    """Return the prior of a dot from its outline (FITTED,) alone."""
    return Known(
        contrast=contrast,
        contrast_std=math.inf,
        size=1.0,
        size_std=max(settings.fit_std, float(outline[SIZE_STD])),
        longer=1.0,
        way_std=max(
            settings.fit_std, float(outline[SMEAR_STD] / math.hypot(*outline[[SMEAR_U, SMEAR_V]]))
        ),
    )


def is_dot(dot: MovingDot, known: Known, settings: MovingDotSettings = MOVING_DOTS) -> bool:
    """Whether a fit is a dot: similar to its neighbors, with small residuals."""
    similar = 1.0 / settings.differs <= dot.contrast / known.contrast <= settings.differs
    return similar and dot.left <= MOST_LEFT * dot.contrast


def moves_far(outlines: Array) -> Mask:
    """Whether dots (n, FITTED) move by more than a radius during the exposure (n,)."""
    way = np.hypot(outlines[:, SMEAR_U], outlines[:, SMEAR_V])
    size = outlines[:, AXIS_XX] * outlines[:, AXIS_YY] - outlines[:, AXIS_XY] ** 2
    return np.asarray(way > np.sqrt(size))


def end_of_arm(outline: Array, along: Array, settings: MovingDotSettings = MOVING_DOTS) -> float:
    """Return the farthest end of the arm beyond the last dot (FITTED,) during the exposure, px."""
    smeared = 0.5 * abs(float(along @ outline[[SMEAR_U, SMEAR_V]]))
    return settings.ends * _radius(outline) - ELLIPSE.around * float(outline[WIDTH]) - smeared


def as_fitted(outline: Array, dot: MovingDot) -> Array:
    """Return a dot in the form of `fit_ellipses`, (FITTED,), with no visible edge."""
    fitted = outline.copy()
    fitted[[CENTER_U, CENTER_V]], fitted[[SMEAR_U, SMEAR_V]] = dot.center, dot.way
    fitted[[AXIS_XX, AXIS_XY, AXIS_YY]] *= dot.size
    fitted[BEHIND] = fitted[PLATEAU] - dot.contrast
    fitted[[ERROR, NEAR_EDGE, ON_EDGE, WITHIN, OUTSIDE]] = dot.std, 1.0, 0.0, 1.0, 0.0
    return fitted
