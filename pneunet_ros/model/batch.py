"""Solve many equilibria of one arm at once, around a known one, for fits, samples and sweeps.

The tangent at the known shape gives every start; the rest is vectorized. Rods that do not converge
are solved separately.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.model.equilibrium import (
    changes_on_mesh,
    DEFAULT_STATIONS,
    is_stable,
    linearized_ends,
    solve_rod,
    station_arclength,
    steady_pressure,
)
from pneunet_ros.model.perturbation import with_pressure_change
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.batch import evaluate_batch, newton_batch
from pneunet_ros.solver.collocation import prepare
from pneunet_ros.solver.columns import (
    CUBIC,
    END_LOAD_MOMENT,
    FIELD_COUNT,
    FIELDS,
    FORCE_X,
    FORCE_Y,
    join_ends,
    LOADS,
    RIGIDITY,
    THETA,
)
from pneunet_ros.solver.interpolation import least_stretch
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import ACCEPTED, BATCH_ITERATIONS, BATCH_TOLERANCE, SOLVER
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shapes:
    """Centerlines of many rods at common stations, in the base frame.

    arclength (stations,) m; x, y (m), theta (rad), curvature, intrinsic_curvature (1/m) and moment
    (N m) are (rods, stations), NaN where `converged` (rods,) is False; residual (rods,) rad.
    """

    arclength: Array
    x: Array
    y: Array
    theta: Array
    curvature: Array
    intrinsic_curvature: Array
    moment: Array
    converged: npt.NDArray[np.bool_]
    residual: Array


def solve_many(
    arm: Arm,
    pressure: npt.ArrayLike,
    force: npt.ArrayLike,
    moment: npt.ArrayLike = 0.0,
    *,
    start: Shape,
    stations: int = DEFAULT_STATIONS,
    history: tuple[History, ...] | tuple[Array, ...] | None = None,
) -> Shapes:
    """Predict the shapes of one arm at many pressures and end loads, near a known shape.

    Args:
        arm: the calibrated arm.
        pressure: that of the chamber, (n,) Pa gauge.
        force: F1, F2 on the free end, (n, 2) N, in the base frame. Loads are true loads: sensing
            effects are not applied.
        moment: on the free end, (n,) or one for all, N m.
        start: a converged shape near all of them.
        stations: number of equally spaced points along the arm.
        history: as in `Arm.rods`; None: a settled arm.

    Returns:
        The shapes of n rods by Eq 4, as in `solve`; NaN if there is none.

    Raises:
        RequestError: arrays of wrong shape, NaN, infinity, or a start without solution.
    """
    pressure = np.atleast_1d(np.asarray(pressure, dtype=np.float64))
    loads = np.empty((pressure.size, LOADS))
    try:
        loads[:, :END_LOAD_MOMENT] = np.asarray(force, dtype=np.float64)
        loads[:, END_LOAD_MOMENT] = np.asarray(moment, dtype=np.float64)
    except ValueError:
        raise RequestError(
            f'{pressure.size} pressures need {pressure.size} x 2 forces and {pressure.size} '
            'moments',
            reason='wrong_shape',
        ) from None
    if pressure.ndim != 1 or not (np.isfinite(pressure).all() and np.isfinite(loads).all()):
        raise RequestError(
            'pressures, forces and moments must be finite numbers', reason='not_finite'
        )
    if start.solution is None:
        raise RequestError(
            f'the start has no equilibrium: {start.status}', reason='no_equilibrium'
        )
    arclength = station_arclength(arm.reach, stations)
    rods = arm.rods(pressure, history, loads)
    guesses = predict_nodes(arm, start, np.column_stack([loads, pressure]))
    nodes, residual = np.empty_like(guesses), np.empty(pressure.size)
    fields = np.empty((FIELD_COUNT, pressure.size, stations))
    detail, missed = np.empty(pressure.size), np.empty(pressure.size)
    batch = rods, loads, np.array(start.solution.counts)
    limits = BATCH_ITERATIONS, BATCH_TOLERANCE
    newton_batch(*batch, guesses, *limits, nodes, residual)
    evaluate_batch(*batch, nodes, arclength, fields, detail, missed)
    inside = np.array([arm.beyond_range(value) <= EXTRAPOLATION for value in pressure])
    fine = detail <= SOLVER.finest_detail * arm.length
    converged = inside & (residual <= ACCEPTED) & fine & (missed <= SOLVER.turn_per_panel)
    converged &= np.isfinite(fields[THETA]).all(axis=1)
    converged &= ~np.any(rods.sections[:, :, CUBIC] != 0.0, axis=1)
    converged &= ~rods.push.any(axis=(1, 2))  # pushes that rotate are solved one by one
    residual = np.maximum(residual, missed)
    springs = np.all(rods.sections[:, :, RIGIDITY] > 0.0, axis=1)
    for index in np.flatnonzero(converged).tolist():
        one = solved(rods, index, loads[index], nodes, start.solution)
        converged[index] = least_stretch(one.panels, one.nodes) >= SOLVER.shortest
        converged[index] &= not springs[index] or is_stable(one)
    for index in np.flatnonzero(~converged).tolist():
        shape = solve_alone(arm, rods.record(index), loads[index], start, arclength)
        converged[index], residual[index] = shape.converged, shape.residual
        for field, name in enumerate(FIELDS):
            fields[field, index] = getattr(shape, name)
    return Shapes(
        arclength=arclength,
        **{name: freeze(fields[field]) for field, name in enumerate(FIELDS)},
        converged=converged,
        residual=frozen_array(residual),
    )


def solved(rods: Rods, index: int, load: Array, nodes: Array, start: SolverNodes) -> SolverNodes:
    """Return one of the rods with its unknowns, of the nodes (6 (panels + 1), n) of all."""
    (ends,) = join_ends(rods.clamp[[index]], load[None])
    panels = np.empty_like(start.panels)
    own = rods.sections[index], rods.knots, rods.rotation[index], ends, np.array(start.counts)
    prepare(rods.length, *own, panels)
    unknowns = nodes[:, index].reshape(start.nodes.shape)
    return SolverNodes(panels=panels, ends=ends, nodes=unknowns, counts=start.counts)


def predict_nodes(arm: Arm, start: Shape, causes: Array) -> Array:
    """Predict nodes (6 (panels + 1), n) at F1, F2, M and chamber pressure (n, 4) by a tangent."""
    assert start.solution is not None
    solution = start.solution
    chamber = steady_pressure(arm, start.pressure)
    _, change = with_pressure_change(arm, chamber)
    change = change.without_loads()
    nodes, _, _ = linearized_ends(solution, *changes_on_mesh(solution, change))
    cause_change = causes - np.array([*start.force, start.end_moment, chamber])
    tangent = nodes.reshape(len(nodes), -1)
    return np.ascontiguousarray(solution.nodes.reshape(-1, 1) + tangent.T @ cause_change.T)


def solve_alone(arm: Arm, rod: Rods, load: Array, start: Shape, arclength: Array) -> Shape:
    """Solve one of the rods with the single solver."""
    true = Load(
        pressure=float(rod.pressure[0]),
        force_x=float(load[FORCE_X]),
        force_y=float(load[FORCE_Y]),
        moment=float(load[END_LOAD_MOMENT]),
    )
    return solve_rod(arm, rod, true, start.solution, arclength)
