"""Displacement of the camera since the base frame was found."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block, Prior

# Halved or doubled, it moves no figure of acceptance/sweep.py.
MOVED_BY = 0.045  # of the length: std of the position of a camera that was moved


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera(Block):
    """Drift and position (x, y m each), and rotation (rad) around the base.

    drift_std, place_std (m) of an undisturbed camera; length (m) of the arm; origin (m): offset
    of the base frame from the neutral line at the clamp.
    """

    PLACE: ClassVar = slice(2, 4)

    drift_std: float
    place_std: float
    length: float
    origin: tuple[float, float] = (0.0, 0.0)
    drift_time: float = tuning(
        40.0, 'correlation time of the drift of the camera', unit='s', source='sweep'
    )
    turn_std: float = tuning(
        3e-5, 'std of the rotation of a camera that was not moved', unit='rad', source='sweep'
    )
    turned_by: float = tuning(
        0.05,
        'std of the rotation around the base of a camera that was moved',
        unit='rad',
        source='sweep',
    )

    @property
    def std(self) -> Array:
        """Prior of a camera that was not moved."""
        return np.array([*[self.drift_std] * 2, *[self.place_std] * 2, self.turn_std])

    @property
    def prior(self) -> Prior:
        """The base frame found by the calibration."""
        mean = np.zeros(self.std.size)
        mean[self.PLACE] = self.origin
        return Prior(mean=mean, std=self.std)

    @property
    def times(self) -> Array:
        """Time constants: drift decays, position and rotation are constant."""
        return np.array([self.drift_time, self.drift_time, math.inf, math.inf, math.inf])

    @property
    def moved_std(self) -> Array:
        """One sigma (3,) of position and rotation of a camera that was moved."""
        position_std = MOVED_BY * self.length
        return np.array([position_std, position_std, self.turned_by])

    def on_camera(self) -> Array:
        """Add drift and position."""
        return np.array([[1.0, 0, 1, 0, 0], [0, 1, 0, 1, 0], [0, 0, 0, 0, 1]])
