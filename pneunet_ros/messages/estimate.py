"""The outputs of the estimator: an entry for each topic, with the layout of its messages.

The live node and the replay use the same code with their own message classes, so that their
messages are bitwise equal.
"""

from __future__ import annotations

from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import heading_quaternion
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.builders import (
    ARRAY_TYPE,
    multi_array,
    Output,
    path,
    PATH_TYPE,
    point_cloud,
    POINTS_TYPE,
    pose_rows,
    POSE_TYPE,
    pose_with_covariance,
)

# A point of `shape`: float32 coordinates, as RViz draws nothing else, then padding to 16 bytes.
SHAPE_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 's', 'theta', 'kappa', 'kappa0', 'moment', 'std_x', 'std_y'],
        'formats': ['<f4'] * 3 + ['<f8'] * 7,
        'offsets': [0, 4, 8, *range(16, 72, 8)],
        'itemsize': 72,
    }
)

# The point of `state`: float32 coordinates, the mode in the 4 bytes after them, then everything
# that a controller needs at one instant. Covariances of x, y (m) and theta (rad); jacobian row by
# row.
COVARIANCES = {'xx': (0, 0), 'xy': (0, 1), 'xt': (0, 2), 'yy': (1, 1), 'yt': (1, 2), 'tt': (2, 2)}
STATE_POINT = np.dtype(
    {
        'names': [
            *('x', 'y', 'z', 'mode', 'theta', 'vx', 'vy', 'omega'),
            *(f'cov_{name}' for name in COVARIANCES),
            *('tip_jacobian', 'settled'),
        ],
        'formats': [*['<f4'] * 3, '<i4', *['<f8'] * 10, ('<f8', (12,)), '<i4'],
        'offsets': [0, 4, 8, 12, *range(16, 96, 8), 96, 192],
        'itemsize': 200,
    }
)


class StateMode(IntEnum):
    """Type of estimate on which a state is based."""

    PREDICTION = 0
    FUSED = 1
    CAMERA_ONLY = 2


# Indices of the covariances of (x, y, theta) among the 36 of a pose: x, y, rotation about z.
_COVARIANCE_PLACES = [6 * row + column for row in (0, 1, 5) for column in (0, 1, 5)]


def centerline_rows(estimate: ShapeEstimate) -> Array:
    """Return a row per station: position (3) and heading quaternion (x, y, z, w)."""
    return pose_rows(estimate.shape.x, estimate.shape.y, estimate.shape.theta)


def curvature_rows(estimate: ShapeEstimate) -> Array:
    """Return the rows named in CURVATURE_ROWS, a column per station."""
    shape = estimate.shape
    return np.stack(
        [
            shape.arclength,
            shape.curvature,
            shape.intrinsic_curvature,
            shape.moment,
            estimate.std_curvature,
        ]
    )


def shape_points(estimate: ShapeEstimate) -> npt.NDArray[Any]:
    """Return one record of SHAPE_POINT per station, NaN where unknown; z = 0."""
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


def tip_row(estimate: ShapeEstimate) -> Array:
    """Return one row: position (3), quaternion (4) and the 36 covariances of the free end.

    Components that are fixed in planar motion have covariance 0.
    """
    row = np.zeros((1, 43))
    x, y, theta = estimate.shape.tip
    row[0, :2] = x, y
    row[0, 5:7] = heading_quaternion(theta)
    row[0, 7:][_COVARIANCE_PLACES] = estimate.tip_covariance.ravel()
    return row


def state_point(
    estimate: ShapeEstimate, mode: StateMode = StateMode.PREDICTION
) -> npt.NDArray[Any]:
    """Return the one record of STATE_POINT; z = 0.

    A model without `motion` is quasi-static: its velocities are zero, and it is settled.
    """
    point = np.zeros(1, STATE_POINT)
    point['x'], point['y'], point['theta'] = estimate.shape.tip
    for name, place in COVARIANCES.items():
        point[f'cov_{name}'] = estimate.tip_covariance[place]
    point['tip_jacobian'] = estimate.jacobian.ravel()
    point['mode'], point['settled'] = mode, 1
    if estimate.motion is not None:
        point['vx'], point['vy'], point['omega'] = estimate.motion.velocity
        point['settled'] = estimate.motion.settled
    return point


STATE = Output(name='state', type=POINTS_TYPE, build=point_cloud, numbers=state_point)
OUTPUTS: tuple[Output[ShapeEstimate], ...] = (
    STATE,
    Output(name='centerline', type=PATH_TYPE, build=path, numbers=centerline_rows),
    Output(
        name='curvature',
        type=ARRAY_TYPE,
        build=partial(multi_array, labels=('field', 'station')),
        numbers=curvature_rows,
    ),
    Output(name='shape', type=POINTS_TYPE, build=point_cloud, numbers=shape_points),
    Output(name='tip', type=POSE_TYPE, build=pose_with_covariance, numbers=tip_row),
    Output(
        name='tip_jacobian',
        type=ARRAY_TYPE,
        build=partial(multi_array, labels=('x, y, theta', 'pressure, F1, F2, M')),
        numbers=lambda estimate: estimate.jacobian,
    ),
)
