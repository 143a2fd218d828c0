"""Association: assign the blobs of a single image to the targets of the row.

A row is grown target by target from the clamp: the next target is expected on the arc through the
last targets, at the known spacing. Beam search: the few best rows are kept at each step, so that a
glint next to the arm does no harm. A target may be missing if no blob fits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.beam_search import (
    BEAM_SEARCH,
    BeamSearchSettings,
    BlobColumns,
    grow_rows,
    HEADING,
    Indices,
    LAST,
    NOTHING,
    SCALE,
    SIZE,
)
from pneunet_ros.vision.row_candidates import (
    blob_columns,
    grow_from_pairs,
    near_line,
    RowCandidates,
)
from pneunet_ros.vision.row_ends import continues_beyond, truncate_row

LEAST_TARGETS = 3  # of an arm: fewer cannot be distinguished from glints
LEAST_FOLLOWED = 4  # fewest visible targets of a row; all targets of an arm with fewer
COMMON_SHARE = 0.5  # share of common blobs from which two rows count as the same
ENOUGH = 64  # largest number of compared rows: further similar rows add nothing


class TargetRow(NamedTuple):
    """Blob index of each target (targets,), -1 for a missing one, and the cost of the row."""

    chosen: Indices
    cost: float

    @property
    def seen(self) -> int:
        """Number of targets seen."""
        return int(np.count_nonzero(self.chosen >= 0))


def least_seen(targets: int, search: BeamSearchSettings = BEAM_SEARCH) -> int:
    """Return the number of targets that must be seen for a row."""
    return min(targets, max(LEAST_FOLLOWED, math.ceil(search.least_share * targets)))


def row_from_clamp(
    points: Array,
    areas: Array,
    arclength: Array,
    clamp_angle: float,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
) -> TargetRow:
    """Find the row that starts at the clamp; points (blobs, 2) m in the base frame.

    areas (blobs,) px^2; arclength (targets,) m; shapes (blobs, 3), as in `Blobs`, None if unknown.
    A row that continues beyond the last target is rejected.
    """
    blobs = blob_columns(points, areas, shapes)
    chosen, cost = _grown_from_clamp(blobs, arclength, clamp_angle, search)
    truncate_row(blobs.x, blobs.y, arclength, clamp_angle, chosen, search)
    if chosen[-1] >= 0 and continues_beyond(blobs, arclength, chosen, search):
        chosen[:] = NOTHING  # the camera has moved, or these dots are others
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

    Arguments as in `row_from_clamp`; returns all blobs if there is no row.
    """
    blobs = blob_columns(points, areas, shapes)
    chosen = _grown_from_clamp(blobs, arclength, clamp_angle, search)[0]
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < least_seen(arclength.size, search):
        return np.arange(len(points))
    return np.flatnonzero(near_line(points, points[chosen[seen]], arclength[seen], search))


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


def find_unplaced_rows(
    points: Array,
    areas: Array,
    arclength: Array,
    search: BeamSearchSettings = BEAM_SEARCH,
    shapes: Array | None = None,
    costs: Array | None = None,
    limit: float = math.inf,
) -> list[TargetRow]:
    """Find all rows of unknown position and scale; both ends of a row must be seen.

    points (blobs, 2) in any coordinates that preserve shapes; shapes: as in `row_from_clamp`;
    costs (blobs,): of each blob in a row, None if all are equal; limit: largest cost of the seen
    targets of a row. A row that continues beyond its ends with more similar blobs is rejected.
    Rows are sorted by cost, and only the best are returned. The same blobs may be read from either
    end.
    """
    if len(points) < arclength.size:
        return []
    candidates = RowCandidates(points, areas, arclength, search, shapes, costs)
    blobs, limits = candidates.blobs, np.full(arclength.size, limit)
    chosen, costs = grow_from_pairs(blobs, arclength, candidates.ends(limit), search, limits)
    order = np.argsort(costs, kind='stable')
    rows = Readings(len(points))
    for place in order[np.isfinite(costs[order])].tolist():
        row = TargetRow(chosen[place], float(costs[place]))
        readings = _readings(row, arclength)
        if all(map(rows.have, readings)) or not _is_whole(row, blobs, arclength, search):
            continue
        for reading in readings:
            if not rows.have(reading):
                rows.add(reading)
        if len(rows.rows) >= ENOUGH:
            break
    return rows.rows


def _is_whole(
    row: TargetRow, blobs: BlobColumns, arclength: Array, search: BeamSearchSettings
) -> bool:
    """Whether a row includes both end targets and does not cross itself."""
    reverse = arclength[-1] - arclength[::-1]
    return not (
        np.unique(row.chosen[row.chosen >= 0]).size < row.seen
        or continues_beyond(blobs, arclength, row.chosen, search)
        or continues_beyond(blobs, reverse, row.chosen[::-1], search)
    )


def _readings(row: TargetRow, arclength: Array) -> tuple[TargetRow, ...]:
    """Return a row, and its reversal if its spacings are symmetric.

    A row is grown by similarity to its last blobs, so that dots of different sizes may be found
    from one end only.
    """
    if not _is_symmetric(arclength):
        return (row,)
    return row, TargetRow(np.ascontiguousarray(row.chosen[::-1]), row.cost)


def _is_symmetric(arclength: Array) -> bool:
    """Whether the spacing of targets is the same from either end."""
    steps = np.diff(arclength)
    return bool(np.allclose(steps, steps[::-1]))


def share_of_blobs(row: TargetRow, other: TargetRow) -> float:
    """Return the fraction of the blobs of a row that also belong to another row."""
    mine = row.chosen[row.chosen >= 0]
    return float(np.isin(mine, other.chosen).mean()) if mine.size else 0.0


class Readings:
    """Distinct rows found so far; the same blobs read from either end are two rows."""

    def __init__(self, blobs: int) -> None:
        self.rows: list[TargetRow] = []
        self._ranks = np.zeros((ENOUGH + 1, blobs))  # of the blobs of each row, from its middle on
        self._belong = np.zeros((ENOUGH + 1, blobs), np.bool_)
        self._chosen: Array = np.empty((0, 0))

    def add(self, row: TargetRow) -> None:
        """Add a row unless it is already known."""
        seen, ranks = _ranks(row)
        self._ranks[len(self.rows), seen] = ranks
        self._belong[len(self.rows), seen] = True
        self.rows.append(row)
        self._chosen = np.array([one.chosen for one in self.rows])

    def have(self, row: TargetRow) -> bool:
        """Whether a row is already known, read from the same end."""
        count = len(self.rows)
        if not count:
            return False
        same = np.count_nonzero((self._chosen == row.chosen) & (row.chosen >= 0), axis=1)
        if (same >= COMMON_SHARE * row.seen).any():
            return True
        # The same end first, but shifted by one target.
        seen, ranks = _ranks(row)
        forward = self._ranks[:count, seen] @ ranks > 0.0
        share = self._belong[:count, seen].mean(axis=1)
        return bool((forward & (share >= COMMON_SHARE)).any())


def _ranks(row: TargetRow) -> tuple[Indices, Array]:
    """Return the blobs of a row in order, and their ranks relative to its middle."""
    seen = row.chosen[row.chosen >= 0]
    return seen, np.arange(seen.size, dtype=np.float64) - 0.5 * (seen.size - 1)
