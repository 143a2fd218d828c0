"""The intrinsic curvature kappa_p0(p, s) of the pressurized, unloaded arm (Eqs 5-6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import (
    Array,
    checked_pressures,
    freeze,
    frozen_array,
    pressure_rows,
    table_array,
)
from pneunet_ros.core.errors import ModelError
from pneunet_ros.model.cubic_spline import cubic_spline


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntrinsicCurvature:
    """Table of kappa_p0: linear in p between rows, C2 cubic spline (not-a-knot) in s.

    A single row describes an arm whose pressure never changes, such as a beam.

    pressure (rows,) Pa; arclength (columns,) as s / l from 0 to 1; curvature (rows, columns) 1/m.
    `rotation` (rows, columns - 1, 5) holds the antiderivative in s / l, piece by piece, as
    ascending powers of the distance from the start of the piece: the angle of the unloaded arm,
    per unit length.
    """

    pressure: Array
    arclength: Array
    curvature: Array
    rotation: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the table and integrate it."""
        where = 'intrinsic_curvature'
        pressure = checked_pressures(self.pressure, where)
        arclength = table_array(self.arclength, f'{where}.arclength', 1)
        curvature = table_array(self.curvature, f'{where}.curvature', 2)
        inside = arclength.size >= 2 and arclength[0] == 0.0 and arclength[-1] == 1.0
        if not inside or not np.all(np.diff(arclength) > 0.0):
            raise ModelError(
                f'{where}.arclength must increase from 0.0 to 1.0 (s / l)', reason='not_increasing'
            )
        expected = (pressure.size, arclength.size)
        if curvature.shape != expected:
            raise ModelError(
                f'{where}.curvature must have one row per pressure and one column per arclength, '
                f'{expected[0]} x {expected[1]}, not {curvature.shape[0]} x {curvature.shape[1]}',
                reason='wrong_shape',
            )
        object.__setattr__(self, 'pressure', pressure)
        object.__setattr__(self, 'arclength', arclength)
        object.__setattr__(self, 'curvature', curvature)
        object.__setattr__(self, 'rotation', frozen_array(rotation_pieces(arclength, curvature)))

    def rotation_of(self, pressure: Array, length: float) -> Array:
        """Return pieces of the rotation over arclength in m; (pressures, columns - 1, 5)."""
        row, weight = pressure_rows(self.pressure, pressure)
        weight = weight[:, None, None]
        per_length = (1.0 - weight) * self.rotation[row] + weight * self.rotation[row + 1]
        return over_meters(per_length, length)

    def mixed_rotation(self, weights: Array, length: float) -> Array:
        """Return pieces of weighted rows, weights (n, rows) or (rows,), over arclength in m.

        The shape is (n, columns - 1, 5), with n = 1 for one set of weights.
        """
        rows = self.rotation.reshape(self.pressure.size, -1)
        mixed = (weights @ rows).reshape(-1, *self.rotation.shape[1:])
        return over_meters(mixed, length)

    def slope(self, pressure: Array) -> Array:
        """Return d kappa_p0 / d p at the knots for pressures (n,) Pa, (n, columns) 1/m per Pa."""
        if self.pressure.size == 1:
            return np.zeros((pressure.size, self.arclength.size))
        row, _ = pressure_rows(self.pressure, pressure)
        slope = np.diff(self.curvature, axis=0) / np.diff(self.pressure)[:, None]
        return np.asarray(slope[row])

    def at(self, pressure: float, arclength: npt.ArrayLike) -> Array:
        """Return kappa_p0 (1/m) at one pressure (Pa) and any s / l."""
        row, weight = pressure_rows(self.pressure, pressure)
        values = (1.0 - weight) * self.curvature[row] + weight * self.curvature[row + 1]
        places = np.asarray(arclength, dtype=np.float64)
        piece = np.searchsorted(self.arclength[1:-1], places, side='right')
        powers = cubic_spline(self.arclength, values)[piece]
        beyond = (places - self.arclength[piece])[..., None] ** np.arange(4)
        return freeze(np.asarray((powers * beyond).sum(axis=-1)))


def rotation_pieces(arclength: Array, curvature: Array) -> Array:
    """Return the antiderivative of curvature (rows, columns) over s / l, (rows, columns - 1, 5).

    Coefficients are ascending powers of the distance from the start of each piece; 0 at the clamp.
    """
    slopes = cubic_spline(arclength, curvature) / np.arange(1.0, 5.0)
    rotations = (slopes * np.diff(arclength)[:, None] ** np.arange(1.0, 5.0)).sum(axis=-1)
    start = np.cumsum(rotations, axis=-1) - rotations
    return np.concatenate([start[..., None], slopes], axis=-1)


def over_meters(per_length: Array, length: float) -> Array:
    """Return rotation (..., 5) over arclength in m from that over s / l, per unit length."""
    # kappa = sum c_k u^(k-1) k with u = s / l, so theta = l sum c_k (s / l)^k
    return per_length * (length ** (1.0 - np.arange(5.0)))
