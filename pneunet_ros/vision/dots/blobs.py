"""Blobs: areas of a camera image that can be targets, before they have an identity.

Whatever the light, a target is brighter than what is just around it; dark targets are bright ones
of the inverted image. So the image is cut at many grey levels; what is as round as an ellipse at
some of them, and large enough, may be a blob. There `centroid` fits an ellipse to the edge, from
which all numbers come.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.camera.camera_settings import AdaptiveBand, AreaLimits, GreyBand
from pneunet_ros.vision.dots.centroid import (
    ANGLE,
    AREA,
    COLUMNS,
    CONTRAST,
    Integers,
    Look,
    MAJOR,
    measure_outlines,
    MINOR,
    outlines,
    SEEN,
    STD,
    U,
    V,
)
from pneunet_ros.vision.dots.ellipse_fit import ELLIPSE, EllipseSettings
import scipy


@dataclass(frozen=True, slots=True, kw_only=True)
class BlobSettings:
    """How areas are told from what is behind them."""

    most: int = tuning(500, 'areas of an image that are measured, those that stand out most')
    least_contrast: float = tuning(
        4.0, 'between a blob and its background where the band is fixed', unit='grey level'
    )
    levels: int = tuning(2, 'at which an area stands out that has the least contrast')
    speck: int = tuning(3, 'side of the square over which noise is averaged', unit='px')
    least_area: float = tuning(0.5, 'of an area where it is cut', unit='smallest area')
    largest_area: float = tuning(1.5, 'the same', unit='largest area')
    roundness: float = tuning(0.88, 'area over that of the ellipse with the same moments')
    longer: float = tuning(1.2, 'an area where it is cut, of the largest elongation')
    nested: float = tuning(0.35, 'between centers of one blob at two levels', unit='radius')
    growth: float = tuning(2.0, 'area of a blob from one level to the next, at most')
    blur: float = tuning(0.9, 'of an edge, expected', unit='px')
    blur_std: float = tuning(0.3, 'one sigma of that', unit='px')
    smear_std: float = tuning(1.0, 'of the way during an exposure, one sigma', unit='px')
    shape_std: float = tuning(0.3, 'one sigma of size and shape before a fit', unit='radius')
    seen: float = tuning(0.5, 'share of the edge that an ellipse must explain', source='measured')
    twice: float = tuning(0.8, 'between blobs that are one', unit='radius of the larger')
    astray: float = tuning(0.25, 'center of an area off that of its blob', unit='diameter')
    beyond: float = tuning(1.0, 'around a place, beyond its reach', unit='diameter')


BLOBS = BlobSettings()


def _row(column: int, meaning: str) -> Any:
    return property(lambda blobs: blobs.table[column], doc=meaning)


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Areas of an image that can be targets; NaN in all quantities where there is none.

    `table` (COLUMNS, n) has the quantities below as rows, and those that only `centroid` names.
    """

    table: Array

    u = _row(U, 'Centers in the image, from left to right, px.')
    v = _row(V, 'Centers in the image, from top to bottom, px.')
    area = _row(AREA, 'How large they are, px^2.')
    major = _row(MAJOR, 'Largest axis of the ellipse, px.')
    minor = _row(MINOR, 'Smallest axis of the ellipse, px.')
    angle = _row(ANGLE, 'Where the largest axis points, rad from +u towards +v.')
    std = _row(STD, 'Standard error of the center per axis, the larger of both, px.')
    contrast = _row(CONTRAST, 'How much brighter they are than the background, grey levels.')

    def __len__(self) -> int:
        return int(self.table.shape[1])

    @property
    def centers(self) -> Array:
        """Where they are in the image, (n, 2) px."""
        return self.table[[U, V]].T


@dataclass(frozen=True, slots=True, kw_only=True)
class Appearance:
    """What counts as a blob: the camera file's part, and how that is used."""

    band: GreyBand
    limits: AreaLimits
    blobs: BlobSettings = BLOBS
    ellipse: EllipseSettings = ELLIPSE

    @property
    def look(self) -> Look:
        """How bright and how large a blob is."""
        if isinstance(self.band, AdaptiveBand):
            return Look(limits=self.limits, brightest=math.inf, contrast=self.band.contrast)
        return Look(
            limits=self.limits, brightest=self.band.high, contrast=self.blobs.least_contrast
        )

    @property
    def levels(self) -> list[int]:
        """Grey levels at which the image is cut, from the highest down."""
        if not isinstance(self.band, AdaptiveBand):
            return [math.ceil(self.band.low)]
        step = max(1, math.floor(self.band.contrast / self.blobs.levels))
        return list(range(255 - step, 0, -step))


def find_blobs(image: Image, appearance: Appearance) -> Blobs:
    """Return all blobs of an image that are within the limits, but for those it cuts off."""
    return measure_areas(image, find_areas(image, appearance), appearance)


def find_areas(image: Image, appearance: Appearance) -> RoundAreas:
    """Return the areas of an image that may be blobs, those that stand out most first."""
    return round_areas(image.grey(), appearance).only(slice(appearance.blobs.most))


