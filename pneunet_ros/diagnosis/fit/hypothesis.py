"""An effect as a hypothesis: its parameters as free numbers, zero at the neutral value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.settings import HYPOTHESIS
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.arm_size import ArmSize, scaled_prior
from pneunet_ros.effects.effect import Effect, Load
from pneunet_ros.model.arm import Arm

# Sizes from which a search begins, of the prior range: where points are linear in them, and not.
FIRST_SIZE = 5e-4
FIRST_SIZES = (0.05, 0.25, 0.8)
SHAPE_MARGIN = 10.0  # factor by which a shape may leave its prior range


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinate:
    """A parameter of an effect as a number: sizes are 0 at neutral, positive shapes are logs.

    If the neutral value is infinite, the coordinate is the reciprocal; std: half of the prior
    range, low and high: the bounds, all in the coordinate; expected: the prior range, bounds:
    those of the parameter (SI), closed.
    """

    parameter: str
    unit: str
    neutral: float
    reciprocal: bool
    shape: bool
    logarithmic: bool
    std: float
    mean: float
    low: float
    high: float
    expected: tuple[float, float]
    bounds: tuple[float, float]

    @property
    def end(self) -> float:
        """End of the prior range of a size."""
        return 2.0 * self.std

    def value(self, coordinate: float) -> float:
        """Return the parameter (SI) at a coordinate, strictly within its bounds."""
        coordinate = min(max(coordinate, self.low), self.high)
        if self.logarithmic:
            value = math.exp(coordinate)
        elif self.reciprocal:
            value = math.inf if coordinate <= 0.0 else 1.0 / coordinate
        else:
            value = self.neutral + coordinate
        return min(max(value, self.bounds[0]), self.bounds[1])  # 1.0 + (0.1 - 1.0) is not 0.1

    def of(self, value: float) -> float:
        """Return the coordinate of a parameter."""
        if self.logarithmic:
            return math.log(value)
        return 1.0 / value if self.reciprocal else value - self.neutral

    def slope(self, coordinate: float) -> float:
        """Return the derivative of the parameter by its coordinate at this value."""
        value = self.value(coordinate)
        if self.logarithmic:
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
        """Number of free parameters."""
        return len(self.coordinates)

    @property
    def has_memory(self) -> bool:
        """Whether the effect depends on past pressures, so that points are nonlinear in it."""
        return self.kind.implements('actuate') or self.kind.implements('frame_delay')

    @property
    def is_linear(self) -> bool:
        """Whether points are linear in its size: without memory, or with a shape parameter."""
        return not self.has_memory or len(self.sizes) < self.size

    @property
    def confounded_with_pressure_scale(self) -> bool:
        """Whether the effect equals a pressure scale, which a refitted kappa_p0(p) absorbs."""
        if self.kind.sense is Effect.sense:
            return False
        load = Load(pressure=1e4, force_x=1.0, force_y=1.0)
        return self.effect(self.starts()[0][1]).sense(load).pressure != load.pressure

    def effect(self, numbers: Array) -> Effect:
        """Return the effect with these numbers (size,)."""
        pairs = zip(self.coordinates, numbers, strict=True)
        return self.kind(**{item.parameter: item.value(float(number)) for item, number in pairs})

    def numbers(self, effect: Effect) -> Array:
        """Return the numbers of an effect."""
        return np.array([item.of(getattr(effect, item.parameter)) for item in self.coordinates])

    @property
    def mean(self) -> Array:
        """Prior mean of the numbers, (size,)."""
        return np.array([item.mean for item in self.coordinates])

    @property
    def std(self) -> Array:
        """Prior standard deviation of the numbers, (size,)."""
        return np.array([item.std for item in self.coordinates])

    @property
    def low(self) -> Array:
        """Lower bounds of the numbers, (size,)."""
        return np.array([item.low for item in self.coordinates])

    @property
    def high(self) -> Array:
        """Upper bounds of the numbers, (size,)."""
        return np.array([item.high for item in self.coordinates])

    @property
    def sizes(self) -> list[int]:
        """Mask of the numbers that are magnitudes, zero at the neutral value."""
        return [i for i, item in enumerate(self.coordinates) if not item.shape]

    def starts(self) -> list[tuple[int, Array]]:
        """Return starts for the fit of the effect: index of the varied size, and all numbers."""
        shapes, starts = self.shapes(), []
        for shape in shapes:
            for which in self.sizes:
                for share in (FIRST_SIZE,) if self.is_linear else FIRST_SIZES:
                    numbers = shape.copy()
                    numbers[which] = share * self.coordinates[which].end
                    starts.append((which, numbers))
        return starts

    def shapes(self) -> list[Array]:
        """Return numbers of size zero, over the prior range of the shape parameters."""
        is_shape = np.array([item.shape for item in self.coordinates])
        steps = np.linspace(-1.0, 1.0, HYPOTHESIS.shapes) if is_shape.any() else [0.0]
        return [np.where(is_shape, self.mean + step * self.std, 0.0) for step in steps]


def hypothesis(kind: type[Effect], size: ArmSize) -> Hypothesis:
    """Return an effect as a hypothesis for an arm of this size."""
    coordinates = tuple(coordinate_of(parameter, size) for parameter in fields(kind))
    return Hypothesis(kind=kind, coordinates=coordinates)


def coordinate_of(parameter: Any, size: ArmSize) -> Coordinate:
    """Return the coordinate of a declared parameter for an arm of this size."""
    neutral, bounds = float(parameter.default), parameter.metadata['bounds']
    low, high = bounds
    first, last = expected = scaled_prior(parameter, size)
    reciprocal, shape = math.isinf(neutral), bool(parameter.metadata['shape'])
    mean, logarithmic = 0.0, shape and first > 0.0
    if logarithmic:
        low = math.log(max(low, first / SHAPE_MARGIN))
        high = math.log(min(high, last * SHAPE_MARGIN))
        mean = 0.5 * (math.log(first) + math.log(last))
        std = 0.5 * (math.log(last) - math.log(first))
    elif reciprocal:
        low, high, std = 1.0 / high, 1.0 / low, 0.5 / first
    elif shape:
        low, high = low - neutral, high - neutral
        mean, std = 0.5 * (first + last) - neutral, 0.5 * (last - first)
    else:
        low, high = low - neutral, high - neutral
        std = 0.5 * max(abs(first - neutral), abs(last - neutral))
    return Coordinate(
        parameter=parameter.name,
        unit=parameter.metadata['unit'],
        neutral=neutral,
        reciprocal=reciprocal,
        shape=shape,
        logarithmic=logarithmic,
        std=std,
        mean=mean,
        low=low,
        high=high,
        expected=expected,
        bounds=bounds,
    )


def hypotheses(model: Arm, withheld: Sequence[str] = ()) -> tuple[Hypothesis, ...]:
    """Return the quasi-static effects that a model lacks, except the withheld ones."""
    left_out = {*(effect.name for effect in model.effects), *withheld}
    return tuple(
        hypothesis(kind, model.size)
        for name, kind in EFFECTS.items()
        if name not in left_out and kind.place != 'motion'
    )
