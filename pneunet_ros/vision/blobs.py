"""Blobs: bright areas of a camera image that can be targets, before they have an identity.

OpenCV outlines what is brighter than its surroundings; `centroid` measures each of them. The
center is our own: that of OpenCV's connected components, at half height, is off by 0.081 to
0.048 px (dots of 3 to 8 px radius, noise 4) where ours is by 0.018 to 0.010 px.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.camera_settings import AdaptiveBand, AreaLimits, GreyBand
from pneunet_ros.vision.centroid import (
    ANGLE,
    AREA,
    CENTROID,
    CentroidSettings,
    COLUMNS,
    CONTRAST,
    cut_crops,
    Integers,
    Look,
    MAJOR,
    measure_crops,
    MINOR,
    STD,
    U,
    V,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlobSettings:
    """How bright areas are told from what is behind them."""

    most: int = tuning(4000, 'areas of an image that are measured')
    least_contrast: float = tuning(
        4.0, 'between a blob and its background where the band is fixed', unit='grey level'
    )
    window: int = tuning(24, 'half side of the window of the background, at least', unit='px')
    window_share: float = tuning(2.0, 'the same, in diameters of the largest blob')
    margin: int = tuning(8, 'added to the longest possible blob', unit='px')
    least_box: float = tuning(0.5, 'area of the box around a blob', unit='smallest area')
    samples: int = tuning(9, 'pixels from the middle of that window to its side')


BLOBS = BlobSettings()


def _row(column: int, meaning: str) -> Any:
    return property(lambda blobs: blobs.table[column], doc=meaning)


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Bright areas of an image that can be targets; NaN in all quantities where there is none.

    `table` (COLUMNS, n) has the quantities below as rows. `crowded`: there were so many bright
    areas that none is given.
    """

    table: Array
    crowded: bool = False

    u = _row(U, 'Centers in the image, from left to right, px.')
    v = _row(V, 'Centers in the image, from top to bottom, px.')
    area = _row(AREA, 'How large they are, px^2.')
    major = _row(MAJOR, 'Largest axis of the ellipse with the same moments, px.')
    minor = _row(MINOR, 'Smallest axis of that ellipse, px.')
    angle = _row(ANGLE, 'Where the largest axis points, rad from +u towards +v.')
    std = _row(STD, 'Standard error of the center per axis, the larger of both, px.')
    contrast = _row(CONTRAST, 'How much brighter they are than the background, grey levels.')

    def __len__(self) -> int:
        return int(self.table.shape[1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Components:
    """Connected white areas of an image, n of which may be targets by their length.

    grey (height, width); boxes (n, 4) left, top, width, height in px; seeds (n, 2): u, v of a
    pixel of each; level (n,): the grey level from which pixels are white there.
    """

    grey: Bytes
    boxes: Integers
    seeds: Integers
    level: Integers
    look: Look
    centroid: CentroidSettings

    def measure(self, chosen: Integers) -> Blobs:
        """Measure the areas with these indices; those that cannot be targets are left out."""
        rows = [np.empty((0, COLUMNS))]
        boxes, seeds, level = self.boxes[chosen], self.seeds[chosen], self.level[chosen]
        # Crops of about one size at a time.
        sizes = np.ceil(np.log2(np.maximum(boxes[:, 2:].max(1), 16)))
        for size in np.unique(sizes):
            alike = sizes == size
            crops = cut_crops(self.grey, boxes[alike], seeds[alike], level[alike], self.centroid)
            with np.errstate(invalid='ignore', divide='ignore'):
                rows.append(measure_crops(crops, level[alike], self.look, self.centroid))
        table = np.concatenate(rows)
        return Blobs(freeze(table[np.isfinite(table[:, U])].T.copy()))

    def nearest(self, places: Array, reach: float) -> Array:
        """Return the blob nearest to each place (n, 2) px, rows (n, COLUMNS).

        NaN where no blob that can be a target has its center within `reach` px.
        """
        nearest = np.full((len(places), COLUMNS), np.nan)
        u, v = places.T
        left, top, width, height = self.boxes.T[:, :, None]
        off_u = np.maximum(left - u, u - (left + width - 1))
        off_v = np.maximum(top - v, v - (top + height - 1))
        near = (off_u <= reach) & (off_v <= reach)  # never where a place is NaN
        blobs = self.measure(np.flatnonzero(near.any(1)))
        if len(blobs):
            distance = np.hypot(u[:, None] - blobs.u, v[:, None] - blobs.v)
            within = distance.min(1) <= reach
            nearest[within] = blobs.table.T[distance.argmin(1)[within]]
        return nearest


def find_components(
    image: Image,
    band: GreyBand,
    limits: AreaLimits,
    settings: BlobSettings = BLOBS,
    centroid: CentroidSettings = CENTROID,
) -> Components:
    """Find the connected white areas of an image."""
    grey = image.grey()
    if isinstance(band, AdaptiveBand):
        level = level_of_white(grey, math.ceil(band.contrast), limits, settings)
        brightest, contrast = 255, band.contrast
    else:
        level = np.full_like(grey, math.ceil(band.low))
        brightest, contrast = math.floor(band.high), settings.least_contrast
    white = cv2.compare(grey, level, cv2.CMP_GE)
    # Much faster than the statistics of connected components: only edges are looked at.
    contours, links = cv2.findContours(white, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outer = [contour for at, contour in enumerate(contours) if links[0, at, 3] < 0]
    boxes = np.array([cv2.boundingRect(contour) for contour in outer], np.int64).reshape(-1, 4)
    seeds = np.array([contour[0, 0] for contour in outer], np.int64).reshape(-1, 2)
    longest = math.ceil(math.sqrt(4.0 / math.pi * limits.largest * limits.elongation))
    longest += settings.margin
    least = settings.least_box * limits.smallest
    possible = (boxes[:, 2:].max(1) <= longest) & (boxes[:, 2:].prod(1) >= least)
    boxes, seeds = boxes[possible], seeds[possible]
    return Components(
        grey=grey,
        boxes=boxes,
        seeds=seeds,
        level=level[seeds[:, 1], seeds[:, 0]].astype(np.int64),
        look=Look(limits=limits, brightest=brightest, contrast=contrast),
        centroid=centroid,
    )


def level_of_white(
    grey: Bytes, contrast: int, limits: AreaLimits, settings: BlobSettings
) -> Bytes:
    """Return grey values above the median of surroundings that are wide against any blob."""
    diameter = math.sqrt(4.0 / math.pi * limits.largest)
    half = max(settings.window, math.ceil(settings.window_share * 0.5 * diameter))
    stride = half // settings.samples
    height, width = grey.shape
    rows = np.minimum(np.arange(stride // 2, height + stride // 2, stride), height - 1)
    columns = np.minimum(np.arange(stride // 2, width + stride // 2, stride), width - 1)
    few = cv2.medianBlur(grey[np.ix_(rows, columns)], 2 * (half // stride) + 1)
    level = np.minimum(few, 255 - contrast) + np.uint8(contrast)
    return np.asarray(cv2.resize(level, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)


def find_blobs(
    image: Image,
    band: GreyBand,
    limits: AreaLimits,
    settings: BlobSettings = BLOBS,
    centroid: CentroidSettings = CENTROID,
) -> Blobs:
    """Return all blobs of an image that are within the limits, but for those it cuts off."""
    components = find_components(image, band, limits, settings, centroid)
    count = len(components.boxes)
    if count > settings.most:
        return Blobs(np.empty((COLUMNS, 0)), crowded=True)
    return components.measure(np.arange(count))
