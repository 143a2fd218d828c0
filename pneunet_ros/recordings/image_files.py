"""Images from a video file or a folder, at a given rate, with a given lens."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
import math
import os
from pathlib import Path
import re
from typing import Any, BinaryIO

import cv2
import numpy as np
from pneunet_ros.core.errors import MessageError, RecordingError, RequestError
from pneunet_ros.core.image import Bytes, eight_bits, Image
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.files.camera_file import load_camera_info
from pneunet_ros.files.regular_file import open_regular
from pneunet_ros.messages.compressed_image import decode_compressed, decode_heard
from pneunet_ros.recordings.file_kinds import COMPRESSED, FOLDER_RATE, NO_LENS, PICTURES
from pneunet_ros.recordings.image_stream import ImageStream, StreamItem, with_lens

LENS_FILES = ('camera_info.yaml', 'ost.yaml')  # in the folder of the images
RATES = (1e-3, 1e5)  # Hz
IMAGE_TOPIC = '/pneunet/image_raw'
CAMERA_FRAME = 'camera'
LARGEST_PICTURE = 200_000_000  # bytes; a tiff of 64 megapixels and 3 channels has as many
SILENT = 0  # log level of OpenCV
FIRST_FRAMES = 20  # read to see whether a video has times
_BROKEN_OFF = 0.9  # share of the declared frames below which a video counts as cut off

# Read by OpenCV when it opens its first video: errors report what ffmpeg would print.
os.environ.setdefault('OPENCV_FFMPEG_LOGLEVEL', '-8')

# Matroska and WebM have no frame count, and their duration is the end of the last frame on a clock
# with an arbitrary start. But the segment, which contains everything, states its size in bytes.
MAGIC = b'\x1a\x45\xdf\xa3'
SEGMENT = b'\x18\x53\x80\x67'


@contextmanager
def silence() -> Iterator[None]:
    """Suppress messages of OpenCV, because errors report the problem."""
    change: Any = getattr(cv2, 'setLogLevel', None)  # OpenCV 4; in 5 it has moved
    change = change or cv2.utils.logging.setLogLevel
    before = change(SILENT)
    try:
        yield
    finally:
        change(before)


def stamp_at(index: int, rate: float) -> int:
    """Return the stamp (ns) of a frame; the first one is 1, as 0 means none."""
    return 1 + round(index * NANOSECONDS_PER_SECOND / rate)


def checked_rate(rate: float | None) -> float | None:
    """Return the requested frames per second; RequestError if invalid."""
    if rate is not None and not RATES[0] <= rate <= RATES[1]:
        raise RequestError(
            f'a rate of {rate} Hz is not possible: it must be from {RATES[0]} to {RATES[1]} Hz',
            reason='out_of_bounds',
        )
    return rate


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
    """Read a folder of images in natural order of their names, `rate` (30) per second.

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

    return _stream('folder of images', folder, items, camera_info, len(files), _counted(used))


def _picture(file: Path, stamp_ns: int, colored: bool) -> Image | MessageError:
    try:
        with open_regular(file) as stream:
            content = stream.read(LARGEST_PICTURE + 1)
        if len(content) > LARGEST_PICTURE:
            raise MessageError(
                f'it has more than {LARGEST_PICTURE // 10**6} MB', reason='too_large'
            )
        data = np.frombuffer(content, np.uint8)
        decode = decode_compressed if file.suffix.lower() in COMPRESSED else _decode_plain
        return _image(decode(data, colored=colored), stamp_ns)
    except MessageError as error:
        return MessageError(f'{file}: {error}', reason=error.reason)
    except OSError as error:
        return MessageError(f'{file} cannot be read: {error.strerror}', reason='unreadable')


def _decode_plain(data: Bytes, *, colored: bool) -> Bytes:
    """Return the grey levels (height, width) of a bmp or tiff, or its colors."""
    grey, complaint = decode_heard(data, colored=colored)
    if grey is None or complaint:  # OpenCV also decodes a damaged tiff
        raise MessageError('it is not an image, or it is damaged', reason='damaged')
    if grey.dtype not in (np.uint8, np.uint16):
        raise MessageError(
            f'an image of {grey.dtype} cannot be read, only images with 8 or 16 bits per channel',
            reason='not_supported',
        )
    return eight_bits(grey)