def measure_areas(image: Image, areas: RoundAreas, appearance: Appearance) -> Blobs:
    """Return the blobs among areas of an image."""
    rows = _measured(image.grey(), areas.starts(appearance), appearance)
    return Blobs(freeze(_distinct(rows, appearance.blobs).T.copy()))


def nearest_blobs(
    image: Image, places: Array, reach: float, across: float, appearance: Appearance
) -> Array:
    """Return the blob nearest to each place (n, 2) px, rows (n, COLUMNS).

    NaN where no blob that can be a target has its center within `reach` px; across: diameter (px)
    that it may have.
    """
    nearest = np.full((len(places), COLUMNS), np.nan)
    grey = image.grey()
    half = math.ceil(reach + appearance.blobs.beyond * across) + 1
    asked = np.flatnonzero(
        (np.abs(places - 0.5 * np.array([image.width, image.height])) < 1e5).all(axis=1)
    )
    if not len(asked):
        return nearest
    corners = np.rint(places[asked]).astype(np.int64) - half
    side = 2 * half + 1
    # Pieces of the image one below the other, with a dark line between them.
    pieces = np.zeros((len(asked), side + 1, side), np.uint8)
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
    away = np.hypot(*(centers - places[asked][piece_of]).T)
    near = np.flatnonzero(away <= reach + appearance.blobs.astray * across)
    starts = areas._replace(centers=centers).only(near).starts(appearance)
    rows, piece_of = _measured(grey, starts, appearance), piece_of[near]
    for number, place in enumerate(asked.tolist()):
        mine = _distinct(rows[piece_of == number], appearance.blobs)
        distance = np.hypot(mine[:, U] - places[place, 0], mine[:, V] - places[place, 1])
        if len(mine) and distance.min() <= reach:
            nearest[place] = mine[distance.argmin()]
    return nearest


def blobs_at(image: Image, starts: Array, appearance: Appearance) -> Array:
    """Return the blobs whose edges are near `outlines`, rows (n, COLUMNS), NaN where none is."""
    return _measured(image.grey(), starts, appearance)


def _measured(grey: Bytes, starts: Array, appearance: Appearance) -> Array:
    """Return rows (n, COLUMNS) of the blobs at outlines, NaN where there is none."""
    rows = measure_outlines(grey, starts, appearance.look, appearance.ellipse)
    rows[~(rows[:, SEEN] >= appearance.blobs.seen)] = np.nan
    return rows


def _distinct(rows: Array, settings: BlobSettings) -> Array:
    """Return the rows that are blobs, each once: of two in one place the more exact one."""
    rows = rows[np.isfinite(rows[:, U])]
    rows = rows[np.argsort(rows[:, STD], kind='stable')]
    apart = np.hypot(*(rows[:, None, [U, V]] - rows[None, :, [U, V]]).transpose(2, 0, 1))
    radius = np.sqrt(rows[:, AREA] / math.pi)
    same = apart < settings.twice * np.maximum(radius[:, None], radius)
    return np.asarray(rows[~np.tril(same, -1).any(axis=1)])


class RoundAreas(NamedTuple):
    """Areas that are as round as ellipses at some grey levels; at most levels first.

    centers (n, 2) px; moments (n, 3) px^2: uu, uv, vv about them.
    """

    centers: Array
    moments: Array

    @property
    def areas(self) -> Array:
        """How large they are, (n,) px^2."""
        uu, uv, vv = self.moments.T
        return np.asarray(4.0 * math.pi * np.sqrt(uu * vv - uv * uv))

    def only(self, which: Integers | slice) -> RoundAreas:
        """Return some of them."""
        return RoundAreas(self.centers[which], self.moments[which])

    def starts(self, appearance: Appearance) -> Array:
        """Return where fits of their edges begin."""
        uu, uv, vv = self.moments.T
        root = np.sqrt(uu * vv - uv * uv)
        scale = 2.0 / np.sqrt(uu + vv + 2.0 * root)
        axes = np.column_stack([uu + root, uv, vv + root]) * scale[:, None]
        blobs, one = appearance.blobs, np.ones(len(uu))
        stds = (blobs.shape_std * one, blobs.blur_std, blobs.smear_std * one)
        return outlines(self.centers, axes, blobs.blur * one, np.zeros((len(uu), 2)), stds)


