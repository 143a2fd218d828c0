"""Modes of a solved rod with mass: shapes, frequencies and damping of small vibrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.solver.links import (
    bending_stiffness,
    Links,
    mass_matrix,
    Masses,
    stiffness_matrix,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modes:
    """The slowest vibrations of a rod about an equilibrium, the slowest first.

    frequency (modes,) rad/s, of the rod without damping; damping (modes,) 1/s, the rate c of q'' +
    c q' + frequency^2 q = 0; shape (modes, links) rad: rotations of the links, with unit modal
    mass (kg m^2); moment (modes, links) N m: joint moments that produce this shape.
    """

    frequency: Array
    damping: Array
    shape: Array
    moment: Array

    @property
    def hertz(self) -> float:
        """Frequency (Hz) of the first mode."""
        return float(self.frequency[0] / (2.0 * np.pi))

    @property
    def decay_time(self) -> float:
        """Time (s) in which the amplitude of the first mode falls to 1/e; infinite undamped."""
        return float(2.0 / self.damping[0]) if self.damping[0] > 0.0 else np.inf


def modes_of(links: Links, masses: Masses, damping_time: float, count: int) -> Modes | None:
    """Return the slowest modes of a chain of links; None if its equilibrium is not stable.

    damping_time: s, Kelvin-Voigt. The stiffness is the second variation of the energy.
    """
    from scipy.linalg import eigh, LinAlgError  # slow to import, and rarely needed

    inertia, stiffness = mass_matrix(links, masses), stiffness_matrix(links)
    size = len(inertia)
    try:  # in 1 / frequency^2, because links without mass make the inertia singular
        squares, shapes = eigh(inertia, stiffness, subset_by_index=[size - count, size - 1])
    except LinAlgError:
        return None
    frequency = 1.0 / np.sqrt(squares[::-1])
    shapes = frequency * shapes[:, ::-1]
    bent = np.einsum('im,ij,jm->m', shapes, bending_stiffness(links), shapes)
    return Modes(
        frequency=freeze(frequency),
        damping=freeze(damping_time * bent),
        shape=freeze(np.ascontiguousarray(shapes.T)),
        moment=freeze(np.diff(shapes.T, axis=1, prepend=0.0) / links.compliance),
    )
