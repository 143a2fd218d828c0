"""The rod record: all properties of an arm in the equilibrium equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.kernels.jit import inlined, kernel
from pneunet_ros.solver.columns import LOAD_X, LOAD_Y


class Rods(NamedTuple):
    """Records of one arm at several pressures, in the form used by the kernels.

    length m; pressure (pressures,) Pa; sections (pressures, sections, 8) and clamp (pressures, 5)
    with the columns of `solver.columns`, the same along each section; knots (pieces + 1,) m and
    rotation (pressures, pieces, 5): the angle rad of the unloaded rod, as ascending powers of the
    distance from the previous knot. push (pressures, pushes, sections) N/m: loads along the normal
    of the solved rod at push_place (pushes,) m; kernels take a rod that is `pointed`, which
    includes them in its line loads.
    """

    length: float
    pressure: Array
    sections: Array
    clamp: Array
    knots: Array
    rotation: Array
    push: Array
    push_place: Array

    def record(self, index: int) -> Rods:
        """Return the record at one of the pressures, as records of one pressure."""
        return self.records(slice(index, index + 1))

    def records(self, only: slice | list[int]) -> Rods:
        """Return the records at some of the pressures."""
        return self._replace(
            pressure=self.pressure[only],
            sections=self.sections[only],
            clamp=self.clamp[only],
            rotation=self.rotation[only],
            push=self.push[only],
        )

    def pointed(self, heading: Array) -> Rods:
        """Return the records with pushes along the normals of headings (pressures, pushes) rad."""
        sections = self.sections.copy()
        for column, normal in ((LOAD_X, -np.sin(heading)), (LOAD_Y, np.cos(heading))):
            sections[:, :, column] += np.einsum('npk,np->nk', self.push, normal)
        return self._replace(
            sections=sections,
            push=np.zeros((len(sections), 0, sections.shape[1])),
            push_place=np.zeros(0),
        )


@kernel
def interpolate_rows(
    pressure: Array,
    sections: Array,
    rotation: Array,
    at: Array,
    sections_at: Array,
    rotation_at: Array,
) -> None:
    """Interpolate or extrapolate two tables over pressure (rows, i, j), into two (n, i, j)."""
    for index in range(at.size):
        row = 0
        while row < pressure.size - 2 and at[index] >= pressure[row + 1]:
            row += 1
        weight = (at[index] - pressure[row]) / (pressure[row + 1] - pressure[row])
        mix(1.0 - weight, sections[row], weight, sections[row + 1], sections_at[index])
        mix(1.0 - weight, rotation[row], weight, rotation[row + 1], rotation_at[index])


@inlined
def mix(one_share: float, one: Array, other_share: float, other: Array, out: Array) -> None:
    """Set out to a weighted sum of two tables (i, j)."""
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            out[i, j] = one_share * one[i, j] + other_share * other[i, j]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RodTable:
    """Sections and rotation of an arm without effects at every pressure of its tables.

    Curvature and moment laws are linear in pressure between table rows, so one linear table
    suffices. pressure (rows,) Pa; sections (rows, sections, 8); rotation (rows, pieces, 5).
    """

    pressure: Array
    sections: Array
    rotation: Array

    def at(self, pressure: Array) -> tuple[Array, Array]:
        """Return sections (n, sections, 8) and rotation (n, pieces, 5) at these pressures (n,)."""
        sections = np.empty((pressure.size, *self.sections.shape[1:]))
        rotation = np.empty((pressure.size, *self.rotation.shape[1:]))
        at = frozen_array(pressure)  # a kernel would be compiled again for a writable array
        interpolate_rows(self.pressure, self.sections, self.rotation, at, sections, rotation)
        return sections, rotation
