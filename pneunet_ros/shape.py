"""What we claim: a shape, an estimate with its uncertainty, or a refusal with its reason."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.errors import RequestError

Array = npt.NDArray[np.float64]


def frozen_array(value: npt.ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return a read-only float64 array; raises RequestError when `shape` is given and differs."""
    array = np.asarray(value, dtype=np.float64, order='C')
    if array is value and array.shape == shape and not array.flags.writeable:
        return array
    if shape is not None and array.shape != shape:
        raise RequestError(f'an array of shape {shape} was expected, got {array.shape}')
    if array.flags.writeable:
        if array is value:
            array = array.copy()
        array.flags.writeable = False
    return array


def freeze(array: Array) -> Array:
    """Make an array that is this function's caller's own read-only, without a copy."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolverNodes:
    """The converged unknowns of the rod equations, from which a neighboring solve starts.

    `panels`, `ends` and `nodes` have the layout of `solver.collocation`; `counts` are the panels
    of each section of the moment law.
    """

    panels: Array
    ends: Array
    nodes: Array
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """The centerline of the arm in equilibrium, at stations along it, in the base frame.

    All arrays have one entry per station, from the clamp to the free end: material arclength (m),
    x and y (m), theta (rad), curvature and intrinsic curvature (1/m, per unstretched length),
    moment (N m). Where the solve failed (`converged` is False) all but `arclength` are NaN, and
    `status` says why.

    `residual` is the largest violation of the rod equations in rad; `stable` says whether the
    equilibrium is a minimum of energy under dead load (None: not defined, negative rigidity);
    `extrapolated` that the pressure lies outside the calibrated range.
    """

    arclength: Array
    x: Array
    y: Array
    theta: Array
    curvature: Array
    intrinsic_curvature: Array
    moment: Array
    force: tuple[float, float]
    end_moment: float
    pressure: float
    converged: bool
    status: str
    residual: float
    iterations: int
    stable: bool | None
    extrapolated: bool
    solution: SolverNodes | None

    @property
    def tip(self) -> tuple[float, float, float]:
        """Position (m) and heading (rad) of the free end."""
        return float(self.x[-1]), float(self.y[-1]), float(self.theta[-1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeEstimate:
    """A shape predicted from readings, with its uncertainty.

    `jacobian` (3, 4): d(x, y, theta of the tip) / d(pressure in the chamber, F1, F2, M).
    `tip_covariance` (3, 3) of (x, y, theta). `std_x`, `std_y` (m) and `std_curvature` (1/m) per
    station. `stamp_ns` is the pressure reading's; `warnings` are sentences about what limits the
    estimate.
    """

    stamp_ns: int
    shape: Shape
    chamber_pressure: float
    jacobian: Array
    tip_covariance: Array
    std_x: Array
    std_y: Array
    std_curvature: Array
    wrench_age: float | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A reading that gave no estimate: `reason` is a key for counting, `sentence` for a person.

    `error` tells that the estimator has stopped giving estimates, not just dropped one reading.
    """

    stamp_ns: int
    reason: str
    sentence: str
    error: bool


def same_values(left: Any, right: Any) -> bool:
    """Whether two claims are equal field by field, arrays to the last bit (NaN equals NaN)."""
    if type(left) is not type(right):
        return False
    if isinstance(left, np.ndarray):
        return bool(np.array_equal(left, right, equal_nan=True))
    if hasattr(left, '__dataclass_fields__'):
        return all(
            same_values(getattr(left, field.name), getattr(right, field.name))
            for field in fields(left)
        )
    return bool(left == right)
