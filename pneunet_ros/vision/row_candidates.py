"""Rows of targets among blobs, of unknown position and scale, with costs up to a limit.

In clutter, nearly every pair of neighbors begins a long row if only the total cost is limited. A
limit per target ends most of these rows after a step or two. The row of the arm is still found,
starting at the target from which its average cost stays below the limit.
"""

from __future__ import annotations

from collections.abc import Iterator
import functools
import math
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.beam_search import (
    ALONG_STD,
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
import scipy

Pairs = tuple[Indices, Indices]
NEIGHBORS = 24  # of a blob, including the next target: more than fit between two targets
PARTS = 8  # most groups of pairs that begin rows; a search may stop after each


class PlacedRow(NamedTuple):
    """Blobs in a row (indices), and their positions along the arm, relative to any origin."""

    chosen: Indices
    places: Array


class RowCandidates:
    """Rows of targets among blobs, found by a limit on the cost of their seen targets.

    points (blobs, 2) in any coordinates that preserve shapes; areas (blobs,) px^2; arclength
    (targets,) m; shapes (blobs, 3), as in `Blobs`, None if unknown; costs (blobs,): of each blob
    in a row, None if all are equal; most: largest number of examined parts of rows.
    """

    def __init__(
        self,
        points: Array,
        areas: Array,
        arclength: Array,
        search: BeamSearchSettings = BEAM_SEARCH,
        shapes: Array | None = None,
        costs: Array | None = None,
        most: int | None = None,
    ) -> None:
        self.points, self.arclength, self.search = points, arclength, search
        # The arm alone has some, at most one from each pair of its targets.
        self.most = max(len(points) if most is None else most, arclength.size**2)
        self._within = dict[float, list[PlacedRow] | None]()
        self._near = dict[tuple[bytes, ...], Indices]()
        self.blobs = blob_columns(points, areas, shapes, costs)
        steps = np.diff(arclength)
        self._even = bool(np.allclose(steps, steps[0]))
        steps_of_row = arclength.size - 2
        self._run = max(1, steps_of_row // 4)
        # The first of evenly spaced targets need not be known.
        self._firsts = range(1 if self._even else steps_of_row + 1 - self._run)

    @functools.cached_property
    def neighbors(self) -> Pairs:
        """Pairs of a blob and one of its neighbors, which may be the first two of a row.

        If only some blobs have no cost, the second blob of a row must be one of them.
        """
        x, y, _, costs = self.blobs
        free = np.flatnonzero(costs == 0.0)
        if free.size < x.size:  # few of them are likely, so all pairs with one are used
            neighbors = np.tile(free, (x.size, 1))
        else:
            tree = scipy.spatial.cKDTree(self.points)  # each blob is its own nearest neighbor
            neighbors = tree.query(self.points, range(1, min(NEIGHBORS + 1, x.size) + 1))[1]
        first, second = np.repeat(np.arange(x.size), neighbors.shape[1]), neighbors.ravel()
        distinct = (x[first] != x[second]) | (y[first] != y[second])
        return first[distinct], second[distinct]

    def near(self, others: Array, limit: float) -> Indices:
        """Return the indices of other points (n, 2) near rows within a limit, or their extensions.

        Returns all indices if nearly every blob begins a row.
        """
        rows = self.rows_within(limit)
        if rows is None:
            return np.arange(len(others))
        key = others.tobytes(), *(row.chosen.tobytes() for row in rows)
        if key not in self._near:
            self._near[key] = self._near_rows(others, rows)
        return self._near[key]

    def _near_rows(self, others: Array, rows: list[PlacedRow]) -> Indices:
        """Return the indices of other points (n, 2) near rows, or near their extensions."""
        near, left = np.zeros(len(others), np.bool_), np.arange(len(others))
        for chosen, places in rows:
            row = self.points[chosen]
            for line, along in ((row, places), (row[::-1], places[-1] - places[::-1])):
                near[left] = near_line(others[left], line, along, self.search)
                left = left[~near[left]]  # noise contains a thousand rows
            if not left.size:
                break
        return np.flatnonzero(near)

    def ends(self, limit: float) -> Pairs:
        """Return the pairs of blobs that may begin a row within a limit, from either end."""
        rows = self.rows_within(limit) if math.isfinite(limit) else None
        if rows is None:
            return self.neighbors
        pairs, spacing = set[tuple[int, int]](), float(np.diff(self.arclength).min())
        shortest = self.arclength[-2] - self.arclength[0] - 0.5 * spacing
        for chosen, places in rows:
            for row, along in ((chosen, places), (chosen[::-1], places[-1] - places[::-1])):
                # It may extend beyond the ends of the arm.
                firsts = along[-1] - along[:-1] >= shortest
                pairs.update(zip(row[:-1][firsts].tolist(), row[1:][firsts].tolist(), strict=True))
        first, second = np.array(sorted(pairs), np.int64).reshape(-1, 2).T
        return first, second

    def are_crowded(self, crowd: int, limit: float) -> bool:
        """Whether there are so many parts of rows that rows within a limit occur by chance.

        crowd: number of parts, none of which share a blob.
        """
        if len(self.points) < self.arclength.size - 1:
            return False
        parts, used = 0, set[int]()
        for _, rows, _ in self._stretches(limit):
            for row in rows:
                blobs = row[row >= 0].tolist()
                if used.isdisjoint(blobs):
                    used.update(blobs)
                    parts += 1
            if parts >= crowd:
                return True
        return False

    def rows_within(self, limit: float) -> list[PlacedRow] | None:
        """Find the rows within a limit; None if there are more than `most` parts.

        The rows may continue beyond their ends; if none shows all targets, the first or last one
        is missing.
        """
        if limit not in self._within:
            self._within[limit] = self._grown_from_stretches(limit)
        return self._within[limit]

    def _grown_from_stretches(self, limit: float) -> list[PlacedRow] | None:
        """Extend parts towards the beginning of the row; returns `rows_within`."""
        targets, arclength = self.arclength.size, self.arclength
        most = self.most * len(self._firsts)
        found = dict[bytes, tuple[int, PlacedRow]]()
        if len(self.points) < targets - 1:
            return []
        for first, rows, costs in self._stretches(limit):
            most -= len(rows)
            if most < 0:
                return None
            if not len(rows):
                continue
            behind = arclength if self._even else arclength[first + 1] - arclength[first + 1 :: -1]
            starts, others = starts_of(self.blobs, behind, (rows[:, 1], rows[:, 0]))
            starts[:, COST] = costs
            limits = np.full(behind.size, limit)
            others, _ = grow_rows(self.blobs, behind, starts, others, True, self.search, limits, 2)
            before, last = _last_seen(others) - 1, _last_seen(rows)
            for number in np.flatnonzero(before + last + 1 >= targets - 1).tolist():
                beginning = others[number, before[number] + 1 : 1 : -1]
                whole = np.append(beginning, rows[number, : last[number] + 1])
                seen = np.flatnonzero(whole >= 0)
                places = seen * (arclength[1] - arclength[0])
                if not self._even:
                    places = arclength[first - len(beginning) :][seen]
                found[whole.tobytes()] = len(whole), PlacedRow(whole[seen], places)
        complete = any(length >= targets for length, _ in found.values())
        return [row for length, row in found.values() if length >= targets or not complete]

    def _stretches(self, limit: float) -> Iterator[tuple[int, Indices, Array]]:
        """Yield the final parts of rows within a limit: first target, blobs and costs.

        Up to each of its targets, the cost of a stretch is at most `rate` per target; other blobs
        rarely achieve this for `run` targets. In each row, a stretch begins where the cost so far
        exceeds the rate by most. Because the whole row costs less than the rate by `rate * run` or
        more, at least `run` targets follow from there.
        """
        arclength, run = self.arclength, self._run
        steps = arclength.size - 2
        rate = limit / max(1, steps - run)
        parts = min(max(len(self.neighbors[0]) // self.most, 1), PARTS)
        for pairs in np.array_split(np.array(self.neighbors), parts, axis=1):
            for first in self._firsts:
                ahead = arclength[first:]
                limits = rate * np.maximum(np.arange(ahead.size) - 1.0, 1.0)
                rows, costs = grow_from_pairs(
                    self.blobs, ahead, (pairs[0], pairs[1]), self.search, limits, 2 + run
                )
                rows, costs = rows[np.isfinite(costs)], costs[np.isfinite(costs)]
                lost = 1 + _last_seen(rows) - np.count_nonzero(rows >= 0, axis=1)
                yield first, rows, costs - self.search.missing * lost


def grow_from_pairs(
    blobs: BlobColumns,
    arclength: Array,
    pairs: Pairs,
    search: BeamSearchSettings,
    limits: Array,
    least: int | None = None,
) -> tuple[Indices, Array]:
    """Grow a row from each pair of blobs; rows (pairs, targets) and costs, as `grow_rows`."""
    starts, rows = starts_of(blobs, arclength, pairs)
    return grow_rows(blobs, arclength, starts, rows, True, search, limits, least)


def starts_of(blobs: BlobColumns, arclength: Array, pairs: Pairs) -> tuple[Array, Indices]:
    """Return the initial states of rows that begin with pairs of blobs (pairs,), and the rows."""
    (x, y, looks, costs), (first, second) = blobs, pairs
    starts = np.zeros((len(first), LAST + 1))
    starts[:, LAST], starts[:, X], starts[:, Y] = 1.0, x[second], y[second]
    starts[:, HEADING] = np.arctan2(y[second] - y[first], x[second] - x[first])
    apart = np.hypot(x[first] - x[second], y[first] - y[second])
    starts[:, SCALE] = apart / (arclength[1] - arclength[0])
    starts[:, COST] = costs[first] + costs[second]
    starts[:, SIZE:LAST] = 0.5 * (looks[:, first] + looks[:, second]).T
    rows = np.full((len(first), arclength.size), NOTHING)
    rows[:, 0], rows[:, 1] = first, second
    return starts, rows


def near_line(points: Array, row: Array, places: Array, search: BeamSearchSettings) -> Mask:
    """Whether points are near a row (n, 2) or its extension by up to two spacings.

    places (n,): positions of the row along the arm.
    """
    spacing = float(np.diff(places).min())
    beyond = row[-1] + (row[-1] - row[-2]) * 2.0 * spacing / (places[-1] - places[-2])
    row, places = np.vstack([row, beyond]), np.append(places, places[-1] + 2.0 * spacing)
    at = np.arange(places[0], places[-1], 0.25 * spacing)
    way = [np.interp(at, places, row[:, axis]) for axis in range(2)]
    away = np.hypot(points[:, :1] - way[0], points[:, 1:] - way[1]).min(axis=1)
    scale = np.median(np.hypot(*np.diff(row, axis=0).T) / np.diff(places))
    tolerance = search.farthest * (ALONG_STD + search.across_std)
    return np.asarray(away <= tolerance * scale * spacing)


def blob_columns(
    points: Array, areas: Array, shapes: Array | None, costs: Array | None = None
) -> BlobColumns:
    """Return x, y, looks and costs of blobs."""
    x, y = np.ascontiguousarray(points.T)
    looks = np.zeros((LOOKS, len(areas)))
    looks[0] = np.log(areas)
    if shapes is not None:
        looks[1:] = shapes.T
    return BlobColumns(x, y, looks, np.zeros(len(areas)) if costs is None else costs)


def _last_seen(rows: Indices) -> Indices:
    """Return the last seen target of each row (rows, targets); every row must show a target."""
    return np.asarray(rows.shape[1] - 1 - np.argmax(rows[:, ::-1] >= 0, axis=1))
