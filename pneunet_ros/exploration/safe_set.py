"""Limits for an arm during exploration."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.exploration.experiment_design import Experiment, pressures_at
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN, LoadHull, PRESSURE
import scipy

SHARES = 1e6  # of a load: beyond the precision of the search for the border of the hull


@dataclass(frozen=True, slots=True, kw_only=True)
class SafeSet:
    """Limits for the arm: gauge pressure (Pa) from low to high, largest force (N).

    hull: the loads of the calibration, within which forces stay; None: the arm was never loaded.
    """

    low: float
    high: float
    force: float
    hull: LoadHull | None = None

    def __post_init__(self) -> None:
        """Check the order."""
        if not (self.low <= self.high and self.force >= 0.0 and math.isfinite(self.force)):
            raise RequestError(
                f'the safe set is {self.low:g} to {self.high:g} Pa with at most {self.force:g} '
                'N: the second pressure must not be smaller, and the force 0 or more',
                reason='out_of_bounds',
            )

    @classmethod
    def of(cls, arm: Arm) -> SafeSet:
        """Return the calibrated range of a model; its weight as force if it was never loaded."""
        low, high = arm.pressure_range
        loads = np.zeros((0, 2)) if arm.domain is None else arm.domain.end_load[:, :2]
        force = float(np.hypot(*loads.T).max()) if loads.size else arm.weight
        # The range of an arm under vacuum ends at the noise of the gauge at rest.
        rest = DOMAIN.pressure_noise * arm.sensors.pressure_std
        low, high = (low, min(high, 0.0)) if high <= min(rest, -low) else (max(low, 0.0), high)
        hull = arm.load_hull if force else None
        return cls(low=low, high=high, force=force or arm.weight, hull=hull)

    @property
    def loaded(self) -> tuple[float, float]:
        """The shares of the pressure range, between which the arm was loaded."""
        if self.hull is None or self.hull.scale[PRESSURE] == 0.0 or self.low == self.high:
            return 0.0, 1.0
        loads = self.hull.points[self.hull.points[:, :PRESSURE].any(axis=1)]
        rest, farthest = pressures_at(np.array([0.0, 1.0]), (self.low, self.high)).tolist()
        shares = (loads[:, PRESSURE] / self.hull.scale[PRESSURE] - rest) / (farthest - rest)
        return min(max(float(shares.min()), 0.0), 1.0), min(max(float(shares.max()), 0.0), 1.0)

    def within(self, experiment: Experiment) -> Experiment:
        """Scale all forces of an experiment by one factor that makes them safe.

        The forces between corners are then safe too, because the hull is convex.
        """
        if self.hull is None:
            return experiment
        time, share, x, y = np.array(experiment.corners, dtype=np.float64).T
        pressure = pressures_at(share, (self.low, self.high))
        loads = np.column_stack([self.force * x, self.force * y, np.zeros(time.size), pressure])
        factor = math.floor(SHARES * min(share_inside(self.hull, load) for load in loads)) / SHARES
        corners = np.column_stack([time, share, factor * x, factor * y])
        return replace(experiment, corners=tuple(map(tuple, corners.tolist())))

    def allows(self, experiment: Experiment) -> bool:
        """Whether the forces of an experiment, if any, are not reduced to zero."""
        return self.within(experiment).loaded == experiment.loaded

    def corners(self, experiment: Experiment) -> Array:
        """Return the corners (k, 4) of an experiment: time s, pressure Pa, F1 and F2 N."""
        time, share, x, y = np.array(self.within(experiment).corners, dtype=np.float64).T
        pressure = pressures_at(share, (self.low, self.high))
        return np.column_stack([time, pressure, self.force * x, self.force * y])


def share_inside(hull: LoadHull, load: Array) -> float:
    """Return the largest factor, up to 1, that scales the end load of a load (4,) into a hull.

    0 if the pressure is outside.
    """
    along, rest = hull.scale * load, hull.scale * load
    along[PRESSURE] = rest[:PRESSURE] = 0.0
    count = len(hull.points)
    # Unknowns: the weights of the points, which add up to 1, and the share.
    equations = np.zeros((len(load) + 1, count + 1))
    equations[:-1, :-1], equations[:-1, -1], equations[-1, :-1] = hull.points.T, -along, 1.0
    found = scipy.optimize.linprog(
        -np.eye(count + 1)[-1],
        A_eq=equations,
        b_eq=np.append(rest, 1.0),
        bounds=[(0.0, None)] * count + [(0.0, 1.0)],
    )
    return float(found.x[-1]) if found.success else 0.0
