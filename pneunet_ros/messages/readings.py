"""Sensors: topics, conversion of messages to readings and back, and components.

`SENSORS` is the only list of sensors, used by all code that replays, checks, exports, imports and
writes recordings. ROS is not imported: a message is anything with the fields of its type, from
rclpy or decoded from a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import are_numbers, Array, freeze
from pneunet_ros.core.arrivals import ArrivalOrder
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.frames import BASE_FRAME, heading_quaternion, planar_heading, rotation_matrix
from pneunet_ros.core.readings import (
    PressureReading,
    TargetSightings,
    TipPoseReading,
    WrenchReading,
)
from pneunet_ros.estimation.base_gravity import GravitySource
from pneunet_ros.estimation.sensor_mapping import base_wrench, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings, turn_of
from pneunet_ros.messages.base_frames import (
    decode_frames,
    decode_imu,
    imu_message,
    IMU_TYPE,
    TRANSFORM_TYPE,
)
from pneunet_ros.messages.builders import (
    header,
    Input,
    MessageTypes,
    nanoseconds,
    POINTS_TYPE,
    ReadingType,
    usable,
)
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.targets import TARGETS_OUTPUT

PRESSURE_TYPE = 'sensor_msgs/msg/FluidPressure'
WRENCH_TYPE = 'geometry_msgs/msg/WrenchStamped'
TIP_POSE_TYPE = 'geometry_msgs/msg/PoseStamped'
# Fields of a point of `targets` in addition to its id.
_OF_A_TARGET = ('x', 'y', 'std', 'u', 'v', 'area', 'major', 'minor', 'angle')


class UnusableTopic(MessageError):
    """No message of this topic is usable, not only the present one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One number of a reading: name and kind of unit of its column, and how it is displayed.

    optional: whether the number may be unknown (NaN).
    """

    name: str
    kind: str
    shown_unit: str
    shown_per_si: float = 1.0
    optional: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor(Input[ReadingType]):
    """A topic of readings, and its reading as a row of numbers: SI, gauge, base frame.

    label: name of a reading in sentences. components: the numbers in a row; with `per_target`,
    each is an array with one entry per target, NaN if not seen. `message(stamp_ns, row, frame_id,
    types)` builds the message of a row. `row(message, settings, targets)` returns stamp (ns) and
    row, or raises MessageError; without it, a row consists of the fields of the reading with the
    names of the components. needed: whether the estimator reads the topic with these settings.
    """

    label: str
    components: tuple[Component, ...]
    message: Callable[[int, Array, str, MessageTypes], Any]
    row: Callable[[Any, EstimatorSettings, int | None], tuple[int, Array]] | None = None
    needed: Callable[[EstimatorSettings], bool] = lambda settings: False
    per_target: bool = False

    def read(
        self, message: Any, settings: EstimatorSettings, targets: int | None = None
    ) -> tuple[int, Array]:
        """Return stamp (ns) and row of a message; targets: their required number (None: any).

        Raises MessageError, or UnusableTopic if no message of the topic can be used.
        """
        if self.row is not None:
            return self.row(message, settings, targets)
        reading: Any = self.decode(message)
        return reading.stamp_ns, np.array([getattr(reading, c.name) for c in self.components])

    def row_shape(self, targets: int) -> tuple[int, ...]:
        """Return the shape of a row of this sensor, for an arm with this many targets."""
        return (len(self.components), targets) if self.per_target else (len(self.components),)

    def present(self, values: Array) -> npt.NDArray[np.bool_]:
        """Return a mask of the rows (rows, *row_shape) that contain readings."""
        needed = [not component.optional for component in self.components]
        if not any(needed):
            return np.asarray(are_numbers(values).any(axis=1))
        complete = np.asarray(are_numbers(values[:, needed]).all(axis=1))
        return np.asarray(complete.any(axis=1)) if self.per_target else complete


def decode_pressure(message: Any) -> PressureReading:
    """Return the reading in a FluidPressure, even if NaN; MessageError if invalid."""
    with usable(PRESSURE_TYPE):
        return PressureReading(
            stamp_ns=nanoseconds(message.header.stamp),
            pressure=float(message.fluid_pressure),
            variance=float(message.variance),
        )


def decode_wrench(message: Any) -> WrenchReading:
    """Return the reading of a WrenchStamped, unchanged; MessageError if invalid."""
    with usable(WRENCH_TYPE):
        force, torque = message.wrench.force, message.wrench.torque
        return WrenchReading(
            stamp_ns=nanoseconds(message.header.stamp),
            force_x=float(force.x),
            force_y=float(force.y),
            moment=float(torque.z),
            frame_id=str(message.header.frame_id),
            force_z=float(force.z),
            moment_x=float(torque.x),
            moment_y=float(torque.y),
        )


def decode_tip_pose(message: Any) -> TipPoseReading:
    """Return the planar part of a PoseStamped, unchanged; MessageError if invalid.

    An invalid quaternion (all zeros, NaN) means that no heading was measured, and a position of 0,
    0 (the clamp) that no position was measured: an inertial sensor measures only the heading, and
    motion capture measures neither if the tip is hidden.
    """
    with usable(TIP_POSE_TYPE):
        position, orientation = message.pose.position, message.pose.orientation
        x, y = float(position.x), float(position.y)
        heading = planar_heading(*(float(getattr(orientation, name)) for name in 'xyzw'))
        if x == y == 0.0:
            x = y = math.nan
            heading = heading if heading != 0.0 else math.nan
        return TipPoseReading(
            stamp_ns=nanoseconds(message.header.stamp),
            x=x,
            y=y,
            heading=heading,
            frame_id=str(message.header.frame_id),
        )


def pressure_message(
    stamp_ns: int, row: Array, frame_id: str, types: MessageTypes, variance: float = 0.0
) -> Any:
    """Build a FluidPressure of a pressure (1,) Pa; variance in Pa^2, 0 = unknown."""
    return types(PRESSURE_TYPE)(
        header=header(stamp_ns, frame_id, types), fluid_pressure=float(row[0]), variance=variance
    )


def wrench_message(stamp_ns: int, row: Array, frame_id: str, types: MessageTypes) -> Any:
    """Build a WrenchStamped of F1, F2 (N) and M (N m), (3,)."""
    vector = types('geometry_msgs/msg/Vector3')
    force_x, force_y, moment = map(float, row)
    return types(WRENCH_TYPE)(
        header=header(stamp_ns, frame_id, types),
        wrench=types('geometry_msgs/msg/Wrench')(
            force=vector(x=force_x, y=force_y, z=0.0), torque=vector(x=0.0, y=0.0, z=moment)
        ),
    )


def tip_pose_message(stamp_ns: int, row: Array, frame_id: str, types: MessageTypes) -> Any:
    """Build a PoseStamped of x, y (m) and heading (rad) of the tip, (3,), NaN where unknown."""
    x, y, heading = map(float, row)
    z, w = heading_quaternion(heading)
    return types(TIP_POSE_TYPE)(
        header=header(stamp_ns, frame_id, types),
        pose=types('geometry_msgs/msg/Pose')(
            position=types('geometry_msgs/msg/Point')(x=x, y=y, z=0.0),
            orientation=types('geometry_msgs/msg/Quaternion')(x=0.0, y=0.0, z=z, w=w),
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

    std: standard error (m) per axis of seen targets, NaN = unknown. Fields that need an image are
    NaN.
    """
    places = np.array([x, y], dtype=np.float64)
    seen = np.isfinite(places).all(axis=0)
    places[:, ~seen] = np.nan
    unseen = np.full(seen.size, np.nan)
    values = dict.fromkeys(('u', 'v', 'area', 'major', 'minor', 'angle'), unseen)
    sightings = TargetSightings(
        stamp_ns=stamp_ns, x=places[0], y=places[1], std=np.where(seen, std, np.nan), **values
    )
    return TARGETS_OUTPUT.encode(sightings, frame_id, types)


