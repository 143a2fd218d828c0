"""The valve of the virtual lab: how the pressure follows what is commanded."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Valve:
    """A pressure regulator: of first order, and no faster than its supply.

    p' = (command - p) / time_constant, at most rate_limit; all numbers are invented.
    """

    time_constant: float = quantity(
        0.1, unit='s', meaning='of the valve; 0.0: none', bounds=(0.0, 100.0), source='invented'
    )
    rate_limit: float = quantity(
        4e4,
        unit='Pa/s',
        meaning='largest rate at which the valve fills or vents',
        bounds=(1.0, 1e9),
        source='invented',
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'valve', RequestError)

    def pressure(self, start: float, command: float, seconds: Array) -> Array:
        """Return the pressures (n,) Pa at times (n,) s after it was `start`, exactly."""
        way = abs(command - start)
        # Limited until what is left is slow enough, and exponential from then on.
        left = min(way, self.rate_limit * self.time_constant)
        limited = (way - left) / self.rate_limit
        after = np.maximum(seconds - limited, 0.0)
        share = np.exp(-after / self.time_constant) if self.time_constant > 0.0 else 1.0
        remaining = np.where(seconds < limited, way - self.rate_limit * seconds, left * share)
        return freeze(command - math.copysign(1.0, command - start) * remaining)
