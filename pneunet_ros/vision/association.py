"""The row of targets among blobs of a single image: which blob is which target.

A row is grown target by target from the clamp: the next one is expected where an arc through the
last ones leads, at the known spacing. The few best rows so far are kept at each step, so that a
glint beside the arm does not lead astray, and a target may be missing where nothing fits.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.beam_search import (
    BEAM_SEARCH,
    BeamSearchSettings,
    BlobColumns,
    COST,
    grow_rows,
    HEADING,
    Indices,
    LAST,
    LOOKS,
    Mask,
    NOTHING,
    SCALE,
    SIZE,
    X,
    Y,
)
from pneunet_ros.vision.row_ends import continues_beyond, truncate_row


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociationSettings:
    """Criteria for blobs that are a row of targets."""

    least_targets: int = tuning(
        3, 'fewest targets of an arm to distinguish its row from other areas'
    )
    least_followed: int = tuning(4, 'fewest targets seen of a row; all of an arm with fewer')
    least_share: float = tuning(0.4, 'smallest share of targets seen of a row')
    alike: float = tuning(0.5, 'share of blobs that two readings of one row have in common')


ASSOCIATION = AssociationSettings()
ENOUGH = 64  # rows that are compared: more of a crowd add nothing


class TargetRow(NamedTuple):
    """Blob index of each target (targets,), -1 for a missing one, and the cost of the row."""

    chosen: Indices
    cost: float

    @property
    def seen(self) -> int:
        """Number of targets seen."""
        return int(np.count_nonzero(self.chosen >= 0))


def least_seen(targets: int, settings: AssociationSettings = ASSOCIATION) -> int:
    """Return the number of targets that must be seen for a row."""
    return min(targets, max(settings.least_followed, math.ceil(settings.least_share * targets)))


def row_from_clamp(
    points: Array,
    areas: Array,
    arclength: Array,
    clamp_angle: float,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
) -> TargetRow:
    """Find the row that starts at the clamp; points (blobs, 2) m in the base frame.

    areas (blobs,) px^2; arclength (targets,) m; shapes (blobs, 3), as `Blobs` has them, None if
    they are not known. A row that goes on beyond the last target is none.
    """
    blobs = _columns(points, areas, shapes)
    chosen, cost = _grown_from_clamp(blobs, arclength, clamp_angle, search)
    truncate_row(blobs.x, blobs.y, arclength, clamp_angle, chosen, search)
    if chosen[-1] >= 0 and continues_beyond(blobs, arclength, chosen, cost, search):
        chosen[:] = NOTHING  # the camera has moved, or these are other dots
    return TargetRow(chosen, cost)


def near_row_from_clamp(
    points: Array,
    areas: Array,
    arclength: Array,
    clamp_angle: float,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
) -> Indices:
    """Return the blobs near the row that starts at the clamp, or near its extension.

    Arguments as in `row_from_clamp`; all of them where there is no row.
    """
    blobs = _columns(points, areas, shapes)
    chosen = _grown_from_clamp(blobs, arclength, clamp_angle, search)[0]
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < least_seen(arclength.size):
        return np.arange(len(points))
    return np.flatnonzero(_near_line(points, points[chosen[seen]], arclength[seen], search))


def _near_line(points: Array, row: Array, places: Array, search: BeamSearchSettings) -> Mask:
    """Whether points are near a row (n, 2) or its extension by up to two spacings.

    places (n,): of the row along the arm.
    """
    spacing = float(np.diff(places).min())
    beyond = row[-1] + (row[-1] - row[-2]) * 2.0 * spacing / (places[-1] - places[-2])
    row, places = np.vstack([row, beyond]), np.append(places, places[-1] + 2.0 * spacing)
    at = np.arange(places[0], places[-1], 0.25 * spacing)
    way = [np.interp(at, places, row[:, axis]) for axis in range(2)]
    away = np.hypot(points[:, :1] - way[0], points[:, 1:] - way[1]).min(axis=1)
    scale = np.median(np.hypot(*np.diff(row, axis=0).T) / np.diff(places))
    beside = search.farthest * (search.along_std + search.across_std)
    return np.asarray(away <= beside * scale * spacing)


def _grown_from_clamp(
    blobs: BlobColumns, arclength: Array, clamp_angle: float, search: BeamSearchSettings
) -> tuple[Indices, float]:
    """Return the best row that starts at the clamp (targets,), and its cost."""
    starts = np.zeros((1, LAST + 1))
    starts[0, [HEADING, SCALE, LAST]] = clamp_angle, 1.0, NOTHING
    starts[0, SIZE:LAST] = math.nan
    nothing = np.full((1, arclength.size), NOTHING)
    (chosen,), (cost,) = grow_rows(blobs, arclength, starts, nothing, False, search)
    return chosen, float(cost)


def rows_anywhere(
    points: Array,
    areas: Array,
    arclength: Array,
    settings: AssociationSettings = ASSOCIATION,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
    costs: Array | None = None,
) -> list[TargetRow]:
    """Find all rows whose place and scale are not known; both ends of a row must be seen.

    points (blobs, 2) in any coordinates that are true to shape; shapes: as in `row_from_clamp`;
    costs (blobs,): of each blob in a row, None if all are as good. A row that goes on beyond
    its ends with more blobs alike is none. The best reading of each row comes first, and of a
    crowd of rows the best ones; the same blobs may be read from either end.
    """
    if len(points) < arclength.size:
        return []
    blobs = _columns(points, areas, shapes, costs)
    chosen, costs = _grown_from_pairs(blobs, arclength, search)
    order = np.argsort(costs, kind='stable')
    rows: list[TargetRow] = []
    for place in order[np.isfinite(costs[order])].tolist():
        row = TargetRow(chosen[place], float(costs[place]))
        if not _is_whole(row, blobs, arclength, search):
            continue
        for reading in _readings(row, arclength):
            if not any(_same(reading, other, settings.alike) for other in rows):
                rows.append(reading)
        if len(rows) >= ENOUGH:
            break
    return rows


def _is_whole(
    row: TargetRow, blobs: BlobColumns, arclength: Array, search: BeamSearchSettings
) -> bool:
    """Whether a row includes both end targets and does not cross itself."""
    reverse = arclength[-1] - arclength[::-1]
    return not (
        np.unique(row.chosen[row.chosen >= 0]).size < row.seen
        or continues_beyond(blobs, arclength, row.chosen, row.cost, search)
        or continues_beyond(blobs, reverse, row.chosen[::-1], row.cost, search)
    )


def _grown_from_pairs(
    blobs: BlobColumns,
    arclength: Array,
    search: BeamSearchSettings,
    limits: Array | None = None,
) -> tuple[Indices, Array]:
    """Grow a row from every blob and each of its neighbors; rows (seeds, targets) and costs.

    Where only some blobs cost nothing, the second of a row is any of these. limits: as of
    `grow_rows`.
    """
    x, y, looks, costs = blobs
    targets = arclength.size
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(apart, math.inf)
    free, many = np.flatnonzero(costs == 0.0), min(search.neighbors, x.size - 1)
    if free.size < x.size:  # few of them are likely: no pair with one is too many
        neighbors = np.tile(free, (x.size, 1))
    else:
        neighbors = np.argpartition(apart, many - 1, axis=1)[:, :many]
    first, second = np.repeat(np.arange(x.size), neighbors.shape[1]), neighbors.ravel()
    distinct = (apart[first, second] > 0.0) & (first != second)
    first, second = first[distinct], second[distinct]
    starts = np.zeros((len(first), LAST + 1))
    starts[:, LAST], starts[:, X], starts[:, Y] = 1.0, x[second], y[second]
    starts[:, HEADING] = np.arctan2(y[second] - y[first], x[second] - x[first])
    starts[:, SCALE] = apart[first, second] / (arclength[1] - arclength[0])
    starts[:, COST] = costs[first] + costs[second]
    starts[:, SIZE:LAST] = 0.5 * (looks[:, first] + looks[:, second]).T
    rows = np.full((len(first), targets), NOTHING)
    rows[:, 0], rows[:, 1] = first, second
    return grow_rows(blobs, arclength, starts, rows, True, search, limits)


def near_rows_anywhere(
    points: Array,
    areas: Array,
    arclength: Array,
    known: Indices,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
    limit: float = math.inf,
) -> Indices:
    """Return the blobs near a row of known ones (indices), or near its extensions.

    Other arguments as in `rows_anywhere`; rows may go on beyond their ends, and the last target
    may be missing where no row shows it. limit: what the targets that are seen of a row may cost.
    """
    near = np.zeros(len(points), np.bool_)
    if len(known) < arclength.size - 1:
        return np.flatnonzero(near)
    limits = np.full(arclength.size, limit, np.float64)
    if _is_symmetric(arclength):  # one half of a row costs half as much at most, from its end
        limits[: arclength.size // 2] *= 0.5
    looks = None if shapes is None else shapes[known]
    blobs = _columns(points[known], areas[known], looks)
    chosen, costs = _grown_from_pairs(blobs, arclength, search, limits)
    rows, others = chosen[np.isfinite(costs)], np.arange(len(points))
    whole = rows[:, -1] >= 0
    if whole.any():
        rows = rows[whole]
    for seed in np.unique(np.sort(rows, axis=1), axis=0, return_index=True)[1].tolist():
        seen = np.flatnonzero(rows[seed] >= 0)
        row, places = points[known[rows[seed, seen]]], arclength[seen]
        for line, along in ((row, places), (row[::-1], arclength[-1] - places[::-1])):
            near[others] = _near_line(points[others], line, along, search)
            others = others[~near[others]]  # in noise there are a thousand rows
        if not others.size:
            break
    return np.flatnonzero(near)


def _readings(row: TargetRow, arclength: Array) -> tuple[TargetRow, ...]:
    """Return a row, and its reversal if its spacings are symmetric.

    It is grown by what its last blobs were like, and dots of different sizes may be found from one
    end alone.
    """
    if not _is_symmetric(arclength):
        return (row,)
    return row, TargetRow(np.ascontiguousarray(row.chosen[::-1]), row.cost)


def _is_symmetric(arclength: Array) -> bool:
    """Whether targets are spaced alike from either end."""
    steps = np.diff(arclength)
    return bool(np.allclose(steps, steps[::-1]))


def share_of_blobs(row: TargetRow, other: TargetRow) -> float:
    """Return the share of the blobs of a row that also belong to another."""
    mine = row.chosen[row.chosen >= 0]
    return float(np.isin(mine, other.chosen).mean()) if mine.size else 0.0


def _same(row: TargetRow, other: TargetRow, alike: float) -> bool:
    """Whether two rows are readings of the same blobs from the same end."""
    same = (row.chosen == other.chosen) & (row.chosen >= 0)
    if np.count_nonzero(same) >= alike * row.seen:
        return True
    # Read from the same end, but a target off.
    size = 1 + max(row.chosen.max(), other.chosen.max())
    forward = np.dot(_direction(row, size), _direction(other, size)) > 0.0
    return bool(forward and share_of_blobs(row, other) >= alike)


def _direction(row: TargetRow, size: int) -> Array:
    """Order of the blobs in a row as a direction, to separate its two readings."""
    ranks = np.zeros(size)
    seen = row.chosen[row.chosen >= 0]
    ranks[seen] = np.arange(seen.size) - 0.5 * (seen.size - 1)
    return ranks


def _columns(
    points: Array, areas: Array, shapes: Array | None, costs: Array | None = None
) -> BlobColumns:
    """Return x, y, looks and costs of blobs."""
    x, y = np.ascontiguousarray(points.T)
    looks = np.zeros((LOOKS, len(areas)))
    looks[0] = np.log(areas)
    if shapes is not None:
        looks[1:] = shapes.T
    return BlobColumns(x, y, looks, np.zeros(len(areas)) if costs is None else costs)
