"""Preview of tracking as a video: every frame with its overlay and its stamp."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.recordings.image_files import silence
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.vision.tracker import TrackerState, Tracking

CODEC = 'mp4v'
RATES = (1.0, 120.0)  # Hz; players cope with these
EMPTY_SIZE = (640, 480)  # px, of a video in which nothing could be shown
FONT = cv2.FONT_HERSHEY_SIMPLEX


class PreviewVideo:
    """Takes frames of a video; made by `write_video`."""

    __slots__ = ('_frames', '_path', '_rate', '_shown', '_size', '_writer')

    def __init__(self, path: Path, shown: Path, rate: float) -> None:
        """Write to `path`; `shown` is what the user called it."""
        self._path = path
        self._shown = shown
        self._rate = min(max(rate, RATES[0]), RATES[1])
        self._frames = 0
        self._size: tuple[int, int] | None = None
        self._writer = cv2.VideoWriter()

    def add(self, image: Image, tracking: Tracking, state: TrackerState) -> None:
        """Add one frame; all have the size of the first one, even as the codec needs it."""
        picture = overlay_of(image, tracking, state)
        height, width = picture.shape[:2]
        if self._size is None:
            self._open((max(width - width % 2, 2), max(height - height % 2, 2)))
        seconds, rest = divmod(tracking.sightings.stamp_ns, NANOSECONDS_PER_SECOND)
        write_text(picture, f'{seconds}.{rest:09d} s')
        self._write(picture)

    def close(self) -> None:
        """Finish the video; one without a frame says so."""
        if self._size is None:
            self._open(EMPTY_SIZE)
            picture = np.zeros((EMPTY_SIZE[1], EMPTY_SIZE[0], 3), np.uint8)
            write_text(picture, 'no frame could be looked at')
            self._write(picture)
        self._writer.release()
        self._check()

    def release(self) -> None:
        """Let go of the file."""
        self._writer.release()

    def _open(self, size: tuple[int, int]) -> None:
        code = cv2.VideoWriter.fourcc(*CODEC)
        if not self._writer.open(str(self._path), cv2.CAP_FFMPEG, code, self._rate, size):
            raise RecordingError(
                f'{self._shown} cannot be written: OpenCV has no encoder for {CODEC} here; '
                'ask for a picture (.png) instead',
                reason='unwritable',
            )
        self._size = size

    def _write(self, picture: Bytes) -> None:
        assert self._size is not None
        width, height = self._size
        if picture.shape[0] - height not in (0, 1) or picture.shape[1] - width not in (0, 1):
            picture = np.asarray(cv2.resize(picture, self._size), np.uint8)
        self._writer.write(np.ascontiguousarray(picture[:height, :width]))
        self._frames += 1

    def _check(self) -> None:
        """Look at what was written: OpenCV does not say when the disk is full."""
        with silence():
            film = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
            frames = 0
            while film.grab():
                frames += 1
            film.release()
        if frames != self._frames:
            raise RecordingError(
                f'{self._shown} cannot be written: only {frames} of its {self._frames} frames can '
                'be read back, as where the disk is full; nothing of it was kept',
                reason='unwritable',
            )


@contextmanager
def write_video(
    path: Path, rate: float, *, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Iterator[PreviewVideo]:
    """Write an .mp4 of `rate` frames a second that stands under its name when it is complete.

    Raises the errors of `atomic_output`, and RecordingError where the codec is missing or not all
    of the frames stand in the file.
    """
    with atomic_output(path, overwrite=overwrite, inputs=inputs) as temporary:
        video = PreviewVideo(temporary, path, rate)
        try:
            yield video
            video.close()
        finally:
            video.release()


def overlay_of(image: Image, tracking: Tracking, state: TrackerState) -> Bytes:
    """Return the image with what was made of it; `state` is that after it."""
    curve = None
    if tracking.curve is not None and state.plane is not None and state.lens is not None:
        curve = curve_in_image(tracking.curve, state.plane, state.lens)
    return draw(image, tracking, curve)


def write_text(picture: Bytes, text: str) -> None:
    """Write white text on black into the lower left corner of a bgr picture."""
    height = picture.shape[0]
    scale = max(0.4, height / 1000.0)
    thickness = max(1, round(2.0 * scale))
    (wide, high), below = cv2.getTextSize(text, FONT, scale, thickness)
    top = height - high - 2 * below
    cv2.rectangle(picture, (0, top), (wide + 2 * below, height), (0, 0, 0), cv2.FILLED)
    cv2.putText(
        picture, text, (below, height - below), FONT, scale, (255, 255, 255), thickness,
        cv2.LINE_AA,
    )  # fmt: skip
