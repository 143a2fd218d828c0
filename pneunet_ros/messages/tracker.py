"""ROS messages <-> images, lenses and what the tracker claims: the table of its topics.

As `messages.py` for the estimator: a message is anything with the fields of its type. A new output
is one function and one line in the tables at the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.image import Bytes, Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.messages.builders import (
    ARRAY_TYPE,
    CURVATURE_ROWS,
    header,
    Input,
    MessageTypes,
    multi_array,
    nanoseconds,
    Output,
    path,
    PATH_TYPE,
    point_cloud,
    POINTS_TYPE,
    pose_rows,
    UNFIT,
)
from pneunet_ros.messages.compressed_image import decode_compressed
from pneunet_ros.vision.camera_model import check_whole_image, Lens
from pneunet_ros.vision.smoother import MeasuredCurve
from pneunet_ros.vision.tracker import Tracking

IMAGE_TYPE = 'sensor_msgs/msg/Image'
COMPRESSED_TYPE = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO_TYPE = 'sensor_msgs/msg/CameraInfo'

# A point of `targets`: float32 coordinates, as RViz draws nothing else, and the index of the
# target in the 4 bytes after them; what is measured in the image has all its digits.
TARGET_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 'id', 'u', 'v', 'area', 'major', 'minor', 'angle', 'std'],
        'formats': ['<f4', '<f4', '<f4', '<i4', *['<f8'] * 7],
        'offsets': [0, 4, 8, 12, *range(16, 72, 8)],
        'itemsize': 72,
    }
)


def decode_image(message: Any) -> Image:
    """Return the image in an Image; MessageError where it cannot be read."""
    try:
        return Image(
            stamp_ns=nanoseconds(message.header.stamp),
            frame_id=str(message.header.frame_id),
            width=int(message.width),
            height=int(message.height),
            step=int(message.step),
            encoding=str(message.encoding),
            data=_bytes(message.data),
        )
    except UNFIT as error:
        raise MessageError(f'a message is no usable {IMAGE_TYPE}: {error}') from error


def decode_compressed_image(message: Any) -> Image:
    """Return the image in a CompressedImage as mono8; MessageError where it cannot be read."""
    try:
        stamp_ns = nanoseconds(message.header.stamp)
        frame_id = str(message.header.frame_id)
        data = _bytes(message.data)
    except UNFIT as error:
        raise MessageError(f'a message is no usable {COMPRESSED_TYPE}: {error}') from error
    grey = decode_compressed(data)
    height, width = grey.shape
    return Image(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        width=width,
        height=height,
        step=width,
        encoding='mono8',
        data=grey.ravel(),
    )


def decode_camera_info(message: Any) -> Lens:
    """Return the lens in a CameraInfo.

    Raises MessageError for another message, CameraError for a camera that is not calibrated or not
    known, and for an image that is binned or only a part of what the lens gives.
    """
    try:
        region = message.roi
        numbers = {'matrix': message.k, 'distortion': message.d}
        arrays = {name: np.array(values, np.float64) for name, values in numbers.items()}
        size = {'width': int(message.width), 'height': int(message.height)}
        model = str(message.distortion_model)
        binning = int(message.binning_x), int(message.binning_y)
        place = int(region.x_offset), int(region.y_offset), int(region.width), int(region.height)
        matrix = arrays['matrix'].reshape(3, 3)
    except UNFIT as error:
        raise MessageError(f'a message is no usable {CAMERA_INFO_TYPE}: {error}') from error
    lens = Lens(**size, model=model, matrix=matrix, distortion=arrays['distortion'])
    check_whole_image(lens, binning, place)
    return lens


def target_points(sightings: TargetSightings) -> npt.NDArray[Any]:
    """Return the points of `targets`, one record of TARGET_POINT per target."""
    points = np.empty(len(sightings.x), TARGET_POINT)
    for name in TARGET_POINT.names or ():
        if name not in ('z', 'id'):
            points[name] = getattr(sightings, name)
    # A point that is not there has no coordinate at all.
    points['z'] = np.where(np.isnan(sightings.x), np.nan, 0.0)
    points['id'] = np.arange(len(points))
    return points


def encode_targets(sightings: TargetSightings, frame_id: str, types: MessageTypes) -> Any:
    """Build a PointCloud2: a point per target in order, NaN in all but `id` where not seen."""
    heading = header(sightings.stamp_ns, frame_id, types)
    whole = sightings.seen == len(sightings.x)
    return point_cloud(target_points(sightings), heading, types, is_dense=whole)


def measured_centerline_numbers(curve: MeasuredCurve) -> Array:
    """Return a row per station: position (3) and heading quaternion (x, y, z, w)."""
    return pose_rows(curve.x, curve.y, curve.theta)


def encode_measured_centerline(curve: MeasuredCurve, frame_id: str, types: MessageTypes) -> Any:
    """Build a Path: a pose per station, +x along the tangent."""
    heading = header(curve.stamp_ns, frame_id, types)
    return path(measured_centerline_numbers(curve), heading, types)


def measured_curvature_numbers(curve: MeasuredCurve) -> Array:
    """Return the rows named in CURVATURE_ROWS; NaN in those that an image does not show."""
    rows = np.full((len(CURVATURE_ROWS), curve.arclength.size), np.nan)
    rows[0] = curve.arclength
    rows[1] = curve.curvature
    rows[4] = curve.std_curvature
    return rows


def encode_measured_curvature(curve: MeasuredCurve, frame_id: str, types: MessageTypes) -> Any:
    """Build a Float64MultiArray "field" x "station", as the estimator's `curvature`."""
    return multi_array(measured_curvature_numbers(curve), ('field', 'station'), types)


def encode_picture(picture: Bytes, stamp_ns: int, frame_id: str, types: MessageTypes) -> Any:
    """Build an Image, bgr8, of a picture (height, width, 3)."""
    height, width, channels = picture.shape
    return types(IMAGE_TYPE)(
        header=header(stamp_ns, frame_id, types),
        height=height,
        width=width,
        encoding='bgr8',
        is_bigendian=0,
        step=width * channels,
        data=types.sequence(np.ascontiguousarray(picture).reshape(-1)),
    )


def _bytes(data: Any) -> Bytes:
    """Look at the data of a message, whatever the binding makes of it, as bytes."""
    return np.frombuffer(data, np.uint8)


TARGETS: Output[TargetSightings] = Output(name='targets', type=POINTS_TYPE, encode=encode_targets)
CURVES: tuple[Output[MeasuredCurve], ...] = (
    Output(
        name='measured_centerline',
        type=PATH_TYPE,
        encode=encode_measured_centerline,
        numbers=measured_centerline_numbers,
    ),
    Output(name='measured_curvature', type=ARRAY_TYPE, encode=encode_measured_curvature),
)
TRACKER_INPUTS: tuple[Input[Image | Lens], ...] = (
    Input(name='image_raw', type=IMAGE_TYPE, decode=decode_image),
    Input(name='image_raw/compressed', type=COMPRESSED_TYPE, decode=decode_compressed_image),
    Input(name='camera_info', type=CAMERA_INFO_TYPE, decode=decode_camera_info),
)
TRACKER_OUTPUTS: tuple[Output[Any], ...] = (TARGETS, *CURVES)


def claims(tracking: Tracking) -> Iterator[tuple[Output[Any], Any]]:
    """Yield the outputs that a frame brings, with what each of them encodes."""
    yield TARGETS, tracking.sightings
    if tracking.curve is not None:
        for output in CURVES:
            yield output, tracking.curve
