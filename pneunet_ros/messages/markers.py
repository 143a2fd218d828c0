"""Visualization of an estimate: markers of the arm, and the transform from its base to its tip.

Not in `OUTPUTS`, because not every ROS installation has the message types; node and replay add
these outputs on request.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import heading_quaternion
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.base_frames import TRANSFORM_TYPE
from pneunet_ros.messages.builders import MessageTypes, Output
from pneunet_ros.model.arm import Arm

MARKERS_TYPE = 'visualization_msgs/msg/MarkerArray'
TIP_FRAME = 'pneunet_tip'

# Constants of visualization_msgs/Marker.
ARROW, LINE_STRIP, SPHERE_LIST = 0, 4, 7
ADD, DELETE = 0, 2

ARM_WIDTH, TARGET_SIZE = 0.006, 0.003  # m
FORCE_SCALE = 0.12  # m of arrow per newton
SHAFT, HEAD, HEAD_LENGTH = 0.0015, 0.004, 0.006  # m
LIFETIME = 1  # s; an arm that is no longer estimated disappears after this time

WHITE = (1.0, 1.0, 1.0, 1.0)
FORCE_COLOR = (0.95, 0.75, 0.1, 1.0)
# Red, green and blue at curvatures of -1, 0 and 1 of the largest intrinsic one of the arm.
CURVATURE_COLORS = np.array([[0.15, 0.4, 0.9], [0.85, 0.85, 0.85], [0.9, 0.25, 0.15]])

Color = tuple[float, float, float, float]
ArmInUse = Callable[[], Arm]


def marker_array(
    estimate: ShapeEstimate, heading: Any, types: MessageTypes, *, arm: ArmInUse
) -> Any:
    """Build a MarkerArray: the arm colored by curvature, its targets, the force at its end."""
    shape = estimate.shape
    places = arm().target_arclength
    target_x, target_y = (
        np.interp(places, shape.arclength, values) for values in (shape.x, shape.y)
    )
    largest = float(np.abs(arm().intrinsic_curvature.curvature).max())
    x, y, _ = shape.tip
    force_x, force_y = shape.force
    end = np.array([x, x + FORCE_SCALE * force_x]), np.array([y, y + FORCE_SCALE * force_y])
    is_pulled = math.hypot(force_x, force_y) > 0.0
    make = partial(marker, heading=heading, types=types)
    return types(MARKERS_TYPE)(
        markers=[
            make(
                'arm',
                LINE_STRIP,
                (ARM_WIDTH, 0.0, 0.0),
                (shape.x, shape.y),
                colors=curvature_colors(shape.curvature, largest),
            ),
            make('targets', SPHERE_LIST, (TARGET_SIZE,) * 3, (target_x, target_y)),
            make(
                'end_force',
                ARROW,
                (SHAFT, HEAD, HEAD_LENGTH),
                end,
                color=FORCE_COLOR,
                action=ADD if is_pulled else DELETE,
            ),
        ]
    )


def curvature_colors(curvature: Array, largest: float) -> list[Color]:
    """Return a color per station, saturated at `largest` (1/m)."""
    share = curvature / largest if largest > 0.0 else np.zeros(curvature.size)
    rgb = [np.interp(share, (-1.0, 0.0, 1.0), channel) for channel in CURVATURE_COLORS.T]
    return [(red, green, blue, 1.0) for red, green, blue in np.stack(rgb, 1).tolist()]


def marker(
    name: str,
    kind: int,
    scale: tuple[float, float, float],
    places: tuple[Array, Array],
    *,
    heading: Any,
    types: MessageTypes,
    color: Color = WHITE,
    colors: list[Color] | None = None,
    action: int = ADD,
) -> Any:
    """Build a Marker from points in the plane; name: its namespace."""
    point, rgba = types('geometry_msgs/msg/Point'), types('std_msgs/msg/ColorRGBA')
    vector, file = types('geometry_msgs/msg/Vector3'), types('visualization_msgs/msg/MeshFile')
    picture = types('sensor_msgs/msg/CompressedImage')
    none = np.zeros(0, np.uint8)
    x, y = (values.tolist() for values in places)
    return types('visualization_msgs/msg/Marker')(
        header=heading,
        ns=name,
        id=0,
        type=kind,
        action=action,
        pose=types('geometry_msgs/msg/Pose')(
            position=point(x=0.0, y=0.0, z=0.0),
            orientation=types('geometry_msgs/msg/Quaternion')(x=0.0, y=0.0, z=0.0, w=1.0),
        ),
        scale=vector(x=scale[0], y=scale[1], z=scale[2]),
        color=rgba(**dict(zip('rgba', color, strict=True))),
        lifetime=types('builtin_interfaces/msg/Duration')(sec=LIFETIME, nanosec=0),
        frame_locked=False,
        points=[point(x=u, y=v, z=0.0) for u, v in zip(x, y, strict=True)],
        colors=[rgba(r=r, g=g, b=b, a=a) for r, g, b, a in colors or ()],
        texture_resource='',
        texture=picture(header=heading, format='', data=types.sequence(none)),
        uv_coordinates=[],
        text='',
        mesh_resource='',
        mesh_file=file(filename='', data=types.sequence(none)),
        mesh_use_embedded_materials=False,
    )


def tip_transform(
    estimate: ShapeEstimate, heading: Any, types: MessageTypes, *, tip_frame: str
) -> Any:
    """Build a TFMessage with the transform from the base to the free end, +x along its tangent."""
    x, y, theta = estimate.shape.tip
    turn_z, turn_w = heading_quaternion(theta)
    transform = types('geometry_msgs/msg/Transform')(
        translation=types('geometry_msgs/msg/Vector3')(x=x, y=y, z=0.0),
        rotation=types('geometry_msgs/msg/Quaternion')(x=0.0, y=0.0, z=turn_z, w=turn_w),
    )
    stamped = types('geometry_msgs/msg/TransformStamped')(
        header=heading, child_frame_id=tip_frame, transform=transform
    )
    return types(TRANSFORM_TYPE)(transforms=[stamped])


def markers_output(arm: ArmInUse) -> Output[ShapeEstimate]:
    """Return the topic `markers`; arm: returns the arm in use when a message is built."""
    return Output(name='markers', type=MARKERS_TYPE, build=partial(marker_array, arm=arm))


def transform_output(tip_frame: str) -> Output[ShapeEstimate]:
    """Return the topic `/tf`, which is the same in every namespace."""
    build = partial(tip_transform, tip_frame=tip_frame)
    return Output(name='/tf', type=TRANSFORM_TYPE, build=build)
