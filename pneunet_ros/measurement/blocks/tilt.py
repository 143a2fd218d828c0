"""Direction of gravity relative to the model: a tilted base, or a hanging arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block


@dataclass(frozen=True, slots=True, kw_only=True)
class Tilt(Block):
    """Components x and y, in the bending plane, of the unit vector along gravity."""

    level_std: float = tuning(
        0.012,
        'std of the direction of gravity in the model file',
        unit='rad',
        source='convention: 0.7 degree, a table set up with a level',
    )
    any_tilt: float = tuning(
        0.17,
        'std of a tilted base',
        unit='rad',
        source='convention: 10 degrees, a table that is not level',
    )

    @property
    def std(self) -> Array:
        """Prior of a base that was not moved."""
        return np.full(2, self.level_std)

    @property
    def tilted_std(self) -> Array:
        """Standard deviations of a tilted base."""
        return np.full(2, self.any_tilt)

    @property
    def law_errors(self) -> tuple[Mapping[str, float], ...]:
        """The whole weight along x, then the whole weight along y."""
        return {'gravity.x': 1.0}, {'gravity.y': 1.0}
