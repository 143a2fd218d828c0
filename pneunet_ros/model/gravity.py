"""Where gravity points: the direction of the arm's own weight in the base frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import re
from typing import Any

from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantity

OUT_OF_PLANE = 'out_of_plane'
ROUNDING = 1e-3  # a unit vector written with three digits may be longer than 1 by this much
ALLOWED = (
    f'must be {OUT_OF_PLANE}, or x and y of the unit vector that points down, in the base frame, '
    'as [0, -1]; a plane that is tilted has a shorter one'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity:
    """Part of the unit vector along gravity that lies in the plane of bending.

    Both are zero where gravity is normal to the plane: then the weight bends nothing.
    """

    x: float = quantity(0.0, unit='-', meaning='share of gravity along E1', bounds=(-1.0, 1.0))
    y: float = quantity(0.0, unit='-', meaning='share of gravity along E2', bounds=(-1.0, 1.0))

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_quantities(self, 'gravity')

    @property
    def is_neutral(self) -> bool:
        """Whether gravity is normal to the plane of bending."""
        return self.x == 0.0 and self.y == 0.0

    @property
    def direction(self) -> str | list[float]:
        """The direction as a model file has it."""
        return OUT_OF_PLANE if self.is_neutral else [self.x, self.y]


def gravity_of(direction: Any) -> Gravity:
    """Return the gravity of a direction.

    Args:
        direction: `out_of_plane`, or x and y of the unit vector that points down in the base
            frame, as two numbers or as a text such as `0, -1`.

    Returns:
        The gravity.

    Raises:
        ModelError: anything else.

    """
    values = direction
    if isinstance(direction, str):
        if direction == OUT_OF_PLANE:
            return Gravity()
        values = re.split(r'[,\s]+', direction.strip('[] '))
    if not isinstance(values, Sequence) or len(values) != 2:
        raise ModelError(f'gravity.direction {ALLOWED}, not {direction!r}')
    try:
        x, y = (math.nan if isinstance(value, bool) else float(value) for value in values)
    except (TypeError, ValueError):
        raise ModelError(f'gravity.direction {ALLOWED}, not {direction!r}') from None
    length = math.hypot(x, y)
    if not length <= 1.0 + ROUNDING:
        hint = f': divide by {length:.4g}' if math.isfinite(length) else ''
        raise ModelError(f'gravity.direction {ALLOWED}, not {direction!r}{hint}')
    longer = max(length, 1.0)
    return Gravity(x=x / longer, y=y / longer)
