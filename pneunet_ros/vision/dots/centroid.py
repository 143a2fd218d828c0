"""Center, size and elongation of a blob: an ellipse fitted to its edge.

The grey level of a pixel is modeled as a mixture of blob and background, weighted by the covered
fraction of the pixel; the edge is blurred. The background may differ around a blob, for example at
the edge of the arm, so each sector has its own background. A sector whose edge does not belong to
the blob (a glint next to it, a finger over it, the end of the arm that cuts it off) is not used.
If the appearance of a target is known from its neighbors, only the position is fitted, so that a
target that is cut off gets the center of the whole dot.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.vision.camera.camera_settings import AreaLimits
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_XY,
    AXIS_YY,
    BEHIND,
    CENTER_U,
    CENTER_V,
    ELLIPSE,
    EllipseSettings,
    ERROR,
    fit_ellipses,
    FITTED,
    NEAR_EDGE,
    ON_EDGE,
    OUTSIDE,
    PLATEAU,
    PLATEAU_STD,
    SHAPE_STD,
    SIZE_STD,
    SMEAR_STD,
    SMEAR_U,
    SMEAR_V,
    WIDTH,
    WIDTH_STD,
    WITHIN,
)

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Columns of a measured blob.
U, V, AREA, MAJOR, MINOR, ANGLE, STD, CONTRAST, BLUR, SEEN, EXACT, LEVEL, FILLED = range(13)
BEYOND = 13
SMEAR = slice(14, 16)  # motion of the blob during the exposure, px
COLUMNS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """Appearance of a target: size and shape, grey levels of its plateau and its height."""

    limits: AreaLimits
    brightest: float
    contrast: float


def outlines(
    places: Array, axes: Array, blur: Array, smear: Array, stds: tuple[Array, float, Array]
) -> Array:
    """Return the initial guesses (n, FITTED) of the fits, for blobs of full brightness.

    places (n, 2) px; axes (n, 3) px: xx, xy, yy of the symmetric matrix that maps the unit circle
    to the ellipse; blur (n,) px; smear (n, 2) px: motion during the exposure; stds: their standard
    deviations: axes (size and shape) relative to the radius (n,), blur px, smear (n,) px.
    """
    starts = np.full((len(places), FITTED), np.nan)
    starts[:, [CENTER_U, CENTER_V]] = places
    starts[:, [AXIS_XX, AXIS_XY, AXIS_YY]] = axes
    starts[:, WIDTH], starts[:, [SMEAR_U, SMEAR_V]] = blur, smear
    starts[:, [PLATEAU, BEHIND]] = 0.0
    starts[:, SHAPE_STD], starts[:, WIDTH_STD], starts[:, SMEAR_STD] = stds
    starts[:, SIZE_STD], starts[:, PLATEAU_STD] = stds[0], math.inf
    return starts


def axes_of(rows: Array) -> Array:
    """Return the axes (n, 3) px of measured blobs (n, COLUMNS), as for `outlines`."""
    cosine, sine = np.cos(rows[:, ANGLE]), np.sin(rows[:, ANGLE])
    long, short = 0.5 * rows[:, MAJOR], 0.5 * rows[:, MINOR]
    return np.column_stack([
        long * cosine**2 + short * sine**2,
        (long - short) * cosine * sine,
        long * sine**2 + short * cosine**2,
    ])  # fmt: skip


def measure_outlines(
    grey: Bytes, starts: Array, look: Look, settings: EllipseSettings = ELLIPSE
) -> Array:
    """Return rows (n, COLUMNS) of the blobs at these outlines; NaN where no target is possible."""
    rows = np.full((len(starts), COLUMNS), np.nan)
    known = ~np.isnan(starts).any(axis=1)
    # One type of array, so that the kernel is compiled once.
    pixels = np.ascontiguousarray(grey).view()
    pixels.flags.writeable = False
    fitted = fit_ellipses(pixels, starts[known], settings)
    rows[known] = rows_of(fitted)
    rows[~is_possible(rows, look, grey.shape)] = np.nan
    rows[np.flatnonzero(known)[fitted[:, PLATEAU] > look.brightest]] = np.nan
    return rows


def rows_of(fitted: Array) -> Array:
    """Return rows (n, COLUMNS) of fitted ellipses."""
    middle = 0.5 * (fitted[:, AXIS_XX] + fitted[:, AXIS_YY])
    half_difference, aslant = fitted[:, AXIS_XX] - middle, fitted[:, AXIS_XY]
    span = np.hypot(half_difference, aslant)
    rows = np.empty((len(fitted), COLUMNS))
    rows[:, U], rows[:, V] = fitted[:, CENTER_U], fitted[:, CENTER_V]
    rows[:, AREA] = math.pi * (middle + span) * (middle - span)
    rows[:, MAJOR], rows[:, MINOR] = 2.0 * (middle + span), 2.0 * (middle - span)
    rows[:, ANGLE] = 0.5 * np.arctan2(aslant, half_difference)
    rows[:, STD], rows[:, BLUR] = fitted[:, ERROR], fitted[:, WIDTH]
    rows[:, CONTRAST] = fitted[:, PLATEAU] - fitted[:, BEHIND]
    rows[:, BEYOND] = fitted[:, OUTSIDE]
    rows[:, SMEAR] = fitted[:, [SMEAR_U, SMEAR_V]]
    rows[:, LEVEL], rows[:, FILLED] = fitted[:, PLATEAU], fitted[:, WITHIN]
    rows[:, SEEN], rows[:, EXACT] = fitted[:, NEAR_EDGE], fitted[:, ON_EDGE]
    return rows


def is_possible(rows: Array, look: Look, size: tuple[int, ...]) -> Mask:
    """Whether blobs can be targets and lie within an image of this size (height, width)."""
    limits, half = look.limits, 0.5 * rows[:, MAJOR]
    with np.errstate(invalid='ignore'):
        return np.asarray(
            (rows[:, AREA] >= limits.smallest)
            & (rows[:, AREA] <= limits.largest)
            & (rows[:, MAJOR] <= limits.elongation * rows[:, MINOR])
            & (rows[:, CONTRAST] >= look.contrast)
            & (rows[:, U] - half >= 1.0)
            & (rows[:, V] - half >= 1.0)
            & (rows[:, U] + half <= size[1] - 2.0)
            & (rows[:, V] + half <= size[0] - 2.0)
            & np.isfinite(rows).all(axis=1)
        )
