"""Many equilibria of one arm at once, around a known one: for fits, samples and sweeps.

The tangent at the known shape predicts every start; vector instructions do the rest. A rod that
this does not bring to equilibrium is solved by itself.
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
    linearized_ends,
    solve_rod,
    station_arclength,
    steady_pressure,
)
from pneunet_ros.model.perturbation import with_pressure_change
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.batch import evaluate_many, newton_many
from pneunet_ros.solver.boundary_value_problem import FINEST_DETAIL
from pneunet_ros.solver.collocation import ACCEPTED
from pneunet_ros.solver.rod import CUBIC, Rods
from pneunet_ros.solver.sensitivity import LOADS

MOST_ITERATIONS = 8
TOLERANCE = 1e-11  # rad, for the sum over all equations of the slowest rod of a block


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
    """Shapes at chamber pressures (n,) Pa under end forces (n, 2) N and moments (n,) or one, N m.

    `start` is a converged shape near them. The loads are the true ones: sensing effects do not
    enter; `history` as in `Arm.rods`. Raises RequestError for values of other shape, NaN or
    infinity, or a start without solution.
    """
    pressure = np.atleast_1d(np.asarray(pressure, dtype=np.float64))
    loads = np.empty((pressure.size, LOADS))
    try:
        loads[:, :2] = np.asarray(force, dtype=np.float64)
        loads[:, 2] = np.asarray(moment, dtype=np.float64)
    except ValueError:
        raise RequestError(
            f'{pressure.size} pressures need {pressure.size} x 2 forces and as many moments'
        ) from None
    if pressure.ndim != 1 or not (np.isfinite(pressure).all() and np.isfinite(loads).all()):
        raise RequestError('pressures, forces and moments must be finite numbers')
    if start.solution is None:
        raise RequestError(f'the start is no shape: {start.status}')
    arclength = station_arclength(arm.length, stations)
    rods = arm.rods(pressure, history)
    ends = np.concatenate([rods.clamp, loads], axis=1)
    guesses = predicted(arm, start, np.column_stack([loads, pressure]))
    nodes, residual = np.empty_like(guesses), np.empty(pressure.size)
    fields, detail = np.empty((6, pressure.size, stations)), np.empty(pressure.size)
    counts = np.array(start.solution.counts)
    record = (arm.length, rods.sections, rods.knots, rods.turning, ends, counts)
    newton_many(*record, guesses, MOST_ITERATIONS, TOLERANCE, nodes, residual)
    evaluate_many(*record, nodes, arclength, fields, detail)
    inside = np.array([arm.beyond_range(value) <= EXTRAPOLATION for value in pressure])
    converged = inside & (residual <= ACCEPTED) & (detail <= FINEST_DETAIL * arm.length)
    converged &= ~np.any(rods.sections[:, :, CUBIC] != 0.0, axis=1)
    for which in np.flatnonzero(~converged):
        shape = solve_alone(arm, rods.one(int(which)), loads[which], start, arclength)
        converged[which], residual[which] = shape.converged, shape.residual
        for field, name in enumerate(FIELDS):
            fields[field, which] = getattr(shape, name)
    return Shapes(
        arclength=arclength,
        **{name: freeze(fields[field]) for field, name in enumerate(FIELDS)},
        converged=converged,
        residual=frozen_array(residual),
    )


FIELDS = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')


def predicted(arm: Arm, start: Shape, causes: Array) -> Array:
    """Nodes (6 (panels + 1), n) for F1, F2, M and chamber pressure (n, 4), by a tangent."""
    assert start.solution is not None
    solution = start.solution
    chamber = steady_pressure(arm, start.pressure)
    _, change = with_pressure_change(arm, chamber)
    nodes, _, _ = linearized_ends(solution, *changes_on_mesh(solution, change))
    moved = causes - np.array([*start.force, start.end_moment, chamber])
    tangent = nodes.reshape(nodes.shape[0], -1)
    return np.ascontiguousarray(solution.nodes.reshape(-1, 1) + tangent.T @ moved.T)


def solve_alone(arm: Arm, rod: Rods, load: Array, start: Shape, arclength: Array) -> Shape:
    """One of the rods by the single solver."""
    true = Load(
        pressure=float(rod.pressure[0]),
        force_x=float(load[0]),
        force_y=float(load[1]),
        moment=float(load[2]),
    )
    return solve_rod(arm, rod, true, start.solution, arclength)
