"""Decode jpeg and png images to grey levels; damaged images are rejected.

The decoder fills in missing parts of a damaged jpeg, and allocates memory before it checks the
size of an image. Therefore, the header is read first, and the decoder's warnings are caught.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import re
import struct
import tempfile
from typing import Any

from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.image import Bytes, LARGEST_SIDE, Levels

COMPRESSED_TYPE = 'sensor_msgs/msg/CompressedImage'
LARGEST_AREA = 64_000_000  # px; 64 MB of grey levels
POSSIBLE = 'supported are jpeg with 8 bits per channel, and png'

JPEG, JPEG_END = b'\xff\xd8\xff', b'\xff\xd9'
PNG, PNG_END = b'\x89PNG\r\n\x1a\n', b'\0\0\0\0IEND\xaeB`\x82'
# Markers of a jpeg: beginnings of a frame, those without content, the beginning of its pixels.
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
BARE, SCAN = frozenset({0x01, *range(0xD0, 0xD8)}), 0xDA

_BY_DECODERS = re.compile(
    rb'(?m)^.*(?:JPEG|JFIF|SOS|progression|Adobe|libpng|grfmt_|loadsave|imdecode_).*\n*'
)
_DAMAGE = re.compile(rb'(?:Corrupt JPEG data|Premature end of JPEG|libpng error).*')


def decode_compressed(data: Bytes, *, colored: bool = False, upright: bool = False) -> Levels:
    """Return the grey levels (height, width) of a jpeg or png, recognized by its magic bytes.

    colored: whether to return its colors instead, (height, width, 3), blue-green-red; upright: as
    in `decode_with_messages`.

    Raises MessageError for other formats, a jpeg with more than 8 bits per channel, a side above
    LARGEST_SIDE or an area above LARGEST_AREA, and for truncated or damaged images.
    """
    head = data[: len(PNG)].tobytes()
    # Some cameras pad their messages with zeros.
    tail = data[-4096:].tobytes().rstrip(b'\0')
    if head.startswith(JPEG):
        kind, (width, height), is_complete = 'jpeg', jpeg_size(data), tail.endswith(JPEG_END)
    elif head == PNG:
        kind, (width, height), is_complete = 'png', png_size(data), tail.endswith(PNG_END)
    else:
        raise MessageError(
            f'a compressed image is neither jpeg nor png; {POSSIBLE}', reason='not_supported'
        )
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise MessageError(
            f'a {kind} of {width} x {height} pixels cannot be used: each side must be 1 to '
            f'{LARGEST_SIDE} pixels',
            reason='too_large',
        )
    if width * height > LARGEST_AREA:
        raise MessageError(
            f'a {kind} of {width} x {height} pixels cannot be used: at most '
            f'{LARGEST_AREA / 1e6:g} megapixels are possible',
            reason='too_large',
        )
    if not is_complete:
        raise MessageError(f'a {kind} is cut off after {data.size} bytes', reason='cut_off')
    pixels, messages = decode_with_messages(data, colored=colored, upright=upright)
    damage = _DAMAGE.search(messages)
    if damage:
        raise MessageError(
            f'a {kind} is damaged: {damage.group().decode(errors="replace")}', reason='damaged'
        )
    possible = {(height, width), (width, height)} if upright else {(height, width)}
    if pixels is None or pixels.shape[:2] not in possible:
        raise MessageError(f'a {kind} of {width} x {height} pixels is damaged', reason='damaged')
    levels: Levels = pixels
    return levels


def decode_with_messages(data: Bytes, *, colored: bool, upright: bool) -> tuple[Any, bytes]:
    """Decode an image file by OpenCV; returns the image (or None) and the decoder's messages.

    The messages are not printed. upright: whether to apply the orientation that a phone stored in
    the file, as viewers do. Images of messages are not turned, because camera_info refers to the
    sensor.
    """
    import cv2  # not needed for readings

    flags = cv2.IMREAD_ANYDEPTH | (cv2.IMREAD_COLOR if colored else 0)
    flags |= 0 if upright else cv2.IMREAD_IGNORE_ORIENTATION
    with tempfile.TemporaryFile() as messages:
        with _stderr_into(messages.fileno()):
            try:
                pixels = cv2.imdecode(data, flags)
            except cv2.error:
                pixels = None
        messages.seek(0)
        return pixels, _of_decoders(messages.read())


def jpeg_size(data: Bytes) -> tuple[int, int]:
    """Return width and height from the header of a jpeg; MessageError without one."""
    raw, place = data.data, 2
    while place + 4 <= len(raw) and raw[place] == 0xFF:
        marker = raw[place + 1]
        if marker == 0xFF or marker in BARE:
            place += 1 if marker == 0xFF else 2
            continue
        if marker in FRAMES and place + 9 <= len(raw):
            bits, height, width = struct.unpack_from('>BHH', raw, place + 4)
            if bits != 8:
                raise MessageError(
                    f'a jpeg has {bits} bits per channel; {POSSIBLE}', reason='not_supported'
                )
            return width, height
        if marker == SCAN:
            break
        place += 2 + int.from_bytes(raw[place + 2 : place + 4], 'big')
    raise MessageError(
        f'a jpeg of {len(raw)} bytes is damaged: its header has no size', reason='damaged'
    )


def png_size(data: Bytes) -> tuple[int, int]:
    """Return width and height from the header of a png; MessageError without one."""
    raw = data[8:25].tobytes()
    if len(raw) < 17 or raw[4:8] != b'IHDR':
        raise MessageError(
            f'a png of {data.size} bytes is damaged: it has no header', reason='damaged'
        )
    width, height = struct.unpack('>II', raw[8:16])
    return width, height


@contextmanager
def _stderr_into(file: int) -> Iterator[None]:
    """Redirect stderr of C libraries to a file, which is the only way to read their warnings."""
    stderr = os.dup(2)
    os.dup2(file, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def _of_decoders(messages: bytes) -> bytes:
    """Return the messages of the decoders; pass on the output of other code."""
    remaining = _BY_DECODERS.sub(b'', messages)
    if remaining:
        os.write(2, remaining)
    return b''.join(_BY_DECODERS.findall(messages))
