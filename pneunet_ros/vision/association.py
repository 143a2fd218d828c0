"""The row of targets among bright areas of a single image: which area is which target.

A row is grown target by target from the clamp: the next one is expected where an arc through the
last ones leads, at the known spacing. The few best rows so far are kept at each step, so that a
glint beside the arm does not lead astray, and a target may be missing where nothing fits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.beam_search import (
    cut,
    goes_on,
    grow,
    HEADING,
    Indices,
    LAST,
    LONGEST_GAP,
    NOTHING,
    SCALE,
    seeded,
    SIZE,
)

MOST_AREAS = 400  # bright areas among which a row is looked for
LEAST_SHARE = 0.4  # of the targets must be seen for a row to be one
LEAST_TARGETS = 4  # and no fewer than these
ALIKE = 0.5  # share of areas that two readings of one row have in common, or more


class Row(NamedTuple):
    """Index of the area that each target is (targets,), -1 where it is missing, and the cost."""

    chosen: Indices
    cost: float

    @property
    def seen(self) -> int:
        """How many targets are seen."""
        return int(np.count_nonzero(self.chosen >= 0))


def least_seen(targets: int) -> int:
    """Return how many of so many targets must be seen for a row to be one."""
    return min(targets, max(LEAST_TARGETS, math.ceil(LEAST_SHARE * targets)))


def row_from_clamp(points: Array, areas: Array, arclength: Array, clamp_angle: float) -> Row:
    """Find the row that starts at the clamp; points (areas, 2) m in the base frame.

    areas (areas,) sizes to compare; arclength (targets,) m. A row that goes on beyond the last
    target is none.
    """
    x, y, sizes = _columns(points, areas)
    start = np.zeros(LAST + 1)
    start[HEADING], start[SCALE], start[SIZE], start[LAST] = clamp_angle, 1.0, math.nan, NOTHING
    chosen = np.full(arclength.size, NOTHING)
    cost = grow(x, y, sizes, arclength, start, LONGEST_GAP, math.inf, chosen)
    cut(x, y, arclength, clamp_angle, chosen)
    if chosen[-1] >= 0 and goes_on(x, y, sizes, arclength, chosen):
        chosen[:] = NOTHING  # the camera has moved, or these are other dots
    return Row(chosen, cost)


def rows_anywhere(points: Array, areas: Array, arclength: Array) -> list[Row]:
    """Find all rows whose place and scale are not known; both ends of a row must be seen.

    points (areas, 2) in any coordinates that are true to shape. A row that goes on beyond its ends
    with more areas alike is none. The best reading of each row comes first; the same areas may be
    read from either end.
    """
    x, y, sizes = _columns(points, areas)
    targets = arclength.size
    if x.size < targets:
        return []
    chosen, costs = seeded(x, y, sizes, arclength)
    order = np.argsort(costs, kind='stable')
    rows: list[Row] = []
    for place in order[np.isfinite(costs[order])].tolist():
        row = Row(chosen[place], float(costs[place]))
        if not any(_same(row, other) for other in rows):
            rows.append(row)
    return rows


def share_of_areas(row: Row, other: Row) -> float:
    """Return which share of the areas of a row belong to another one as well."""
    mine = row.chosen[row.chosen >= 0]
    return float(np.isin(mine, other.chosen).mean()) if mine.size else 0.0


def _same(row: Row, other: Row) -> bool:
    """Whether two rows are readings of the same areas from the same end."""
    same = (row.chosen == other.chosen) & (row.chosen >= 0)
    if np.count_nonzero(same) >= ALIKE * row.seen:
        return True
    # Read from the same end, but a target off.
    forward = np.dot(_direction(row), _direction(other)) > 0.0
    return bool(forward and share_of_areas(row, other) >= ALIKE)


def _direction(row: Row) -> Array:
    """Order of the areas in a row as a direction, to tell its two readings apart."""
    ranks = np.zeros(MOST_AREAS)
    seen = row.chosen[row.chosen >= 0]
    ranks[seen] = np.arange(seen.size) - 0.5 * (seen.size - 1)
    return ranks


def _columns(points: Array, areas: Array) -> tuple[Array, Array, Array]:
    """Return x, y and logarithmic size of areas, contiguous."""
    x, y = np.ascontiguousarray(points.T)
    return x, y, np.log(areas)
