"""Where the center of a blob is, how large it is and how long: moments of weights.

The center is the centroid of weights. At the edge of the ellipse that has the moments of the blob
the weight is what the grey value says, without any clamping, so that noise has no preferred
direction. Elsewhere it is 1 in the blob and 0 outside: pixels there have noise and know nothing
of the center. Blobs of about one size are measured at once, as a stack of crops of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.camera_settings import AreaLimits

Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Box = tuple[Integers, Integers, Integers, Integers]  # first and last column, first and last row

# Columns of a measured blob.
U, V, AREA, MAJOR, MINOR, ANGLE, STD, CONTRAST = range(8)
COLUMNS = 8
QUANTIZATION = 1.0 / 12.0  # variance of a grey level that has been rounded
PIXEL = 1.0 / 12.0  # px^2, second moment of a pixel, which is a square


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidSettings:
    """How a blob is measured."""

    gap: int = tuning(3, 'between a blob and the ring of its background', unit='px')
    ring: int = tuning(3, 'thickness of that ring', unit='px', source='measured')
    fewest: int = tuning(16, 'pixels of the ring that tell anything', unit='px')
    growth: int = tuning(3, 'of a blob from the level of white to half height', unit='px')
    clip: float = tuning(4.0, 'off the background: a bright neighbor', unit='grey level')
    clip_scatter: float = tuning(3.0, 'the same, in scatters, added')
    edge_share: float = tuning(
        0.65, 'half the thickness of the weighed edge, of its width', source='measured'
    )
    edge_margin: float = tuning(0.5, 'the same, added', unit='px', source='measured')
    widest_edge: float = tuning(4.0, 'width of a blurred edge, at most', unit='px')


CENTROID = CentroidSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How a target looks: size and shape, and grey levels of its plateau and its height."""

    limits: AreaLimits
    brightest: int
    contrast: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crops:
    """Square pieces of an image, n of `side` px, and the white pixels that each is about.

    grey, own, inside (n, side, side): grey values, the white pixels, what lies in the image;
    left, top (n,) px of the first pixel; size: width and height of the image.
    """

    grey: Bytes
    own: Mask
    inside: Mask
    left: Integers
    top: Integers
    size: tuple[int, int]


def cut_crops(
    grey: Bytes, boxes: Integers, seeds: Integers, level: Integers, settings: CentroidSettings
) -> Crops:
    """Cut out areas of pixels that are at `level` (n,) or brighter.

    boxes (n, 4): left, top, width, height in px; seeds (n, 2): u, v of one of their pixels.
    """
    longest = max(16, 1 << int(boxes[:, 2:].max() - 1).bit_length())
    side = longest + 2 * (settings.gap + settings.ring + settings.growth)
    left = boxes[:, 0] + (boxes[:, 2] - side) // 2
    top = boxes[:, 1] + (boxes[:, 3] - side) // 2
    columns, rows = left[:, None] + np.arange(side), top[:, None] + np.arange(side)
    height, width = grey.shape
    inside_u, inside_v = (columns >= 0) & (columns < width), (rows >= 0) & (rows < height)
    inside = inside_v[:, :, None] & inside_u[:, None, :]
    at = np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :]
    pixels = grey[at]
    white = (pixels >= level[:, None, None]) & inside
    own = _connected(white, seeds[:, 0] - left, seeds[:, 1] - top)
    return Crops(grey=pixels, own=own, inside=inside, left=left, top=top, size=(width, height))


