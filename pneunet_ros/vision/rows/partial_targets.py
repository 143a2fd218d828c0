"""Targets that are partly visible or smeared, completed from their neighbors."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.vision.dots.blobs import blobs_at
from pneunet_ros.vision.dots.centroid import AREA, CONTRAST, is_possible, rows_of, STD, U
from pneunet_ros.vision.dots.ellipse_fit import (
    AXIS_XX,
    AXIS_YY,
    CENTER_U,
    CENTER_V,
    SIZE_STD,
    SMEAR_U,
    SMEAR_V,
)
from pneunet_ros.vision.dots.moving_dots import (
    as_fitted,
    end_of_arm,
    fit_moving_dot,
    is_dot,
    moves_far,
    MovingDot,
    prior_alone,
    prior_from_neighbors,
    SAME_PIXELS,
)
from pneunet_ros.vision.gating import Mask
from pneunet_ros.vision.row_look import (
    believable_parts,
    FEWEST,
    has_whole_edge,
    is_larger,
    looks_of_neighbors,
    OFF_PLACE,
    OWN_STD,
    part_stds,
    share_of_area,
    UNSURE,
    whole_targets,
)
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.row_gate import expected_pixels, gate_row
from pneunet_ros.vision.rows.row_motion import velocity_along_row
from pneunet_ros.vision.rows.view import View


def with_partial(
    view: View, row: ObservedRow, usual: Array, sized: Mask, last: TrackedRow | None = None
) -> ObservedRow:
    """Return a row with its partly visible targets, completed from their neighbors.

    sized (targets,): mask of targets with their own usual area; other arguments as in `gate_row`.
    """
    settings = view.vision.row_look
    if row.seen <= FEWEST:
        return row
    starts = _places_by_neighbors(view, row, last)
    large = is_larger(usual, view.vision.gating) & ~sized
    own = np.where(sized | large, usual, np.nan)
    expected = looks_of_neighbors(row.table, starts[0], own, settings)
    expected[large, SIZE_STD] = OWN_STD
    expected[large, AXIS_XX : AXIS_YY + 1] *= 1.0 + OWN_STD
    share = share_of_area(row.table, expected)
    partial = ~whole_targets(row.table, expected, settings)
    same = has_whole_edge(row.table, settings) & (
        row.table[:, AREA] >= settings.least_area * usual
    )
    if last is None:  # the size of each is not known yet
        partial &= ~same
    found = np.full_like(row.table, np.nan)
    swept = expected
    if last is not None and partial.any():
        swept = _with_exposure_motion(view, row, expected, last)
    moving = partial & moves_far(swept)
    if moving.any():
        found[moving] = _moving_at(view, row, moving, swept, starts, last)[moving]
    for places in starts:
        expected[:, [CENTER_U, CENTER_V]] = places
        fitted_now = partial & ~moving & np.isfinite(places[:, 0])
        if fitted_now.any():
            part = _parts_at(view, row, usual, fitted_now, expected, last)
            better = np.isfinite(part[:, U]) & ~(found[:, STD] <= part[:, STD])
            found[better] = part[better]
    believed = np.isfinite(found[:, U])
    # A blob with neither the earlier size, nor the look of a part of such a target, is something
    # else.
    other = partial & ~believed & ~same & np.isfinite(share)
    if not (believed | other).any():
        return row
    table = np.where(believed[:, None], found, row.table)
    table[other] = np.nan
    causes = tuple(np.where(other, 'part', row.causes).tolist())
    return gate_row(view, table, usual, last, believed, causes)


def _parts_at(
    view: View,
    row: ObservedRow,
    usual: Array,
    partial: Mask,
    expected: Array,
    last: TrackedRow | None,
) -> Array:
    """Return the targets whose visible part matches their neighbors.

    partial (targets,): mask of targets to examine; expected: positions, and as from
    `looks_of_neighbors`. Rows (targets, columns), NaN without a reliable match.
    """
    settings = view.vision.row_look
    found = np.full_like(row.table, np.nan)
    found[partial] = blobs_at(view.image, expected[partial], view.appearance)
    found[:, STD] = part_stds(found, expected, settings)
    off = np.hypot(*(found[:, :2] - expected[:, [CENTER_U, CENTER_V]]).T)
    believed = off <= OFF_PLACE * np.sqrt(usual / math.pi)
    share = share_of_area(row.table, expected)
    believed &= believable_parts(found, expected, share, settings, view.vision.gating)
    if last is not None:
        # A new target must be on the row: a finger nail is as bright and as large.
        worse = found[:, STD] > settings.unlike * np.nanmedian(row.table[:, STD])
        believed &= _are_on_row(view, row, found, partial & (~last.seen | worse))
    found[~believed] = np.nan
    return found


def _with_exposure_motion(
    view: View, row: ObservedRow, expected: Array, last: TrackedRow
) -> Array:
    """Return outlines (targets, FITTED) that move with the row during the exposure.

    The smear predicted from neighbors is too short if most of them are not seen whole; the longer
    of this smear and the motion since the last frame is used.
    """
    outlines, both = expected.copy(), np.isfinite(row.table[:, U]) & last.seen
    if both.any():
        seconds = seconds_between(last.stamp_ns, view.image.stamp_ns)
        moved = (row.table[both, :2] - last.pixels[both]) / seconds
        neighbors = view.vision.row_look.neighbors
        # No exposure is longer than the time between two images, whose stamps may be wrong.
        exposure = min(last.exposure, seconds)
        ways = exposure * velocity_along_row(moved, view.arclength, both, neighbors)
        longer = np.hypot(*ways.T) > np.hypot(expected[:, SMEAR_U], expected[:, SMEAR_V])
        outlines[longer, SMEAR_U : SMEAR_V + 1] = ways[longer]
    return outlines


def _moving_at(
    view: View,
    row: ObservedRow,
    moving: Mask,
    expected: Array,
    starts: tuple[Array, ...],
    last: TrackedRow | None,
) -> Array:
    """Return the targets that move far during the exposure, rows (targets, columns).

    moving (targets,): mask of targets to search, at each of `starts` and at positions predicted by
    the others, because a smeared blob may be off its start; expected: as from
    `looks_of_neighbors`. NaN without a reliable match.
    """
    without = replace(row, table=row.table.copy(), points=row.points.copy())
    without.table[moving] = without.points[moving] = np.nan
    starts = _places_by_neighbors(view, without, last) + starts
    settings, look, grey = view.vision.moving_dots, view.vision.row_look, view.image.grey()
    along = np.gradient(starts[0], axis=0)
    along /= np.hypot(*along.T)[:, None]
    ends = np.full(len(along), math.inf)
    ends[-1] = end_of_arm(expected[-1], along[-1], settings)
    informing = np.flatnonzero(whole_targets(row.table, expected, look)).tolist()
    if not informing:
        return np.full_like(row.table, np.nan)
    fitted: dict[int, MovingDot | None] = {}
    found = np.full_like(row.table, np.nan)
    away = np.abs(np.arange(len(moving))[:, None] - informing).min(axis=1)
    for target in sorted(np.flatnonzero(moving).tolist(), key=lambda it: int(away[it])):
        nearest = sorted(informing, key=lambda it: abs(it - target))[:FEWEST]
        for other in nearest:
            if other not in fitted:
                outline = expected[other].copy()
                outline[[CENTER_U, CENTER_V]] = row.table[other, :2]
                nothing = prior_alone(outline, row.table[other, CONTRAST], settings)
                fitted[other] = fit_moving_dot(
                    grey, outline, along[other], ends[other], nothing, settings
                )
        dots = [dot for it in nearest if (dot := fitted[it]) is not None]
        if not dots:
            continue
        known = prior_from_neighbors(dots, settings)
        for places in starts:
            outline = expected[target].copy()
            outline[[CENTER_U, CENTER_V]] = places[target]
            again = math.hypot(*(places[target] - found[target, :2])) < SAME_PIXELS
            if np.isnan(outline).any() or again:
                continue
            dot = fit_moving_dot(grey, outline, along[target], ends[target], known, settings)
            if dot is None or not is_dot(dot, known, settings):
                continue
            fitting = rows_of(as_fitted(outline, dot)[None])[0]
            radius = math.sqrt(fitting[AREA] / math.pi)
            off = math.hypot(*(dot.center - places[target]))
            precise = dot.std <= UNSURE * radius and not found[target, STD] <= dot.std
            if precise and off <= radius:
                found[target], fitted[target] = fitting, dot
        if target in fitted:  # skin and light change along the arm: the nearest predicts best
            informing.append(target)
    found[~is_possible(found, view.appearance.look, grey.shape)] = np.nan
    if last is not None:
        worse = found[:, STD] > look.unlike * np.nanmedian(row.table[:, STD])
        found[~_are_on_row(view, row, found, moving & (~last.seen | worse))] = np.nan
    return found


def _places_by_neighbors(
    view: View, row: ObservedRow, last: TrackedRow | None
) -> tuple[Array, ...]:
    """Return seen positions of targets and those interpolated from neighbors, (targets, 2) px.

    The first are interpolated along the row, which is inaccurate beyond a gap. The second, for
    targets seen in the last row (NaN for all others), are their predicted motion plus the
    deviation of the other targets from their predictions.
    """
    seen = np.isfinite(row.table[:, U])
    on_row = np.where(seen[:, None], row.table[:, :2], expected_pixels(view, row.points))
    if last is None:
        return (on_row,)
    lost, both = last.seen & ~seen, last.seen & seen
    if not (lost.any() and both.any()):
        return (on_row,)
    predicted = last.predict(view.image.stamp_ns)
    moved, off = np.full_like(predicted, np.nan), (row.table[:, :2] - predicted)[both]
    for axis in range(2):
        more = np.interp(view.arclength[lost], view.arclength[both], off[:, axis])
        moved[lost, axis] = predicted[lost, axis] + more
    return on_row, moved


def _are_on_row(view: View, row: ObservedRow, found: Array, doubtful: Mask) -> Mask:
    """Whether doubtful targets lie where the neighbors on both sides predict them (targets,).

    found (targets, columns): of each; doubtful (targets,): partly visible, or with a bad fit. True
    for all others, and for targets at the end of the seen row.
    """
    others = np.where(doubtful[:, None], np.nan, row.points)
    seen = np.flatnonzero(np.isfinite(others[:, 0]))
    if seen.size < 2:
        return ~doubtful
    between = np.zeros_like(doubtful)
    between[seen[0] : seen[-1]] = True
    off = np.hypot(*(found[:, :2] - expected_pixels(view, others)).T)
    reach = OFF_PLACE * np.sqrt(found[:, AREA] / math.pi)
    return np.asarray(~(doubtful & between) | (off <= reach))
