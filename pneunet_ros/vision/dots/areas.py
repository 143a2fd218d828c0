"""Round areas of an image, bright or dark: candidates for dots before their edges are fitted.

In any light, a bright target is brighter than its immediate surroundings, and a dark target is
darker. The image is therefore thresholded at many grey levels; areas that are large enough and
elliptical at some of the levels may be dots.
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import math
from typing import NamedTuple

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.camera.camera_settings import AdaptiveBand, AreaLimits, GreyBand
from pneunet_ros.vision.dots.centroid import Integers, Look, outlines
from pneunet_ros.vision.dots.contour_kernel import fill_moments
from pneunet_ros.vision.dots.ellipse_fit import ELLIPSE, EllipseSettings
import scipy


@dataclass(frozen=True, slots=True, kw_only=True)
class BlobSettings:
    """Criteria that separate areas from the background."""

    levels: int = tuning(
        2, 'number of thresholds at which an area of the least contrast is visible', source='sweep'
    )
    speck: int = tuning(
        3, 'side of the square over which noise is averaged', unit='px', source='sweep'
    )
    growth: float = tuning(
        2.0, 'largest growth of the area of a blob from one level to the next', source='sweep'
    )
    blur: float = tuning(0.9, 'expected blur of an edge', unit='px', source='sweep')
    smear_std: float = tuning(
        1.0, 'std of the motion during an exposure', unit='px', source='sweep'
    )
    shape_std: float = tuning(
        0.3,
        'one sigma of size, shape, blur and predicted motion before a fit',
        unit='radius, blur, way',
        source='sweep',
    )

    @property
    def blur_std(self) -> float:
        """One sigma of the blur of an edge, px."""
        return self.shape_std * self.blur


BLOBS = BlobSettings()
# Tolerances of a thresholded area relative to the limits of blobs, which apply to its edge: for
# the smallest and largest area, and for the elongation; and distance of its center from that of
# the blob, diameters.
LEAST_AREA, LARGEST_AREA, LONGER, OFF_BLOB = 0.5, 1.5, 1.2, 0.25
ROUNDNESS = 0.88  # area over that of the ellipse with the same moments; a square has 0.95
NESTED = 0.35  # radii between the centers of one blob at two levels
TWICE = 0.8  # radii of the larger between blobs that are one
LEAST_CONTRAST = 4.0  # grey levels, of a blob to its background, for a fixed band
SATURATED = 255  # the highest grey level


@dataclass(frozen=True, slots=True, kw_only=True)
class Appearance:
    """Criteria for blobs from the camera file, and their application."""

    band: GreyBand
    limits: AreaLimits
    blobs: BlobSettings = BLOBS
    ellipse: EllipseSettings = ELLIPSE

    @property
    def look(self) -> Look:
        """Brightness and size of a blob."""
        if isinstance(self.band, AdaptiveBand):
            return Look(limits=self.limits, brightest=math.inf, contrast=self.band.contrast)
        # A plateau fitted to saturated pixels is about 255.
        brightest = self.band.high if self.band.high < SATURATED else math.inf
        return Look(limits=self.limits, brightest=brightest, contrast=LEAST_CONTRAST)

    @property
    def levels(self) -> list[int]:
        """Grey levels of the thresholds, from the highest down."""
        if not isinstance(self.band, AdaptiveBand):
            return [math.ceil(self.band.low)]
        step = max(1, math.floor(self.band.contrast / self.blobs.levels))
        return list(range(255 - step, 0, -step))


class RoundAreas(NamedTuple):
    """Areas that are elliptical at some grey levels, sorted by the number of levels, descending.

    centers (n, 2) px; moments (n, 3) px^2: uu, uv, vv about them; levels (n,): number of levels.
    """

    centers: Array
    moments: Array
    levels: Integers

    @property
    def areas(self) -> Array:
        """Their areas, (n,) px^2."""
        uu, uv, vv = self.moments.T
        return np.asarray(4.0 * math.pi * np.sqrt(uu * vv - uv * uv))

    @property
    def shapes(self) -> Array:
        """Logarithms of elongation, as in `Blobs`, (n, 3); 0 for the unknown blur."""
        uu, uv, vv = self.moments.T
        spread = np.hypot(uu - vv, 2.0 * uv)
        longer = 0.5 * np.log((uu + vv + spread) / np.maximum(uu + vv - spread, 1e-9))
        share = longer / np.maximum(spread, 1e-9)
        return np.column_stack([(uu - vv) * share, 2.0 * uv * share, np.zeros(len(uu))])

    def only(self, which: Integers | slice) -> RoundAreas:
        """Return a subset of the areas."""
        return RoundAreas(self.centers[which], self.moments[which], self.levels[which])

    def stand_out(self, appearance: Appearance) -> Integers:
        """Return the areas that exist at enough levels for the least contrast."""
        least = min(appearance.blobs.levels, len(appearance.levels))
        return np.flatnonzero(self.levels >= least)

    def starts(self, appearance: Appearance) -> Array:
        """Return the initial guesses of the edge fits."""
        uu, uv, vv = self.moments.T
        root = np.sqrt(uu * vv - uv * uv)
        scale = 2.0 / np.sqrt(uu + vv + 2.0 * root)
        axes = np.column_stack([uu + root, uv, vv + root]) * scale[:, None]
        blobs, one = appearance.blobs, np.ones(len(uu))
        stds = (blobs.shape_std * one, blobs.blur_std, blobs.smear_std * one)
        return outlines(self.centers, axes, blobs.blur * one, np.zeros((len(uu), 2)), stds)


def round_areas(grey: Bytes, appearance: Appearance) -> RoundAreas:
    """Find elliptical areas brighter than their surroundings.

    An area is measured at the middle of the grey levels at which it exists.
    """
    return _joined(_cuts(grey, appearance), appearance)


def bright_and_dark_areas(
    grey: Bytes, appearance: Appearance
) -> tuple[RoundAreas, RoundAreas] | None:
    """Find elliptical areas brighter or darker than their surroundings.

    None if the band is not adaptive, because then both kinds have different grey levels.
    """
    if not isinstance(appearance.band, AdaptiveBand):
        return None
    cuts = _cuts(grey, appearance)
    # A dark area is a hole at the levels above its own; it grows with the level.
    dark = [table * np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]) for table in cuts[::-1]]
    return _joined(cuts, appearance), _joined(dark, appearance)


def _cuts(grey: Bytes, appearance: Appearance) -> list[Array]:
    """Threshold an image at all levels, from the highest down, as in `_cut_at`."""
    settings = appearance.blobs
    soft = np.asarray(cv2.blur(grey, (settings.speck, settings.speck)), np.uint8)
    highest, lowest = int(soft.max(initial=0)), int(soft.min(initial=255))
    levels = [level for level in appearance.levels if lowest < level <= highest]
    return [_cut_at(soft, level, appearance) for level in levels]


def _cut_at(grey: Bytes, level: int, appearance: Appearance) -> Array:
    """Return the areas at a level or brighter, (n, 6): area, center u, v, moments uu, uv, vv.

    The areas may be dots or contain dots; areas of holes are negative.
    """
    limits = appearance.limits
    _, white = cv2.threshold(grey, level - 1, 255, cv2.THRESH_BINARY)
    contours, _ = cv2.findContours(white, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    # At most the circumference of an ellipse with the largest area.
    longest = 8.0 * math.sqrt(LARGEST_AREA * limits.largest * limits.elongation)
    shortest = 2.0 * math.sqrt(LEAST_AREA * limits.smallest)
    corners = np.fromiter(map(len, contours), np.int64, len(contours))
    usable = corners <= longest
    if not usable.any():
        return np.empty((0, 6))
    points = np.concatenate(list(itertools.compress(contours, usable.tolist())))
    sizes = corners[usable]
    table, length = np.empty((sizes.size, 6)), np.empty(sizes.size)
    fill_moments(points[:, 0], sizes, table, length)
    return table[(length >= shortest) & (length <= longest)]


def _joined(cuts: list[Array], appearance: Appearance) -> RoundAreas:
    """Return the round areas of nested cuts, each of which contains the previous cut."""
    settings = appearance.blobs
    found: list[Array] = []
    chains: list[Integers] = []
    above, chain_above, chain_count = np.empty((0, 6)), np.empty(0, np.int64), 0
    for table in cuts:
        areas = _round_ones(table, appearance)
        chain = _continued(areas, above, chain_above, settings)
        new = chain < 0
        chain[new] = chain_count + np.arange(np.count_nonzero(new))
        chain_count += int(np.count_nonzero(new))
        found.append(areas)
        chains.append(chain)
        above, chain_above = areas, chain
    if not chain_count:
        return RoundAreas(np.empty((0, 2)), np.empty((0, 3)), np.empty(0, np.int64))
    table, chain = np.concatenate(found), np.concatenate(chains)
    order = np.argsort(chain, kind='stable')
    length = np.bincount(chain)
    middle = order[np.cumsum(length) - length + length // 2]
    most_first = np.argsort(-length, kind='stable')
    chosen = middle[most_first]
    return RoundAreas(table[chosen, 1:3], table[chosen, 3:], length[most_first])


def _round_ones(table: Array, appearance: Appearance) -> Array:
    """Return the areas (n, 6) of a cut that are elliptical and have no large hole."""
    limits = appearance.limits
    area, uu, uv, vv = table[:, [0, 3, 4, 5]].T
    with np.errstate(invalid='ignore', divide='ignore'):
        root = np.sqrt(uu * vv - uv * uv)
        round_enough = area >= ROUNDNESS * 4.0 * math.pi * root
        ratio = (uu + vv) / (2.0 * root)
    most = LONGER * limits.elongation
    possible = (
        (area >= LEAST_AREA * limits.smallest)
        & (area <= LARGEST_AREA * limits.largest)
        & round_enough
        & (ratio <= 0.5 * (most + 1.0 / most))
    )
    found: Array = table[possible]
    holes = table[(area < -limits.hole) & np.isfinite(uu)]  # a hairline has no inside
    if len(found) and len(holes):
        apart, nearest = scipy.spatial.cKDTree(found[:, 1:3]).query(holes[:, 1:3])
        around = found[nearest, 0]
        within = (apart < np.sqrt(around / math.pi)) & (-holes[:, 0] < around)
        found = np.delete(found, nearest[within], axis=0)
    return found


def _continued(areas: Array, above: Array, chain: Integers, settings: BlobSettings) -> Integers:
    """Return the chain that each area continues, -1 for none.

    above: the areas one level higher, of these chains.
    """
    if not len(areas) or not len(above):
        return np.full(len(areas), -1)
    apart, nearest = scipy.spatial.cKDTree(above[:, 1:3]).query(areas[:, 1:3])
    reach = NESTED * np.sqrt(areas[:, 0] / math.pi) + 0.5
    there = (apart <= reach) & (areas[:, 0] <= settings.growth * above[nearest, 0])
    return np.where(there, chain[nearest], -1)
