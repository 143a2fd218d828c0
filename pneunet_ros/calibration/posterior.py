"""The full posterior of a calibration, which is the prior of the next one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.calibration.parameters import PriorState
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosteriorState(PriorState):
    """Mean and covariance of all parameters of a fit: the prior of the next one.

    pressure (rows,) Pa and arclength (knots,) s / l of the table of kappa_p0; kind and stiffness
    (N m^2) of the moment law's parameters over low to high (Pa), kind '' if none was fitted.
    shapes, elongates: as in `Parameters`, 0 for as many as there are knots. information (n, n):
    information of all recordings so far on the values, without the prior.
    """

    pressure: Array
    arclength: Array
    kind: str
    stiffness: float
    low: float
    high: float
    information: Array
    shapes: int = 0
    elongates: bool | None = None

    def __post_init__(self) -> None:
        """Check that the shapes of the arrays agree."""
        for name in ('pressure', 'arclength', 'values', 'placement'):
            values = getattr(self, name)
            object.__setattr__(self, name, frozen_array(values, (np.size(values),)))
        shape = (self.values.size,) * 2
        object.__setattr__(self, 'information', frozen_array(self.information, shape))
        size = self.values.size + self.placement.size
        object.__setattr__(self, 'covariance', frozen_array(self.covariance, (size, size)))

    def has_tip(self, painted: int) -> bool:
        """Whether the last target is the measured tip, added to this many targets."""
        return self.placement.size == 2 * (painted + 1)


def all_information(fit: Fit) -> Array:
    """Return the information of the recordings of a fit and of the previous ones it continues."""
    total, earlier = np.array(fit.information), fit.parameters.earlier
    if isinstance(earlier, PosteriorState):
        size = earlier.values.size
        total[:size, :size] += earlier.information
    return total


def posterior_of(fit: Fit, low: float, high: float) -> PosteriorState:
    """Return the posterior of a fit; low, high (Pa): the range of its moment law."""
    law = fit.parameters.law
    return PosteriorState(
        pressure=fit.parameters.pressure,
        arclength=fit.parameters.arclength,
        kind='' if law is None else law.kind,
        stiffness=0.0 if law is None else law.stiffness,
        low=low,
        high=high,
        shapes=fit.parameters.shapes or 0,
        elongates=fit.parameters.elongates,
        values=fit.values,
        placement=fit.placement.ravel(),
        covariance=fit.shared_covariance,
        information=all_information(fit),
    )
