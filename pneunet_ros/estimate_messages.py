"""An estimate as ROS messages: the numbers of each topic, and the message around them.

Nothing of ROS is imported: the classes come through `MessageTypes`. The live node (rclpy classes)
and the replay (classes of a recording) run the same lines, so what they publish and what they
write is equal to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from pneunet_ros.frames import heading_quaternion
from pneunet_ros.shape import Array, ShapeEstimate
from pneunet_ros.units import NANOSECONDS_PER_SECOND

PATH_TYPE = 'nav_msgs/msg/Path'
ARRAY_TYPE = 'std_msgs/msg/Float64MultiArray'
POINTS_TYPE = 'sensor_msgs/msg/PointCloud2'
POSE_TYPE = 'geometry_msgs/msg/PoseWithCovarianceStamped'

# A point of `shape`: float32 coordinates, as RViz draws nothing else, then padding to 16 bytes.
SHAPE_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 's', 'theta', 'kappa', 'kappa0', 'moment', 'std_x', 'std_y'],
        'formats': ['<f4'] * 3 + ['<f8'] * 7,
        'offsets': [0, 4, 8, *range(16, 72, 8)],
        'itemsize': 72,
    }
)
CURVATURE_ROWS = ('arclength', 'curvature', 'intrinsic_curvature', 'moment', 'std_curvature')
JACOBIAN_ROWS, JACOBIAN_COLUMNS = 'x, y, theta', 'pressure, F1, F2, M'

# Where the covariances of (x, y, theta) stand among the 36 of a pose: x, y and the turn about z.
_COVARIANCE_PLACES = [6 * row + column for row in (0, 1, 5) for column in (0, 1, 5)]
_POINT_FIELD_DATATYPE = {'<f4': 7, '<f8': 8}


class MessageTypes(Protocol):
    """The message classes of one ROS binding."""

    def __call__(self, type_name: str, /) -> Callable[..., Any]:
        """Return the class of a type such as 'nav_msgs/msg/Path'; it takes fields as keywords."""

    def sequence(self, values: npt.NDArray[Any], /) -> Any:
        """Return what a field of variable length takes for a contiguous array of numbers."""

    def __hash__(self) -> int:
        """Tell bindings apart, so that constant parts of messages are made once for each."""


def centerline_numbers(estimate: ShapeEstimate) -> Array:
    """Return a row per station: position (3) and heading quaternion (x, y, z, w)."""
    shape = estimate.shape
    rows = np.zeros((shape.x.size, 7))
    rows[:, 0] = shape.x
    rows[:, 1] = shape.y
    half = 0.5 * shape.theta
    rows[:, 5] = np.sin(half)
    rows[:, 6] = np.cos(half)
    return rows


def encode_centerline(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a Path: a pose per station, +x along the tangent, all with the estimate's stamp."""
    header = _header(estimate, frame_id, types)
    stamped, pose = types('geometry_msgs/msg/PoseStamped'), types('geometry_msgs/msg/Pose')
    point, quaternion = types('geometry_msgs/msg/Point'), types('geometry_msgs/msg/Quaternion')
    poses = [
        stamped(
            header=header,
            pose=pose(
                position=point(x=x, y=y, z=z), orientation=quaternion(x=qx, y=qy, z=qz, w=qw)
            ),
        )
        for x, y, z, qx, qy, qz, qw in centerline_numbers(estimate).tolist()
    ]
    return types(PATH_TYPE)(header=header, poses=poses)


def curvature_numbers(estimate: ShapeEstimate) -> Array:
    """Return the rows named in CURVATURE_ROWS, a column per station."""
    shape = estimate.shape
    rows = np.empty((len(CURVATURE_ROWS), shape.x.size))
    rows[0] = shape.arclength
    rows[1] = shape.curvature
    rows[2] = shape.intrinsic_curvature
    rows[3] = shape.moment
    rows[4] = estimate.std_curvature
    return rows


