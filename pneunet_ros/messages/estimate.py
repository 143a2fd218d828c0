"""An estimate as ROS messages: the numbers of each topic, and the message around them.

The live node and the replay run the same lines on message classes of their own, so what they
publish and what they write is equal to the last bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import heading_quaternion
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.builders import (
    CURVATURE_ROWS,
    header,
    MessageTypes,
    multi_array,
    path,
    point_cloud,
    pose_rows,
)

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
JACOBIAN_ROWS, JACOBIAN_COLUMNS = 'x, y, theta', 'pressure, F1, F2, M'

# Where the covariances of (x, y, theta) stand among the 36 of a pose: x, y and the turn about z.
_COVARIANCE_PLACES = [6 * row + column for row in (0, 1, 5) for column in (0, 1, 5)]


def centerline_numbers(estimate: ShapeEstimate) -> Array:
    """Return a row per station: position (3) and heading quaternion (x, y, z, w)."""
    shape = estimate.shape
    return pose_rows(shape.x, shape.y, shape.theta)


def encode_centerline(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a Path: a pose per station, +x along the tangent, all with the estimate's stamp."""
    heading = header(estimate.stamp_ns, frame_id, types)
    return path(centerline_numbers(estimate), heading, types)


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
    return multi_array(curvature_numbers(estimate), ('field', 'station'), types)


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
    heading = header(estimate.stamp_ns, frame_id, types)
    return point_cloud(shape_numbers(estimate), heading, types, is_dense=True)


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
        header=header(estimate.stamp_ns, frame_id, types),
        pose=types('geometry_msgs/msg/PoseWithCovariance')(pose=pose, covariance=row[7:]),
    )


def jacobian_numbers(estimate: ShapeEstimate) -> Array:
    """Return d(x, y, theta of the tip) / d(pressure, F1, F2, M), 3 x 4."""
    return estimate.jacobian


def encode_jacobian(estimate: ShapeEstimate, frame_id: str, types: MessageTypes) -> Any:
    """Build a Float64MultiArray 3 x 4 labeled with its rows and columns."""
    return multi_array(jacobian_numbers(estimate), (JACOBIAN_ROWS, JACOBIAN_COLUMNS), types)
