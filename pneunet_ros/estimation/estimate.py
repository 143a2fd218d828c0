"""A shape predicted from readings, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.measurement.errors.propagated_errors import propagate_errors, PropagatedErrors
from pneunet_ros.measurement.errors.second_order import SecondOrder
from pneunet_ros.measurement.moving_arm import MotionEstimate
from pneunet_ros.model.domain_position import DomainPosition
from pneunet_ros.model.shape import Shape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeEstimate:
    """A shape predicted from readings, with its uncertainty; SI units, in the base frame.

    stamp_ns of the pressure reading; chamber_pressure: Pa; jacobian (3, 4): d(x, y, theta of the
    tip) / d(pressure in the chamber, F1, F2, M); tip_covariance (3, 3) of (x, y, theta); std_x,
    std_y (m) and std_curvature (1/m): per station, arrays (stations,); wrench_age: s, None if no
    wrench is needed; warnings: sentences about limits of the estimate. position: of the load
    relative to the domain of the model. gravity: as measured, along x and y, in g; None: as in the
    model.

    noise (sources, causes): noise input matrix, without the age of the wrench and the additional
    model error outside the domain; curved: second-order effects, including the linearization.
    Covariance and standard deviations follow from both; they are stored to avoid another
    linearization. motion: of the arm, None if the model has no `motion`; with motion, shape and
    standard deviations are those of the moving arm, but jacobian, noise and curved are those of
    its equilibrium.
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
    position: DomainPosition | None = None
    gravity: tuple[float, float] | None = None
    noise: Array | None = None
    curved: SecondOrder | None = None
    motion: MotionEstimate | None = None

    @property
    def second_order(self) -> SecondOrder | None:
        """Second-order effect of noise, for the comparison with measured targets.

        Computed on demand, so that an estimate does not wait for it.
        """
        if self.curved is None or self.noise is None or self.position is None:
            return self.curved
        if not any(self.position.error) and not self.wrench_age:
            return self.curved
        errors = propagate_errors(self.curved.sensitivity, self.noise, self.shape.arclength[-1:])
        return self.curved if errors is None else errors.second_order


def estimate_of(
    *,
    stamp_ns: int,
    shape: Shape,
    chamber_pressure: float,
    jacobian: Array,
    noise: Array,
    errors: PropagatedErrors,
    position: DomainPosition,
    wrench_age: float | None,
    notes: Sequence[str],
    motion: MotionEstimate | None = None,
    gravity: tuple[float, float] | None = None,
) -> ShapeEstimate:
    """Return the estimate of a solved shape with propagated errors; notes: notes to attach."""
    warnings = [*notes, *position.notes]
    if shape.stable is False:
        warnings.append('the equilibrium is unstable under dead load')
    curved = errors.second_order
    if curved is None or curved.step < 1.0:
        warnings.append('an error of one sigma leads to another equilibrium, or to none')
    if shape.extrapolated != position.extrapolated:
        shape = replace(shape, extrapolated=position.extrapolated)
    std_x, std_y, std_curvature = errors.std
    return ShapeEstimate(
        stamp_ns=stamp_ns,
        shape=shape,
        chamber_pressure=chamber_pressure,
        jacobian=jacobian,
        tip_covariance=errors.tip_covariance,
        std_x=std_x,
        std_y=std_y,
        std_curvature=std_curvature,
        wrench_age=wrench_age,
        warnings=tuple(warnings),
        position=position,
        gravity=gravity,
        noise=noise,
        curved=curved,
        motion=motion,
    )


Outcome = ShapeEstimate | Refusal | None
