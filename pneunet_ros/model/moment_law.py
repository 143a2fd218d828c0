"""Moment law: M = M_O + B (kappa - kappa0).

The paper's law (Eq 10) has two sections with a pressure-dependent border; the classical law M = EI
(kappa - kappa0) and the law of Majidi et al. (Eq 11) have one.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, checked_pressures, pressure_rows, table_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantity


class MomentLaw(abc.ABC):
    """A moment law: constants of the rod in every section, as functions of the pressure."""

    __slots__ = ()
    kind: ClassVar[str]

    @abc.abstractmethod
    def sections(self, pressure: Array, length: float, weight: float) -> Array:
        """Return start (m), rigidity B (N m^2) and moment offset M_O (N m) of every section.

        pressure (n,) Pa; length m; weight N; returns (n, sections, 3).
        """

    @property
    @abc.abstractmethod
    def pressure_range(self) -> tuple[float, float]:
        """Range of pressure (Pa) in which the law is calibrated."""

    @property
    def table_pressures(self) -> Array:
        """Pressures (Pa) between which the law is linear in pressure."""
        return np.zeros(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseLinearLaw(MomentLaw):
    """Eq 10: rigidities alpha1 on [0, l1) and alpha2 on [l1, l], all linear in p between rows.

    pressure (rows,) Pa; split (rows,) l1 / l; rigidity (rows, 2) alpha = B / (mg l^2);
    moment_offset (rows, 2) M_O / (mg l).
    """

    kind: ClassVar[str] = 'piecewise_linear'
    pressure: Array
    split: Array
    rigidity: Array
    moment_offset: Array

    def __post_init__(self) -> None:
        """Check shapes and split, and that no rigidity passes through zero."""
        where = 'moment_law'
        pressure = checked_pressures(self.pressure, where)
        split = table_array(self.split, f'{where}.split', 1)
        if split.shape != pressure.shape:
            raise ModelError(
                f'{where}.split must hold {pressure.size} values, one per pressure',
                reason='wrong_shape',
            )
        if not np.all((split > 0.0) & (split < 1.0)):
            raise ModelError(
                f'{where}.split must lie between 0 and 1 (l1 / l), both excluded',
                reason='out_of_bounds',
            )
        object.__setattr__(self, 'pressure', pressure)
        object.__setattr__(self, 'split', split)
        for name in ('rigidity', 'moment_offset'):
            table = table_array(getattr(self, name), f'{where}.{name}', 2)
            if table.shape != (pressure.size, 2):
                raise ModelError(
                    f'{where}.{name} must have {pressure.size} rows (one per pressure) of 2, '
                    f'not {table.shape[0]} x {table.shape[1]}',
                    reason='wrong_shape',
                )
            object.__setattr__(self, name, table)
        sign = np.sign(self.rigidity)
        if np.any(sign == 0.0) or np.any(sign != sign[0]):
            raise ModelError(
                f'{where}.rigidity may be negative, but must not be zero or change sign between '
                'rows, because the shape is undefined where it passes through zero',
                reason='singular_rigidity',
            )

    def sections(self, pressure: Array, length: float, weight: float) -> Array:
        """Start, rigidity and moment offset of both sections; see MomentLaw."""
        row, weight_above = pressure_rows(self.pressure, pressure)
        above = weight_above[:, None]
        out = np.empty((pressure.size, 2, 3))
        out[:, 0, 0] = 0.0
        split = (1.0 - weight_above) * self.split[row] + weight_above * self.split[row + 1]
        out[:, 1, 0] = length * split
        blend = (1.0 - above) * self.rigidity[row] + above * self.rigidity[row + 1]
        out[:, :, 1] = weight * length**2 * blend
        blend = (1.0 - above) * self.moment_offset[row] + above * self.moment_offset[row + 1]
        out[:, :, 2] = weight * length * blend
        return out

    @property
    def pressure_range(self) -> tuple[float, float]:
        """The pressures of the first and the last row."""
        return float(self.pressure[0]), float(self.pressure[-1])

    @property
    def table_pressures(self) -> Array:
        """The pressures of the rows."""
        return self.pressure


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearLaw(MomentLaw):
    """The classical law M = EI (kappa - kappa0), which the paper found inadequate."""

    kind: ClassVar[str] = 'linear'
    bending_stiffness: float = quantity(unit='N m^2', meaning='EI', bounds=(-1e9, 1e9))

    def __post_init__(self) -> None:
        """Reject a stiffness of zero."""
        check_quantities(self, 'moment_law')
        if self.bending_stiffness == 0.0:
            raise ModelError(
                'moment_law.bending_stiffness must not be zero', reason='singular_rigidity'
            )

    def sections(self, pressure: Array, length: float, weight: float) -> Array:
        """One section; see MomentLaw."""
        out = np.zeros((pressure.size, 1, 3))
        out[:, 0, 1] = self.bending_stiffness
        return out

    @property
    def pressure_range(self) -> tuple[float, float]:
        """Any pressure."""
        return -np.inf, np.inf


_SIZE = (1e-9, 1e3)


@dataclass(frozen=True, slots=True, kw_only=True)
class MajidiLaw(MomentLaw):
    """Majidi et al. (Eq 11): rigidity affine in pressure, from geometry and elastic modulus."""

    kind: ClassVar[str] = 'majidi'
    modulus: float = quantity(unit='Pa', meaning='elastic modulus E', bounds=(1.0, 1e13))
    width: float = quantity(unit='m', meaning='w', bounds=_SIZE)
    thickness: float = quantity(unit='m', meaning='t', bounds=_SIZE)
    height: float = quantity(unit='m', meaning='H', bounds=_SIZE)
    t1: float = quantity(unit='m', meaning='chamber wall t1', bounds=_SIZE)
    t2: float = quantity(unit='m', meaning='chamber gap t2', bounds=_SIZE)

    def __post_init__(self) -> None:
        """Check the geometry."""
        check_quantities(self, 'moment_law')

    @property
    def flexural_rigidity(self) -> float:
        """D = E t^3 w / 12 (N m^2)."""
        return self.modulus * self.thickness**3 * self.width / 12.0

    def rigidity(self, pressure: float) -> float:
        """D + H^3 t1 w p / (4 (t1 + t2)) (N m^2), Eq 11."""
        slope = self.height**3 * self.t1 * self.width / (4.0 * (self.t1 + self.t2))
        return self.flexural_rigidity + slope * pressure

    def intrinsic_curvature(self, pressure: float) -> float:
        """H^2 t1 w p / (2 D (t1 + t2)) (1/m), the uniform kappa0 of Eq 11."""
        slope = self.height**2 * self.t1 * self.width / (2.0 * (self.t1 + self.t2))
        return slope * pressure / self.flexural_rigidity

    def sections(self, pressure: Array, length: float, weight: float) -> Array:
        """One section; see MomentLaw."""
        out = np.zeros((pressure.size, 1, 3))
        slope = self.rigidity(1.0) - self.flexural_rigidity
        out[:, 0, 1] = self.flexural_rigidity + slope * pressure
        return out

    @property
    def pressure_range(self) -> tuple[float, float]:
        """Pressures above the one at which the rigidity would vanish."""
        slope = self.rigidity(1.0) - self.flexural_rigidity
        return -0.5 * self.flexural_rigidity / slope, np.inf


MOMENT_LAWS: dict[str, type[MomentLaw]] = {
    law.kind: law for law in (PiecewiseLinearLaw, LinearLaw, MajidiLaw)
}


def law_fields(law: type[MomentLaw]) -> tuple[str, ...]:
    """Return the names of the constants of a moment law, as in the model file."""
    return tuple(item.name for item in fields(law))  # type: ignore[arg-type]
