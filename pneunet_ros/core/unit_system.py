"""Units of written and displayed numbers: SI, or the scales of an arm as in the paper."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A unit: its name and its size in SI."""

    name: str
    size: float

    @property
    def per_si(self) -> float:
        """The number of these units per SI unit."""
        return 1.0 / self.size


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitSystem:
    """Units of the quantities of a rod; time, pressure and angles are always in SI."""

    name: str
    length: Unit
    force: Unit
    moment: Unit
    curvature: Unit

    def of_kind(self, kind: str) -> Unit | None:
        """Return the unit of a kind of quantity; None if the system does not define one."""
        unit = getattr(self, kind, None)
        return unit if isinstance(unit, Unit) else None


SI = UnitSystem(
    name='SI',
    length=Unit(name='m', size=1.0),
    force=Unit(name='N', size=1.0),
    moment=Unit(name='N m', size=1.0),
    curvature=Unit(name='1/m', size=1.0),
)
SHOWN_SI = UnitSystem(  # for display
    name='SI',
    length=Unit(name='mm', size=1e-3),
    force=Unit(name='N', size=1.0),
    moment=Unit(name='mN m', size=1e-3),
    curvature=Unit(name='1/m', size=1.0),
)
DIMENSIONLESS = 'dimensionless'


def dimensionless(length: float, weight: float) -> UnitSystem:
    """Return the scales of an arm of length l (m) and weight mg (N).

    Source: de Payrebrune and O'Reilly (2016): forces by mg, moments by mg l, curvature by 1/l.
    """
    return UnitSystem(
        name=DIMENSIONLESS,
        length=Unit(name='l', size=length),
        force=Unit(name='mg', size=weight),
        moment=Unit(name='mg l', size=weight * length),
        curvature=Unit(name='1/l', size=1.0 / length),
    )
