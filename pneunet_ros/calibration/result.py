"""What a fit hands over: the model, how sure it is, and every recording beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.parameters import Parameters
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedRun:
    """A run beside what the fitted model says of it.

    points (frames, 2, targets) m: the model alone, as measured; disturbance (frames, 2, targets)
    m: what placement and camera add; fields (frames, 6, targets) as of
    `solver.stations.at_stations`; whitened (frames,) the squared whitened residual and freedom
    (frames,) the number of its coordinates.
    Frames that have no equilibrium (`solved` False) count nothing.
    """

    run: RecordingData
    inputs: Inputs
    fields: Array
    points: Array
    disturbance: Array
    whitened: Array
    dof: Array
    solved: npt.NDArray[np.bool_]

    @property
    def residual(self) -> Array:
        """Measured minus predicted with the disturbances found, (frames, 2, targets) m."""
        return np.stack([self.run.x, self.run.y], axis=1) - self.points - self.disturbance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A fitted model: values (n,) of the unknowns, their covariance, and every run beside it.

    placement (2, targets) m, along tangent and normal, and shared_covariance that of unknowns and
    placement together. information (n, n) is that of the data alone on the unknowns of the model
    (disturbances integrated out) and pull (n,) the same data's linear term. disturbance: all
    unknowns of `Disturbances`, m. `converged` and `status` say how the search ended.
    """

    parameters: Parameters
    values: Array
    covariance: Array
    shared_covariance: Array
    information: Array
    information_vector: Array
    placement: Array
    disturbance: Array
    runs: tuple[FittedRun, ...]
    chi_squared: float
    dof: int
    steps: int
    converged: bool
    status: str

    @property
    def arm(self) -> Arm:
        """The arm with the fitted values."""
        return self.parameters.arm(self.values)
