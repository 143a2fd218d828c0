"""A camera image as received: raw bytes with a layout, and its brightness.

OpenCV is imported only when pixels are used, because many modules import this one.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
import sys
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import MessageError

Bytes = npt.NDArray[np.uint8]
Levels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

Made = TypeVar('Made')

LARGEST_SIDE = 16_384  # px; a larger image is not an image of an arm


class Layout(NamedTuple):
    """Conversion of the bytes of an encoding to grey levels.

    channels: values per pixel of a row; deep: whether a value has two bytes; grey: (height, width,
    channels) to (height, width); bgr: to (height, width, 3); None without colors, or if the colors
    are in planes after the brightness (nv12), which are not read.
    """

    channels: int
    deep: bool
    grey: Callable[[Levels], Levels]
    bgr: Callable[[Levels], Levels] | None = None


def _channel(number: int) -> Callable[[Levels], Levels]:
    return lambda pixels: pixels[:, :, number]


def _converted(name: str) -> Callable[[Levels], Levels]:
    """Return a function that converts pixels by the OpenCV code `cv2.COLOR_` plus this name."""

    def convert(pixels: Levels) -> Levels:
        import cv2

        code = getattr(cv2, f'COLOR_{name}')
        continuous: Any = np.ascontiguousarray(pixels[:, :, 0] if pixels.shape[2] == 1 else pixels)
        converted: Any = cv2.cvtColor(continuous, code)
        levels: Levels = converted
        return levels

    return convert


def _layouts() -> dict[str, Layout]:
    """List the image encodings of sensor_msgs, and nv12."""
    grey, colors = _channel(0), ('RGB', 'BGR', 'RGBA', 'BGRA')
    table: dict[str, Layout] = {}
    for bits, deep in ((8, False), (16, True)):
        table |= {name: Layout(1, deep, grey) for name in (f'mono{bits}', f'{bits}UC1')}
        for name in colors:
            bgr = np.asarray if name == 'BGR' else _converted(f'{name}2BGR')
            table[f'{name.lower()}{bits}'] = Layout(
                len(name), deep, _converted(f'{name}2GRAY'), bgr
            )
        table[f'{bits}UC3'], table[f'{bits}UC4'] = table[f'bgr{bits}'], table[f'bgra{bits}']
        for name in ('RGGB', 'BGGR', 'GBRG', 'GRBG'):
            pattern = f'Bayer{name}2'
            table[f'bayer_{name.lower()}{bits}'] = Layout(
                1, deep, _converted(f'{pattern}GRAY'), _converted(f'{pattern}BGR')
            )
    for first, names in (('UYVY', ('yuv422', 'uyvy')), ('YUY2', ('yuv422_yuy2', 'yuyv'))):
        channel, bgr = _channel(int(first == 'UYVY')), _converted(f'YUV2BGR_{first}')
        table |= {name: Layout(2, False, channel, bgr) for name in names}
    table |= {name: Layout(1, False, grey) for name in ('nv12', 'nv21', 'nv24')}
    return table


ENCODINGS = MappingProxyType(_layouts())


def lab_color(color: tuple[float, float, float]) -> tuple[tuple[float, ...], float]:
    """Return a color (red, green, blue; 0 to 255) in OpenCV's 8-bit L*a*b*, and its chroma."""
    import cv2

    pixel = np.asarray([[color[::-1]]], np.uint8)
    lab = tuple(float(value) for value in np.asarray(cv2.cvtColor(pixel, cv2.COLOR_BGR2LAB))[0, 0])
    return lab, float(np.hypot(lab[1] - 128.0, lab[2] - 128.0))


