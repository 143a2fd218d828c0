"""Sources of images: a recording, a video or a folder, detected by content."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from pneunet_ros.core.errors import CameraError, MessageError, RecordingError, RequestError
from pneunet_ros.core.image import Image
from pneunet_ros.files.camera_file import load_camera_info
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE, decode_compressed_image, TRACKER_INPUTS
from pneunet_ros.recordings.bag_folder import is_recording, METADATA
from pneunet_ros.recordings.file_kinds import NO_LENS, VIDEOS
from pneunet_ros.recordings.images.image_folder import folder_images
from pneunet_ros.recordings.images.image_stream import ImageStream, StreamItem, with_lens
from pneunet_ros.recordings.images.video_file import video_images
from pneunet_ros.recordings.message_store import deserialize, store_for
from pneunet_ros.recordings.recording import open_recording, Recording
from pneunet_ros.vision.camera.camera_model import Lens

IMAGE_TYPES = {'image_raw': IMAGE_TYPE, 'image_raw/compressed': COMPRESSED_TYPE}
TOPIC_NAMES = ('image_raw', 'camera_info')  # allowed in --topic
BEHIND_STAMP = 12  # bytes: encapsulation, seconds, nanoseconds
DECODERS = {item.type: item.decode for item in TRACKER_INPUTS}


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceRequest:
    """Options for reading a source.

    camera_info: file with the lens, 'none' for images without distortion, None for the lens of the
    source. rate: frames per second of a video or a folder. topics: full name of a topic by one of
    TOPIC_NAMES, for a recording. colored: whether colors are needed instead of brightness.
    """

    camera_info: str | None = None
    rate: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    colored: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceKind:
    """A kind of source: a test for its paths, and a function that opens them."""

    fits: Callable[[Path], bool]
    open: Callable[[Path, SourceRequest], ImageStream]


def open_images(path: Path, request: SourceRequest) -> ImageStream:
    """Open any source of images; raises RecordingError, RequestError or CameraError."""
    return next(kind for kind in SOURCES if kind.fits(path)).open(path, request)


def _is_folder(path: Path) -> bool:
    return (
        path.is_dir()
        and not (path / METADATA).exists()
        and not any(map(is_recording, path.iterdir()))
    )


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEOS


def _open_folder(path: Path, request: SourceRequest) -> ImageStream:
    _refuse_topics(path, request)
    return folder_images(path, request.camera_info, request.rate, colored=request.colored)


def _open_video(path: Path, request: SourceRequest) -> ImageStream:
    _refuse_topics(path, request)
    return video_images(path, request.camera_info, request.rate)


def _refuse_topics(path: Path, request: SourceRequest) -> None:
    if request.topics:
        raise RequestError(
            f'{path} is not a recording and has no topics: omit --topic', reason='other_source'
        )


def _open_recording(path: Path, request: SourceRequest) -> ImageStream:
    recording = open_recording(path)
    if request.rate is not None:
        raise RequestError(
            f'--rate is only for videos and folders of images; {path} has its own stamps',
            reason='other_source',
        )
    image_topic = recording.find_any(
        IMAGE_TYPES, request.topics.get('image_raw'), label='with images'
    )
    info_topic = None
    lens: Lens | None = None
    if request.camera_info is None:
        info_topic = find_info_topic(recording, image_topic, request.topics.get('camera_info'))
    elif 'camera_info' in request.topics:
        raise RequestError(
            'give either --camera-info or --topic camera_info=, not both', reason='exclusive'
        )
    elif request.camera_info != NO_LENS:
        lens = load_camera_info(Path(request.camera_info))

    def read(other_topics: Collection[str]) -> Iterator[StreamItem]:
        items = _recorded_items(recording, image_topic, info_topic, other_topics, request.colored)
        return items if info_topic is not None else with_lens(items, lens)

    return ImageStream(
        kind='recording',
        image_topic=image_topic,
        lens_source=info_topic or str(request.camera_info),
        frames=recording.topic(image_topic).count,
        clock='headers of the images',
        read=read,
        recording=recording,
    )


def find_info_topic(recording: Recording, image_topic: str, override: str | None) -> str:
    """Return the camera_info topic; if there are several, the one in the namespace of the images.

    Raises RecordingError if there is none, or if the choice is ambiguous.
    """
    if override is None:
        candidates = recording.candidates('camera_info', CAMERA_INFO_TYPE)
        same_namespace = image_topic.removesuffix('/compressed').rsplit('/', 1)[0] + '/camera_info'
        if same_namespace in candidates:
            return same_namespace
        if not candidates:
            raise RecordingError(
                f'{recording.path} has no topic camera_info of type {CAMERA_INFO_TYPE}: give '
                '--camera-info FILE.yaml (as made by camera_calibration), or --camera-info '
                f'{NO_LENS} (images without distortion), or --topic camera_info=/its/name',
                reason='no_camera_info',
            )
    return recording.find('camera_info', CAMERA_INFO_TYPE, override)


def _recorded_items(
    recording: Recording,
    image_topic: str,
    info_topic: str | None,
    other_topics: Collection[str],
    colored: bool,
) -> Iterator[StreamItem]:
    """Yield the messages of these topics; undecodable messages carry an error."""
    decoded = [name for name in (info_topic, image_topic) if name is not None]
    topics = {name: recording.topic(name) for name in decoded}
    stores = {name: store_for(topic.type, topic.definition) for name, topic in topics.items()}
    passed_on = [name for name in other_topics if name not in topics]
    decoders = dict(DECODERS)
    decoders[COMPRESSED_TYPE] = partial(decode_compressed_image, colored=colored)
    last_content, lens = b'', None
    for name, log_time_ns, raw in recording.raw_messages([*decoded, *passed_on]):
        reading: Image | Lens | MessageError | CameraError | None = None
        if name == info_topic and raw[BEHIND_STAMP:] == last_content:
            reading = lens  # only the stamp differs
        elif name in topics:
            kind = topics[name].type
            try:
                reading = decoders[kind](deserialize(raw, kind, stores[name]))
            except (MessageError, CameraError) as error:
                reading = error
            if isinstance(reading, Lens):
                last_content, lens = raw[BEHIND_STAMP:], reading
        yield StreamItem(log_time_ns, name, reading, raw)


# The first matching source opens a path; anything but a folder of images or a video is a
# recording.
SOURCES = (
    SourceKind(fits=_is_folder, open=_open_folder),
    SourceKind(fits=_is_video, open=_open_video),
    SourceKind(fits=lambda path: True, open=_open_recording),
)
