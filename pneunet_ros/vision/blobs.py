"""White areas of a camera image: where their centers are, how large they are, and how certain."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import ENCODINGS, Image
from pneunet_ros.vision.background import Picture
from pneunet_ros.vision.blob_kernels import Look, measure_all, measure_nearest, MOST_AREAS
from pneunet_ros.vision.camera_settings import AdaptiveBand, AreaLimits, GreyBand
from pneunet_ros.vision.centroid import ANGLE, AREA, COLUMNS, CONTRAST, MAJOR, MINOR, STD, U, V

# Red, green and blue in 1/32768, as cv2.cvtColor has them.
WEIGHTS = {'r': 9798, 'g': 19235, 'b': 3735}
LEAST_CONTRAST = 4.0  # grey levels between an area and its background where the band is fixed


@dataclass(frozen=True, slots=True, eq=False)
class Areas:
    """White areas of an image, an entry per area; NaN in all where there is none.

    `table` has the quantities as rows. `crowded`: there were so many areas that none is given.
    """

    table: Array
    crowded: bool = False

    def __len__(self) -> int:
        return len(self.u)

    @property
    def u(self) -> Array:
        """Centers in the image, from left to right, px."""
        row: Array = self.table[U]
        return row

    @property
    def v(self) -> Array:
        """Centers in the image, from top to bottom, px."""
        row: Array = self.table[V]
        return row

    @property
    def area(self) -> Array:
        """How large the areas are, px^2."""
        row: Array = self.table[AREA]
        return row

    @property
    def major(self) -> Array:
        """Largest axis of the ellipse with the same moments, px."""
        row: Array = self.table[MAJOR]
        return row

    @property
    def minor(self) -> Array:
        """Smallest axis of that ellipse, px."""
        row: Array = self.table[MINOR]
        return row

    @property
    def angle(self) -> Array:
        """Where the largest axis points, rad from +u towards +v."""
        row: Array = self.table[ANGLE]
        return row

    @property
    def std(self) -> Array:
        """Standard error of the center per axis, the larger of both, px."""
        row: Array = self.table[STD]
        return row

    @property
    def contrast(self) -> Array:
        """How much brighter the areas are than their background, grey levels."""
        row: Array = self.table[CONTRAST]
        return row


def find_areas(image: Image, band: GreyBand, limits: AreaLimits) -> Areas:
    """Return all white areas of an image that are within the limits, from top to bottom.

    Areas that the image cuts off are left out.
    """
    out = np.empty((MOST_AREAS, COLUMNS))
    count = measure_all(grey_picture(image), look_of(band, limits), out)
    return Areas(freeze(out[: max(count, 0)].T.copy()), crowded=count < 0)


def measure_areas(
    image: Image,
    around: Array,
    reach: float,
    size: float,
    band: GreyBand,
    limits: AreaLimits,
) -> Areas:
    """Return the white area nearest to each place, n entries.

    around: (n, 2) px; reach: how far from there the center may be, px; size: the diameter that is
    expected, px. NaN where no area within the limits is that near, and where it is cut off by the
    image or hangs together with so much other white that it is not within the limits.
    """
    out = np.empty((len(around), COLUMNS))
    out[:, :2] = around
    look = look_of(band, limits)
    measure_nearest(picture_of(image), look, float(reach), float(size), out)
    return Areas(freeze(np.ascontiguousarray(out.T)))


def look_of(band: GreyBand, limits: AreaLimits) -> Look:
    """Return how targets look, as kernels take it."""
    if isinstance(band, AdaptiveBand):
        low, high, contrast = -1, 255, band.contrast
    else:
        low, high, contrast = math.ceil(band.low), math.floor(band.high), LEAST_CONTRAST
    longest = math.ceil(math.sqrt(4.0 / math.pi * limits.largest * limits.elongation)) + 8
    return (
        low,
        (limits.smallest, limits.largest, limits.elongation, limits.hole, high, contrast),
        longest,
    )


def picture_of(image: Image) -> Picture:
    """Return the bytes of an image, where its pixels lie in them and what its channels weigh."""
    first = second = third = 0
    if image.channels > 1:
        first, second, third = (WEIGHTS[channel] for channel in ENCODINGS[image.encoding][:3])
    layout = (image.width, image.height, image.step, image.channels, first, second, third)
    return image.data, layout


def grey_picture(image: Image) -> Picture:
    """Return an image in which each pixel is a byte: itself where it is grey."""
    if image.channels == 1:
        return picture_of(image)
    grey = image.grey().reshape(-1)
    grey.flags.writeable = False
    return grey, (image.width, image.height, image.width, 1, 0, 0, 0)
