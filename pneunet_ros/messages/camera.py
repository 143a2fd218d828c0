"""Messages of a camera of the virtual lab: its grey images, and the numbers of its lens."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneunet_ros.core.image import Bytes
from pneunet_ros.lab.lens import Camera
from pneunet_ros.messages.builders import header, MessageTypes
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE, IMAGE_TYPE


def grey_image_message(grey: Bytes, stamp_ns: int, frame_id: str, types: MessageTypes) -> Any:
    """Build an Image, mono8, of grey levels (height, width)."""
    height, width = grey.shape
    return types(IMAGE_TYPE)(
        header=header(stamp_ns, frame_id, types),
        height=height,
        width=width,
        encoding='mono8',
        is_bigendian=0,
        step=width,
        data=types.sequence(np.ascontiguousarray(grey).reshape(-1)),
    )


def camera_info_message(camera: Camera, stamp_ns: int, frame_id: str, types: MessageTypes) -> Any:
    """Build the CameraInfo of a camera whose images are not rectified."""
    whole = types('sensor_msgs/msg/RegionOfInterest')(
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
        roi=whole,
    )
