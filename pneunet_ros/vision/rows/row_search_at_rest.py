"""Search for the row of the arm at rest, before the plane of the arm is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.vision.association import LEAST_TARGETS, TargetRow
from pneunet_ros.vision.beam_search import ALONG_STD, Indices, Mask
from pneunet_ros.vision.dots.areas import RoundAreas
from pneunet_ros.vision.dots.blobs import Blobs, measure_areas
from pneunet_ros.vision.rest_plane import (
    CHANCE,
    CROWD,
    Failure,
    LIMITS,
    NO_ROW,
    no_row,
    ODDS,
    plane_at_rest,
    RestAverage,
    RestSearch,
    row_at_rest,
    row_points,
    spacing_of,
)
from pneunet_ros.vision.row_candidates import RowCandidates
from pneunet_ros.vision.rows.row import ObservedRow
from pneunet_ros.vision.rows.row_search import row_among
from pneunet_ros.vision.rows.view import NO_AREAS, View
from pneunet_ros.vision.still_areas import is_moved, StillAreas


def search_at_rest(view: View, rest: RestSearch) -> Array | Failure:
    """Find the targets of the arm at rest, normalized (targets, 2), NaN where one is not seen.

    view: its plane is not used; rest: earlier rest positions of the arm, which identify the
    targets in a frame that does not show a whole row.
    """
    areas = view.round_areas()
    if len(areas.centers) == 0:
        return NO_AREAS
    if view.limits:
        first = _search_salient_areas(view, areas)
        if view.shallow or not (isinstance(first, Failure) or np.isnan(first).any()):
            return first
    blobs = _free_blobs(view, areas)
    if len(blobs) == 0:
        return NO_AREAS
    found = _search_all(view, blobs)
    if not isinstance(found, Failure):
        return found
    others = np.count_nonzero(np.isfinite(view.taken[:, 0]))
    more = f'; not counting {others} targets of other arms' if others else ''
    found = replace(found, found=blobs.centers, blobs=blobs, sentence=found.sentence + more)
    if found.reason != 'no_row':
        return found
    points = view.lens.undistort(blobs.centers)
    seen = points[np.isfinite(points[:, 0])]
    again = rest.recognize(seen, view.arclength, view.vision)
    return found if again is None else again


def _free_blobs(view: View, areas: RoundAreas) -> Blobs:
    """Return the blobs among areas of a frame that do not belong to other rows."""
    blobs = measure_areas(view.image, areas, view.appearance)
    return Blobs(freeze(blobs.table[:, ~view.is_taken(blobs.table.T)]))


def _search_salient_areas(view: View, areas: RoundAreas) -> Array | Failure:
    """Find the targets of the arm at rest among salient areas, as in `search_at_rest`.

    Only areas that are on a row, according to their moments, are measured, with all areas near
    this row or near another row that is not due to chance.
    """
    points = view.lens.undistort(areas.centers)
    clear = areas.stand_out(view.appearance)
    clear = clear[np.isfinite(points[clear, 0])]
    nothing = Failure(
        reason='no_row',
        sentence=f'no row of {view.arclength.size} targets with the distances of '
        f'target_arclength among {len(clear)} clearly visible areas',
        found=areas.centers[clear],
    )
    candidates = _candidates(view, points, areas.areas, areas.shapes, clear)
    return _search_within(
        view,
        view.limits,
        candidates,
        points,
        lambda near: _free_blobs(view, areas.only(near)),
        nothing,
    )


def _search_all(view: View, blobs: Blobs) -> Array | Failure:
    """Find the targets of the arm at rest among all blobs of a frame, as `search_at_rest`.

    Among many areas, only rows of low cost are searched for, because others are due to chance.
    """
    arclength = view.arclength
    points = view.lens.undistort(blobs.centers)
    known = np.flatnonzero(np.isfinite(points[:, 0]))
    candidates = _candidates(view, points, blobs.area, blobs.shapes, known)
    found, limits = no_row(arclength.size, len(known)), LIMITS
    while True:
        row = _search_within(
            view,
            limits,
            candidates,
            points,
            lambda near: Blobs(freeze(blobs.table[:, near])),
            found,
        )
        if not isinstance(row, Failure) or row.reason not in NO_ROW:
            return row
        found, dearest = row, view.vision.beam_search.dearest(arclength.size)
        if limits[-1] >= dearest:
            return found
        limit = min(2.0 * limits[-1], dearest)
        if candidates.are_crowded(CROWD, min(limit + CHANCE, dearest)):
            more = ' (among so many areas, only rows that fit well are searched for)'
            return replace(found, sentence=found.sentence + more)
        limits = (limit,)


def _candidates(
    view: View, points: Array, areas: Array, shapes: Array, known: Indices
) -> RowCandidates:
    """Return the candidate rows among some areas (known) of the frame."""
    return RowCandidates(
        points[known],
        areas[known],
        view.arclength,
        view.vision.beam_search,
        shapes[known],
        most=len(points),
    )


def _search_within(
    view: View,
    limits: tuple[float, ...],
    candidates: RowCandidates,
    points: Array,
    measured: Callable[[Indices], Blobs],
    found: Failure,
) -> Array | Failure:
    """Find the targets of the arm at rest near rows of low cost, the lowest first.

    points (areas, 2): all areas, normalized; measured: returns blobs of some; found: the result
    if there is no such row. Returns as `search_at_rest`.
    """
    if len(limits) > 1 and not len(candidates.near(points, limits[-1])):
        return found
    for limit in limits:
        if not len(candidates.near(points, limit)):
            continue
        more = limit + CHANCE
        decide: tuple[float, ...] = limit, more, more + CHANCE, math.inf
        if limit > LIMITS[-1]:  # more expensive rows are accidental
            more = min(more, view.vision.beam_search.dearest(view.arclength.size))
            decide = limit, more
        blobs = measured(candidates.near(points, more))
        if len(blobs) == 0:
            found = NO_AREAS
            continue
        row = _search_cached(view, blobs, decide)
        if not isinstance(row, Failure):
            return row
        found = replace(row, found=blobs.centers)
        if found.reason not in NO_ROW:
            break
    return found


def _search_cached(view: View, blobs: Blobs, limits: tuple[float, ...]) -> Array | Failure:
    """Find the targets of the arm at rest, as `_search`; the same blobs are searched once.

    The cache helps if all areas are salient.
    """
    key = (
        'at rest', limits, view.settings, view.vision, view.clamp_angle, view.arclength.tobytes(),
        view.taken.tobytes(), blobs.table.tobytes(),
    )  # fmt: skip
    return view.image.once(key, lambda: _search(view, blobs, limits))


def _search(view: View, blobs: Blobs, limits: tuple[float, ...]) -> Array | Failure:
    """Find the targets of the arm at rest from this frame alone, as in `search_at_rest`.

    limits: as in `row_at_rest`. Once the row has determined the plane, it must be found again from
    its clamp, so that the result does not depend on earlier frames.
    """
    settings, vision, arclength = view.settings, view.vision, view.arclength
    points = view.lens.undistort(blobs.centers)
    at_rest = whole = _row_at_rest(view, blobs, points, arclength, limits)
    if isinstance(whole, Failure):
        # The last target may be partly visible: its neighbors predict its position.
        short = arclength.size > LEAST_TARGETS
        if whole.reason != 'no_row' or not short:
            return whole
        at_rest = _row_at_rest(view, blobs, points, arclength[:-1], limits)
    if isinstance(at_rest, Failure):
        return whole
    places = arclength[: len(at_rest)]
    plane = plane_at_rest(at_rest, places, settings.plane, view.clamp_angle)
    found = row_among(replace(view, plane=plane), blobs)
    if isinstance(found, Failure):
        return found
    ambiguous = isinstance(whole, Failure) and np.isnan(found.std[-1])
    if ambiguous and not _begins_at_clamp_pixel(view, found):
        return Failure(
            reason='no_row',
            seen=found.seen,
            sentence=f'only {arclength.size - 1} of {arclength.size} targets are visible, and '
            'their distances do not show whether target 0 or target '
            f'{arclength.size - 1} is missing: give clamp_pixel (--clamp-pixel U V) to '
            'within half their spacing. Is one of them too faint (contrast, focus), or '
            'cut off by the end of the arm?',
        )
    again = view.dot_centers(found.table)
    # A target next to a slot or a glint is measured again with the look of its neighbors: it
    # remains the same target.
    apart = np.hypot(*(again[: len(at_rest)] - at_rest).T)
    same = np.count_nonzero(apart < 0.5 * spacing_of(at_rest, places))
    if same < vision.beam_search.seen * arclength.size:
        return Failure(
            reason='no_row',
            seen=int(same),
            sentence=f'only {same} of {arclength.size} targets at rest were found again when '
            'counted from the clamp: does target_arclength match them?',
        )
    return again


def _begins_at_clamp_pixel(view: View, row: ObservedRow) -> bool:
    """Whether clamp_pixel determines which target is the first one of a row."""
    if view.settings.clamp_pixel is None:
        return False
    spacing = float(np.nanmedian(np.hypot(*np.diff(row.table[:, :2], axis=0).T)))
    return math.hypot(*(row.table[0, :2] - view.settings.clamp_pixel)) < 0.5 * spacing


def search_moved_areas(view: View, still: StillAreas, wanted: int) -> RestAverage | None:
    """Find the rest position of the arm among areas that stood still until the arm moved.

    wanted: number of frames for which an area must have existed, and must have been absent since.
    An area that still exists costs as much as a missing target, because an arm hardly moves near
    the clamp. None if nothing moved, or if the moved areas are not a row of all targets.
    """
    known = still.only(still.seen >= wanted)
    vanished, search = known.unseen >= wanted, view.vision.beam_search
    most_of_all = np.argsort(~vanished, kind='stable')[: view.arclength.size]
    if not is_moved(vanished, most_of_all, ODDS):
        return None
    straight = view.rest_straightness * (view.arclength.size - 1) / search.farthest
    straight_rows = replace(search, across_std=min(search.across_std, straight))
    points = view.lens.undistort(known.centers)
    row = row_at_rest(
        points,
        known.centers,
        known.area,
        view.arclength,
        view.settings.clamp_pixel,
        view.rest_straightness,
        replace(view.vision, beam_search=straight_rows),
        known.shapes,
        np.where(vanished, 0.0, search.missing),
    )
    if isinstance(row, Failure) or not _has_moved(view, row, points, vanished):
        return None
    seen = np.where(row.chosen >= 0, known.seen[row.chosen], 0)
    return RestAverage(
        frames=int(seen[seen > 0].min()), points=freeze(row_points(row, points)), seen=seen
    )


def _has_moved(view: View, row: TargetRow, points: Array, vanished: Mask) -> bool:
    """Whether a row among points (areas, 2) moved like an arm, with all of its targets.

    vanished (areas,): mask of areas that disappeared. For an arm, all targets disappeared except
    some at the clamp, and no area disappeared where the next target beyond the tip would be.
    """
    chosen = row.chosen[row.chosen >= 0]
    if np.any(np.diff(vanished[chosen].astype(np.int64)) < 0):
        return False
    step = np.diff(view.arclength)[-1] / np.ptp(view.arclength)
    beyond = points[chosen[-1]] + step * (points[chosen[-1]] - points[chosen[0]])
    reach = view.vision.beam_search.farthest * ALONG_STD
    reach *= spacing_of(row_points(row, points), view.arclength)
    if np.any(np.hypot(*(points[vanished] - beyond).T) <= reach):
        return False
    return is_moved(vanished, chosen, ODDS)


def _row_at_rest(
    view: View, blobs: Blobs, points: Array, arclength: Array, limits: tuple[float, ...]
) -> Array | Failure:
    """Return the targets of a resting arm among blobs, normalized (targets, 2), NaN where missing.

    points (blobs, 2) normalized, NaN outside the view of the lens.
    """
    settings, usable = view.settings, np.isfinite(points[:, 0])
    row = row_at_rest(
        points[usable],
        blobs.centers[usable],
        blobs.area[usable],
        arclength,
        settings.clamp_pixel,
        view.rest_straightness,
        view.vision,
        blobs.shapes[usable],
        limits=limits,
    )
    return row if isinstance(row, Failure) else row_points(row, points[usable])
