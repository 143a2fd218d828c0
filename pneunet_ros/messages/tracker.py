"""ROS messages of images, lenses and tracker outputs: the table of its topics.

A message is anything with the fields of its type. An output is one entry in the table at the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import CameraError, PneunetError
from pneunet_ros.core.image import Bytes, Image, pixel_image
from pneunet_ros.core.outcome import drop, Refusal, refuse
from pneunet_ros.lab.pictures.lens import Camera
from pneunet_ros.messages.builders import (
    ARRAY_TYPE,
    header,
    IMAGE_TYPE,
    Input,
    MessageTypes,
    multi_array,
    nanoseconds,
    Output,
    path,
    PATH_TYPE,
    pose_rows,
    UNREADABLE,
    usable,
)
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE, decode_compressed
from pneunet_ros.messages.targets import TARGETS_OUTPUT
from pneunet_ros.vision.camera.camera_model import check_whole_image, Lens
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import Tracking

CAMERA_INFO_TYPE = 'sensor_msgs/msg/CameraInfo'
WRONG_CAMERA_INFO = 'wrong_camera_info'  # reason of a rejection: its lens model is unusable


def decode_image(message: Any) -> Image:
    """Return the image of an Image message; MessageError if it cannot be read."""
    with usable(IMAGE_TYPE):
        return Image(
            stamp_ns=nanoseconds(message.header.stamp),
            frame_id=str(message.header.frame_id),
            width=int(message.width),
            height=int(message.height),
            step=int(message.step),
            encoding=str(message.encoding),
            data=_bytes(message.data),
            big_endian=bool(message.is_bigendian),
        )


def decode_compressed_image(message: Any, *, colored: bool = False) -> Image:
    """Return the grey image of a CompressedImage; MessageError if it cannot be read.

    colored: whether to return it in colors instead.
    """
    with usable(COMPRESSED_TYPE):
        stamp_ns = nanoseconds(message.header.stamp)
        frame_id = str(message.header.frame_id)
        data = _bytes(message.data)
    return pixel_image(decode_compressed(data, colored=colored), stamp_ns, frame_id)


def decode_camera_info(message: Any) -> Lens:
    """Return the lens in a CameraInfo.

    Raises MessageError for an invalid message, and CameraError for an uncalibrated or unsupported
    camera, and for binned or cropped images.
    """
    with usable(CAMERA_INFO_TYPE):
        region = message.roi
        numbers = {'matrix': message.k, 'distortion': message.d}
        arrays = {name: np.array(values, np.float64) for name, values in numbers.items()}
        size = {'width': int(message.width), 'height': int(message.height)}
        model = str(message.distortion_model)
        binning = int(message.binning_x), int(message.binning_y)
        place = int(region.x_offset), int(region.y_offset), int(region.width), int(region.height)
        matrix = arrays['matrix'].reshape(3, 3)
    lens = Lens(**size, model=model, matrix=matrix, distortion=arrays['distortion'])
    check_whole_image(lens, binning, place)
    return lens


def refusal_of(error: PneunetError, stamp_ns: int) -> Refusal:
    """Return the refusal of an image or camera_info that could not be decoded."""
    if isinstance(error, CameraError):
        return refuse(stamp_ns, WRONG_CAMERA_INFO, str(error))
    return drop(stamp_ns, UNREADABLE, str(error))


def measured_centerline_rows(curve: MeasuredCurve) -> Array:
    """Return a row per station: position (3) and heading quaternion (x, y, z, w)."""
    return pose_rows(curve.x, curve.y, curve.theta)


def measured_curvature_rows(curve: MeasuredCurve) -> Array:
    """Return the rows named in CURVATURE_ROWS; NaN in rows that are unknown from an image."""
    unknown = np.full(curve.arclength.size, np.nan)
    return np.stack([curve.arclength, curve.curvature, unknown, unknown, curve.std_curvature])


def camera_info_message(camera: Camera, stamp_ns: int, frame_id: str, types: MessageTypes) -> Any:
    """Build the CameraInfo of a camera of the virtual lab; its images are not rectified."""
    full_image = types('sensor_msgs/msg/RegionOfInterest')(
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return types(CAMERA_INFO_TYPE)(
        header=header(stamp_ns, frame_id, types),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model,
        d=types.sequence(camera.distortion),
        k=camera.matrix.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=np.hstack([camera.matrix, np.zeros((3, 1))]).reshape(-1),
        binning_x=0,
        binning_y=0,
        roi=full_image,
    )


def _bytes(data: Any) -> Bytes:
    """Return the data of a message as bytes, for any binding."""
    return np.frombuffer(data, np.uint8)


CURVES: tuple[Output[MeasuredCurve], ...] = (
    Output(
        name='measured_centerline', type=PATH_TYPE, build=path, numbers=measured_centerline_rows
    ),
    Output(
        name='measured_curvature',
        type=ARRAY_TYPE,
        build=partial(multi_array, labels=('field', 'station')),
        numbers=measured_curvature_rows,
    ),
)
TRACKER_INPUTS: tuple[Input[Image | Lens], ...] = (
    Input(name='image_raw', type=IMAGE_TYPE, decode=decode_image),
    Input(name='image_raw/compressed', type=COMPRESSED_TYPE, decode=decode_compressed_image),
    Input(name='camera_info', type=CAMERA_INFO_TYPE, decode=decode_camera_info),
)
TRACKER_OUTPUTS: tuple[Output[Any], ...] = (TARGETS_OUTPUT, *CURVES)


def outputs_of(tracking: Tracking) -> Iterator[tuple[Output[Any], Any]]:
    """Yield the outputs of a frame with their content."""
    yield TARGETS_OUTPUT, tracking.sightings
    if tracking.curve is not None:
        for output in CURVES:
            yield output, tracking.curve
