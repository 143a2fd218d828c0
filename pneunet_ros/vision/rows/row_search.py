"""Search for the row that starts at the clamp, among all areas of a frame."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.vision.association import least_seen, near_row_from_clamp, row_from_clamp
from pneunet_ros.vision.dots.areas import round_areas
from pneunet_ros.vision.dots.blobs import Blobs, measure_areas, nearest_blobs
from pneunet_ros.vision.dots.centroid import AREA, COLUMNS, MAJOR
from pneunet_ros.vision.gating import FARTHEST, initial_area
from pneunet_ros.vision.rest_plane import Failure
from pneunet_ros.vision.row_candidates import blob_columns
from pneunet_ros.vision.row_ends import continues_beyond
from pneunet_ros.vision.row_look import has_whole_edge, shows_own_size
from pneunet_ros.vision.rows.partial_targets import with_partial
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.row_gate import gate_row, is_at_clamp
from pneunet_ros.vision.rows.view import NO_AREAS, View


def search_around(view: View, last: TrackedRow) -> ObservedRow | Failure:
    """Find the row that starts at the clamp near its last position."""
    reach = FARTHEST * last.spacing
    places = last.pixels[np.isfinite(last.pixels[:, 0])]
    if not (len(places) and math.isfinite(reach)):
        return NO_AREAS
    size = view.image.width, view.image.height
    first = np.clip(np.floor(places.min(axis=0) - reach), 0, size).astype(np.int64)
    after = np.clip(np.ceil(places.max(axis=0) + reach) + 1.0, 0, size).astype(np.int64)
    piece = view.image.grey()[first[1] : after[1], first[0] : after[0]]
    if not piece.size:
        return NO_AREAS
    areas = round_areas(piece, view.appearance)
    areas = areas._replace(centers=areas.centers + first)
    return search_row(replace(view, areas=areas, shallow=True))


def search_row(view: View) -> ObservedRow | Failure:
    """Find the row that starts at the clamp among all areas of the frame.

    Areas that are on a row, according to their moments, are measured first; if they do not include
    all targets, all areas are measured.
    """
    areas = view.round_areas()
    points = view.plane.points(view.lens.undistort(areas.centers))
    usable = np.flatnonzero(np.isfinite(points[:, 0]))
    near = usable[
        near_row_from_clamp(
            points[usable],
            areas.areas[usable],
            view.arclength,
            view.clamp_angle,
            view.vision.beam_search,
            areas.shapes[usable],
        )
    ]
    if len(near) < len(areas.centers):
        row = row_among(view, measure_areas(view.image, areas.only(near), view.appearance))
        if isinstance(row, ObservedRow) and row.seen == view.arclength.size:
            return row
        if view.shallow:
            return replace(row, found=areas.centers) if isinstance(row, Failure) else row
    blobs = measure_areas(view.image, areas, view.appearance)
    if len(blobs) == 0:
        return NO_AREAS
    found = row_among(view, blobs)
    return replace(found, found=blobs.centers) if isinstance(found, Failure) else found


def row_among(view: View, blobs: Blobs) -> ObservedRow | Failure:
    """Find the row that starts at the clamp among these blobs."""
    vision = view.vision
    points = view.plane.points(view.lens.undistort(blobs.centers))
    taken = view.is_taken(blobs.table.T)
    usable = np.flatnonzero(np.isfinite(points[:, 0]) & ~taken)
    row = row_from_clamp(
        points[usable],
        blobs.area[usable],
        view.arclength,
        view.clamp_angle,
        vision.beam_search,
        blobs.shapes[usable],
    )
    targets = view.arclength.size
    least = least_seen(targets, vision.beam_search)
    table, chosen = np.full((targets, COLUMNS), np.nan), row.chosen >= 0
    table[chosen] = blobs.table.T[usable[row.chosen[chosen]]]
    shown = shows_own_size(table, vision.row_look, vision.gating)
    usual = initial_area(table[:, AREA], shown, vision.gating)
    sized = has_whole_edge(table, vision.row_look)
    found = with_partial(view, gate_row(view, table, usual), usual, sized)
    if found.seen >= least and is_at_clamp(view, found.points) and is_shifted(view, found):
        return Failure(
            reason='no_row',
            seen=found.seen,
            sentence=f'{found.seen} of {targets} targets form a row that may be off by one '
            'spacing: the target at one end is missing, and beyond the other end there is another '
            'dot, or the border of the image. Uncover that target, or reset the tracker; has the '
            'camera moved, or has the row more dots than target_arclength?',
        )
    if found.seen < least or not is_at_clamp(view, found.points):
        others = f', {taken.sum()} of which belong to other arms' if taken.any() else ''
        return Failure(
            reason='no_row',
            seen=found.seen,
            sentence=f'{found.seen} of {targets} targets form a row from the clamp, among '
            f'{len(blobs)} areas{others}; {least} are needed: is the arm covered, or has the '
            'camera moved?',
        )
    return found


def is_shifted(view: View, row: ObservedRow) -> bool:
    """Whether a row lacks the target at one end and continues beyond the other.

    In this case, the camera has moved along the arm by a spacing. The same is possible if a
    recovered row lacks an end that was seen last, and the place beyond its other end is out of
    view.
    """
    seen = np.flatnonzero(np.isfinite(row.points[:, 0]))
    ends = {0, len(row.points) - 1} - set(seen.tolist())
    if len(ends) != 1:
        return False
    forward = 0 in ends
    order = slice(None, None, 1 if forward else -1)
    arclength = view.arclength if forward else view.arclength[-1] - view.arclength[::-1]
    table, points = row.table[order], row.points[order]
    places = 2.0 * table[-1:, :2] - table[-2:-1, :2]
    if np.isnan(places).any():
        return False
    reach = view.settings.gate * math.hypot(*(places[0] - table[-1, :2]))
    size = np.array([view.image.width, view.image.height], np.float64)
    across = float(table[-1, MAJOR])
    inside = np.abs(2.0 * places[0] - size) <= size - 2.0 * reach - across
    if not inside.all() and view.lost is not None and view.lost[0 if forward else -1]:
        return True
    beyond = nearest_blobs(view.image, places, reach, across, view.appearance)
    beyond = beyond[np.isfinite(beyond[:, AREA]) & ~view.is_taken(beyond)]
    known = np.isfinite(points[:, 0])
    chosen = np.where(known, np.cumsum(known) - 1, -1)
    blobs = Blobs(np.vstack([table[known], beyond]).T)
    at = np.vstack([points[known], view.plane.points(view.dot_centers(beyond))])
    columns = blob_columns(at, blobs.area, blobs.shapes)
    return continues_beyond(columns, arclength, chosen, view.vision.beam_search)
