"""What all errors together move: the covariance of the tip, the deviations along the arm."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.jit import inner, kernel
from pneunet_ros.measurement.noise_jacobian import propagate_covariance
from pneunet_ros.measurement.second_order import (
    DEFAULTS,
    KINDS,
    leading_error,
    second_order_factor,
    SecondOrder,
)
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.solver import columns as col
from pneunet_ros.solver.linearization import station_changes
from pneunet_ros.solver.settings import SOLVER
from pneunet_ros.solver.sides import Beside, Response, second_difference, solve_sides

NO_SIDES, UNBOUNDED = -1, -2  # why errors are not carried to second order, or not at all
NO_MIXING, NO_PLACES = np.zeros((0, 0)), freeze(np.zeros(0))


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
class SeenShape:
    """Where along an arm (places,) m its shape was measured, and its std (2, places) m.

    Errors whose linear parts cancel at the places seen, and whose second order does not, are no
    errors of one sigma any more: the measurements bound them where the second order is as large as
    their noise.
    """

    arclength: Array
    std: Array


NOT_SEEN = SeenShape(arclength=NO_PLACES, std=np.zeros((2, 0)))


def propagate_errors(
    sensitivity: Sensitivity, noise: Array, arclength: Array, seen: SeenShape | None = None
) -> PropagatedErrors | None:
    """Carry errors through a solved rod, to second order.

    noise (sources, causes): the noise input matrix; arclength (stations,) m; seen: where the shape
    was measured, if it was. None where the shape has no bounded answer to its errors.
    """
    covariance, std = np.empty((3, 3)), np.empty((3, arclength.size))
    measured = NOT_SEEN if seen is None else seen
    response = sensitivity.for_kernels()
    beside = Beside.of(response)
    which = carry_errors(
        noise,
        sensitivity.tip,
        NO_MIXING if sensitivity.mixing is None else sensitivity.mixing,
        response,
        KINDS[sensitivity.stable],
        np.array(DEFAULTS.steps),
        SOLVER.frame_iterations,
        SOLVER.tolerance,
        arclength,
        frozen_array(measured.arclength),
        measured.std,
        beside,
        covariance,
        std,
    )
    if which == UNBOUNDED:
        return None
    curved = None
    if which != NO_SIDES:
        curved = SecondOrder(sensitivity=sensitivity, beside=beside, step=DEFAULTS.steps[which])
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
    seen: Array,
    seen_std: Array,
    beside: Beside,
    covariance: Array,
    std: Array,
) -> int:
    """Do what `propagate_errors` does; returns at which of the steps, NO_SIDES or UNBOUNDED.

    tip (causes, 3): the sensitivity of the free end; mixing (causes, single causes), of size 0
    where a cause is single; kind and steps: as of `solve_sides`; seen (places,) m and seen_std (2,
    places) m, of size 0 where the shape was not measured. Fills the rods beside the solution,
    covariance (3, 3) and std (3, stations).
    """
    direction = leading_error(tip, noise)
    if mixing.size:
        direction = single_causes(direction, mixing)
    which = solve_sides(response, direction, kind, steps, most_iterations, tolerance, beside)
    further = np.zeros((col.CURVATURE, arclength.size))
    if which >= 0:
        factor = second_order_factor(steps[which])
        second_difference(response, beside, arclength, factor, further)
        if seen.size:
            at_seen = np.empty((col.CURVATURE, seen.size))
            second_difference(response, beside, seen, factor, at_seen)
            square = 0.0
            for i in range(2):
                for place in range(seen.size):
                    square += (at_seen[i, place] / seen_std[i, place]) ** 2
            share = 1.0 / max(1.0, math.sqrt(square))
            for i in range(col.CURVATURE):
                for station in range(arclength.size):
                    further[i, station] *= share
    elif not seen.size:
        return UNBOUNDED
    panels, nodes, causes = response.panels, response.nodes, len(response.node_changes)
    stations = np.empty((causes, col.FIELD_COUNT, arclength.size))
    station_changes(
        panels,
        nodes,
        response.knots,
        response.rotation,
        response.panel_changes,
        response.rotation_changes,
        response.node_changes,
        arclength,
        stations,
    )
    if mixing.size:
        stations = mixed_stations(stations, mixing)
    if not propagate_covariance(noise, tip, stations, further, covariance, std):
        return UNBOUNDED
    return which


@inner
def single_causes(amounts: Array, mixing: Array) -> Array:
    """Return the single causes (single,) that amounts of the causes (causes,) come to."""
    single = np.zeros(mixing.shape[1])
    for cause in range(mixing.shape[0]):
        for i in range(single.size):
            single[i] += amounts[cause] * mixing[cause, i]
    return single


@inner
def mixed_stations(stations: Array, mixing: Array) -> Array:
    """Return the changes (causes, 6, n) per cause, of those per single cause."""
    mixed = np.zeros((mixing.shape[0], stations.shape[1], stations.shape[2]))
    for cause in range(mixing.shape[0]):
        for single in range(mixing.shape[1]):
            share = mixing[cause, single]
            for field in range(stations.shape[1]):
                for i in range(stations.shape[2]):
                    mixed[cause, field, i] += share * stations[single, field, i]
    return mixed
