"""A camera image as it came: bytes with a layout, and how bright a pixel of it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import MessageError

Bytes = npt.NDArray[np.uint8]

# Encoding -> what its channels hold, in their order.
ENCODINGS = {'mono8': 'g', 'rgb8': 'rgb', 'bgr8': 'bgr', 'rgba8': 'rgba', 'bgra8': 'bgra'}
LARGEST_SIDE = 16_384  # px; what claims to be larger is no image of an arm
_TO_GREY = {
    'rgb8': cv2.COLOR_RGB2GRAY,
    'bgr8': cv2.COLOR_BGR2GRAY,
    'rgba8': cv2.COLOR_RGBA2GRAY,
    'bgra8': cv2.COLOR_BGRA2GRAY,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Image:
    """A camera image: `height` rows of `step` bytes each, in which `width` pixels stand.

    `data` (bytes,) is read-only; `encoding` is a key of ENCODINGS. Pixel (u, v) = (0, 0) is the
    center of the first pixel, u to the right, v down. Raises MessageError where these do not fit.
    """

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    step: int
    encoding: str
    data: Bytes

    def __post_init__(self) -> None:
        """Check the layout once."""
        if self.encoding not in ENCODINGS:
            raise MessageError(
                f'an image with the encoding {self.encoding!r} cannot be read; '
                f'possible are {", ".join(ENCODINGS)}, and compressed jpeg and png'
            )
        if not (0 < self.width <= LARGEST_SIDE and 0 < self.height <= LARGEST_SIDE):
            raise MessageError(
                f'an image of {self.width} x {self.height} pixels cannot be used; '
                f'sides go from 1 to {LARGEST_SIDE}'
            )
        row = self.width * self.channels
        if self.step < row:
            raise MessageError(
                f'an image of {self.width} pixels of {self.encoding} needs rows of {row} bytes, '
                f'but its step is {self.step}'
            )
        data = np.frombuffer(self.data, np.uint8)
        if data.size < self.step * (self.height - 1) + row:
            raise MessageError(
                f'an image of {self.width} x {self.height} pixels of {self.encoding} with rows of '
                f'{self.step} bytes is cut off after {data.size} bytes'
            )
        if data.flags.writeable:
            data.flags.writeable = False
        object.__setattr__(self, 'data', data)

    @property
    def channels(self) -> int:
        """How many bytes a pixel has."""
        return len(ENCODINGS[self.encoding])

    @property
    def pixels(self) -> Bytes:
        """All pixels, (height, width, channels), a read-only view."""
        view: Bytes = np.ndarray(
            (self.height, self.width, self.channels),
            np.uint8,
            self.data.data,
            0,
            (self.step, self.channels, 1),
        )
        return view

    def grey(self) -> Bytes:
        """How bright all pixels are, (height, width); a view where the image is grey itself."""
        if self.encoding == 'mono8':
            return self.pixels[:, :, 0]
        grey: Any = cv2.cvtColor(np.ascontiguousarray(self.pixels), _TO_GREY[self.encoding])
        return np.asarray(grey, np.uint8)

    def inverted(self) -> Image:
        """Return the image in grey, with dark and bright exchanged."""
        dark = np.asarray(cv2.bitwise_not(np.ascontiguousarray(self.grey())), np.uint8)
        return replace(self, encoding='mono8', step=self.width, data=dark.reshape(-1))
