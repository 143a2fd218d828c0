"""The message classes of rclpy, for encoders that use only field names."""

from __future__ import annotations

import array
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy.typing as npt
from pneunet_ros.core.errors import RequestError
from pneunet_ros.messages.cdr_reader import read_message
from rclpy.serialization import deserialize_message, serialize_message


class RclpyTypes:
    """The message classes of rclpy; a `MessageTypes`."""

    def __call__(self, type_name: str, /) -> Callable[..., Any]:
        """Return the class of a type such as 'nav_msgs/msg/Path'."""
        return message_class(type_name)

    def sequence(self, values: npt.NDArray[Any], /) -> Any:
        """Return an array.array, which rclpy assigns as a whole instead of item by item."""
        return array.array(values.dtype.char, values.tobytes())


RCLPY_TYPES = RclpyTypes()


@cache
def message_class(type_name: str) -> Callable[..., Any]:
    """Import the class of a type such as 'nav_msgs/msg/Path'; RequestError if missing."""
    package, _, name = type_name.split('/')
    try:
        module = import_module(f'{package}.msg')
    except ModuleNotFoundError:
        raise RequestError(
            f'{type_name} is needed, but this ROS installation does not have the package '
            f'{package}. Install it (apt install ros-jazzy-{package.replace("_", "-")}; not '
            'every message package has a wheel on PyPI), or omit whatever needs it',
            reason='not_installed',
        ) from None
    found: Callable[..., Any] = getattr(module, name)
    return found


def has_message(type_name: str) -> bool:
    """Whether this ROS installation has a message type."""
    try:
        message_class(type_name)
    except RequestError:
        return False
    return True


def deserialize(raw: bytes, type_name: str) -> Any:
    """Deserialize a message; raises the errors of rclpy if the bytes are invalid."""
    message = read_message(raw, type_name)
    return deserialize_message(raw, message_class(type_name)) if message is None else message


def serialize(message: Any, type_name: str) -> bytes:
    """Return the little-endian CDR of a message; the bytes between its fields are undefined."""
    return bytes(serialize_message(message))
