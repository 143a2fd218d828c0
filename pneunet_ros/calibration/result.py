"""The result of a fit: the model, its uncertainty, and its residuals in every recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.calibration.parameters import Parameters, PosteriorState, reference_of
from pneunet_ros.calibration.settings import CONSISTENCY
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A fitted model: values (n,) of the parameters, their covariance, and all runs.

    placement (2, targets) m, along tangent and normal, and shared_covariance that of parameters
    and placement together. information (n, n) of the data alone on the parameters (disturbances
    integrated out), information_vector (n,) their linear term. disturbance: all unknowns of
    `Disturbances`, m; origin (2,) m: offset of the base frame from the neutral line. log_evidence:
    of the runs, with the normal approximation of the posterior, up to a constant. `converged` and
    `status`: how the search ended.
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

    @property
    def noise_ratio(self) -> float:
        """The rms of the whitened residual; 1 = noise only."""
        return math.sqrt(self.chi_squared / max(self.dof, 1))

    @property
    def as_noise(self) -> bool:
        """Whether the residual is as small as noise alone."""
        return self.chi_squared <= CONSISTENCY.as_noise * max(self.dof, 1)

    @property
    def all_information(self) -> Array:
        """The information of the recordings of this fit and of earlier fits that it continues."""
        total, earlier = np.array(self.information), self.parameters.earlier
        if earlier is not None:
            size = earlier.values.size
            total[:size, :size] += earlier.information
        return total

    def posterior(self, low: float, high: float) -> PosteriorState:
        """Return the posterior of the fit; low, high (Pa): the range of its moment law."""
        law = self.parameters.law
        return PosteriorState(
            pressure=self.parameters.pressure,
            arclength=self.parameters.arclength,
            kind='' if law is None else law.kind,
            stiffness=0.0 if law is None else law.stiffness,
            low=low,
            high=high,
            shapes=self.parameters.shapes or 0,
            elongates=self.parameters.elongates,
            arm=reference_of(self.parameters.frame),
            values=self.values,
            placement=self.placement.ravel(),
            covariance=self.shared_covariance,
            information=self.all_information,
        )

    def widened(self, errors: Array) -> Fit:
        """Return the fit with errors (parameters, errors) added to its covariance."""
        if not errors.size:
            return self
        added, shared = errors @ errors.T, self.shared_covariance.copy()
        size = len(added)
        shared[:size, :size] += added
        return replace(
            self,
            covariance=frozen_array(self.covariance + added),
            shared_covariance=frozen_array(shared),
        )
