"""What all errors together move: the covariance of the tip, the deviations along the arm."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.measurement.noise_jacobian import propagate_covariance
from pneunet_ros.measurement.second_order import second_order, SecondOrder
from pneunet_ros.model.equilibrium import Sensitivity

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PropagatedErrors:
    """Covariance (3, 3) of x, y (m), theta (rad) of the tip, and standard deviations.

    std (3, stations): of x, y (m) and curvature (1/m) along the arm. second_order: what errors
    move beyond the linearization; it is in both. None where there is none and the shape was seen.
    """

    tip_covariance: Array
    std: Array
    second_order: SecondOrder | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaceChanges:
    """Places along an arm, the last of them the tip, and what each cause changes there.

    arclength (places,) m; changes (causes, 6, places): as of `Sensitivity.stations`.
    """

    arclength: Array
    changes: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenShape:
    """Where along an arm its shape was measured, and how well.

    at: places (m) with its changes, of stations and of what was seen; stations: which of them are
    the stations; seen: which were seen; std (2, seen) m.
    """

    at: PlaceChanges
    stations: Indices
    seen: Indices
    std: Array

    def allowed(self, further: Array) -> float:
        """Return the share of an error to second order that would not have been seen.

        further (3, places): all of it. Errors whose linear parts cancel at the places seen, and
        whose second order does not, are no errors of one sigma any more: the measurements bound
        them where the second order is as large as their noise.
        """
        moved = further[:2].take(self.seen, axis=1) / self.std
        size = math.sqrt(float((moved**2).sum()))
        return 1.0 / max(1.0, size)


def propagate_errors(
    sensitivity: Sensitivity, noise: Array, arclength: Array, seen: SeenShape | None = None
) -> PropagatedErrors | None:
    """Carry errors through a solved rod, to second order.

    noise (sources, causes): the noise input matrix; arclength (stations,) m; seen: where the shape
    was measured, if it was, with the same stations. None where the shape has no bounded answer to
    its errors.
    """
    curved = second_order(sensitivity, noise)
    if seen is None:
        if curved is None:
            return None
        at = PlaceChanges(arclength=arclength, changes=sensitivity.stations(arclength))
    else:
        at = seen.at
    covariance, std = np.empty((3, 3)), np.empty((3, at.arclength.size))
    if not propagate_covariance(noise, sensitivity.tip, at.changes, covariance, std):
        return None
    if curved is not None:
        further = curved.stations(at.arclength)
        if seen is not None:
            further *= seen.allowed(further)
        covariance += further[:, -1:] * further[:, -1]
        std[:2] = np.hypot(std[:2], further[:2])
    if seen is not None:
        std = std.take(seen.stations, axis=1)
    return PropagatedErrors(
        tip_covariance=freeze(covariance), std=freeze(std), second_order=curved
    )
