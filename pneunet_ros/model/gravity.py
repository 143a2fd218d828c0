"""Direction of gravity in the base frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import re
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantity

OUT_OF_PLANE = 'out_of_plane'
IMU = 'imu'
FIXED = '='  # not the name of a frame
ROUNDING = 1e-3  # a unit vector written with three digits may be longer than 1 by this much
FRAME_NAME = re.compile(r'/?[A-Za-z_][\w/.-]*')
ALLOWED = (
    f'must be {OUT_OF_PLANE}, or x and y of the unit vector that points down, in the base frame, '
    f'as [0, -1]; shorter if the plane is tilted. For a base that rotates, use {IMU}, or the '
    'name of a tf frame whose z axis points up'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity:
    """In-plane components of the unit vector along gravity.

    Both are zero if gravity is normal to the bending plane, because the weight then has no effect.
    source: of the measured direction. Empty: `base_imu`, if there is one; `FIXED`: none; `IMU`:
    only `base_imu`; any other text: the name of a tf frame whose z axis points up.
    """

    x: float = quantity(0.0, unit='-', meaning='share of gravity along E1', bounds=(-1.0, 1.0))
    y: float = quantity(0.0, unit='-', meaning='share of gravity along E2', bounds=(-1.0, 1.0))
    source: str = ''

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_quantities(self, 'gravity')

    @property
    def is_measured(self) -> bool:
        """Whether only a sensor or a frame gives the direction of gravity."""
        return self.source not in ('', FIXED)

    def difference(self, measured: Array) -> Array:
        """Return the difference of gravity (..., 2), in g, from this one."""
        return np.asarray(measured - np.array([self.x, self.y]))

    @property
    def direction(self) -> str | list[float]:
        """The direction as written to a model file."""
        if self.is_measured:
            return self.source
        return OUT_OF_PLANE if self.x == self.y == 0.0 else [self.x, self.y]


def gravity_of(direction: Any, *, fixed: bool = False) -> Gravity:
    """Return the gravity for a direction.

    Args:
        direction: `out_of_plane`; x and y of the unit vector that points down in the base frame,
            as two numbers or as a text such as `0, -1`; `imu`; or the name of a tf frame.
        fixed: whether numbers take precedence over `base_imu`.

    Returns:
        The gravity.

    Raises:
        ModelError: anything else.
    """
    source, values = FIXED if fixed else '', direction
    if isinstance(direction, str):
        if direction == OUT_OF_PLANE:
            return Gravity(source=source)
        if FRAME_NAME.fullmatch(direction) and direction not in ('nan', 'inf'):
            return Gravity(source=direction.lstrip('/'))
        values = re.split(r'[,\s]+', direction.strip('[] '))
    if not isinstance(values, Sequence) or len(values) != 2:
        raise ModelError(f'gravity.direction {ALLOWED}, not {direction!r}', reason='no_direction')
    try:
        x, y = (math.nan if isinstance(value, bool) else float(value) for value in values)
    except (TypeError, ValueError):
        raise ModelError(
            f'gravity.direction {ALLOWED}, not {direction!r}', reason='no_direction'
        ) from None
    length = math.hypot(x, y)
    if not length <= 1.0 + ROUNDING:
        hint = f': divide by {length:.4g}' if math.isfinite(length) else ''
        raise ModelError(
            f'gravity.direction {ALLOWED}, not {direction!r}{hint}', reason='no_direction'
        )
    longer = max(length, 1.0)
    return Gravity(x=x / longer, y=y / longer, source=source)
