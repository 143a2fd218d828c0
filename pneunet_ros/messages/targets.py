"""The message `targets`: one point per target, written by the tracker and read by other nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.messages.builders import MessageTypes, Output, point_cloud, POINTS_TYPE

# A point of `targets`: float32 coordinates, as RViz draws nothing else, and the index of the
# target in the 4 bytes after them; image measurements keep all their digits.
TARGET_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 'id', 'u', 'v', 'area', 'major', 'minor', 'angle', 'std'],
        'formats': ['<f4', '<f4', '<f4', '<i4', *['<f8'] * 7],
        'offsets': [0, 4, 8, 12, *range(16, 72, 8)],
        'itemsize': 72,
    }
)


def target_points(sightings: TargetSightings) -> npt.NDArray[Any]:
    """Return the points of `targets`, one record of TARGET_POINT per target."""
    points = np.empty(len(sightings.x), TARGET_POINT)
    for name in TARGET_POINT.names or ():
        if name not in ('z', 'id'):
            with np.errstate(over='ignore'):  # too large for float32: infinite
                points[name] = getattr(sightings, name)
    # All coordinates of a missing point are NaN.
    points['z'] = np.where(np.isnan(sightings.x), np.nan, 0.0)
    points['id'] = np.arange(len(points))
    return points


def _targets_cloud(sightings: TargetSightings, heading: Any, types: MessageTypes) -> Any:
    """Build a PointCloud2: a point per target in order, all NaN except `id` if not seen."""
    is_dense = sightings.seen == len(sightings.x)
    return point_cloud(target_points(sightings), heading, types, is_dense=is_dense)


TARGETS_OUTPUT: Output[TargetSightings] = Output(
    name='targets', type=POINTS_TYPE, build=_targets_cloud
)
