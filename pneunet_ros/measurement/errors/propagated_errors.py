"""Propagation of all errors: covariance of the tip, standard deviations along the arm."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.measurement.errors.noise_jacobian import propagate_covariance
from pneunet_ros.measurement.errors.second_order import (
    KINDS,
    leading_error,
    second_order_factor,
    SecondOrder,
    STEPS,
)
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.settings import FRAME_ITERATIONS, SOLVER
from pneunet_ros.solver.sides import Response, second_difference, SideNodes, solve_sides

Indices = npt.NDArray[np.intp]
NO_SIDES, UNBOUNDED = -1, -2  # why errors are not carried to second order, or not at all
NO_MIXING, NO_STD = np.zeros((0, 0)), np.zeros((2, 0))
NOTHING_SEEN = np.zeros(0, np.intp)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PropagatedErrors:
    """Covariance (3, 3) of x, y (m), theta (rad) of the tip, and standard deviations.

    std (3, stations) of x, y (m) and curvature (1/m) along the arm. second_order: effect of
    errors beyond the linearization, included in both; None if there is none, or if the shape was
    measured.
    """

    tip_covariance: Array
    std: Array
    second_order: SecondOrder | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaceChanges:
    """Positions along an arm, ending with the tip, and their derivatives by each cause.

    arclength (places,) m; changes (causes, 6, places): from `Sensitivity.stations`.
    """

    arclength: Array
    changes: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenShape:
    """Arclengths at which the shape was measured, and the accuracy.

    at: stations and measured places (m) with their changes; stations: indices of the stations;
    seen: indices of the measured places; std (2, seen) m. If the first-order effects of errors
    cancel at the measured places but the second-order effects do not, the measurements limit the
    errors to less than one sigma: to the size at which the second order equals the noise.
    """

    at: PlaceChanges
    stations: Indices
    seen: Indices
    std: Array


def propagate_errors(
    sensitivity: Sensitivity, noise: Array, arclength: Array, seen: SeenShape | None = None
) -> PropagatedErrors | None:
    """Propagate errors through a solved rod, to second order.

    noise (sources, causes): the noise input matrix; arclength (stations,) m; seen: the measured
    places, if any, with the same stations. Returns None if the response of the shape to its errors
    is unbounded.
    """
    if seen is None:
        at = PlaceChanges(arclength=arclength, changes=sensitivity.stations(arclength))
    else:
        at = seen.at
    covariance, std = np.empty((3, 3)), np.empty((3, at.arclength.size))
    response = sensitivity.for_kernels()
    sides = SideNodes.of(response)
    which = carry_errors(
        noise,
        sensitivity.tip,
        NO_MIXING if sensitivity.mixing is None else sensitivity.mixing,
        response,
        KINDS[sensitivity.stable],
        np.array(STEPS),
        FRAME_ITERATIONS,
        SOLVER.tolerance,
        frozen_array(at.arclength),
        at.changes,
        NOTHING_SEEN if seen is None else seen.seen,
        NO_STD if seen is None else seen.std,
        sides,
        covariance,
        std,
    )
    if which == UNBOUNDED:
        return None
    curved = None
    if which != NO_SIDES:
        curved = SecondOrder(sensitivity=sensitivity, sides=sides, step=STEPS[which])
    if seen is not None:
        std = std.take(seen.stations, axis=1)
    return PropagatedErrors(
        tip_covariance=freeze(covariance), std=freeze(std), second_order=curved
    )


@kernel
def carry_errors(
    noise: Array,
    tip: Array,
    mixing: Array,
    response: Response,
    kind: int,
    steps: Array,
    most_iterations: int,
    tolerance: float,
    arclength: Array,
    changes: Array,
    seen: Indices,
    seen_std: Array,
    sides: SideNodes,
    covariance: Array,
    std: Array,
) -> int:
    """Kernel of `propagate_errors`; returns the failed step, NO_SIDES or UNBOUNDED.

    tip (causes, 3): the sensitivity of the free end; mixing (causes, single causes), of size 0 if
    every cause is single; kind and steps: as in `solve_sides`; changes (causes, 6, places) at
    places of increasing arclength (m), the last of them the tip; seen: indices of the measured
    places, empty if the shape was not measured; seen_std (2, seen) m. Fills the rods to both sides
    of the solution, covariance (3, 3) and std (3, places).
    """
    direction = leading_error(tip, noise)
    if mixing.size:
        direction = single_causes(direction, mixing)
    which = solve_sides(response, direction, kind, steps, most_iterations, tolerance, sides)
    second_order = np.zeros((col.CURVATURE, arclength.size))
    if which >= 0:
        factor = second_order_factor(steps[which])
        second_difference(response, sides, arclength, factor, second_order)
        square = 0.0
        for i in range(2):
            for k in range(seen.size):
                square += (second_order[i, seen[k]] / seen_std[i, k]) ** 2
        allowed = 1.0 / max(1.0, math.sqrt(square))
        for i in range(col.CURVATURE):
            for station in range(arclength.size):
                second_order[i, station] *= allowed
    elif not seen.size:
        return UNBOUNDED
    if not propagate_covariance(noise, tip, changes, second_order, covariance, std):
        return UNBOUNDED
    return which


@inner
def single_causes(amounts: Array, mixing: Array) -> Array:
    """Return amounts of the single causes (single,) for amounts of the causes (causes,)."""
    single = np.zeros(mixing.shape[1])
    for cause in range(mixing.shape[0]):
        for i in range(single.size):
            single[i] += amounts[cause] * mixing[cause, i]
    return single
