"""A contact: a push along the normal of the arm on a short part of it."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block
from pneunet_ros.model.part_load import PartLoad

# Halved or doubled, it moves no figure of acceptance/sweep.py.
WIDTH = 0.018  # of the length of the arm, that a contact presses on


@dataclass(frozen=True, slots=True, kw_only=True)
class Push(Block):
    """Contact force (N) along the normal and its arclength (m); without a contact both are zero.

    scale (N) of forces; length (m) of the arm.
    """

    scale: float
    length: float
    places: tuple[float, float] = tuning(
        (0.05, 0.98),
        'positions along the arm at which a contact is tried',
        unit='of the length',
        source='sweep',
    )
    largest_walk: float = tuning(
        0.3,
        'largest random walk of a contact force',
        unit='of the force scale/sqrt(s)',
        source='sweep',
    )
    place_walk: float = tuning(
        0.018,
        'random walk of the place of a contact',
        unit='of the length/sqrt(s)',
        source='sweep',
    )

    @property
    def std(self) -> Array:
        """Zero: no contact a priori."""
        return np.zeros(2)

    def touching_prior(self, low: float, high: float) -> tuple[Array, Array]:
        """Return mean and one sigma of a contact with any force on a part of the arm (shares)."""
        middle, spread = 0.5 * (low + high), (high - low) / math.sqrt(12.0)
        return np.array([0.0, middle * self.length]), np.array([self.scale, spread * self.length])

    @property
    def limits(self) -> tuple[float, float]:
        """Range (m) of possible contact positions."""
        low, high = self.places
        return low * self.length, high * self.length

    def random_walks(self, walk: float, seconds: float) -> Array:
        """Return the random walks (2,) for a walk (N/sqrt(s)) of the force."""
        force_walk = min(walk, self.largest_walk * self.scale)
        walks = np.array([force_walk, self.place_walk * self.length])
        return np.asarray(walks * math.sqrt(seconds))

    def load_of(self, unknowns: Array) -> PartLoad | None:
        """Return the contact force for these unknowns (2,); None if the contact is off the arm."""
        force, position = unknowns.tolist()
        low, high = self.limits
        if not low <= position <= high:
            return None
        return PartLoad(force=force, place=position, width=WIDTH * self.length)

    def limited_load(self, unknowns: Array) -> PartLoad:
        """Return the push of these unknowns (2,), limited to the arm."""
        low, high = self.limits
        force, position = unknowns.tolist()
        return PartLoad(
            force=force, place=min(max(position, low), high), width=WIDTH * self.length
        )
