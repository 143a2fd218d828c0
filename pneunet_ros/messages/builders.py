"""Building blocks of messages: a topic, a header, a path, points, an array.

ROS is not imported: the classes come from `MessageTypes`. A live node (rclpy classes) and a
recording (rosbags classes) use the same code, so that their messages are bitwise equal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
import math
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND

PATH_TYPE = 'nav_msgs/msg/Path'
ARRAY_TYPE = 'std_msgs/msg/Float64MultiArray'
IMAGE_TYPE = 'sensor_msgs/msg/Image'
POINTS_TYPE = 'sensor_msgs/msg/PointCloud2'
POSE_TYPE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
UNREADABLE = 'unreadable'  # reason of a rejection: a message does not match the type of its topic
# Errors of missing fields, fields of another type, and infinite values of integers.
UNFIT = (AttributeError, TypeError, ValueError, OverflowError)

# The rows of a curvature along the arm, estimated or measured.
CURVATURE_ROWS = ('arclength', 'curvature', 'intrinsic_curvature', 'moment', 'std_curvature')

_POINT_FIELD_DATATYPE = {'<i4': 5, '<f4': 7, '<f8': 8}


class Stamped(Protocol):
    """A result with the stamp of its reading."""

    @property
    def stamp_ns(self) -> int:
        """The stamp of the reading on which it is based."""


ReadingType = TypeVar('ReadingType')
Result = TypeVar('Result', bound=Stamped)  # computed from readings, and published


class MessageTypes(Protocol):
    """The message classes of one ROS binding."""

    def __call__(self, type_name: str, /) -> Callable[..., Any]:
        """Return the class of a type such as 'nav_msgs/msg/Path'; its keywords are the fields."""

    def sequence(self, values: npt.NDArray[Any], /) -> Any:
        """Return the value for a message field of variable length from a contiguous array."""

    def __hash__(self) -> int:
        """Hash bindings by identity, so that constant message parts are cached for each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Input(Generic[ReadingType]):
    """An input topic: its last name, its type, and the conversion of a message to a reading.

    shared: whether all nodes of a robot share the topic.
    """

    direction: ClassVar[Literal['in', 'out']] = 'in'
    name: str
    type: str
    decode: Callable[[Any], ReadingType]
    shared: bool = False

    @property
    def topic(self) -> str:
        """The topic name used by the node: relative unless shared by the whole robot."""
        return f'/{self.name}' if self.shared else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Output(Generic[Result]):
    """An output topic: its name, its type, and the layout of its messages.

    `numbers(result)` returns all numbers of a message except its stamps, row by row in the order
    of the serialized message; `build(numbers, header, types)` builds the message from them. A
    `MessageSerializer` builds one message for each size, and then fills in the numbers in place.
    Without `numbers`, `build` takes the result itself, and every message is built.
    """

    direction: ClassVar[Literal['in', 'out']] = 'out'
    name: str
    type: str
    build: Callable[[Any, Any, MessageTypes], Any]
    numbers: Callable[[Result], npt.NDArray[Any]] | None = None

    def encode(self, result: Result, frame_id: str, types: MessageTypes) -> Any:
        """Build the message of a result."""
        content = result if self.numbers is None else self.numbers(result)
        return self.build(content, header(result.stamp_ns, frame_id, types), types)


def nanoseconds(stamp: Any) -> int:
    """Return the stamp of a header in ns; ValueError if it has none."""
    seconds, rest = int(stamp.sec), int(stamp.nanosec)
    if not 0 <= rest < NANOSECONDS_PER_SECOND:
        raise ValueError(f'nanosec = {rest} of its stamp is not within [0, 999999999]')
    return seconds * NANOSECONDS_PER_SECOND + rest


@contextmanager
def usable(name: str) -> Iterator[None]:
    """Raise MessageError if a message does not have the content of its type `name`."""
    try:
        yield
    except (*UNFIT, IndexError) as error:
        raise MessageError(
            f'a message is not a usable {name}: {error}', reason='unreadable'
        ) from error


def header_stamp(message: Any) -> int:
    """Return the stamp (ns) of a message's header; 0 without a valid stamp."""
    try:
        return nanoseconds(message.header.stamp)
    except UNFIT:
        return 0


