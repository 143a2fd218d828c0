"""Units of printed lengths: meters and millimeters, or scaled by the arm as in the paper."""

from __future__ import annotations

from dataclasses import dataclass

LENGTHS = ('m', 'l')


@dataclass(frozen=True, slots=True, kw_only=True)
class LengthUnit:
    """A unit of length for tables and files, and the one shown to people.

    `per_meter` of the unit `name`, or `shown_per_meter` of the unit `shown`, make a meter;
    a curvature of 1/m is `curvature_per_reciprocal` in the unit `curvature`.
    """

    name: str
    per_meter: float
    shown: str
    shown_per_meter: float
    curvature: str
    curvature_per_reciprocal: float


def length_unit(name: str, arm_length: float) -> LengthUnit:
    """Return the unit of this name, one of LENGTHS; `l` is the length of the arm (m)."""
    if name == 'l':
        return LengthUnit(
            name='l',
            per_meter=1.0 / arm_length,
            shown='l',
            shown_per_meter=1.0 / arm_length,
            curvature='1/l',
            curvature_per_reciprocal=arm_length,
        )
    return LengthUnit(
        name='m',
        per_meter=1.0,
        shown='mm',
        shown_per_meter=1000.0,
        curvature='1/m',
        curvature_per_reciprocal=1.0,
    )
