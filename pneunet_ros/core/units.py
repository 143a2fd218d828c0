"""All unit conversions (SI is used inside), and `quantity` for dataclass fields with units.

A field made by `quantity` has unit, bounds, source and meaning in its metadata. The same
declaration is used for validation, the model file, `--help`, ROS parameter descriptions and the
table of effects.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from pneunet_ros.core.errors import ModelError, PneunetError

NANOSECONDS_PER_SECOND = 1_000_000_000
PASCALS_PER_KILOPASCAL = 1000.0
STANDARD_ATMOSPHERE = 101_325.0  # Pa
STANDARD_GRAVITY = 9.80665  # m/s^2

# Units of pressure as people write them, in Pa (NIST SP 811, appendix B).
PRESSURE_UNITS = {
    'Pa': 1.0,
    'hPa': 100.0,
    'mbar': 100.0,
    'kPa': 1000.0,
    'MPa': 1e6,
    'bar': 1e5,
    'psi': 6894.757293168,
    'mmHg': 133.322387415,
    'Torr': STANDARD_ATMOSPHERE / 760.0,
    'inHg': 25.4 * 133.322387415,
    'mmH2O': STANDARD_GRAVITY,
    'cmH2O': 10.0 * STANDARD_GRAVITY,
    'inH2O': 25.4 * STANDARD_GRAVITY,
    'at': 1e4 * STANDARD_GRAVITY,
    'atm': STANDARD_ATMOSPHERE,
}
# Size of each unit in SI, by quantity: the units in names of table columns and on the command
# line.
SI_PER_UNIT: dict[str, dict[str, float]] = {
    'time': {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'min': 60.0, 'h': 3600.0, 'd': 86400.0},
    'pressure': {name.lower(): size for name, size in PRESSURE_UNITS.items()},
    # A scale in g or kg measures the weight of this mass.
    'force': {
        'n': 1.0,
        'mn': 1e-3,
        'gf': 1e-3 * STANDARD_GRAVITY,
        'kgf': STANDARD_GRAVITY,
        'lbf': 4.4482216152605,
        'g': 1e-3 * STANDARD_GRAVITY,
        'kg': STANDARD_GRAVITY,
    },
    'moment': {'n_m': 1.0, 'n_mm': 1e-3, 'mn_m': 1e-3},
    'length': {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6, 'in': 25.4e-3},
    'angle': {'rad': 1.0, 'deg': math.pi / 180.0},
    'acceleration': {'m_s2': 1.0, 'mm_s2': 1e-3, 'g': STANDARD_GRAVITY},
    'turn_rate': {'rad_s': 1.0, 'deg_s': math.pi / 180.0},
}


def kilopascals(pressure: float) -> float:
    """Convert a pressure from Pa to kPa."""
    return pressure / PASCALS_PER_KILOPASCAL


def millimeters(length: float) -> float:
    """Convert a length from m to mm."""
    return length * 1000.0


def as_weight(force: float) -> str:
    """Format a force (N) with the mass of this weight, which makes a wrong unit obvious."""
    return f'{force:.3g} N, the weight of {1e3 * force / STANDARD_GRAVITY:.4g} g'


def seconds_between(one_ns: int, other_ns: int) -> float:
    """Return the seconds between two stamps (an age or a gap), never negative."""
    return abs(seconds_since(one_ns, other_ns))


def seconds_since(start_ns: int, stamp_ns: int) -> float:
    """Return the time (s) of a stamp relative to start_ns; negative before it."""
    return (stamp_ns - start_ns) / NANOSECONDS_PER_SECOND


def quantity(
    default: Any = dataclasses.MISSING,
    *,
    unit: str,
    meaning: str = '',
    bounds: tuple[float, float] = (-math.inf, math.inf),
    prior: tuple[float, float] | None = None,
    prior_scales: bool = False,
    source: str = '',
    shape: bool = False,
) -> Any:
    """Declare a dataclass field that is a physical quantity.

    unit: SI unit, '-' for none. bounds: closed interval of allowed values. prior: interval in
    which the value is expected before any data. prior_scales: whether the prior is for the paper's
    arm, and scales with the size of other arms (`effects/arm_size.py`). source: where the default
    or the bounds come from. shape: whether the quantity describes the form of an effect, not its
    size.
    """
    metadata = {
        'unit': unit,
        'meaning': meaning,
        'bounds': bounds,
        'prior': prior or bounds,
        'prior_scales': prior_scales,
        'source': source,
        'shape': shape,
    }
    return dataclasses.field(default=default, metadata=metadata)


def quantities(owner: Any) -> tuple[dataclasses.Field[Any], ...]:
    """Return the fields of a dataclass that were declared by `quantity`, in order."""
    return tuple(field for field in dataclasses.fields(owner) if 'unit' in field.metadata)


def list_fields(owner: Any) -> tuple[str, ...]:
    """Return the names of the other fields of such a dataclass, which are lists of numbers."""
    return tuple(field.name for field in dataclasses.fields(owner) if 'unit' not in field.metadata)


def check_quantities(owner: Any, where: str, error: type[PneunetError] = ModelError) -> None:
    """Reject a value that is not a number, NaN, or outside its declared bounds.

    Infinity is allowed if a bound is infinite (a rod with infinite axial stiffness is
    inextensible).
    """
    for field in quantities(owner):
        value = getattr(owner, field.name)
        low, high = field.metadata['bounds']
        name = f'{where}.{field.name}' if where else field.name
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise error(
                f'{name} must be a number in {field.metadata["unit"]}, not {value!r}',
                reason='not_a_number',
            )
        if not low <= value <= high:
            raise error(
                f'{name} = {value} is not within [{low}, {high}] {field.metadata["unit"]}',
                reason='out_of_bounds',
            )