def decode_targets(message: Any, frame_id: str, targets: int | None = None) -> TargetSightings:
    """Return the targets in a PointCloud2, in order of their ids, NaN where one was not seen.

    x, y may be float32 or float64 and the points in any order; fields other than x, y and id may
    be missing. Tag trackers write 0, 0 for unseen targets, so 0, 0 means "not seen", except for a
    target at the clamp. Raises MessageError for a frame other than `frame_id`, a missing field,
    ids that are not 0, 1, ... once each, and a number of points other than `targets` (None: any).
    """
    with usable(POINTS_TYPE):
        stamp_ns, found = nanoseconds(message.header.stamp), str(message.header.frame_id)
    if found != frame_id:
        raise MessageError(
            f'targets are in frame {found!r}, but must be in {frame_id!r}', reason='wrong_frame'
        )
    points = cloud_points(message)
    kinds = {name: points.dtype[name].kind for name in points.dtype.names or ()}
    for name, kind, what in (('x', 'f', 'float'), ('y', 'f', 'float'), ('id', 'iu', 'int32')):
        if kinds.get(name, ' ') not in kind:
            wrong = 'is no' if name in kinds else 'is missing: it must be'
            raise MessageError(f'the field {name} of targets {wrong} {what}', reason='wrong_field')
    if targets is not None and points.size != targets:
        raise MessageError(
            f'there are {points.size} points in targets, but the arm has {targets} targets: '
            'every message must have one point per target, NaN if it was not seen. For another '
            'arm, use --model (calibrate: --arm; a node: the parameter model_file)',
            reason='wrong_targets',
        )
    ids = points['id'].tolist()
    if ids != list(range(points.size)):  # the points may be in any order
        order = sorted(range(points.size), key=ids.__getitem__)
        points = points[order]
        if points['id'].tolist() != list(range(points.size)):
            raise MessageError(
                f'the ids of targets must be 0 to {points.size - 1}, each once, not '
                f'{", ".join(str(number) for number in ids[:30])}',
                reason='wrong_targets',
            )
    table = np.full((len(_OF_A_TARGET), points.size), np.nan)
    for row, name in zip(table, _OF_A_TARGET, strict=True):
        if name in kinds:
            row[:] = points[name]
    seen = np.asarray(are_numbers(table[:2]).all(axis=0))
    seen[1:] &= (table[:2, 1:] != 0.0).any(axis=0)
    if not seen.all():
        table[:, ~seen] = np.nan
    columns = dict(zip(_OF_A_TARGET, freeze(table), strict=True))
    return TargetSightings(stamp_ns=stamp_ns, **columns)


