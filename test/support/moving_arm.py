"""A model's arm before the camera of the virtual lab."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.motion import ArmMotion
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve, station_arclength

STATIONS = 225  # of a solve, from which places between them are interpolated


def motion_of(
    arm: Arm,
    pressure_range: tuple[float, float],
    force: tuple[float, float] = (0.0, 0.0),
    placement: Array | None = None,
) -> ArmMotion:
    """Return an arm under a constant end force (N) at pressures (Pa) of a range.

    placement (targets, 2) m: that of `ArmMotion`. Raises RequestError without an equilibrium.
    """

    def shape_at(pressure: float) -> Array:
        shape = solve(arm, pressure, force=force, stations=STATIONS)
        if not shape.converged:
            raise RequestError(f'the arm has no shape at {pressure:.6g} Pa: {shape.status}')
        return np.array([shape.x, shape.y, shape.theta])

    arclength = station_arclength(arm.length, STATIONS)
    return ArmMotion(shape_at, arclength, arm.target_arclength, pressure_range, placement)
