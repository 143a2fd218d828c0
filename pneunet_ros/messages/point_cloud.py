"""The points of a PointCloud2 as a table of numbers, for any layout of fields."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import MessageError
from pneunet_ros.messages.builders import POINTS_TYPE, usable

# Largest size of a record in numpy.
_LARGEST_POINT = int(np.iinfo(np.intc).max)
# Kinds of numbers by the `datatype` of a PointField.
_KINDS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}


def cloud_points(message: Any) -> npt.NDArray[Any]:
    """Return the points of a PointCloud2 as one record per point, with named fields.

    Fields may be in any order and at any offset in a point, in either byte order; fields with more
    than one number are ignored. Raises MessageError if the message is inconsistent.
    """
    with usable(POINTS_TYPE):
        order = '>' if message.is_bigendian else '<'
        height, width = int(message.height), int(message.width)
        point_step, row_step = int(message.point_step), int(message.row_step)
        data = np.frombuffer(message.data, np.uint8)
        fields = [
            (str(item.name), f'{order}{_KINDS[item.datatype]}', int(item.offset))
            for item in message.fields
            if item.datatype in _KINDS and item.count == 1
        ]
    point = point_type(tuple(fields), point_step)
    if point_step < 1 and width:
        raise MessageError(f'points of {point_step} bytes hold no numbers', reason='wrong_shape')
    needed = (height - 1) * row_step + width * point_step if height and width else 0
    if row_step < width * point_step and height > 1:
        raise MessageError(
            f'rows of {row_step} bytes cannot hold {width} points', reason='cut_off'
        )
    if data.size < needed:
        raise MessageError(
            f'{data.size} bytes cannot hold {height} x {width} points of {point_step} bytes',
            reason='cut_off',
        )
    if not needed:
        return np.empty(0, point)
    rows = np.ndarray(
        (height, width), point, np.ascontiguousarray(data), strides=(row_step, point_step)
    )
    return rows.reshape(-1)


@lru_cache(maxsize=64)
def point_type(fields: tuple[tuple[str, str, int], ...], size: int) -> np.dtype[Any]:
    """Return the record type of fields (name, kind, offset) in a point of this many bytes.

    Raises MessageError if a name occurs twice, a field exceeds the point, or the point is too
    large.
    """
    if size > _LARGEST_POINT:
        raise MessageError(
            f'a point of {size} bytes is not possible: points have 1 to {_LARGEST_POINT} bytes',
            reason='too_large',
        )
    names = [name for name, _, _ in fields]
    if len(set(names)) < len(names):
        raise MessageError(f'a point has a field twice: {", ".join(names)}', reason='given_twice')
    for name, kind, offset in fields:
        if not 0 <= offset <= size - np.dtype(kind).itemsize:
            raise MessageError(
                f'the field {name} does not lie within the {size} bytes', reason='wrong_shape'
            )
    return np.dtype(
        {
            'names': names,
            'formats': [kind for _, kind, _ in fields],
            'offsets': [offset for _, _, offset in fields],
            'itemsize': max(size, 1),
        }
    )
