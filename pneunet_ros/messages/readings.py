"""Readings -> messages of the topics that are read: pressure, end wrench, targets; and back.

What measures or imports writes with these; the way back for pressure and wrench is in `messages`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.messages.builders import header, MessageTypes, nanoseconds, POINTS_TYPE, UNFIT
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.topics import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.messages.tracker import encode_targets

TARGETS_NAME = 'targets'
# What a point of `targets` may hold beside its coordinates and its id.
_BESIDE = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')


def pressure_message(reading: PressureReading, frame_id: str, types: MessageTypes) -> Any:
    """Build a FluidPressure of a reading."""
    return types(PRESSURE_TYPE)(
        header=header(reading.stamp_ns, frame_id, types),
        fluid_pressure=float(reading.pressure),
        variance=float(reading.variance),
    )


def wrench_message(reading: WrenchReading, types: MessageTypes) -> Any:
    """Build a WrenchStamped of a reading, in the frame that the reading names."""
    vector = types('geometry_msgs/msg/Vector3')
    return types(WRENCH_TYPE)(
        header=header(reading.stamp_ns, reading.frame_id, types),
        wrench=types('geometry_msgs/msg/Wrench')(
            force=vector(x=float(reading.force_x), y=float(reading.force_y), z=0.0),
            torque=vector(x=0.0, y=0.0, z=float(reading.moment)),
        ),
    )


def targets_message(
    stamp_ns: int,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    frame_id: str,
    types: MessageTypes,
    std: float = math.nan,
) -> Any:
    """Build the PointCloud2 of targets at x, y (targets,) m in the base frame, NaN = not seen.

    std: standard error (m) per axis of those seen, NaN = unknown. What only an image shows is NaN.
    """
    places = np.array([x, y], dtype=np.float64)
    seen = np.isfinite(places).all(axis=0)
    places[:, ~seen] = np.nan
    nothing = np.full(seen.size, np.nan)
    values = dict.fromkeys(('u', 'v', 'area', 'major', 'minor', 'angle'), nothing)
    sightings = TargetSightings(
        stamp_ns=stamp_ns,
        x=places[0],
        y=places[1],
        std=np.where(seen, std, np.nan),
        **values,
    )
    return encode_targets(sightings, frame_id, types)


def decode_targets(message: Any, frame_id: str, targets: int | None = None) -> TargetSightings:
    """Return the targets in a PointCloud2, in order of their ids, NaN where one was not seen.

    x, y may be float32 or float64 and the points in any order; fields beside x, y and id may be
    missing. Raises MessageError for another frame than `frame_id`, a missing field, ids that are
    not 0, 1, ... once each, and another number of points than `targets` (None: any).
    """
    try:
        stamp_ns, found = nanoseconds(message.header.stamp), str(message.header.frame_id)
    except UNFIT as error:
        raise MessageError(f'a message is no usable {POINTS_TYPE}: {error}') from error
    if found != frame_id:
        raise MessageError(f'targets are in frame {found!r}, and must be in {frame_id!r}')
    points = cloud_points(message)
    kinds = {name: points.dtype[name].kind for name in points.dtype.names or ()}
    for name, kind, what in (('x', 'f', 'float'), ('y', 'f', 'float'), ('id', 'iu', 'int32')):
        if kinds.get(name, ' ') not in kind:
            wrong = 'is no' if name in kinds else 'is missing: it must be'
            raise MessageError(f'the field {name} of targets {wrong} {what}')
    if targets is not None and points.size != targets:
        raise MessageError(
            f'there are {points.size} points in targets, and the arm has {targets} targets: '
            'every message must hold a point for each, NaN where it was not seen'
        )
    ids = points['id'].astype(np.int64)
    if not np.array_equal(np.sort(ids), np.arange(points.size)):
        raise MessageError(
            f'the ids of targets must be 0 to {points.size - 1}, each once, not '
            f'{", ".join(str(number) for number in ids[:30].tolist())}'
        )
    points = points[np.argsort(ids)]
    columns = {
        name: points[name].astype(np.float64) if name in kinds else np.full(points.size, np.nan)
        for name in ('x', 'y', *_BESIDE)
    }
    unseen = ~(np.isfinite(columns['x']) & np.isfinite(columns['y']))
    for values in columns.values():
        values[unseen] = np.nan
    return TargetSightings(stamp_ns=stamp_ns, **columns)