def encode_curvature(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a Float64MultiArray "field" x "station"; `shape` has the same with a stamp."""
    return _array(curvature_numbers(estimate), ('field', 'station'), types)


def shape_numbers(estimate: ShapeEstimate) -> npt.NDArray[Any]:
    """Return the points of `shape`, one record of SHAPE_POINT per station."""
    shape = estimate.shape
    points = np.zeros(shape.x.size, SHAPE_POINT)
    points['x'] = shape.x
    points['y'] = shape.y
    points['s'] = shape.arclength
    points['theta'] = shape.theta
    points['kappa'] = shape.curvature
    points['kappa0'] = shape.intrinsic_curvature
    points['moment'] = shape.moment
    points['std_x'] = estimate.std_x
    points['std_y'] = estimate.std_y
    return points


def encode_shape(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a PointCloud2: all that is known of each station, for displays and controllers."""
    points = shape_numbers(estimate)
    return types(POINTS_TYPE)(
        header=_header(estimate, frame_id, types),
        height=1,
        width=points.size,
        fields=list(_point_fields(SHAPE_POINT, types)),
        is_bigendian=False,
        point_step=SHAPE_POINT.itemsize,
        row_step=points.nbytes,
        data=types.sequence(points.view(np.uint8)),
        is_dense=True,
    )


def tip_numbers(estimate: ShapeEstimate) -> Array:
    """Return one row: position (3), quaternion (4) and the 36 covariances of the free end."""
    row = np.zeros((1, 43))
    x, y, theta = estimate.shape.tip
    row[0, :2] = x, y
    row[0, 5:7] = heading_quaternion(theta)
    row[0, 7:][_COVARIANCE_PLACES] = estimate.tip_covariance.ravel()
    return row


def encode_tip(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build the pose of the free end; what cannot move in the plane has covariance 0."""
    row = tip_numbers(estimate)[0]
    x, y, z, qx, qy, qz, qw = row[:7].tolist()
    pose = types('geometry_msgs/msg/Pose')(
        position=types('geometry_msgs/msg/Point')(x=x, y=y, z=z),
        orientation=types('geometry_msgs/msg/Quaternion')(x=qx, y=qy, z=qz, w=qw),
    )
    return types(POSE_TYPE)(
        header=_header(estimate, frame_id, types),
        pose=types('geometry_msgs/msg/PoseWithCovariance')(pose=pose, covariance=row[7:]),
    )


def jacobian_numbers(estimate: ShapeEstimate) -> Array:
    """Return d(x, y, theta of the tip) / d(pressure, F1, F2, M), 3 x 4."""
    return estimate.jacobian


def encode_jacobian(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a Float64MultiArray 3 x 4 labeled with its rows and columns."""
    return _array(jacobian_numbers(estimate), (JACOBIAN_ROWS, JACOBIAN_COLUMNS), types)


def _header(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    seconds, nanoseconds = divmod(int(estimate.stamp_ns), NANOSECONDS_PER_SECOND)
    stamp = types('builtin_interfaces/msg/Time')(sec=seconds, nanosec=nanoseconds)
    return types('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def _array(values: Array, labels: tuple[str, str], types: MessageTypes) -> Any:
    """Build a 2-D Float64MultiArray; a stride counts all elements from its dimension on."""
    dimension = types('std_msgs/msg/MultiArrayDimension')
    rows, columns = values.shape
    layout = types('std_msgs/msg/MultiArrayLayout')(
        dim=[
            dimension(label=labels[0], size=rows, stride=rows * columns),
            dimension(label=labels[1], size=columns, stride=columns),
        ],
        data_offset=0,
    )
    return types(ARRAY_TYPE)(layout=layout, data=types.sequence(values.ravel()))


@cache
def _point_fields(point: np.dtype[Any], types: MessageTypes) -> tuple[Any, ...]:
    """Describe a record of numbers by PointFields."""
    make = types('sensor_msgs/msg/PointField')
    assert point.fields is not None
    return tuple(
        make(
            name=name,
            offset=int(point.fields[name][1]),
            datatype=_POINT_FIELD_DATATYPE[point.fields[name][0].str],
            count=1,
        )
        for name in point.names or ()
    )