def pixel_image(pixels: Levels, stamp_ns: int, frame_id: str) -> Image:
    """Return decoded pixels, (height, width) grey or (height, width, 3) bgr, as an image."""
    name, channels = ('mono', 1) if pixels.ndim == 2 else ('bgr', 3)
    height, width = pixels.shape[:2]
    return Image(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        width=width,
        height=height,
        step=channels * width * pixels.itemsize,
        encoding=f'{name}{8 * pixels.itemsize}',
        data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
        big_endian=sys.byteorder == 'big',
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Image:
    """A camera image: `height` rows of `step` bytes each, with `width` pixels.

    `data` (bytes,) is read-only; `encoding` is a key of ENCODINGS; big_endian: byte order of
    two-byte values; bits: number of significant bits, 0: `bits_used`. Pixel (u, v) = (0, 0) is the
    center of the first pixel, u to the right, v down. Raises MessageError if these do not match.
    """

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    step: int
    encoding: str
    data: Bytes
    big_endian: bool = False
    bits: int = 0
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the layout once."""
        if self.encoding not in ENCODINGS:
            raise MessageError(
                f'an image with the encoding {self.encoding!r} cannot be read: supported are '
                f'{", ".join(ENCODINGS)}, and compressed jpeg and png',
                reason='not_supported',
            )
        if not (0 < self.width <= LARGEST_SIDE and 0 < self.height <= LARGEST_SIDE):
            raise MessageError(
                f'an image of {self.width} x {self.height} pixels cannot be used: each side must '
                f'be 1 to {LARGEST_SIDE} pixels',
                reason='too_large',
            )
        layout = ENCODINGS[self.encoding]
        row = self.width * layout.channels * (1 + layout.deep)
        if self.step < row:
            raise MessageError(
                f'an image of {self.width} pixels of {self.encoding} needs rows of {row} bytes, '
                f'but its step is {self.step}',
                reason='wrong_shape',
            )
        data = np.frombuffer(self.data, np.uint8)
        if data.size < self.step * (self.height - 1) + row:
            raise MessageError(
                f'an image of {self.width} x {self.height} pixels of {self.encoding} with rows of '
                f'{self.step} bytes is cut off after {data.size} bytes',
                reason='cut_off',
            )
        if data.flags.writeable:
            data.flags.writeable = False
        object.__setattr__(self, 'data', data)

    @property
    def has_colors(self) -> bool:
        """Whether the image has colors to compare; pixel-pair encodings need an even width."""
        layout = ENCODINGS[self.encoding]
        return layout.bgr is not None and not (layout.channels == 2 and self.width % 2)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return a value derived from this image, computed once per key."""
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made

    @property
    def bits_used(self) -> int:
        """Number of bits in use of two-byte values; 8 for other encodings.

        A camera of 10, 12 or 14 bits fills the lower bits without stating their number; the
        smallest even number of bits that holds the image, except for hot pixels, is assumed.
        """
        return self.once('bits', self._bits_used)

    def _bits_used(self) -> int:
        layout = ENCODINGS[self.encoding]
        if not layout.deep:
            return 8
        import cv2

        pixels, apart = self._pixels()[:, :, :3], 1 + self.encoding.startswith('bayer')
        colors = [pixels[i::apart, j::apart] for i in range(apart) for j in range(apart)]
        usual = [cv2.medianBlur(np.ascontiguousarray(it), 3) for it in colors if it.size]
        most = max(int(np.max(levels)) for levels in usual)
        return max(most.bit_length() + most.bit_length() % 2, 8)

    def with_bits(self, bits: int) -> Image:
        """Return this image with another number of bits in use of two-byte values."""
        if not ENCODINGS[self.encoding].deep:
            return self
        return self.once(('bits', bits), lambda: replace(self, bits=bits))

    def _eight_bits(self, levels: Levels) -> Bytes:
        if levels.dtype == np.uint8:
            return np.asarray(levels, np.uint8)
        more = (self.bits or self.bits_used) - 8
        return np.asarray(np.minimum(levels >> more, 255), np.uint8)

    def grey(self) -> Bytes:
        """Brightness of all pixels, (height, width); a view if the image is grey."""
        return self.once('grey', self._grey)

    def _grey(self) -> Bytes:
        return self._eight_bits(ENCODINGS[self.encoding].grey(self._pixels()))

    def _pixels(self) -> Levels:
        """Return all values as received, (height, width, channels)."""
        layout = ENCODINGS[self.encoding]
        kind = np.dtype(np.uint16 if layout.deep else np.uint8)
        pixels: Any = np.ndarray(
            (self.height, self.width, layout.channels),
            kind.newbyteorder('>' if self.big_endian else '<'),
            self.data.data,
            0,
            (self.step, layout.channels * kind.itemsize, kind.itemsize),
        )
        levels: Levels = pixels.astype(kind) if self.big_endian else pixels
        return levels

    def closeness(self, color: tuple[float, float, float]) -> Image:
        """Return a grey image of similarity to a color (red, green, blue): 255 if equal.

        The similarity is 0 if a pixel is at least as far from the color as grey, in CIE L*a*b*.
        Differences in lightness count half, because the light varies along an arm. Raises
        MessageError for an image without colors.
        """
        return self.once(color, lambda: self._closeness(color))

    def _closeness(self, color: tuple[float, float, float]) -> Image:
        convert = ENCODINGS[self.encoding].bgr
        if convert is None or not self.has_colors:
            raise MessageError(
                f'an image of {self.encoding}, {self.width} pixels wide, has no colors',
                reason='no_colors',
            )
        import cv2

        pixels = np.ascontiguousarray(self._eight_bits(convert(self._pixels())))
        lab = cv2.cvtColor(pixels, cv2.COLOR_BGR2LAB)
        target, largest_distance = lab_color(color)
        levels = np.arange(256.0)
        square: Any = 0.0
        for channel, (value, weight) in enumerate(zip(target, (0.5, 1.0, 1.0), strict=True)):
            table = np.asarray((weight * (levels - value)) ** 2, np.float32)
            square = square + cv2.LUT(lab[:, :, channel], table)
        closeness = np.clip(255.0 - (255.0 / largest_distance) * cv2.sqrt(square), 0.0, 255.0)
        data = np.asarray(closeness, np.uint8).reshape(-1)
        return replace(self, encoding='mono8', step=self.width, data=data, big_endian=False)

    def inverted(self) -> Image:
        """Return the inverted grey image."""
        return self.once('inverted', self._inverted)

    def _inverted(self) -> Image:
        import cv2

        dark = np.asarray(cv2.bitwise_not(np.ascontiguousarray(self.grey())), np.uint8)
        return replace(
            self, encoding='mono8', step=self.width, data=dark.reshape(-1), big_endian=False
        )