def pressure_row(message: Any, settings: EstimatorSettings, _: int | None) -> tuple[int, Array]:
    """Return stamp and gauge pressure (1,) Pa of a FluidPressure."""
    reading = decode_pressure(message)
    return reading.stamp_ns, np.array([settings.pressure.gauge(reading.pressure)])


def wrench_row(message: Any, settings: EstimatorSettings, _: int | None) -> tuple[int, Array]:
    """Return stamp and end load (3,) N, N, N m of a WrenchStamped; UnusableTopic: wrong frame."""
    reading = decode_wrench(message)
    sentence = wrong_frame(settings, reading)
    if sentence:
        raise UnusableTopic(sentence)
    load = base_wrench(settings, reading)
    return load.stamp_ns, np.array([load.force_x, load.force_y, load.moment])


def targets_row(
    message: Any, settings: EstimatorSettings, targets: int | None
) -> tuple[int, Array]:
    """Return stamp and coordinates (2, targets) m of a PointCloud2; UnusableTopic: no targets."""
    try:
        sightings = decode_targets(message, settings.frame_id, targets)
    except MessageError as error:
        raise UnusableTopic(str(error)) from error
    return sightings.stamp_ns, np.array([sightings.x, sightings.y])


def tip_pose_row(message: Any, settings: EstimatorSettings, _: int | None) -> tuple[int, Array]:
    """Return stamp and x, y (m), heading (rad) of the tip, in the frame of the message."""
    reading = decode_tip_pose(message)
    return reading.stamp_ns, np.array([reading.x, reading.y, reading.heading])


def imu_row(message: Any, settings: EstimatorSettings, _: int | None) -> tuple[int, Array]:
    """Return stamp, specific force (m/s^2) and turn rate (rad/s) in the base frame, (4,).

    UnusableTopic: wrong frame.
    """
    reading, turn = decode_imu(message), turn_of(settings.imu_from_base)
    force, rate = np.array([reading.x, reading.y, reading.z]), np.array(reading.rate)
    if turn is not None:
        rotation = rotation_matrix(turn)
        return reading.stamp_ns, np.append(rotation @ force, rotation[2] @ rate)
    if reading.frame_id != settings.frame_id:
        raise UnusableTopic(
            f'base_imu in frame {reading.frame_id!r}, but /tf_static has no transform from it to '
            f'{settings.frame_id!r}: set imu_from_base (--imu-from-base)'
        )
    return reading.stamp_ns, np.append(force, rate[2])


