"""The record of the rod: everything that the equations of equilibrium know of an arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import kernel

# Columns of a section: start m, rigidity N m^2, moment offset N m, cubic term m^2, axial
# compliance 1/N, rest strain -, line load N/m.
START, RIGIDITY, MOMENT_OFFSET, CUBIC, AXIAL_COMPLIANCE, REST_STRAIN, LOAD_X, LOAD_Y = range(8)
SECTION_WIDTH = 8
# Columns of the clamp: angle rad, compliance rad/(N m); and how far beside the tip the load acts,
# m.
CLAMP_ANGLE, CLAMP_COMPLIANCE, LOAD_OFFSET = range(3)
CLAMP_WIDTH = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rods:
    """Records of one arm at several pressures.

    pressure (pressures,) Pa; sections (pressures, sections, 8) and clamp (pressures, 3) with the
    columns above, the same along each section; knots (pieces + 1,) m and turning (pressures,
    pieces, 5): the angle rad that the unloaded rod has turned, as ascending powers of the distance
    from the knot before.
    """

    length: float
    pressure: Array
    sections: Array
    clamp: Array
    knots: Array
    turning: Array

    def one(self, which: int) -> Rods:
        """Return the record at one of the pressures, as records of one pressure."""
        only = slice(which, which + 1)
        return Rods(
            length=self.length,
            pressure=self.pressure[only],
            sections=self.sections[only],
            clamp=self.clamp[only],
            knots=self.knots,
            turning=self.turning[only],
        )


@kernel
def interpolate_rows(pressure: Array, table: Array, at: Array, out: Array) -> None:
    """Tables over pressure (rows, i, j), linear also beyond their ends, into out (n, i, j)."""
    for index in range(at.size):
        row = 0
        while row < pressure.size - 2 and at[index] >= pressure[row + 1]:
            row += 1
        weight = (at[index] - pressure[row]) / (pressure[row + 1] - pressure[row])
        for i in range(table.shape[1]):
            for j in range(table.shape[2]):
                below, above = table[row, i, j], table[row + 1, i, j]
                out[index, i, j] = (1.0 - weight) * below + weight * above


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RodTable:
    """Sections and turning of an arm without effects at every pressure of its tables.

    Curvature and moment laws are linear in pressure between tables' rows, so this is one linear
    table. pressure (rows,) Pa; sections (rows, sections, 8); turning (rows, pieces, 5).
    """

    pressure: Array
    sections: Array
    turning: Array

    def at(self, pressure: Array) -> tuple[Array, Array]:
        """Sections (n, sections, 8) and turning (n, pieces, 5) at these pressures (n,)."""
        sections = np.empty((pressure.size, *self.sections.shape[1:]))
        turning = np.empty((pressure.size, *self.turning.shape[1:]))
        interpolate_rows(self.pressure, self.sections, pressure, sections)
        interpolate_rows(self.pressure, self.turning, pressure, turning)
        return sections, turning
