"""Limits for an arm during exploration."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.diagnosis.experiment_design import Experiment, pressures_at
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN


@dataclass(frozen=True, slots=True, kw_only=True)
class SafeSet:
    """Limits for the arm: gauge pressure (Pa) from low to high, largest force (N)."""

    low: float
    high: float
    force: float

    def __post_init__(self) -> None:
        """Check the order."""
        if not (self.low < self.high and self.force >= 0.0 and math.isfinite(self.force)):
            raise RequestError(
                f'the safe set is {self.low:g} to {self.high:g} Pa with at most {self.force:g} '
                'N: the second pressure must be larger, and the force 0 or more',
                reason='out_of_bounds',
            )

    @classmethod
    def of(cls, arm: Arm) -> SafeSet:
        """Return the calibrated range of a model; its weight as force if it was never loaded."""
        low, high = arm.pressure_range
        loads = np.zeros((0, 2)) if arm.domain is None else arm.domain.end_load[:, :2]
        force = float(np.hypot(*loads.T).max()) if loads.size else arm.weight
        # An arm under vacuum ends where its gauge reads noise at rest.
        rest = DOMAIN.pressure_noise * arm.sensors.pressure_std
        low, high = (low, min(high, 0.0)) if high <= min(rest, -low) else (max(low, 0.0), high)
        return cls(low=low, high=high, force=force or arm.weight)

    def corners(self, experiment: Experiment) -> Array:
        """Return the corners (k, 4) of an experiment: time s, pressure Pa, F1 and F2 N."""
        time, share, x, y = np.array(experiment.corners, dtype=np.float64).T
        pressure = pressures_at(share, (self.low, self.high))
        return np.column_stack([time, pressure, self.force * x, self.force * y])
