"""Appearance of a target from its neighbors: size, shape and blur change little along the row.

A partly visible target (cut off by the end of the arm, behind a finger, or in front of a
background of the same grey level) is located by fitting the outline of its neighbors to the
visible part.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.dots.centroid import (
    AREA,
    axes_of,
    BEYOND,
    BLUR,
    CONTRAST,
    EXACT,
    FILLED,
    LEVEL,
    Mask,
    outlines,
    SEEN,
    SMEAR,
    STD,
)
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_XY,
    AXIS_YY,
    BEHIND,
    PLATEAU,
    PLATEAU_STD,
    SIZE_STD,
    WIDTH,
    WIDTH_STD,
)
from pneunet_ros.vision.gating import GATING, GatingSettings, local_median


@dataclass(frozen=True, slots=True, kw_only=True)
class RowLookSettings:
    """Settings for predicting the appearance of a target from its neighbors."""

    neighbors: int = tuning(
        6, 'number of nearest neighbors used for the appearance', source='sweep'
    )
    unlike: float = tuning(
        3.0,
        'largest difference from neighbors in size, brightness and blur; largest error of a whole '
        'or new blob, relative to that of the others',
        unit='one sigma',
        source='measured: 4.5 to 6 of a tip cut off by 5 %',
    )
    least_area: float = tuning(
        0.985, 'smallest area of a whole blob, relative to its neighbors', source='measured'
    )
    least_std: float = tuning(0.0015, 'least std of size and shape', unit='radius', source='sweep')
    blur_std: float = tuning(
        0.15,
        'one sigma of the blur',
        unit='px',
        source='measured: blurred films of acceptance/composed_pictures.py lose parts with 0.1',
    )
    level_std: float = tuning(
        0.05,
        'least std of the plateau',
        unit='contrast',
        source='measured: blurred films of acceptance/composed_pictures.py lose parts with 0.03',
    )
    beyond: float = tuning(
        0.15, 'largest share of the edge outside of the outline', source='sweep'
    )
    part_error: float = tuning(
        0.007,
        'error of the center of a part that moves along its cover',
        unit='way^2 / radius',
        source='measured: films of acceptance/composed_pictures.py',
    )
    size_error: float = tuning(
        0.12,
        'error of the center of a part of unknown size, over that of its radius',
        source='measured: films `uneven` of acceptance/composed_pictures.py',
    )


ROW_LOOK = RowLookSettings()
LEAST_SMEAR_STD = 0.15  # px, of the motion during an exposure
UNSURE = 0.15  # radii, the largest error of the center of a part
OFF_PLACE = 0.25  # radii, of a part or of a doubtful target from where its neighbors say
FEWEST = 3  # neighbors, for a line and their deviation from it
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
# Share of the edge near the outline of a target larger than its neighbors: of a tip cut by the end
# of the arm at 0.7 radii from its center.
OWN_SIZE = 0.75
# Radii by which a target cut off looks smaller, with an equal uncertainty; measured: 0.04, cut at
# 0.8 radii.
OWN_STD = 0.05
EDGE_SEEN = 0.5  # least share of the edge of a partly hidden target; measured: 0.54 of a cut tip


def looks_of_neighbors(
    table: Array, places: Array, own: Array, settings: RowLookSettings = ROW_LOOK
) -> Array:
    """Return the looks of targets predicted from neighbors, as `outlines` at (targets, 2) px.

    table (targets, COLUMNS), NaN where one is not seen; own (targets,) px^2: relative sizes of the
    targets, NaN for a target never seen whole. Shape, smear, plateau and relative size are from a
    line through the nearest neighbors with whole edges; the scatter about this line is the
    uncertainty. The uncertainty of an unknown size is the scatter of the sizes of neighbors. NaN
    for a target with too few neighbors. Targets much smaller than expected, because a finger
    covers a part of them, are excluded.
    """
    whole = has_whole_edge(table, settings)
    first = _predicted_looks(table, places, own, whole, settings)
    smaller = whole & (share_of_area(table, first) < _least_share(first, settings))
    if not smaller.any():
        return first
    return _predicted_looks(table, places, own, whole & ~smaller, settings)


def _predicted_looks(
    table: Array, places: Array, own: Array, reliable: Mask, settings: RowLookSettings
) -> Array:
    """Return the appearance of targets (targets,) predicted from reliable neighbors."""
    whole = np.flatnonzero(reliable)
    away = (whole - np.arange(len(table))[:, None]).astype(np.float64)
    distance = np.where(away == 0.0, np.inf, np.abs(away))
    nearest = np.argsort(distance, axis=1, kind='stable')[:, : settings.neighbors]
    # Whole targets may have one neighbor less, because they do not count themselves.
    known = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
    known &= (np.count_nonzero(known, axis=1) >= FEWEST)[:, None]
    away, near = np.take_along_axis(away, nearest, axis=1), whole[nearest]
    radius, one = np.sqrt(table[:, AREA] / math.pi), np.isfinite(own)
    own_radius = np.sqrt(own / math.pi)
    larger = (radius / own_radius)[reliable & one]
    own_radius[~one] = radius[~one] / (np.median(larger) if larger.size else 1.0)
    on_line = np.column_stack([
        axes_of(table) / radius[:, None], own_radius, radius / own_radius,
        table[:, SMEAR], table[:, LEVEL],
    ])  # fmt: skip
    line, variance = _lines_at(away, on_line[near], known)
    shape, smear, level = line[:, :3], line[:, 5:7], line[:, 7]
    size = line[:, 4] * np.where(one, own_radius, line[:, 3])
    differ = np.where(one, 0.0, np.sqrt(variance[:, 3]) / line[:, 3])
    size_std = np.hypot(np.sqrt(variance[:, 4]) / line[:, 4], differ)
    usual = np.full((len(table), nearest.shape[1] + 1, 2), np.nan)
    usual[:, :-1] = table[:, [BLUR, CONTRAST]][near]
    usual[:, :-1][~known] = np.nan
    middle = np.count_nonzero(known, axis=1) // 2
    blur, contrast = np.sort(usual, axis=1)[np.arange(len(table)), middle].T
    shape_std = np.maximum(np.sqrt(variance[:, :3].mean(axis=1)), settings.least_std)
    smear_std = np.maximum(np.sqrt(variance[:, 5:7].mean(axis=1)), LEAST_SMEAR_STD)
    stds = (shape_std, settings.blur_std, smear_std)
    starts = outlines(places, shape * size[:, None], blur, smear, stds)
    starts[:, SIZE_STD] = np.maximum(size_std, settings.least_std)
    starts[:, PLATEAU], starts[:, BEHIND] = level, level - contrast
    level_std = np.sqrt(variance[:, 7])
    starts[:, PLATEAU_STD] = np.maximum(level_std, settings.level_std * contrast)
    return starts


def _lines_at(away: Array, values: Array, known: Mask) -> tuple[Array, Array]:
    """Return values (n, k) of lines over neighbors at targets, and their variances.

    away (n, neighbors): distance from a target to its neighbors along the row; values (n,
    neighbors, k); known (n, neighbors): mask of existing neighbors. NaN for a target without any.
    """
    count = np.count_nonzero(known, axis=1)[:, None]
    with np.errstate(invalid='ignore', divide='ignore'):
        away = np.where(known, away, 0.0)
        middle = away.sum(axis=1, keepdims=True) / count
        away = np.where(known, away - middle, 0.0)
        square = np.sum(away * away, axis=1, keepdims=True)
        values = np.where(known[:, :, None], values, 0.0)
        at_middle = values.sum(axis=1) / count
        slope = np.sum(away[:, :, None] * values, axis=1) / square
        off = values - at_middle[:, None] - away[:, :, None] * slope[:, None]
        square_off = np.sum(np.where(known[:, :, None], off * off, 0.0), axis=1)
        larger = 1.0 + 1.0 / count + middle * middle / square
    return at_middle - middle * slope, larger * square_off / np.maximum(count - 2, 1)


def whole_targets(table: Array, expected: Array, settings: RowLookSettings = ROW_LOOK) -> Mask:
    """Whether targets are seen whole (targets,): with whole edges and the size of neighbors.

    expected: as from `looks_of_neighbors`.
    """
    large = share_of_area(table, expected) >= _least_share(expected, settings)
    return has_whole_edge(table, settings) & large


def has_whole_edge(table: Array, settings: RowLookSettings = ROW_LOOK) -> Mask:
    """Whether the edges of targets (targets, COLUMNS) are completely visible.

    Whether an edge is on an outline depends on its uncertainty. An edge that is far more uncertain
    than others, and than its motion explains, is ignored.
    """
    error = table[:, STD]
    known = np.sort(error)[: np.count_nonzero(np.isfinite(error))]
    middle = len(known) // 2
    usual = 0.5 * (known[middle] + known[-1 - middle]) if len(known) else math.nan
    most = settings.unlike * usual + _error_along(table, settings)
    return np.asarray((table[:, EXACT] == 1.0) & (error <= most))


def shows_own_size(
    table: Array, settings: RowLookSettings = ROW_LOOK, gating: GatingSettings = GATING
) -> Mask:
    """Whether targets (targets, COLUMNS) are visible enough to measure their own size.

    These targets are whole, or larger than their neighbors along most of their edge; for a target
    that moves by more than a radius during the exposure, the motion may be mistaken for length.
    """
    large = is_larger(table[:, AREA], gating) & (table[:, SEEN] >= OWN_SIZE)
    large &= np.sum(table[:, SMEAR] ** 2, axis=1) <= table[:, AREA] / math.pi
    return has_whole_edge(table, settings) | large


def is_larger(area: Array, gating: GatingSettings = GATING) -> Mask:
    """Whether targets of these areas (targets,) are larger than their neighbors.

    A target that is cut off is never larger.
    """
    usual = local_median(area, np.full(len(area), math.inf))
    return np.asarray(area > gating.first_growth * usual)


def _error_along(table: Array, settings: RowLookSettings) -> Array:
    """Return the largest shift of moving targets by their background, px."""
    way = np.sum(table[:, SMEAR] ** 2, axis=1)
    return np.asarray(settings.part_error * way / np.sqrt(table[:, AREA] / math.pi))


def _least_share(expected: Array, settings: RowLookSettings) -> Array:
    """Return the smallest relative area of whole targets, given how neighbors differ."""
    return settings.least_area - settings.unlike * 2.0 * expected[:, SIZE_STD]


def share_of_area(table: Array, expected: Array) -> Array:
    """Return the areas of targets over those expected from their neighbors (targets,).

    expected: as from `looks_of_neighbors`.
    """
    size = expected[:, AXIS_XX] * expected[:, AXIS_YY] - expected[:, AXIS_XY] ** 2
    return np.asarray(table[:, AREA] / (math.pi * size))


def believable_parts(
    found: Array,
    expected: Array,
    share: Array,
    settings: RowLookSettings = ROW_LOOK,
    gating: GatingSettings = GATING,
) -> Mask:
    """Whether partly visible targets (targets, COLUMNS) match their neighbors.

    expected: as from `looks_of_neighbors`; share: as from `share_of_area`. A cover has a different
    grey level and its own edge, and makes a target smaller, never larger.
    """
    similar = _misfit(found, expected) <= settings.unlike
    edge = (share >= gating.largest_loss) | (found[:, SEEN] >= EDGE_SEEN)
    within = found[:, BEYOND] <= settings.beyond
    size = share_of_area(found, expected)
    differs = settings.unlike * 2.0 * expected[:, SIZE_STD]
    sized = np.abs(np.log(size)) <= differs - math.log(gating.largest_loss)
    precise = found[:, STD] <= UNSURE * np.sqrt(found[:, AREA] / math.pi)
    return np.asarray(similar & edge & within & sized & precise & (found[:, FILLED] > 0.5))


def part_stds(found: Array, expected: Array, settings: RowLookSettings = ROW_LOOK) -> Array:
    """Return the standard errors of the centers of partly visible targets, px.

    found (targets, COLUMNS); expected: as from `looks_of_neighbors`. If a target moves along the
    edge of its cover during the exposure, both edges look similar, and the outline may fit
    anywhere between them. If the end of the arm cuts off a target of unknown size, a smaller
    target fits as well. If level or blur differ from the neighbors by more than expected, the
    model is wrong, and the error of the fit is increased by the same factor.
    """
    along = _error_along(found, settings)
    size = settings.size_error * expected[:, SIZE_STD] * np.sqrt(found[:, AREA] / math.pi)
    misfit = np.maximum(_misfit(found, expected), 1.0)
    return np.asarray(np.hypot(np.hypot(misfit * found[:, STD], along), size))


def _misfit(found: Array, expected: Array) -> Array:
    """Return the larger difference of level and blur from those expected, sigma (targets,)."""
    level = np.abs(found[:, LEVEL] - expected[:, PLATEAU]) / expected[:, PLATEAU_STD]
    blur = np.abs(found[:, BLUR] - expected[:, WIDTH]) / expected[:, WIDTH_STD]
    return np.asarray(np.maximum(level, blur))