def header(stamp_ns: int, frame_id: str, types: MessageTypes) -> Any:
    """Build a Header."""
    seconds, rest = divmod(int(stamp_ns), NANOSECONDS_PER_SECOND)
    stamp = types('builtin_interfaces/msg/Time')(sec=seconds, nanosec=rest)
    return types('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def pose_rows(x: Array, y: Array, theta: Array) -> Array:
    """Return a row per point of a curve: position (3) and heading quaternion (x, y, z, w)."""
    rows = np.zeros((x.size, 7))
    rows[:, 0] = x
    rows[:, 1] = y
    half = 0.5 * theta
    rows[:, 5] = np.sin(half)
    rows[:, 6] = np.cos(half)
    return rows


def path(rows: Array, heading: Any, types: MessageTypes) -> Any:
    """Build a Path from the rows of `pose_rows`, all poses with the header `heading`."""
    stamped, pose = types('geometry_msgs/msg/PoseStamped'), types('geometry_msgs/msg/Pose')
    point, quaternion = types('geometry_msgs/msg/Point'), types('geometry_msgs/msg/Quaternion')
    poses = [
        stamped(
            header=heading,
            pose=pose(
                position=point(x=x, y=y, z=z), orientation=quaternion(x=qx, y=qy, z=qz, w=qw)
            ),
        )
        for x, y, z, qx, qy, qz, qw in rows.tolist()
    ]
    return types(PATH_TYPE)(header=heading, poses=poses)


def multi_array(
    values: Array, heading: Any, types: MessageTypes, *, labels: tuple[str, str]
) -> Any:
    """Build a 2-D Float64MultiArray; a stride counts all elements from its dimension on.

    This message type has no header.
    """
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


def pose_with_covariance(rows: Array, heading: Any, types: MessageTypes) -> Any:
    """Build a PoseWithCovarianceStamped of one row: a row of `pose_rows`, then 36 covariances."""
    x, y, z, qx, qy, qz, qw = rows[0, :7].tolist()
    pose = types('geometry_msgs/msg/Pose')(
        position=types('geometry_msgs/msg/Point')(x=x, y=y, z=z),
        orientation=types('geometry_msgs/msg/Quaternion')(x=qx, y=qy, z=qz, w=qw),
    )
    return types(POSE_TYPE)(
        header=heading,
        pose=types('geometry_msgs/msg/PoseWithCovariance')(pose=pose, covariance=rows[0, 7:]),
    )


def point_cloud(
    points: npt.NDArray[Any], heading: Any, types: MessageTypes, *, is_dense: bool = True
) -> Any:
    """Build a PointCloud2 from a row of records; is_dense: no NaN in them."""
    return types(POINTS_TYPE)(
        header=heading,
        height=1,
        width=points.size,
        fields=list(_point_fields(points.dtype, types)),
        is_bigendian=False,
        point_step=points.dtype.itemsize,
        row_step=points.nbytes,
        data=types.sequence(points.view(np.uint8)),
        is_dense=is_dense,
    )


def image(pixels: Bytes, heading: Any, types: MessageTypes) -> Any:
    """Build an Image of grey levels (height, width), mono8, or colors (height, width, 3), bgr8."""
    height, width = pixels.shape[:2]
    return types(IMAGE_TYPE)(
        header=heading,
        height=height,
        width=width,
        encoding='mono8' if pixels.ndim == 2 else 'bgr8',
        is_bigendian=0,
        step=pixels[0].size,
        data=types.sequence(np.ascontiguousarray(pixels).reshape(-1)),
    )


@cache
def _point_fields(point: np.dtype[Any], types: MessageTypes) -> tuple[Any, ...]:
    """Describe a record of numbers by PointFields."""
    make = types('sensor_msgs/msg/PointField')
    assert point.fields is not None
    return tuple(
        make(
            name=name,
            offset=int(offset),
            datatype=_POINT_FIELD_DATATYPE[kind.base.str],
            count=math.prod(kind.shape),
        )
        for name, (kind, offset, *_) in point.fields.items()
    )
