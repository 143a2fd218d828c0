"""Blobs: areas of a camera image that can be targets, before they have an identity.

`areas` finds elliptical areas, and `centroid` measures each by fitting an ellipse to its edge.
Dark targets are detected as bright targets in the inverted image.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.vision.dots.areas import Appearance, OFF_BLOB, round_areas, RoundAreas, TWICE
from pneunet_ros.vision.dots.centroid import (
    ANGLE,
    AREA,
    BLUR,
    COLUMNS,
    CONTRAST,
    MAJOR,
    Mask,
    measure_outlines,
    MINOR,
    SEEN,
    STD,
    U,
    V,
)

# Largest number of measured blobs of an image, by contrast. No figure of acceptance/sweep.py moves
# when it is halved or doubled.
MOST_AREAS = 500


def _row(column: int, meaning: str) -> Any:
    return property(lambda blobs: blobs.table[column], doc=meaning)


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Areas of an image that can be targets; NaN in all quantities for a missing one.

    `table` (COLUMNS, n) has the quantities below as rows, and further ones named in `centroid`.
    """

    table: Array

    u = _row(U, 'Centers in the image, from left to right, px.')
    v = _row(V, 'Centers in the image, from top to bottom, px.')
    area = _row(AREA, 'Areas, px^2.')
    major = _row(MAJOR, 'Largest axes of the ellipses, px.')
    minor = _row(MINOR, 'Smallest axes of the ellipses, px.')
    angle = _row(ANGLE, 'Directions of the largest axes, rad from +u towards +v.')
    std = _row(STD, 'Standard errors of the centers per axis, the larger of both, px.')
    contrast = _row(CONTRAST, 'Brightness above the background, grey levels.')

    def __len__(self) -> int:
        return int(self.table.shape[1])

    @property
    def shapes(self) -> Array:
        """Logarithms of elongation, along and diagonal to u, and of the blur of edges, (n, 3)."""
        longer, twice = np.log(self.major / self.minor), 2.0 * self.angle
        columns = longer * np.cos(twice), longer * np.sin(twice), np.log(self.table[BLUR])
        return np.column_stack(columns)

    @property
    def centers(self) -> Array:
        """Centers in the image, (n, 2) px."""
        return self.table[[U, V]].T


def find_blobs(image: Image, appearance: Appearance) -> Blobs:
    """Return all blobs of an image within the limits, except those cut off by its border."""
    return measure_areas(image, find_areas(image, appearance), appearance)


def find_areas(image: Image, appearance: Appearance) -> RoundAreas:
    """Return candidate areas of an image, most salient first."""
    areas = image.once(('areas', appearance), lambda: round_areas(image.grey(), appearance))
    return areas.only(slice(MOST_AREAS))


def measure_areas(image: Image, areas: RoundAreas, appearance: Appearance) -> Blobs:
    """Return the blobs among areas of an image; each area is measured once."""
    known: dict[bytes, Array] = image.once(('measured', appearance), dict)
    starts = areas.starts(appearance)
    keys = [start.tobytes() for start in starts]
    new = [number for number, key in enumerate(keys) if key not in known]
    measured = _measured(image.grey(), starts[new], appearance)
    known.update(zip((keys[number] for number in new), measured, strict=True))
    rows = np.array([known[key] for key in keys]).reshape(-1, COLUMNS)
    return Blobs(freeze(_distinct(rows).T.copy()))


def nearest_blobs(
    image: Image, places: Array, reach: float, across: float, appearance: Appearance
) -> Array:
    """Return the blob nearest to each place (n, 2) px, rows (n, COLUMNS).

    NaN if no possible target has its center within `reach` px; across: its largest diameter, px.
    """
    nearest = np.full((len(places), COLUMNS), np.nan)
    grey = image.grey()
    half = math.ceil(reach + across) + 1
    possible = np.flatnonzero(
        (np.abs(places - 0.5 * np.array([image.width, image.height])) < 1e5).all(axis=1)
    )
    if not len(possible):
        return nearest
    corners = np.rint(places[possible]).astype(np.int64) - half
    side = 2 * half + 1
    # Pieces of the image one below the other, with a dark line between them.
    pieces = np.zeros((len(possible), side + 1, side), np.uint8)
    for piece, (left, top) in zip(pieces, corners.tolist(), strict=True):
        right, bottom = min(left + side, image.width), min(top + side, image.height)
        from_u, from_v = max(left, 0), max(top, 0)
        if from_u < right and from_v < bottom:
            piece[from_v - top : bottom - top, from_u - left : right - left] = grey[
                from_v:bottom, from_u:right
            ]
    areas = round_areas(pieces.reshape(-1, side), appearance)
    which, down = np.divmod(areas.centers[:, 1], side + 1.0)
    piece_of = which.astype(np.int64)
    centers: Array = np.column_stack([areas.centers[:, 0], down]) + corners[piece_of]
    away = np.hypot(*(centers - places[possible][piece_of]).T)
    near = away <= reach + OFF_BLOB * across
    clear = np.isin(np.arange(len(near)), areas.stand_out(appearance))
    areas = areas._replace(centers=centers)
    # Most blobs are found by their contrast; only the remaining ones cost more.
    for group in (np.flatnonzero(near & clear), np.flatnonzero(near & ~clear)):
        left = np.isnan(nearest[possible[piece_of[group]], U])
        some = group[left]
        rows = _measured(grey, areas.only(some).starts(appearance), appearance)
        for number in np.unique(piece_of[some]).tolist():
            place = possible[number]
            mine = _distinct(rows[piece_of[some] == number])
            distance = np.hypot(mine[:, U] - places[place, 0], mine[:, V] - places[place, 1])
            if len(mine) and distance.min() <= reach:
                nearest[place] = mine[distance.argmin()]
    return nearest


def blobs_at(image: Image, starts: Array, appearance: Appearance) -> Array:
    """Return the blobs with edges near `outlines`, rows (n, COLUMNS), NaN where there is none."""
    return _measured(image.grey(), starts, appearance)


def _measured(grey: Bytes, starts: Array, appearance: Appearance) -> Array:
    """Return rows (n, COLUMNS) of the blobs at outlines, NaN where there is none."""
    rows = measure_outlines(grey, starts, appearance.look, appearance.ellipse)
    rows[~(rows[:, SEEN] >= 0.5)] = np.nan
    return rows


def _distinct(rows: Array) -> Array:
    """Return the distinct blobs; of two blobs at one position, the more accurate is kept."""
    rows = rows[np.isfinite(rows[:, U])]
    rows = rows[np.argsort(rows[:, STD], kind='stable')]
    return np.asarray(rows[~np.tril(same_blobs(rows, rows), -1).any(axis=1)])


def same_blobs(rows: Array, others: Array) -> Mask:
    """Whether rows (n, COLUMNS) are at the positions of others (m, COLUMNS), (n, m)."""
    apart = np.hypot(*(rows[:, None, [U, V]] - others[None, :, [U, V]]).transpose(2, 0, 1))
    radius, other = (np.sqrt(table[:, AREA] / math.pi) for table in (rows, others))
    return np.asarray(apart < TWICE * np.maximum(radius[:, None], other))
