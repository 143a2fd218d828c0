"""Films of the paper's arm by the virtual lab, as recordings, videos and folders of images."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.lab.pictures.lens import Camera, overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Dots, FrameState, Scene
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.readings import PRESSURE_TYPE
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE
from pneunet_ros.offline.track import track_steps, TrackStep
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.vision.tracker import Tracker

from support.made_recordings import header, PRESSURE, pressure

ARM = load_model(share_path('config/paper_arm.yaml'))
WIDTH, HEIGHT = 640, 480
RATE = 25.0  # Hz
PERIOD_NS = 40_000_000
CAMERA = overhead_camera(
    width=WIDTH, height=HEIGHT, focal_px=600.0, scale=0.00026, middle=(0.055, 0.03)
)
REST = 5  # frames at the beginning in which the arm is straight
FRAMES = 12
STEP = 500.0  # Pa from frame to frame
IMAGE, COMPRESSED, INFO = (
    f'/pneunet/{name}' for name in ('image_raw', 'image_raw/compressed', 'camera_info')
)
Picture = npt.NDArray[np.uint8]


def stamp_of(index: int) -> int:
    """Return the stamp of a frame, as a video or a folder of RATE frames a second has it."""
    return 1 + index * PERIOD_NS


def place_of(index: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return where the targets are in a frame (m in base): at rest, then bending."""
    pressure_there = STEP * max(0, index - REST + 1)
    shape = solve(ARM, pressure_there, (0.0, 0.0), stations=225)
    places = [np.interp(ARM.target_arclength, shape.arclength, way) for way in (shape.x, shape.y)]
    return places[0], places[1]


@cache
def pictures(
    frames: int = FRAMES, hidden: int | None = None, uneven: float = 0.0
) -> tuple[Picture, ...]:
    """Render the arm, (HEIGHT, WIDTH) grey.

    hidden: a target that is gone in the last frame; uneven: how radii of dots scatter, relative.
    """
    renderer, rng = Renderer(Scene(camera=CAMERA)), np.random.default_rng(5)
    sizes = 1.0 + uneven * np.random.default_rng(6).standard_normal(ARM.target_arclength.size)
    films = []
    for index in range(frames):
        x, y = place_of(index)
        radius = 0.0011 * sizes
        if hidden is not None and index == frames - 1:
            radius[hidden] = 0.0
        films.append(renderer.render(FrameState(dots=Dots(x=x, y=y, radius=radius)), rng)[0])
    return tuple(films)


def image_message(stamp_ns: int, grey: Picture) -> Any:
    """Return an Image, mono8."""
    height, width = grey.shape
    return ROSBAGS_TYPES(IMAGE_TYPE)(
        header=header(stamp_ns, 'camera'),
        height=height,
        width=width,
        encoding='mono8',
        is_bigendian=0,
        step=width,
        data=grey.reshape(-1),
    )


def compressed_message(stamp_ns: int, data: bytes) -> Any:
    """Return a CompressedImage."""
    return ROSBAGS_TYPES(COMPRESSED_TYPE)(
        header=header(stamp_ns, 'camera'), format='', data=np.frombuffer(data, np.uint8)
    )


def info_message(
    stamp_ns: int, width: int = WIDTH, height: int = HEIGHT, camera: Camera = CAMERA
) -> Any:
    """Return the CameraInfo of a camera."""
    region = ROSBAGS_TYPES('sensor_msgs/msg/RegionOfInterest')(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    matrix = np.asarray(camera.matrix).reshape(9)
    return ROSBAGS_TYPES(CAMERA_INFO_TYPE)(
        header=header(stamp_ns, 'camera'),
        height=height,
        width=width,
        distortion_model='plumb_bob',
        d=np.zeros(5),
        k=matrix,
        r=np.eye(3).reshape(9),
        p=np.hstack([matrix.reshape(3, 3), np.zeros((3, 1))]).reshape(12),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def encoded(grey: Picture, suffix: str = '.png') -> bytes:
    """Return an image file in memory."""
    return bytes(cv2.imencode(suffix, grey)[1])


def write_messages(path: Path, messages: Iterable[tuple[str, str, int, Any]]) -> Path:
    """Write (topic, type, log time, message) as they come."""
    with write_recording(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, log_time_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add(topic, kind)
            writer.write(connections[topic], log_time_ns, message)
    return path


def film(
    shown: Sequence[Picture | bytes], *, topic: str | None = None, info: bool = True
) -> list[tuple[str, str, int, Any]]:
    """List the messages of a recording: images (bytes: compressed), their camera_info, pressure.

    Log times are the stamps, and camera_info is written after its image, to be put right.
    """
    messages: list[tuple[str, str, int, Any]] = []
    for index, picture in enumerate(shown):
        stamp = stamp_of(index)
        if isinstance(picture, bytes):
            message = compressed_message(stamp, picture)
            messages.append((topic or COMPRESSED, COMPRESSED_TYPE, stamp, message))
        else:
            messages.append((topic or IMAGE, IMAGE_TYPE, stamp, image_message(stamp, picture)))
        if info:
            messages.append((INFO, CAMERA_INFO_TYPE, stamp, info_message(stamp)))
        messages.append((PRESSURE, PRESSURE_TYPE, stamp + 1000, pressure(stamp + 1000, 1e3)))
    return messages


def write_folder(folder: Path, shown: Sequence[Picture], suffix: str = '.png') -> Path:
    """Write a folder of images, numbered without leading zeros."""
    folder.mkdir()
    for index, picture in enumerate(shown):
        (folder / f'frame{index}{suffix}').write_bytes(encoded(picture, suffix))
    return folder


def write_video(path: Path, shown: Sequence[Picture]) -> Path:
    """Write a video without loss."""
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*'FFV1'), RATE, shown[0].shape[::-1]
    )
    assert writer.isOpened()
    for picture in shown:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def write_camera_info(path: Path, width: int = WIDTH) -> Path:
    """Write the lens of CAMERA as camera_calibration does."""
    numbers = ', '.join(str(value) for value in np.asarray(CAMERA.matrix).ravel())
    path.write_text(
        f'image_width: {width}\nimage_height: {HEIGHT}\ncamera_name: lab\n'
        f'camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{numbers}]\n'
        'distortion_model: plumb_bob\n'
        'distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.0, 0.0, 0.0, 0.0, 0.0]\n'
    )
    return path


def tracked_steps(path: Path, tracker: Tracker) -> list[TrackStep]:
    """Return the steps of frames in which the arm rests, bends, and is hidden for a while."""
    shown = list(pictures())
    shown[6] = np.full((HEIGHT, WIDTH), 90, np.uint8)
    stream = open_images(write_messages(path, film(shown)), SourceRequest())
    return [step for step in track_steps(stream, tracker) if step.frame]
