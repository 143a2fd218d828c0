"""Effects of what happened to the lab arm before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import freeze
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.history_kernels import lagging, largest_so_far, playing, relaxing
from pneunet_ros.lab.lab_effect import Course, LabEffect, Past

RECOVERY_TIME = 120.0  # s, in which a part of a rich Mullins effect is forgotten
RECOVERING = 0.05  # that part; invented, in real rubber it is small at room temperature
# Share of the arm's largest pressure over which a softened arm comes back to its first curve:
# hardly any by the plain law, and more by a rich one.
REJOINING, RICH_REJOINING = 0.002, 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureLag(LabEffect):
    """First-order line; rich: it empties more slowly than it fills."""

    name: ClassVar[str] = 'pressure_lag'
    time_constant: float = quantity(0.0, unit='s', bounds=(0.0, 1e3))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the chamber follow the sensor."""
        start = past[0] if past else float(course.chamber[0])
        filling = self.time_constant * (1.0 - 0.25 * self.richness)
        emptying = self.time_constant * (1.0 + 0.25 * self.richness)
        chamber = freeze(lagging(course.time, course.chamber, start, filling, emptying))
        return course.pressed(chamber), (float(chamber[-1]),)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabHysteresis(LabEffect):
    """Play of full width on the chamber pressure; rich: three plays of mean width `width`."""

    name: ClassVar[str] = 'hysteresis'
    width: float = quantity(0.0, unit='Pa', bounds=(0.0, 1e6))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the plays follow the chamber."""
        spread = np.array([-1.0, 0.0, 1.0]) * min(0.6 * self.richness, 1.0)
        half = 0.5 * self.width * (1.0 + spread)
        start = np.array(past) if past else np.full(half.size, course.chamber[0])
        answers = playing(course.chamber, freeze(start), freeze(half))
        return course.pressed(freeze(answers.mean(axis=1))), tuple(answers[-1].tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCreep(LabEffect):
    """kappa0 follows by 1 - amplitude at once, the rest later; rich: a part of that soon."""

    name: ClassVar[str] = 'creep'
    amplitude: float = quantity(0.0, unit='-', bounds=(0.0, 1.0))
    time_constant: float = quantity(60.0, unit='s', bounds=(0.0, 1e6))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let a part of the intrinsic curvature come late."""
        wanted, rows = course.weights, course.weights.shape[1]
        start = np.array(past).reshape(2, rows) if past else np.stack([wanted[0]] * 2)
        constants = self.time_constant, self.time_constant / 8.0
        slow, fast = (
            relaxing(course.time, wanted, freeze(start[i].copy()), constants[i]) for i in (0, 1)
        )
        share = 0.3 * self.richness
        late = (1.0 - share) * slow + share * fast
        weights = freeze((1.0 - self.amplitude) * wanted + self.amplitude * late)
        past = (*slow[-1].tolist(), *fast[-1].tolist())
        return replace(course, weights=weights), past


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSoftening(LabEffect):
    """Mullins: softer below the largest pressure ever; rich: a part recovers within minutes."""

    name: ClassVar[str] = 'softening'
    loss: float = quantity(0.0, unit='-', bounds=(0.0, 0.9))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Scale the rigidity."""
        top = course.arm.pressure_range[1]
        rest = float(course.chamber[0])
        start, later = past if past else (rest, rest)
        ever = largest_so_far(course.time, course.chamber, start, 0.0)
        lately = largest_so_far(course.time, course.chamber, later, 1.0 / RECOVERY_TIME)
        recovering = RECOVERING * self.richness
        largest = freeze((1.0 - recovering) * ever + recovering * lately)
        rejoining = REJOINING + RICH_REJOINING * self.richness
        below = (largest - course.chamber) / (rejoining * top)
        lost = self.loss * largest / top * (1.0 - np.exp(-below))
        factor = freeze(course.rigidity_factor * (1.0 - lost))
        return replace(course, rigidity_factor=factor), (float(ever[-1]), float(lately[-1]))