PRESSURE = Sensor(
    name='pressure',
    type=PRESSURE_TYPE,
    label='pressure reading',
    components=(Component(name='pressure', kind='pressure', shown_unit='kPa', shown_per_si=1e-3),),
    decode=decode_pressure,
    row=pressure_row,
    message=pressure_message,
    needed=lambda settings: True,
)
END_WRENCH = Sensor(
    name='end_wrench',
    type=WRENCH_TYPE,
    label='end wrench',
    components=(
        Component(name='force_x', kind='force', shown_unit='N'),
        Component(name='force_y', kind='force', shown_unit='N'),
        Component(name='moment', kind='moment', shown_unit='mN m', shown_per_si=1e3),
    ),
    decode=decode_wrench,
    row=wrench_row,
    message=wrench_message,
    needed=lambda settings: settings.wrench_required,
)
TARGETS = Sensor(
    name=TARGETS_OUTPUT.name,
    type=TARGETS_OUTPUT.type,
    label='frame',
    components=tuple(
        Component(name=name, kind='length', shown_unit='mm', shown_per_si=1e3) for name in 'xy'
    ),
    decode=partial(decode_targets, frame_id=BASE_FRAME),
    row=targets_row,
    message=lambda stamp_ns, row, *end: targets_message(stamp_ns, row[0], row[1], *end),
    needed=lambda settings: settings.watch_targets,
    per_target=True,
)
TIP_POSE = Sensor(
    name='tip_pose',
    type=TIP_POSE_TYPE,
    label='tip pose',
    components=(
        Component(name='tip_x', kind='length', shown_unit='mm', shown_per_si=1e3, optional=True),
        Component(name='tip_y', kind='length', shown_unit='mm', shown_per_si=1e3, optional=True),
        Component(
            name='tip_heading',
            kind='angle',
            shown_unit='deg',
            shown_per_si=math.degrees(1.0),
            optional=True,
        ),
    ),
    decode=decode_tip_pose,
    row=tip_pose_row,
    message=tip_pose_message,
)
BASE_IMU = Sensor(
    name='base_imu',
    type=IMU_TYPE,
    label='base_imu reading',
    components=(
        *(
            Component(name=f'imu_a{axis}', kind='acceleration', shown_unit='m/s^2')
            for axis in 'xyz'
        ),
        Component(name='imu_wz', kind='turn_rate', shown_unit='rad/s', optional=True),
    ),
    decode=decode_imu,
    row=imu_row,
    message=imu_message,
)
# The end load of a string with known tension: not measured by a sensor, and never attributed to
# one.
STRING_WRENCH = replace(END_WRENCH, name='string_wrench', label='pull of the string')
SENSORS: tuple[Sensor[Any], ...] = (
    PRESSURE,
    END_WRENCH,
    TARGETS,
    TIP_POSE,
    BASE_IMU,
)  # fmt: skip
FIXED_FRAMES, FRAMES = (
    Input(
        name=name,
        type=TRANSFORM_TYPE,
        decode=partial(decode_frames, fixed=name == 'tf_static'),
        shared=True,
    )
    for name in ('tf_static', 'tf')
)
# In order of priority at equal stamps: the inputs of an estimate precede the pressure, which
# triggers it.
OF_ESTIMATOR: tuple[Input[Any], ...] = (
    FIXED_FRAMES,
    FRAMES,
    BASE_IMU,
    END_WRENCH,
    PRESSURE,
    TARGETS,
)
OF_FUSION: tuple[Input[Any], ...] = (FIXED_FRAMES, FRAMES, BASE_IMU, END_WRENCH, TARGETS, PRESSURE)
FUSED = 'fused'  # namespace of the estimates of the fusion


def gravity_inputs(source: GravitySource) -> tuple[Input[Any], ...]:
    """Return the input topics for the direction of gravity."""
    if source.frame:
        return FIXED_FRAMES, FRAMES
    return (FIXED_FRAMES, BASE_IMU) if source.uses_imu else ()


def arrival_order(sensors: Iterable[Input[Any]]) -> ArrivalOrder[Any]:
    """Return the processing order of these sensors, which are given in the order of ties."""
    return ArrivalOrder([sensor.name for sensor in sensors], PRESSURE.name)


def is_estimated(topic: str) -> bool:
    """Whether a topic is named like a sensor but contains estimates of the fusion."""
    *_, space, name = ('', *topic.split('/'))
    return space == FUSED and any(name == sensor.name for sensor in SENSORS)
