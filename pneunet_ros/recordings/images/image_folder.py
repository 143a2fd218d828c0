"""Images from a folder of image files, at a given rate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
import re

import numpy as np
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.image import Bytes, Image, Levels, pixel_image
from pneunet_ros.files.regular_file import open_regular
from pneunet_ros.messages.compressed_image import decode_compressed, decode_with_messages
from pneunet_ros.recordings.file_kinds import COMPRESSED, FOLDER_RATE, PICTURES
from pneunet_ros.recordings.images.image_stream import (
    CAMERA_FRAME,
    checked_rate,
    describe_frame_clock,
    IMAGE_TOPIC,
    ImageStream,
    LENS_FILES,
    stamp_at,
    stream_of_file,
    StreamItem,
)

LARGEST_PICTURE = 200_000_000  # bytes, as of a tiff of 64 megapixels and 3 channels


def picture_files(folder: Path) -> list[Path]:
    """List the images of a folder in natural order: 2 before 10."""
    files = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in PICTURES and not file.name.startswith('.')
    ]
    return sorted(files, key=_natural)


def _natural(file: Path) -> tuple[tuple[int, int, str], ...]:
    parts = re.split(r'([0-9]+)', file.name)
    return tuple((1, int(part), part) if part.isdigit() else (0, 0, part) for part in parts)


def folder_images(
    folder: Path, camera_info: str | None, rate: float | None, *, colored: bool = False
) -> ImageStream:
    """Read a folder of images in natural order of their names, at `rate` (30) per second.

    camera_info: file with the lens, or 'none'; None: a camera_info.yaml or ost.yaml in the folder;
    colored: read colors instead of brightness. Raises RecordingError without images and
    RequestError without a lens.
    """
    files = picture_files(folder)
    if not files:
        raise RecordingError(
            f'{folder} contains neither a recording (metadata.yaml) nor images '
            f'({", ".join(PICTURES)})',
            reason='no_images',
        )
    if camera_info is None:
        lens_files = [folder / name for name in LENS_FILES if (folder / name).is_file()]
        camera_info = str(lens_files[0]) if lens_files else None
    used = checked_rate(rate) or FOLDER_RATE

    def items() -> Iterator[StreamItem]:
        for index, file in enumerate(files):
            stamp_ns = stamp_at(index, used)
            yield StreamItem(stamp_ns, IMAGE_TOPIC, _picture(file, stamp_ns, colored), b'')

    clock = describe_frame_clock(used)
    stream = stream_of_file('folder of images', folder, items, camera_info, len(files), clock)
    return replace(stream, turned=_is_turned(files[0]))


def _is_turned(file: Path) -> bool:
    try:
        seen, stored = (_pixels(file, upright=upright) for upright in (True, False))
    except (MessageError, OSError):
        return False  # reading the stream reports the cause
    return not np.array_equal(seen, stored)


def _picture(file: Path, stamp_ns: int, colored: bool) -> Image | MessageError:
    try:
        return pixel_image(_pixels(file, colored=colored), stamp_ns, CAMERA_FRAME)
    except MessageError as error:
        return MessageError(f'{file}: {error}', reason=error.reason)
    except OSError as error:
        return MessageError(f'{file} cannot be read: {error.strerror}', reason='unreadable')


def _pixels(file: Path, *, colored: bool = False, upright: bool = True) -> Levels:
    with open_regular(file) as stream:
        content = stream.read(LARGEST_PICTURE + 1)
    if len(content) > LARGEST_PICTURE:
        raise MessageError(f'it has more than {LARGEST_PICTURE // 10**6} MB', reason='too_large')
    data = np.frombuffer(content, np.uint8)
    decode = decode_compressed if file.suffix.lower() in COMPRESSED else _decode_plain
    return decode(data, colored=colored, upright=upright)


def _decode_plain(data: Bytes, *, colored: bool, upright: bool) -> Levels:
    """Return the grey levels (height, width) of a bmp or tiff, or its colors."""
    grey, messages = decode_with_messages(data, colored=colored, upright=upright)
    if grey is None or messages:  # OpenCV also decodes a damaged tiff
        raise MessageError('it is not an image, or it is damaged', reason='damaged')
    if grey.dtype not in (np.uint8, np.uint16):
        raise MessageError(
            f'an image of {grey.dtype} cannot be read, only images with 8 or 16 bits per channel',
            reason='not_supported',
        )
    levels: Levels = grey
    return levels
