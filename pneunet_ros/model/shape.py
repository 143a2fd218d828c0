"""The centerline of the arm in equilibrium."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.arrays import Array
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """The centerline of the arm in equilibrium, at stations along it, in the base frame.

    All arrays have one entry per station, from the clamp to the free end: material arclength (m),
    x and y (m), theta (rad), curvature and intrinsic curvature (1/m, per unstretched length),
    moment (N m). If the solve failed (`converged` is False), all except `arclength` are NaN, and
    `status` says why.

    `residual`: largest violation of the rod equations in rad, at the Gauss points and between them
    (a bound: about 20 times the error at stations). `stable`: whether the equilibrium is an energy
    minimum under dead load (None: undefined, negative rigidity); `extrapolated`: whether the
    pressure is outside the calibrated range.
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
