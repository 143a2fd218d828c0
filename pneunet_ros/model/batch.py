"""Solve many equilibria of one arm around a known one, for fits, samples and sweeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import DEFAULT_STATIONS, solve_rod, station_arclength
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.columns import END_LOAD_MOMENT, FIELD_COUNT, FIELDS, LOADS


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
        pressure: in the chamber, (n,) Pa gauge.
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
    fields = np.empty((FIELD_COUNT, pressure.size, stations))
    converged, residual = np.empty(pressure.size, dtype=np.bool_), np.empty(pressure.size)
    for index, (force_x, force_y, couple) in enumerate(loads.tolist()):
        rod = rods.record(index)
        chamber = float(rod.pressure[0])
        load = Load(pressure=chamber, force_x=force_x, force_y=force_y, moment=couple)
        shape = solve_rod(arm, rod, load, start.solution, arclength)
        converged[index], residual[index] = shape.converged, shape.residual
        fields[:, index] = [getattr(shape, name) for name in FIELDS]
    return Shapes(
        arclength=arclength,
        **{name: freeze(fields[field]) for field, name in enumerate(FIELDS)},
        converged=converged,
        residual=frozen_array(residual),
    )