def video_images(path: Path, camera_info: str | None, rate: float | None) -> ImageStream:
    """Read the frames of a video, at the presentation times in the file.

    rate: frames per second to use instead, as for a file without times. camera_info: file with the
    lens, or 'none'. Raises RecordingError if it is not a video and RequestError without a lens.
    """
    checked_rate(rate)
    if not path.is_file():
        raise RecordingError(f'{path} does not exist: give a video file', reason='not_found')
    video = _open_video(path)
    file_rate, count = video.get(cv2.CAP_PROP_FPS), video.get(cv2.CAP_PROP_FRAME_COUNT)
    times = _first_times(video)
    video.release()
    if not times:
        raise RecordingError(f'{path} is a video without any readable frame', reason='no_frames')
    timed = rate is None and len(times) > 1 and bool(np.all(np.diff(times) > 0.0))
    if not (timed or rate or (math.isfinite(file_rate) and RATES[0] <= file_rate <= RATES[1])):
        raise RequestError(
            f'{path} does not state its frame rate: give --rate HZ', reason='no_rate'
        )
    used = rate or file_rate
    if timed and not RATES[0] <= file_rate <= RATES[1]:
        used = 1e3 * (len(times) - 1) / (times[-1] - times[0])
    frames = round(count) if math.isfinite(count) and count >= 1.0 else 1

    def items() -> Iterator[StreamItem]:
        video = _open_video(path)
        index, since = 0, 0.0
        while True:
            readable, pixels = video.read()
            if not readable:
                break
            since = video.get(cv2.CAP_PROP_POS_MSEC) - times[0]
            stamp_ns = 1 + round(since * 1e6) if timed else stamp_at(index, used)
            yield StreamItem(
                stamp_ns, IMAGE_TOPIC, _image(np.asarray(pixels, np.uint8), stamp_ns), b''
            )
            index += 1
        video.release()
        if why := _breaks_off(path, index, 1 + since * file_rate / 1e3, frames):
            error = MessageError(f'{path} ends too early: {why}', reason='cut_off')
            yield StreamItem(stamp_at(index, used), IMAGE_TOPIC, error, b'')

    clock = 'presentation times in the file' if timed else _counted(used)
    return _stream('video', path, items, camera_info, frames, clock)


def _breaks_off(path: Path, read: int, last: float, frames: int) -> str:
    """Describe how a video ends too early, '' if it does not.

    read: number of readable frames; last: position of the last one, counted at the rate of the
    file; frames: number stated in the file. An AVI also counts frames omitted by a variable rate,
    and a Matroska counts none.
    """
    if is_matroska(path):
        return f'the file is cut, {read} frames can be read' if is_cut(path) else ''
    if max(read, last if path.suffix.lower() == '.avi' else 0) < _BROKEN_OFF * frames:
        return f'{read} of {frames} frames can be read'
    return ''


def _first_times(video: cv2.VideoCapture) -> list[float]:
    """Return the presentation times (ms) of the first frames."""
    times: list[float] = []
    while len(times) < FIRST_FRAMES and video.grab():
        times.append(float(video.get(cv2.CAP_PROP_POS_MSEC)))
    return times


def _counted(rate: float) -> str:
    return f'frames counted, {rate:g} a second'


def _open_video(path: Path) -> cv2.VideoCapture:
    with silence():
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not video.isOpened():
        raise RecordingError(
            f'{path} cannot be read as a video: it is damaged, or its format is not known',
            reason='damaged',
        )
    return video


def _image(pixels: Bytes, stamp_ns: int) -> Image:
    """Return decoded pixels, (height, width) grey or (height, width, 3) bgr, as an image."""
    height, width = pixels.shape[:2]
    colored = pixels.ndim == 3
    return Image(
        stamp_ns=stamp_ns,
        frame_id=CAMERA_FRAME,
        width=width,
        height=height,
        step=3 * width if colored else width,
        encoding='bgr8' if colored else 'mono8',
        data=np.ascontiguousarray(pixels).reshape(-1),
    )


def _stream(
    kind: str,
    path: Path,
    items: Callable[[], Iterator[StreamItem]],
    camera_info: str | None,
    frames: int,
    clock: str,
) -> ImageStream:
    if camera_info is None:
        raise RequestError(
            f'{path} has no camera calibration: give --camera-info FILE.yaml (as made by '
            f'camera_calibration) or --camera-info {NO_LENS} (images without distortion)'
            + ('' if path.is_file() else f', or put {" or ".join(LENS_FILES)} into the folder'),
            reason='no_camera_info',
        )
    lens = None if camera_info == NO_LENS else load_camera_info(Path(camera_info))

    def read(_other_topics: Collection[str]) -> Iterator[StreamItem]:
        return with_lens(items(), lens)

    return ImageStream(
        kind=kind,
        image_topic=IMAGE_TOPIC,
        lens_source=camera_info,
        frames=frames,
        clock=clock,
        read=read,
    )


def is_matroska(path: Path) -> bool:
    """Whether a file begins like Matroska or WebM."""
    with open_regular(path) as stream:
        return stream.read(len(MAGIC)) == MAGIC


def is_cut(path: Path) -> bool:
    """Whether a Matroska file is shorter than its segment; False if no size is stated."""
    with open_regular(path) as stream:
        size_on_disk = stream.seek(0, 2)
        stream.seek(len(MAGIC))
        header = _size(stream)
        if header is None:
            return False
        stream.seek(header, 1)
        if stream.read(len(SEGMENT)) != SEGMENT:
            return False
        size = _size(stream)
        return size is not None and stream.tell() + size > size_on_disk


def _size(stream: BinaryIO) -> int | None:
    """Read a variable-length size of one to eight bytes; None: unknown."""
    first = stream.read(1)
    if not first or not first[0]:
        return None
    more = 8 - first[0].bit_length()
    rest = stream.read(more)
    bits = 7 * (1 + more)
    value = int.from_bytes(first + rest, 'big') & ((1 << bits) - 1)
    return None if len(rest) < more or value == (1 << bits) - 1 else value
