"""Message classes and serialization for recordings with rosbags: ROS 2 Jazzy without ROS.

The types of Jazzy are built in; other types are registered from their definition in the recording.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import re
from typing import Any

import numpy.typing as npt
from pneunet_ros.core.errors import MessageError, RecordingError
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

SEPARATOR = '=' * 80 + '\n'  # between the definition of a type and those of its dependencies
ENCAPSULATIONS = (b'\0\0', b'\0\1')  # plain CDR, big-endian and little-endian
LARGEST_DEFINITION = 200_000  # characters
LONGEST_ARRAYS = 10_000  # elements of fixed arrays of non-numbers, each a line of generated code
IDL_HEAD = f'{SEPARATOR}IDL: '  # first characters of a definition in IDL


class RosbagsTypes:
    """The message classes of rosbags: plain dataclasses with numpy arrays."""

    def __call__(self, type_name: str, /) -> Callable[..., Any]:
        """Return the dataclass of a type of Jazzy."""
        return jazzy().types[type_name]

    def sequence(self, values: npt.NDArray[Any], /) -> Any:
        """Return the array itself."""
        return values


ROSBAGS_TYPES = RosbagsTypes()


@cache
def jazzy() -> Typestore:
    """Return the types of ROS 2 Jazzy; the first call takes 0.2 s."""
    return get_typestore(Stores.ROS2_JAZZY)


def serialize(message: Any, type_name: str) -> bytes:
    """Return little-endian CDR of a message of `ROSBAGS_TYPES`; MessageError if unfit."""
    try:
        return bytes(jazzy().serialize_cdr(message, type_name, little_endian=True))
    except Exception as error:
        # Generated code may raise any error for invalid content.
        raise MessageError(
            f'a {type_name} cannot be serialized: {error}', reason='not_serialized'
        ) from error


@cache
def store_for(type_name: str, definition: str) -> Typestore:
    """Return the types for reading a topic: those of Jazzy if identical, or its own.

    definition: the schema in the recording, '' if it has none. Raises RecordingError if the type
    is unknown and cannot be registered.
    """
    store = jazzy()
    if not definition:
        if type_name not in store.fielddefs:
            raise RecordingError(
                f'{type_name} is not a message type of ROS 2 Jazzy, and the recording does not '
                'define it',
                reason='unknown_type',
            )
        return store
    if len(definition) > LARGEST_DEFINITION:
        raise RecordingError(
            f'the definition of {type_name} in the recording has more than '
            f'{LARGEST_DEFINITION} characters',
            reason='too_large',
        )
    try:
        types = _parse(definition, type_name)
        if all(store.fielddefs.get(name, ((), ()))[1] == types[name][1] for name in types):
            return store
        if sum(map(_code_length, types.values())) > LONGEST_ARRAYS:
            raise RecordingError(
                f'the definition of {type_name} in the recording has fixed arrays of more than '
                f'{LONGEST_ARRAYS} elements that are not numbers',
                reason='too_large',
            )
        own_store = get_typestore(Stores.ROS2_JAZZY)
        for name in types:
            own_store.fielddefs.pop(name, None)
            own_store.types.pop(name, None)
        own_store.register(types)
        own_store.get_msgdef(type_name)
        return own_store
    except RecordingError:
        raise
    except Exception as error:
        # The parser, the code generated from a definition, and the lookup of a missing type may
        # all fail.
        raise RecordingError(
            f'the definition of {type_name} in the recording is not complete or cannot be parsed',
            reason='wrong_form',
        ) from error


def _parse(definition: str, type_name: str) -> dict[str, Any]:
    """Parse a definition and its dependencies, which follow it."""
    if not definition.startswith(IDL_HEAD):
        return dict(get_types_from_msg(definition, type_name))
    if _is_nested(definition):
        raise RecordingError(
            f'the definition of {type_name} in the recording has nested parentheses',
            reason='wrong_form',
        )
    types: dict[str, Any] = {}
    for part in definition.split(SEPARATOR)[1:]:
        types.update(get_types_from_idl(part.partition('\n')[2]))
    return types


def _is_nested(definition: str) -> bool:
    """Whether parentheses are nested, outside of string literals."""
    return '((' in re.sub(r'[^()]', '', re.sub(r'"(?:\\"|[^"])*"', '', definition))


def _code_length(parsed: Any) -> int:
    """Count the elements of fixed arrays of a type for which code will be generated."""
    return sum(
        content[1]
        for _, (kind, content) in parsed[1]
        if kind == Nodetype.ARRAY
        and (content[0][0] == Nodetype.NAME or content[0][1][0] == 'string')
    )


def deserialize(raw: bytes, type_name: str, store: Typestore) -> Any:
    """Return the message in serialized bytes; MessageError if they are not such a message."""
    if raw[:2] not in ENCAPSULATIONS:
        raise MessageError('it does not begin with a plain CDR header', reason='damaged')
    try:
        return store.deserialize_cdr(raw, type_name)
    except Exception as error:
        # Generated code may raise any error for invalid bytes.
        raise MessageError(str(error) or 'its size is wrong', reason='damaged') from error
