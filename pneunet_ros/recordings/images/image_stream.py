"""A common stream of images from recordings, videos and folders."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.errors import PneunetError, RequestError
from pneunet_ros.core.image import Image
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.files.camera_file import load_camera_info
from pneunet_ros.recordings.file_kinds import NO_LENS
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.vision.camera.camera_model import Lens

LENS_FILES = ('camera_info.yaml', 'ost.yaml')  # in the folder of the images
RATES = (1e-3, 1e5)  # Hz
IMAGE_TOPIC = '/pneunet/image_raw'
CAMERA_FRAME = 'camera'


class StreamItem(NamedTuple):
    """One message of a stream: log time in ns, topic, content, serialized bytes.

    `reading` is an error if a message of the image or camera_info topic is unusable, and None for
    any other topic. `raw` is empty if nothing was recorded.
    """

    log_time_ns: int
    topic: str
    reading: Image | Lens | PneunetError | None
    raw: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageStream:
    """A source of images that can be read.

    `read(other_topics)` yields image and camera_info, and for a recording also these topics, in
    log time order; at equal log times camera_info comes first. `image_topic`: real or nominal name
    of the image topic; `lens_source`: source of the lens. `frames`: expected number of images;
    `clock`: description of the source of their stamps; `turned`: whether the images (of a folder:
    the first image) were turned upright.
    """

    kind: str
    image_topic: str
    lens_source: str
    frames: int
    clock: str
    read: Callable[[Collection[str]], Iterator[StreamItem]]
    recording: Recording | None = None
    turned: bool = False

    @property
    def namespace(self) -> str:
        """Namespace of the images and of the tracker topics, as in '/pneunet'."""
        return self.image_topic.removesuffix('/compressed').rsplit('/', 1)[0]


def ideal_lens(width: int, height: int) -> Lens:
    """Return a pinhole without distortion for images of this size, with a made-up focal length."""
    focal, center = float(max(width, height)), (0.5 * (width - 1), 0.5 * (height - 1))
    return Lens(
        width=width,
        height=height,
        model='plumb_bob',
        matrix=np.array([[focal, 0.0, center[0]], [0.0, focal, center[1]], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(0),
    )


def with_lens(items: Iterator[StreamItem], lens: Lens | None) -> Iterator[StreamItem]:
    """Insert camera_info before the first image: the given one, or that of an ideal lens."""
    known = False
    for item in items:
        image = item.reading
        if not known and isinstance(image, Image):
            known = True
            given = ideal_lens(image.width, image.height) if lens is None else lens
            yield StreamItem(item.log_time_ns, '', given, b'')
        yield item


def stamp_at(index: int, rate: float) -> int:
    """Return the stamp (ns) of a frame; the first stamp is 1, because 0 means no stamp."""
    return 1 + round(index * NANOSECONDS_PER_SECOND / rate)


def checked_rate(rate: float | None) -> float | None:
    """Return the requested frames per second; RequestError if invalid."""
    if rate is not None and not RATES[0] <= rate <= RATES[1]:
        raise RequestError(
            f'a rate of {rate} Hz is not possible: it must be from {RATES[0]} to {RATES[1]} Hz',
            reason='out_of_bounds',
        )
    return rate


def describe_frame_clock(rate: float) -> str:
    """Describe stamps that count the frames at a rate (Hz)."""
    return f'frames counted, {rate:g} per second'


def stream_of_file(
    kind: str,
    path: Path,
    items: Callable[[], Iterator[StreamItem]],
    camera_info: str | None,
    frames: int,
    clock: str,
) -> ImageStream:
    """Return the stream of a video or folder with its lens; RequestError without a lens."""
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