def round_areas(grey: Bytes, appearance: Appearance) -> RoundAreas:
    """Find what is as round as an ellipse and brighter than what is around it.

    An area is as it is at the middle one of the grey levels at which it is there.
    """
    settings = appearance.blobs
    soft = np.asarray(cv2.blur(grey, (settings.speck, settings.speck)), np.uint8)
    highest = int(soft.max(initial=0))
    found: list[Array] = []
    chains: list[Integers] = []
    above, chain_above, chain_count = np.empty((0, 6)), np.empty(0, np.int64), 0
    for level in appearance.levels:
        if level > highest:
            continue
        areas = _cut_at(soft, level, appearance)
        chain = _continued(areas, above, chain_above, settings)
        new = chain < 0
        chain[new] = chain_count + np.arange(np.count_nonzero(new))
        chain_count += int(np.count_nonzero(new))
        found.append(areas)
        chains.append(chain)
        above, chain_above = areas, chain
    if not chain_count:
        return RoundAreas(np.empty((0, 2)), np.empty((0, 3)))
    table, chain = np.concatenate(found), np.concatenate(chains)
    order = np.argsort(chain, kind='stable')
    length = np.bincount(chain)
    middle = order[np.cumsum(length) - length + length // 2]
    chosen = middle[np.argsort(-length, kind='stable')]
    return RoundAreas(table[chosen, 1:3], table[chosen, 3:])


def _cut_at(grey: Bytes, level: int, appearance: Appearance) -> Array:
    """Return the round areas at a level or brighter, (n, 6): area, center u, v, uu, uv, vv."""
    settings, limits = appearance.blobs, appearance.limits
    _, white = cv2.threshold(grey, level - 1, 255, cv2.THRESH_BINARY)
    contours, _ = cv2.findContours(white, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # As long as an ellipse of the largest area can be around, at most.
    longest = 8.0 * math.sqrt(settings.largest_area * limits.largest * limits.elongation)
    shortest = 2.0 * math.sqrt(settings.least_area * limits.smallest)
    usable = [contour for contour in contours if shortest <= len(contour) <= longest]
    if not usable:
        return np.empty((0, 6))
    table = _polygon_moments(usable)
    area, uu, uv, vv = table[:, [0, 3, 4, 5]].T
    with np.errstate(invalid='ignore', divide='ignore'):
        root = np.sqrt(uu * vv - uv * uv)
        round_enough = area >= settings.roundness * 4.0 * math.pi * root
        ratio = (uu + vv) / (2.0 * root)
    most = settings.longer * limits.elongation
    possible = (
        (area >= settings.least_area * limits.smallest)
        & (area <= settings.largest_area * limits.largest)
        & round_enough
        & (ratio <= 0.5 * (most + 1.0 / most))
    )
    found: Array = table[possible]
    holes = table[area < -limits.hole]
    if len(found) and len(holes):
        apart, nearest = scipy.spatial.cKDTree(found[:, 1:3]).query(holes[:, 1:3])
        around = found[nearest, 0]
        within = (apart < np.sqrt(around / math.pi)) & (-holes[:, 0] < around)
        found = np.delete(found, nearest[within], axis=0)
    return found


def _polygon_moments(contours: list[Any]) -> Array:
    """Return area, center u, v and moments uu, uv, vv of the pixels within contours, (n, 6).

    Those of holes have negative areas.
    """
    sizes = np.array([len(contour) for contour in contours])
    first = np.cumsum(sizes) - sizes
    points = np.concatenate(contours)[:, 0].astype(np.float64)
    x, y = (points - np.repeat(points[first], sizes, axis=0)).T
    after = np.arange(len(points)) + 1
    after[first + sizes - 1] = first
    x2, y2 = x[after], y[after]
    cross = x2 * y - x * y2  # contours of areas turn from +v to +u
    terms = np.column_stack([
        cross, cross * (x + x2), cross * (y + y2), cross * (x * x + x * x2 + x2 * x2),
        cross * (2.0 * (x * y + x2 * y2) + x * y2 + x2 * y), cross * (y * y + y * y2 + y2 * y2),
        np.hypot(x2 - x, y2 - y),
    ])  # fmt: skip
    sums = np.add.reduceat(terms, first)
    area = 0.5 * sums[:, 0]
    # The contour leads through the middle of pixels: half a pixel is outside of it.
    outer = 0.5 * sums[:, 6] + 1.0
    with np.errstate(invalid='ignore', divide='ignore'):
        center = sums[:, 1:3] / (6.0 * area[:, None])
        square = sums[:, 3:6] / (np.array([12.0, 24.0, 12.0]) * area[:, None])
        square -= center[:, [0, 0, 1]] * center[:, [0, 1, 1]]
        square *= ((area + outer) / area)[:, None]
    whole = np.where(area > 0.0, area + outer, area + outer - 2.0)
    return np.column_stack([whole, center + points[first], square])


def _continued(areas: Array, above: Array, chain: Integers, settings: BlobSettings) -> Integers:
    """Return of which chain areas are a further part, -1 of none.

    above: the areas one level higher, of these chains.
    """
    if not len(areas) or not len(above):
        return np.full(len(areas), -1)
    apart, nearest = scipy.spatial.cKDTree(above[:, 1:3]).query(areas[:, 1:3])
    reach = settings.nested * np.sqrt(areas[:, 0] / math.pi) + 0.5
    there = (apart <= reach) & (areas[:, 0] <= settings.growth * above[nearest, 0])
    return np.where(there, chain[nearest], -1)
