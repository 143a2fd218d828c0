"""The result of a fit: the model, its uncertainty, and every recording compared with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pneunet_ros.calibration.parameters import Parameters
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A fitted model: values (n,) of the parameters, their covariance, and all runs.

    placement (2, targets) m, along tangent and normal, and shared_covariance that of parameters
    and placement together. information (n, n) is that of the data alone on the parameters
    (disturbances integrated out), information_vector (n,) the same data's linear term.
    disturbance: all unknowns of `Disturbances`, m; origin (2,) m: offset of the base frame from
    the neutral line. log_evidence: of the runs, with the normal approximation of the posterior, up
    to a constant. `converged` and `status`: how the search ended.
    """

    parameters: Parameters
    values: Array
    covariance: Array
    shared_covariance: Array
    information: Array
    information_vector: Array
    placement: Array
    disturbance: Array
    origin: Array
    runs: tuple[FittedRun, ...]
    chi_squared: float
    dof: int
    log_evidence: float
    steps: int
    converged: bool
    status: str

    @property
    def arm(self) -> Arm:
        """The arm with the fitted values."""
        return self.parameters.arm(self.values)

    def widened(self, errors: Array) -> Fit:
        """Return the fit with errors (parameters, errors) added to its covariance."""
        further, shared = errors @ errors.T, self.shared_covariance.copy()
        size = len(further)
        shared[:size, :size] += further
        return replace(
            self,
            covariance=frozen_array(self.covariance + further),
            shared_covariance=frozen_array(shared),
        )
