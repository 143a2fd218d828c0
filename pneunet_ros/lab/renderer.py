"""Render images of an arm with white targets, and the truth about every target in them.

A pixel is the light that falls on its whole square; pixel (0, 0) is the center of the first. Then
the optics blur, the light is uneven, glare adds, and the sensor clips, adds noise and rounds.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.image import Bytes, ENCODINGS, Image
from pneunet_ros.lab.discs import flat_discs
from pneunet_ros.lab.scene import Moment, Scene
from pneunet_ros.lab.shading import (
    backdrop,
    draw_body,
    draw_label,
    glare,
    Grey,
    illumination,
    polygon_mask,
)
from pneunet_ros.lab.targets import Cover, draw_dots, paint, Truth

GLARE = 25.0  # grey levels of glare from which a pixel counts as hidden by it
NOISE_SHIFTS = 64  # px: the stock of noise is larger than an image by this


class Renderer:
    """A scene made ready: what stands still is drawn once, and noise is drawn from a stock."""

    __slots__ = ('_canvas', '_glare', '_grain', '_light', '_unhidden', 'scene')

    def __init__(self, scene: Scene) -> None:
        """Draw what does not move."""
        self.scene = scene
        width, height = scene.camera.width, scene.camera.height
        still = backdrop(scene.background, scene.texture, scene.seed, width, height)
        canvas = np.clip(np.rint(still), 0.0, 255.0).astype(np.uint8)
        for label in scene.labels:
            draw_label(canvas, label)
        still = canvas.astype(np.float32)
        for spot in scene.spots:
            values = (spot.u, spot.v, spot.major, spot.minor, spot.angle)
            paint(still, flat_discs(*(np.array([value]) for value in values)), spot.grey)
        draw_dots(still, scene.camera, scene.decoys)
        self._canvas: Bytes = np.rint(still).astype(np.uint8)
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

    def render(self, moment: Moment, rng: np.random.Generator) -> tuple[Bytes, Truth]:
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
                behind = canvas[window]
                canvas[window] = np.rint(behind + mask * (occluder.grey - behind))
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
            # Light that is more than the sensor holds is clipped before its noise is added.
            np.minimum(picture, np.float32(255.0), out=picture)
            picture += self._noise(rng)
        picture += np.float32(0.5)
        np.clip(picture, np.float32(0.0), np.float32(255.5), out=picture)
        return picture.astype(np.uint8), truth

    def _noise(self, rng: np.random.Generator) -> Grey:
        """Return noise for one image: some place of the stock, mirrored or not."""
        height, width = self._canvas.shape
        row, column, mirrors = rng.integers((NOISE_SHIFTS + 1, NOISE_SHIFTS + 1, 4)).tolist()
        grain = self._grain[row : row + height, column : column + width]
        return grain[:: -1 if mirrors & 1 else 1, :: -1 if mirrors & 2 else 1]


def as_image(
    grey: Bytes,
    *,
    stamp_ns: int,
    frame_id: str = 'camera',
    encoding: str = 'mono8',
    padding: int = 0,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Image:
    """Return a rendered picture as a camera would send it.

    padding: bytes of rubbish after every row; tint: factors of red, green and blue, to tell them
    apart. Raises MessageError for an encoding that is none.
    """
    height, width = grey.shape
    channels = ENCODINGS.get(encoding, 'g')
    planes = {'g': grey, 'a': np.full_like(grey, 255)}
    for name, factor in zip('rgb', tint, strict=True):
        planes[name] = np.clip(np.rint(factor * grey), 0.0, 255.0).astype(np.uint8)
    step = width * len(channels) + padding
    data = np.full((height, step), 170, np.uint8)
    pixels = np.stack([planes[name] for name in channels], axis=2)
    data[:, : step - padding] = pixels.reshape(height, -1)
    return Image(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        width=width,
        height=height,
        step=step,
        encoding=encoding,
        data=freeze_bytes(data),
    )


def freeze_bytes(data: Bytes) -> Bytes:
    """Return rows of bytes as one read-only run."""
    run = data.reshape(-1)
    run.flags.writeable = False
    return run