def measure_crops(crops: Crops, level: Integers, look: Look, settings: CentroidSettings) -> Array:
    """Return rows (n, COLUMNS) of the areas in crops, NaN where one cannot be a target.

    level (n,): grey level from which pixels are white.
    """
    around = _histograms(crops.grey, _ring(crops, _box_of(crops.own), settings))
    background, scatter = _median_and_scatter(around)
    plateau, edge = _plateau_and_edge(_histograms(crops.grey, crops.own), background, level)
    bright, counts = _areas_at_half_height(crops, (background + plateau + 1) // 2)
    pixels, box = bright.sum((1, 2)), _box_of(bright)
    _close_holes(bright, counts, look.limits.hole)
    rows = _weigh(
        crops, bright, counts, plateau, edge,
        _background_plane(crops, box, background, scatter, settings), settings,
    )  # fmt: skip
    possible = (
        (around.sum(1) >= settings.fewest)
        & (plateau - background >= look.contrast)
        & (plateau <= look.brightest)
        & (pixels >= 0.5 * look.limits.smallest)
        & ~_cut_off(crops, box)
        & (rows[:, AREA] >= look.limits.smallest)
        & (rows[:, AREA] <= look.limits.largest)
        & (rows[:, MAJOR] <= look.limits.elongation * rows[:, MINOR])
        & (rows[:, CONTRAST] >= look.contrast)
    )
    rows[~possible] = np.nan
    return rows


def _box_of(mask: Mask) -> Box:
    """Return the boxes around the pixels of masks (n, side, side)."""
    last = mask.shape[1] - 1
    columns, rows = np.any(mask, axis=1), np.any(mask, axis=2)
    return (
        columns.argmax(1), last - columns[:, ::-1].argmax(1),
        rows.argmax(1), last - rows[:, ::-1].argmax(1),
    )  # fmt: skip


def _ring(crops: Crops, box: Box, settings: CentroidSettings) -> Mask:
    """Return the pixels around a box in which the background is looked at."""
    pixel = np.arange(crops.grey.shape[1])
    first_u, last_u, first_v, last_v = (edge[:, None] for edge in box)
    off_u = np.maximum(first_u - pixel, pixel - last_u)[:, None, :]
    off_v = np.maximum(first_v - pixel, pixel - last_v)[:, :, None]
    off = np.maximum(off_u, off_v)
    return np.asarray((off > settings.gap) & (off <= settings.gap + settings.ring) & crops.inside)


def _histograms(grey: Bytes, mask: Mask) -> Integers:
    """Count the grey values of the masked pixels, (n, 256)."""
    number, row, column = np.nonzero(mask)
    index = 256 * number + grey[number, row, column]
    return np.bincount(index, minlength=256 * len(grey)).reshape(-1, 256)


def _median_and_scatter(histograms: Integers) -> tuple[Integers, Integers]:
    """Return median (n,), and how far below it the darkest sixth ends.

    The darker pixels tell the scatter: they have no bright neighbors among them.
    """
    darker, count = histograms.cumsum(1), histograms.sum(1)[:, None]
    median = (darker > count // 2).argmax(1)
    return median, median - (darker > count // 6).argmax(1)


def _plateau_and_edge(
    histograms: Integers, background: Integers, level: Integers
) -> tuple[Integers, Array]:
    """Return the grey value that an eighth of the area reaches, and how many pixels rise to it.

    How many pixels lie between a fifth and four fifths of the height tells how wide the edge is.
    """
    brighter = histograms[:, ::-1].cumsum(1)
    plateau = 255 - (8 * brighter >= brighter[:, -1:]).argmax(1)
    height = plateau - background
    light = background + 4 * height // 5
    dim = np.minimum(np.maximum(background + height // 5, level), light - 1)
    darker = np.pad(histograms.cumsum(1), ((0, 0), (1, 0)))
    number = np.arange(len(darker))
    between = darker[number, np.maximum(light, 0)] - darker[number, np.maximum(dim, 0)]
    return plateau, between * (height / (light - dim))


def _areas_at_half_height(crops: Crops, half: Integers) -> tuple[Mask, Mask]:
    """Return the area at half height, which is as large as it is without blur.

    It begins at the brightest pixel. Return its pixels, and all but those of other white areas.
    """
    count, side = crops.grey.shape[:2]
    white = (crops.grey >= half[:, None, None]) & crops.inside
    brightest = np.where(crops.own, crops.grey, 0).reshape(count, -1).argmax(1)
    bright = _connected(white, brightest % side, brightest // side)
    return bright, bright | ~white


def _connected(white: Mask, u: Integers, v: Integers) -> Mask:
    """Return the white pixels of crops that hang together with the pixels u, v (n,)."""
    white[:, 0] = False  # between crops one above the other
    flat = white.reshape(-1, white.shape[1]).view(np.uint8)
    labels = np.asarray(cv2.connectedComponents(flat, connectivity=8)[1]).reshape(white.shape)
    return np.asarray(white & (labels == labels[np.arange(len(white)), v, u][:, None, None]))


def _close_holes(bright: Mask, counts: Mask, largest: float) -> None:
    """Add dark holes of up to `largest` px^2 to bright areas; they count as they are."""
    dark = ~bright
    flat = dark.reshape(-1, dark.shape[1]).view(np.uint8)
    count, labels = cv2.connectedComponents(flat, connectivity=4)
    if count == 2:  # the areas themselves, and all that is around them
        return
    hole = np.bincount(labels.ravel()) <= largest
    hole[[0, labels[0, 0]]] = False
    closed = hole[labels].reshape(dark.shape)
    bright |= closed
    counts &= ~closed


def _cut_off(crops: Crops, box: Box) -> Mask:
    """Whether image or crop cut off what is in a box."""
    left, right, upper, lower = box
    last = crops.grey.shape[1] - 1
    (width, height), u, v = crops.size, crops.left, crops.top
    by_crop = (left < 1) | (upper < 2) | (right >= last) | (lower >= last)
    by_image = (u + left < 2) | (v + upper < 2) | (u + right > width - 3)
    return np.asarray(by_crop | by_image | (v + lower > height - 3))


def _moments(weights: npt.NDArray[Any]) -> Array:
    """Return sums of y^i x^j weight (n, 3, 3) about the middle of crops (n, side, side)."""
    side = weights.shape[1]
    powers = (np.arange(side)[:, None] - side // 2.0) ** np.arange(3)
    return np.asarray(powers.T @ (weights @ powers))


def _background_plane(
    crops: Crops, box: Box, median: Integers, scatter: Integers, settings: CentroidSettings
) -> Array:
    """Fit level and slopes of the background to the ring around a box.

    Return level in the middle of the crop, slope along x and y, variance of a pixel, and the sums
    of squares of x and y, (6, n); NaN where there are too few pixels. What is far from the median,
    bright neighbors above all, is left out.
    """
    off = crops.grey - median[:, None, None]
    clip = (settings.clip + settings.clip_scatter * scatter)[:, None, None]
    keep = (_ring(crops, box, settings) & (np.abs(off) <= clip)).astype(np.float64)
    off = off * keep
    sums, levels = _moments(keep), _moments(off)
    kept = np.where(sums[:, 0, 0] < settings.fewest, np.nan, sums[:, 0, 0])
    x, y, g = sums[:, 0, 1], sums[:, 1, 0], levels[:, 0, 0]
    xx, yy = sums[:, 0, 2] - x * x / kept, sums[:, 2, 0] - y * y / kept
    xy = sums[:, 1, 1] - x * y / kept
    gx, gy = levels[:, 0, 1] - g * x / kept, levels[:, 1, 0] - g * y / kept
    determinant = xx * yy - xy * xy
    slope_x, slope_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    left_over = (off * off).sum((1, 2)) - g * g / kept - slope_x * gx - slope_y * gy
    level = median + (g - slope_x * x - slope_y * y) / kept
    variance = np.maximum(left_over / (kept - 3.0), QUANTIZATION)
    return np.array([level, slope_x, slope_y, variance, xx, yy])


def _weigh(
    crops: Crops,
    bright: Mask,
    counts: Mask,
    plateau: Integers,
    edge: Array,
    ground: Array,
    settings: CentroidSettings,
) -> Array:
    """Return rows (n, COLUMNS) of bright areas: center, moments and standard error.

    counts: where grey values tell of the area; edge (n,): how many pixels the whole rise from
    background to plateau takes; ground (6, n) as `_background_plane`.
    """
    level, slope_x, slope_y, variance, ring_xx, ring_yy = ground
    side = crops.grey.shape[1]
    place = np.arange(side) - side // 2.0
    height = plateau - level
    moments = _moments(bright.astype(np.float64))
    m, cx, cy, xx, xy, yy = _central(moments)
    radius = np.sqrt(m / math.pi)
    width = np.clip(edge / (2.0 * math.pi * radius), 1.0, settings.widest_edge)
    reach = (settings.edge_share * width + settings.edge_margin) / radius
    determinant = xx * yy - xy * xy
    # x^2 a + 2 x y b + y^2 c = 1 is the ellipse with these moments.
    a, b, c = (each[:, None] * 0.25 / determinant[:, None] for each in (yy, -xy, xx))
    x, y = place - cx[:, None], place - cy[:, None]
    ellipse = (a * x * x)[:, None, :] + (c * y * y)[:, :, None]
    ellipse += 2.0 * (b * y)[:, :, None] * x[:, None, :]
    inner, outer = np.maximum(1.0 - reach, 0.0) ** 2, (1.0 + reach) ** 2
    rim = (ellipse >= inner[:, None, None]) & (ellipse <= outer[:, None, None]) & crops.inside

    share = crops.grey - (level[:, None] + slope_y[:, None] * place)[:, :, None]
    share -= (slope_x[:, None] * place)[:, None, :]
    share /= height[:, None, None]
    moments += _moments(np.where(rim & counts, share - bright, 0.0))
    m, cx, cy, xx, xy, yy = _central(moments)
    xx, yy = xx - PIXEL, yy - PIXEL
    middle, half_span = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    smallest = middle - half_span
    usable = (determinant > 0.01) & (height > 0.0) & (m > 0.0) & (smallest > 0.0)
    # Noise of the rim's pixels, and of the slopes of the background under them.
    n_xx, n_yy = (rim.sum(1) * x * x).sum(1), (rim.sum(2) * y * y).sum(1)
    noise = np.maximum(n_xx + n_xx**2 / ring_xx, n_yy + n_yy**2 / ring_yy) * variance
    rows = np.empty((len(m), COLUMNS))
    rows[:, U], rows[:, V] = crops.left + side // 2 + cx, crops.top + side // 2 + cy
    rows[:, AREA], rows[:, CONTRAST] = m, height
    rows[:, MAJOR], rows[:, MINOR] = 4.0 * np.sqrt(middle + half_span), 4.0 * np.sqrt(smallest)
    rows[:, ANGLE] = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    rows[:, STD] = np.sqrt(noise) / (height * m)
    rows[~usable] = np.nan
    return rows


def _central(moments: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return the sum, the center, and the second moments about it: xx, xy, yy."""
    m = moments[:, 0, 0]
    x, y = moments[:, 0, 1] / m, moments[:, 1, 0] / m
    xx, yy = moments[:, 0, 2] / m - x * x, moments[:, 2, 0] / m - y * y
    return m, x, y, xx, moments[:, 1, 1] / m - x * y, yy
