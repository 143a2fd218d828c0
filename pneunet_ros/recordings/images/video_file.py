"""Images from a video file, at its presentation times or at a given rate."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import math
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pneunet_ros.core.errors import MessageError, RecordingError, RequestError
from pneunet_ros.core.image import pixel_image
from pneunet_ros.recordings.images.image_stream import (
    CAMERA_FRAME,
    checked_rate,
    describe_frame_clock,
    IMAGE_TOPIC,
    ImageStream,
    RATES,
    stamp_at,
    stream_of_file,
    StreamItem,
)
from pneunet_ros.recordings.images.matroska import is_cut, is_matroska

SILENT = 0  # log level of OpenCV
FIRST_FRAMES = 20  # read to see whether a video has times
_BROKEN_OFF = 0.9  # share of the declared frames below which a video counts as cut off

# Read by OpenCV when it opens its first video: error messages replace the output of ffmpeg.
os.environ.setdefault('OPENCV_FFMPEG_LOGLEVEL', '-8')


@contextmanager
def silence() -> Iterator[None]:
    """Suppress messages of OpenCV, because errors report the problem."""
    change: Any = getattr(cv2, 'setLogLevel', None)  # OpenCV 4; the module was moved in OpenCV 5
    change = change or cv2.utils.logging.setLogLevel
    before = change(SILENT)
    try:
        yield
    finally:
        change(before)


def video_images(path: Path, camera_info: str | None, rate: float | None) -> ImageStream:
    """Read the frames of a video, at the presentation times in the file.

    rate: frames per second to use instead, for example for a file without times. camera_info: file
    with the lens, or 'none'. Raises RecordingError if it is not a video and RequestError without a
    lens.
    """
    checked_rate(rate)
    if not path.is_file():
        raise RecordingError(f'{path} does not exist: give a video file', reason='not_found')
    video = _open_video(path)
    file_rate, count = video.get(cv2.CAP_PROP_FPS), video.get(cv2.CAP_PROP_FRAME_COUNT)
    turned = round(video.get(cv2.CAP_PROP_ORIENTATION_META)) % 360 != 0
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
            image = pixel_image(np.asarray(pixels, np.uint8), stamp_ns, CAMERA_FRAME)
            yield StreamItem(stamp_ns, IMAGE_TOPIC, image, b'')
            index += 1
        video.release()
        if why := _describe_truncation(path, index, 1 + since * file_rate / 1e3, frames):
            error = MessageError(f'{path} ends too early: {why}', reason='cut_off')
            yield StreamItem(stamp_at(index, used), IMAGE_TOPIC, error, b'')

    clock = 'presentation times in the file' if timed else describe_frame_clock(used)
    stream = stream_of_file('video', path, items, camera_info, frames, clock)
    return replace(stream, turned=turned)


def _describe_truncation(path: Path, read: int, last: float, frames: int) -> str:
    """Describe the truncation of a video; '' if it is complete.

    read: number of readable frames; last: position of the last one, counted at the rate of the
    file; frames: number stated in the file. The number in an AVI includes frames omitted by a
    variable rate; a Matroska file states none.
    """
    if is_matroska(path):
        return f'the file is cut off, {read} frames can be read' if is_cut(path) else ''
    if max(read, last if path.suffix.lower() == '.avi' else 0) < _BROKEN_OFF * frames:
        return f'{read} of {frames} frames can be read'
    return ''


def _first_times(video: cv2.VideoCapture) -> list[float]:
    """Return the presentation times (ms) of the first frames."""
    times: list[float] = []
    while len(times) < FIRST_FRAMES and video.grab():
        times.append(float(video.get(cv2.CAP_PROP_POS_MSEC)))
    return times


def _open_video(path: Path) -> cv2.VideoCapture:
    with silence():
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not video.isOpened():
        raise RecordingError(
            f'{path} cannot be read as a video: it is damaged, or its format is not known',
            reason='damaged',
        )
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1.0)  # upright, as the images of a folder
    return video
