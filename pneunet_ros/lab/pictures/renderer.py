"""Render images of an arm with white targets, with the ground truth of every target.

A pixel integrates the light over its square; (0, 0) is the center of the first pixel. Optical
blur, uneven light, glare, clipping, sensor noise and rounding follow.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Bytes
from pneunet_ros.lab.pictures.discs import (
    cover,
    Discs,
    flat_discs,
    optics,
    PARTS,
    see_discs,
    steps_of,
)
from pneunet_ros.lab.pictures.lens import Camera
from pneunet_ros.lab.pictures.scene import Dots, FrameState, Scene
from pneunet_ros.lab.pictures.shading import (
    backdrop,
    draw_body,
    draw_label,
    glare,
    Grey,
    illumination,
    polygon_mask,
)

GLARE = 25.0  # grey levels of glare above which a pixel counts as hidden
NOISE_SHIFTS = 64  # px by which the stored noise is larger than an image
BLUR_REACH = 3.5  # sigmas
BEYOND = 99.0  # px outside the image up to which objects are drawn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """Ground truth of every drawn target, (n,) each, in the order of the dots.

    x, y m in base and u, v px in the image: the center of the disc, in the middle of the exposure;
    centroid_u, centroid_v px: the centroid of the image of the whole disc, which differs from the
    image of its center due to lens and perspective; area px^2 of this image; visible: its share
    inside the image that is hidden neither by an occluder nor by glare. NaN, with `visible` 0,
    where a dot has no radius or is behind the camera.
    """

    x: Array
    y: Array
    u: Array
    v: Array
    centroid_u: Array
    centroid_v: Array
    area: Array
    visible: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cover:
    """Transmitted light (height, width) after occluders and glare."""

    open: Grey
    unglared: Grey


def draw_dots(
    picture: Grey, camera: Camera, dots: Dots, blur: float = 0.0, hiding: Cover | None = None
) -> Truth:
    """Draw blurred targets (sigma, px) into an image; return their ground truth."""
    discs = see_discs(camera, dots.x, dots.y, dots.radius)
    visible = np.zeros(dots.x.size)
    exists = (discs.area > 0.0) & np.isfinite(discs.u + discs.v + discs.reach)
    near_u = np.abs(discs.u - 0.5 * camera.width) < 0.5 * camera.width + discs.reach + BEYOND
    near_v = np.abs(discs.v - 0.5 * camera.height) < 0.5 * camera.height + discs.reach + BEYOND
    drawn = exists & near_u & near_v
    if drawn.any():
        shifts = _shifts(camera, dots.x[drawn], dots.y[drawn], dots.motion[drawn])
        visible[drawn] = paint(picture, _only(discs, drawn), dots.grey, shifts, blur, hiding)
    empty = np.where(exists, 0.0, np.nan)
    return Truth(
        x=freeze(dots.x + empty),
        y=freeze(dots.y + empty),
        u=freeze(discs.u + empty),
        v=freeze(discs.v + empty),
        centroid_u=freeze(discs.centroid[:, 0] + empty),
        centroid_v=freeze(discs.centroid[:, 1] + empty),
        area=freeze(discs.area + empty),
        visible=freeze(visible),
    )


def _only(discs: Discs, which: Any) -> Discs:
    """Return a subset of the discs."""
    return Discs(**{name: getattr(discs, name)[which] for name in Discs.__slots__})


def _shifts(camera: Camera, x: Array, y: Array, motion: Array) -> tuple[Array, Array]:
    """Return the displacements of discs during the exposure, (n, times) px from mid-exposure."""
    if not motion.any():
        return np.zeros((x.size, 1)), np.zeros((x.size, 1))
    u, v = camera.project(x[:, None], y[:, None])
    end_u, end_v = camera.project(x + motion[:, 0], y + motion[:, 1])
    times = steps_of(float(np.hypot(end_u - u[:, 0], end_v - v[:, 0]).max()))
    there_u, there_v = camera.project(
        x[:, None] + motion[:, :1] * times, y[:, None] + motion[:, 1:] * times
    )
    return there_u - u, there_v - v


def paint(
    picture: Grey,
    discs: Discs,
    grey: float,
    shifts: tuple[Array, Array] | None = None,
    blur: float = 0.0,
    hiding: Cover | None = None,
) -> Array:
    """Draw discs of a grey level, and return the visible share of each."""
    no_shift = np.zeros((discs.u.size, 1))
    column, row, parts = cover(
        discs, *(shifts or (no_shift, no_shift)), math.ceil(BLUR_REACH * blur)
    )
    size = parts.shape[1] // PARTS
    pixels = parts.reshape(-1, size, PARTS, size, PARTS).sum(axis=(2, 4))
    visible = np.zeros(discs.u.size)
    blurring = optics(size, blur)
    for index, (left, top) in enumerate(zip(column.tolist(), row.tolist(), strict=True)):
        # The part of the window that lies in the image: there, and in the window itself.
        in_rows, rows = _overlap(top, size, picture.shape[0])
        in_columns, columns = _overlap(left, size, picture.shape[1])
        seen = pixels[index, rows, columns]
        lit = parts[index]
        if hiding is not None:
            is_open = hiding.open[in_rows, in_columns]
            seen = seen * is_open * hiding.unglared[in_rows, in_columns]
            if (is_open < 1.0).any():
                shadow = np.ones((size, size))
                shadow[rows, columns] = is_open
                lit = lit * shadow.repeat(PARTS, axis=0).repeat(PARTS, axis=1)
        visible[index] = seen.sum()
        share = (blurring[rows] @ lit @ blurring[columns].T).astype(np.float32)
        background = picture[in_rows, in_columns]
        background += share * (np.float32(grey) - background)
    fraction: Array = np.clip(visible / pixels.sum(axis=(1, 2)), 0.0, 1.0)
    return fraction


def _overlap(first: int, size: int, limit: int) -> tuple[slice, slice]:
    """Return the overlap of pixels first ... first + size - 1 with 0 ... limit - 1 as slices."""
    start, stop = min(max(first, 0), limit), min(max(first + size, 0), limit)
    return slice(start, stop), slice(start - first, stop - first)


class Renderer:
    """A prepared scene: static objects are drawn once, and noise is reused."""

    __slots__ = ('_canvas', '_glare', '_grain', '_light', '_unhidden', 'scene')

    def __init__(self, scene: Scene) -> None:
        """Draw the static part of the image."""
        self.scene = scene
        width, height = scene.camera.width, scene.camera.height
        picture = backdrop(scene.background, scene.texture, scene.seed, width, height)
        canvas = np.clip(np.rint(picture), 0.0, 255.0).astype(np.uint8)
        for label in scene.labels:
            draw_label(canvas, label)
        picture = canvas.astype(np.float32)
        for spot in scene.spots:
            values = (spot.u, spot.v, spot.major, spot.minor, spot.angle)
            paint(picture, flat_discs(*(np.array([value]) for value in values)), spot.grey)
        draw_dots(picture, scene.camera, scene.decoys)
        self._canvas: Bytes = np.rint(picture).astype(np.uint8)
        self._light: Grey = illumination(scene.light, width, height)
        self._glare: Grey = glare(scene.glints, width, height)
        self._unhidden = Cover(
            open=np.ones((height, width), np.float32),
            unglared=(self._glare < GLARE).astype(np.float32),
        )
        grain = np.random.default_rng(scene.seed).standard_normal(
            (height + NOISE_SHIFTS, width + NOISE_SHIFTS), np.float32
        )
        self._grain: Grey = grain * np.float32(scene.noise)

    def render(self, moment: FrameState, rng: np.random.Generator) -> tuple[Bytes, Truth]:
        """Return the image (height, width), grey levels, and the truth about its targets."""
        scene = self.scene
        height, width = self._canvas.shape
        canvas = self._canvas.copy()
        if moment.body is not None:
            draw_body(canvas, moment.body, scene.camera)
        hiding = self._unhidden
        if moment.occluders:
            hiding = Cover(open=np.ones((height, width), np.float32), unglared=hiding.unglared)
        for occluder in moment.occluders:
            found = polygon_mask(occluder.corners, width, height)
            if found is not None:
                window, mask = found
                hiding.open[window] *= 1.0 - mask
                background = canvas[window]
                canvas[window] = np.rint(background + mask * (occluder.grey - background))
        if scene.blur > 0.0:
            blurred: Any = cv2.GaussianBlur(
                canvas, (0, 0), scene.blur, borderType=cv2.BORDER_REPLICATE
            )
            canvas = blurred
        picture = canvas.astype(np.float32)
        truth = draw_dots(picture, scene.camera, moment.dots, scene.blur, hiding)
        picture *= self._light
        if scene.glints:
            picture += self._glare
        if scene.noise > 0.0:
            # Saturated light is clipped before the noise is added.
            np.minimum(picture, np.float32(255.0), out=picture)
            picture += self._noise(rng)
        picture += np.float32(0.5)
        np.clip(picture, np.float32(0.0), np.float32(255.5), out=picture)
        return picture.astype(np.uint8), truth

    def _noise(self, rng: np.random.Generator) -> Grey:
        """Return noise for one image: a random crop of the stored noise, possibly mirrored."""
        height, width = self._canvas.shape
        row, column, mirrors = rng.integers((NOISE_SHIFTS + 1, NOISE_SHIFTS + 1, 4)).tolist()
        grain = self._grain[row : row + height, column : column + width]
        return grain[:: -1 if mirrors & 1 else 1, :: -1 if mirrors & 2 else 1]
