"""Apparent positions of misplaced targets: shifted along or across the arm.

Calibration, replay, diagnosis and fusion all use this module.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class PaintedTargets:
    """Offsets of targets from their nominal positions, x + i y (.., targets) m in the base frame.

    by_theta (m), by_curvature (m^2): derivatives of `displacement` by angle and curvature of the
    arm at the target; by_along, by_across (-): derivatives by the placement along and across the
    arm.
    """

    displacement: Complex
    by_theta: Complex
    by_curvature: Complex
    by_along: Complex
    by_across: Complex

    @property
    def to_arm(self) -> Complex:
        """Factor from the base frame to the frame of the arm (along + i across), (.., targets).

        Evaluated at the actual position of the target, not at the nominal position.
        """
        return np.asarray(1j * self.by_across.conj())

    def jacobian(self) -> Array:
        """Return the derivatives of x and y by the placements, (.., 2, targets, 2 targets).

        The placements along the arm come first, then those across it.
        """
        which = np.arange(self.by_along.shape[-1])
        jacobian = np.zeros((*self.by_along.shape[:-1], 2, which.size, 2 * which.size))
        jacobian[..., which, which] = in_plane(self.by_along)
        jacobian[..., which, which.size + which] = in_plane(self.by_across)
        return jacobian


def paint(theta: Array, curvature: Array, placement: Array) -> PaintedTargets:
    """Return targets painted placement (2, targets) m along and across the arm.

    theta (rad), curvature (1/m), both (.., targets) of the arm at their places.
    """
    along, across = placement
    chord, heading = along_the_arc(theta, curvature, along)
    displacement = chord + 1j * heading * across
    half = np.exp(1j * (theta + 0.5 * curvature * along))
    return PaintedTargets(
        displacement=displacement,
        by_theta=1j * displacement,
        by_curvature=0.5j * along * chord - heading * along * across,
        by_along=half * (1.0 + 0.5j * curvature * along) - curvature * across * heading,
        by_across=1j * heading,
    )


def along_the_arc(theta: Array, curvature: Array, along: Array) -> tuple[Complex, Complex]:
    """Return x + i y and heading of targets painted (..) m further along the arc.

    theta (rad), curvature (1/m): of the arm at the nominal positions. The points lie on the arc of
    the arm, not on its tangent.
    """
    turn = curvature * along
    return along * np.exp(1j * (theta + 0.5 * turn)), np.exp(1j * (theta + turn))


def in_plane(points: Complex) -> Array:
    """Return points x + i y (.., targets) as (.., 2, targets)."""
    return np.stack([points.real, points.imag], axis=-2)
