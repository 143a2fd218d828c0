"""Errors of the force sensor: offset and gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block, WrenchSeen

# Halved or doubled, it moves no figure of acceptance/sweep.py.
# Harmless error of offset (of the force scale) and gain; a sensor known to this is confirmed.
TOLERANCE = 0.015


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceSensor(Block):
    """Offset (N) of F1 and F2, and gain minus 1; scale (N) of forces.

    is_there: whether the sensor is used; it is not if the tip is declared free.
    """

    scale: float
    is_there: bool = True
    error_std: float = tuning(
        0.0003,
        'std of the gain error of a healthy force sensor, and of its offset',
        unit='of the force scale',
        source='sweep',
    )

    @property
    def std(self) -> Array:
        """Standard deviations of a healthy sensor."""
        return self.error_std * self.off_std

    @property
    def innocent_std(self) -> Array:
        """Standard deviations of harmless sensor errors."""
        return TOLERANCE * np.array([self.scale, self.scale, 1.0])

    @property
    def off_std(self) -> Array:
        """Standard deviations of a faulty sensor."""
        return np.array([self.scale, self.scale, 1.0])

    def on_wrench(self, seen: WrenchSeen) -> Array | None:
        """Add the offset and the gain error."""
        return np.column_stack([np.eye(2), seen.force]) if self.is_there else None
