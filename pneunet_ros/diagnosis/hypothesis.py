"""An effect as a hypothesis: its parameters as free numbers that are zero where it is neutral."""

from __future__ import annotations

from dataclasses import dataclass, fields
import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect, Load

FIRST_SIZES = (0.05, 0.25, 0.8)  # of the prior range, where effects with a history are tried
FIRST_SIZE = 5e-4  # of the prior range, for those linear in their size: the tangent
SHAPES = 5  # values of a shape parameter that are tried, over its prior range


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinate:
    """A parameter of an effect as a number: a size is 0 where neutral; a shape is a logarithm.

    A parameter whose neutral value is infinite is its reciprocal; std: half of the prior range,
    low and high: the bounds, all in the coordinate.
    """

    parameter: str
    unit: str
    neutral: float
    reciprocal: bool
    shape: bool
    std: float
    mean: float
    low: float
    high: float

    def value(self, coordinate: float) -> float:
        """Return the parameter (SI) at a coordinate."""
        coordinate = min(max(coordinate, self.low), self.high)
        if self.shape:
            return math.exp(coordinate)
        if self.reciprocal:
            return math.inf if coordinate <= 0.0 else 1.0 / coordinate
        return self.neutral + coordinate

    def of(self, value: float) -> float:
        """Return the coordinate of a parameter."""
        if self.shape:
            return math.log(value)
        return 1.0 / value if self.reciprocal else value - self.neutral

    def slope(self, coordinate: float) -> float:
        """Return how much the parameter changes per coordinate, there."""
        value = self.value(coordinate)
        if self.shape:
            return value
        return -(value**2) if self.reciprocal else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """An effect that may be missing, with its free numbers in the order of its parameters."""

    kind: type[Effect]
    coordinates: tuple[Coordinate, ...]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.kind.name

    @property
    def size(self) -> int:
        """How many free numbers it has."""
        return len(self.coordinates)

    @property
    def has_memory(self) -> bool:
        """Whether it lives by the history of pressure, so that its answer is no straight line."""
        return self.kind.actuate is not Effect.actuate

    @property
    def confounded_with_pressure_scale(self) -> bool:
        """Whether it is another pressure scale alone: kappa_p0(p), fitted anew, takes that up."""
        if self.kind.sense is Effect.sense:
            return False
        sensed = self.effect(self.starts()[0][1]).sense(
            Load(pressure=1e4, force_x=1.0, force_y=1.0)
        )
        return sensed.pressure != 1e4

    def effect(self, numbers: Array) -> Effect:
        """Return the effect with these numbers (size,)."""
        values = {
            item.parameter: item.value(float(number))
            for item, number in zip(self.coordinates, numbers, strict=True)
        }
        return self.kind(**values)

    def numbers(self, effect: Effect) -> Array:
        """Return the numbers of an effect."""
        return np.array([item.of(getattr(effect, item.parameter)) for item in self.coordinates])

    @property
    def mean(self) -> Array:
        """What is expected before any data, (size,)."""
        return np.array([item.mean for item in self.coordinates])

    @property
    def std(self) -> Array:
        """How far from it a number may be, (size,)."""
        return np.array([item.std for item in self.coordinates])

    @property
    def sizes(self) -> list[int]:
        """Which numbers are sizes: zero where nothing happens."""
        return [i for i, item in enumerate(self.coordinates) if not item.shape]

    def clipped(self, numbers: Array) -> Array:
        """Return numbers within the bounds."""
        low = [item.low for item in self.coordinates]
        high = [item.high for item in self.coordinates]
        return np.clip(numbers, low, high)

    def starts(self) -> list[tuple[int, Array]]:
        """Return where the answer is tried: which size is moved, and all numbers there."""
        tried = []
        shapes = self.shapes()
        # What has a shape of its own is linear in its size.
        shares = FIRST_SIZES if self.has_memory and len(shapes) == 1 else (FIRST_SIZE,)
        for shape in shapes:
            for which in self.sizes:
                for share in shares:
                    numbers = shape.copy()
                    numbers[which] = 2.0 * share * self.coordinates[which].std
                    tried.append((which, numbers))
        return tried

    def shapes(self) -> list[Array]:
        """Return numbers without any size, over the range of what is a shape."""
        base = np.zeros(self.size)
        places = [i for i, item in enumerate(self.coordinates) if item.shape]
        if not places:
            return [base]
        out = []
        for step in np.linspace(-1.0, 1.0, SHAPES):
            numbers = base.copy()
            for place in places:
                item = self.coordinates[place]
                numbers[place] = item.mean + step * item.std
            out.append(numbers)
        return out


def hypothesis(kind: type[Effect]) -> Hypothesis:
    """Return an effect of the table as a hypothesis."""
    return Hypothesis(kind=kind, coordinates=tuple(coordinate(item) for item in fields(kind)))


def coordinate(item: Any) -> Coordinate:
    """Return the coordinate of a declared parameter."""
    neutral, (low, high) = float(item.default), item.metadata['bounds']
    first, last = item.metadata['prior']
    reciprocal, shape = math.isinf(neutral), bool(item.metadata['shape'])
    mean = 0.0
    if shape:
        low, high = math.log(max(low, first / 10.0)), math.log(min(high, last * 10.0))
        mean = 0.5 * (math.log(first) + math.log(last))
        std = 0.5 * (math.log(last) - math.log(first))
    elif reciprocal:
        low, high, std = 1.0 / high, 1.0 / low, 0.5 / first
    else:
        low, high = low - neutral, high - neutral
        std = 0.5 * max(abs(first - neutral), abs(last - neutral))
    return Coordinate(
        parameter=item.name,
        unit=item.metadata['unit'],
        neutral=neutral,
        reciprocal=reciprocal,
        shape=shape,
        std=std,
        mean=mean,
        low=low,
        high=high,
    )


def hypotheses(without: tuple[str, ...] = ()) -> tuple[Hypothesis, ...]:
    """Return all effects of the table but some, as hypotheses."""
    return tuple(hypothesis(kind) for name, kind in EFFECTS.items() if name not in without)
