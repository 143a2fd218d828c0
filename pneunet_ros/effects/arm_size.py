"""The size of an arm relative to the paper's arm, which scales priors of effects.

A load of 0.1 N is large for an arm of 0.1 m with a stiffness of 1e-4 N m^2, and negligible for an
arm ten times as long and a thousand times as stiff. The prior of an effect is therefore defined
for the paper's arm and multiplied by the ratios of length, force (bending stiffness / length^2)
and pressure that make up its unit. Times belong to valves and cameras, and are not scaled.
"""

from __future__ import annotations

from dataclasses import dataclass, Field
from typing import Any

# From the paper: the length and, from Table 1, the stiffness at 0 kPa (the two sections in series)
# over its square, and the highest pressure.
PAPER_LENGTH = 0.112  # m
PAPER_FORCE = 8e-3  # N
PAPER_PRESSURE = 66e3  # Pa
# Powers of length, force and pressure in each unit; a mass is a weight in the same gravity.
DIMENSIONS = {
    '-': (0, 0, 0),
    's': (0, 0, 0),
    'rad': (0, 0, 0),
    'm': (1, 0, 0),
    'm^2': (2, 0, 0),
    '1/m': (-1, 0, 0),
    '1/m^2': (-2, 0, 0),
    'N': (0, 1, 0),
    '1/N': (0, -1, 0),
    'N/m': (-1, 1, 0),
    'N m': (1, 1, 0),
    'N m^2': (2, 1, 0),
    'rad/(N m)': (-1, -1, 0),
    'kg': (0, 1, 0),
    'Pa': (0, 0, 1),
    '1/Pa': (0, 0, -1),
    '1/Pa^2': (0, 0, -2),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSize:
    """Ratios of length, force scale and pressure to those of the paper's arm."""

    length: float = 1.0
    force: float = 1.0
    pressure: float = 1.0

    def of(self, unit: str) -> float:
        """Return the factor of a quantity of this unit."""
        length, force, pressure = DIMENSIONS[unit]
        return float(self.length**length * self.force**force * self.pressure**pressure)


def scaled_prior(parameter: Field[Any], size: ArmSize) -> tuple[float, float]:
    """Return the prior range (SI) of a declared parameter for an arm of this size."""
    first, last = parameter.metadata['prior']
    factor = size.of(parameter.metadata['unit']) if parameter.metadata['prior_scales'] else 1.0
    return factor * first, factor * last
