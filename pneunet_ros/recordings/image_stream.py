"""A common stream of images from recordings, videos and folders."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.image import Image
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.vision.camera.camera_model import Lens


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

    `read(others)` yields image and camera_info, and of a recording also the topics named in
    `others`, in log time order; of equal log times camera_info comes first. `image_topic`: real or
    nominal name of the image topic; `lens_source`: source of the lens. `frames`: expected number
    of images; `clock`: description of the source of their stamps.
    """

    kind: str
    image_topic: str
    lens_source: str
    frames: int
    clock: str
    read: Callable[[Collection[str]], Iterator[StreamItem]]
    recording: Recording | None = None

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
    """Insert camera_info before the first image: the given one, or an ideal lens."""
    known = False
    for item in items:
        image = item.reading
        if not known and isinstance(image, Image):
            known = True
            given = ideal_lens(image.width, image.height) if lens is None else lens
            yield StreamItem(item.log_time_ns, '', given, b'')
        yield item
