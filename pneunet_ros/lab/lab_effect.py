"""Interface of effects in the virtual lab, independent of the model's effects.

Names and main parameters are those of the model, so that results can be compared with the truth.
`richness` is the departure of an effect from the plain law of the same name: 0 is the plain law.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, quantity
from pneunet_ros.lab.chain import Chain
from pneunet_ros.lab.lab_arm import LabArm

Past = tuple[float, ...]  # memory of an effect
RICHNESS = quantity(
    0.0, unit='-', meaning='departure from the plain law: 0 plain, 1 rich', bounds=(0.0, 2.0)
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Chamber pressure over a fine time grid (n,) s, with the states that depend on it.

    pressure (n,) Pa at the sensor, chamber (n,) Pa behind the line, both true values; weights (n,
    rows) of the arm's rows of intrinsic curvature; rigidity_factor (n,).
    """

    arm: LabArm
    time: Array
    pressure: Array
    chamber: Array
    weights: Array
    rigidity_factor: Array

    def with_chamber(self, chamber: Array) -> Course:
        """Return the course with another chamber pressure."""
        return replace(self, chamber=chamber, weights=self.arm.curvature_weights(chamber))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabEffect(abc.ABC):
    """Base class of lab effects; an effect overrides the methods of the places where it acts."""

    name: ClassVar[str]

    def __post_init__(self) -> None:
        """Reject parameters outside their bounds."""
        check_quantities(self, f'effects.{self.name}', RequestError)

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Return the sensor readings at pressures (n,) Pa and forces (n, 2) N."""
        return pressure, force

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Apply this effect to the course; also return its memory; past: its memory before."""
        return course, past

    def resume(self, past: Past, rest: Array) -> Array:
        """Return the history of the effect, with the shape of `rest`; () means at rest.

        Raises RequestError if it is the history of another arm.
        """
        if not past:
            return rest
        if len(past) != rest.size:
            raise RequestError(
                f'the earlier recording has {len(past)} numbers for the state of {self.name}, '
                f'but this arm needs {rest.size}: continue a recording of the same arm',
                reason='other_arm',
            )
        return freeze(np.array(past).reshape(rest.shape))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Return the chain with this effect at chamber pressures (frames,) Pa."""
        return chain

    def frame_delay(self, share: Array) -> Array:
        """Return the delay (s) of frame stamps; share (frames,) 0 to 1 of the recording time."""
        return 0.0 * share

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Return points (frames, n, 2) m as seen by a camera; share (frames,) 0 to 1 of time."""
        return points


@dataclass(frozen=True, slots=True, kw_only=True)
class RichEffect(LabEffect):
    """An effect of the model, with a law that may depart from that of the model."""

    richness: float = field(default=0.0, metadata=RICHNESS.metadata)


def relative_pressure(arm: LabArm, pressure: Array) -> Array:
    """Map pressures to -1 (lowest of the arm) to 1 (highest)."""
    low, high = arm.pressure_range
    return 2.0 * (pressure - low) / (high - low) - 1.0
