"""An effect put into the model and fitted jointly with all of it, its shape parameters free.

Gauss-Newton; how points answer to the base model is taken from its fit, how they answer to the
effect is taken anew at every step, and residuals are those of the equilibrium itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.linearization import Linearization, LinearizationPoint
from pneunet_ros.effects.effect import Effect
from pneunet_ros.measurement.gauss_newton import End, gauss_newton

MOST_STEPS, MOST_HALVINGS = 5, 5
SMALL = 0.1  # of the cost, that a step can gain at most
SETTLED = 0.5  # of the cost, from one round to the next
# Of the prior's standard deviation, for the answer to a number. The base takes up most of what
# gravity does: a coarser difference is bent by more than is left, and taken for information.
DIFFERENCE = 5e-4
PRIOR_WIDTHS = 1.0  # of the prior's standard deviation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refit:
    """Effects fitted jointly: their numbers and covariance, and the linear problem at the end.

    numbers (k,) of all hypotheses, one after the other; base (n,) scaled position of the base
    unknowns; linear: with columns base, departures, numbers. settled: taking the answer of the
    base anew changes nothing.
    """

    design: Linearization
    hypotheses: tuple[Hypothesis, ...]
    numbers: Array
    covariance: Array
    base: Array
    linear: GaussianModel
    cost: float
    converged: bool
    settled: bool = False

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects with the numbers found."""
        return effects_of(self.hypotheses, self.numbers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(item.name for item in self.hypotheses)

    @property
    def point(self) -> LinearizationPoint:
        """Where it ended."""
        design, here = self.design, self.design.point
        values = design.mean + design.scale @ self.base[: design.mean.size]
        return replace(
            here,
            values=frozen_array(values[: design.size]),
            placement=frozen_array(values[design.size :].reshape(2, -1)),
            effects=self.effects,
        )


def split(hypotheses: Sequence[Hypothesis], numbers: Array) -> list[Array]:
    """Return the numbers of each hypothesis."""
    if not hypotheses:
        return []
    ends = np.cumsum([item.size for item in hypotheses])
    return list(np.split(numbers, ends[:-1]))


def effects_of(hypotheses: Sequence[Hypothesis], numbers: Array) -> tuple[Effect, ...]:
    """Return the effects with these numbers."""
    parts = split(hypotheses, numbers)
    return tuple(item.effect(part) for item, part in zip(hypotheses, parts, strict=True))


class Trial(NamedTuple):
    """Where a search stands: scaled base, numbers, residuals of the runs, and the cost."""

    scaled: Array
    numbers: Array
    residuals: list[Array]
    cost: float


class Refitting:
    """The search for the numbers of some hypotheses, in the first runs of a design: training."""

    def __init__(
        self, design: Linearization, hypotheses: Sequence[Hypothesis], runs: int | None = None
    ) -> None:
        self.design, self.hypotheses = design, tuple(hypotheses)
        self.which = range(design.training if runs is None else runs)
        self.fixed = design.fixed[: self.which.stop]
        self.grams = design.grams[: self.which.stop]
        self.mean = np.concatenate([item.mean for item in hypotheses] or [np.zeros(0)])
        std = np.concatenate([item.std for item in hypotheses] or [np.zeros(0)])
        self.width = PRIOR_WIDTHS * std
        self.delta = DIFFERENCE * std
        self.low = [item.low for one in hypotheses for item in one.coordinates]
        self.high = [item.high for one in hypotheses for item in one.coordinates]

    def residuals(self, scaled: Array, numbers: Array) -> list[Array] | None:
        """Return residuals of all runs with nothing but the model taken off."""
        design, size = self.design, self.design.size
        values = design.mean[:size] + design.scale[:size, :size] @ scaled[:size]
        return design.residual(values, effects_of(self.hypotheses, numbers), self.which)

    def answers(self, scaled: Array, numbers: Array, at: list[Array]) -> list[Array] | None:
        """Return how residuals fall per number, (rows, numbers) per run."""
        columns: list[list[Array]] = [[] for _ in at]
        for place, delta in enumerate(self.delta.tolist()):
            moved = numbers.copy()
            moved[place] += delta if numbers[place] + delta <= self.high[place] else -delta
            beside = self.residuals(scaled, moved)
            if beside is None:
                return None
            for run, values in enumerate(beside):
                columns[run].append((at[run] - values) / (moved[place] - numbers[place]))
        return [
            np.column_stack(item) if item else np.zeros((rest.size, 0))
            for item, rest in zip(columns, at, strict=True)
        ]

    def linear(self, scaled: Array, numbers: Array, at: list[Array]) -> GaussianModel | None:
        """Return the linear problem here."""
        answers = self.answers(scaled, numbers, at)
        if answers is None:
            return None
        position = np.concatenate([scaled, (numbers - self.mean) / self.width])
        size = self.design.size
        columns = [
            np.concatenate([fixed, item * self.width], axis=1)
            for fixed, item in zip(self.fixed, answers, strict=True)
        ]
        rest = [
            values - fixed[:, size:] @ scaled[size:]
            for fixed, values in zip(self.fixed, at, strict=True)
        ]
        return GaussianModel.of(columns, rest, position, self.grams_with(columns))

    def grams_with(self, columns: Sequence[Array]) -> list[Array]:
        """Return columns^T columns of each run, of which most is known."""
        out = []
        for known, item in zip(self.grams, columns, strict=True):
            size = known.shape[0]
            gram = np.empty((item.shape[1],) * 2)
            gram[:size, :size] = known
            gram[:, size:] = item.T @ item[:, size:]
            gram[size:, :size] = gram[:size, size:].T
            out.append(gram)
        return out

    def cost(self, scaled: Array, numbers: Array, at: list[Array]) -> float:
        """Half of chi squared and prior."""
        size = self.design.size
        cost = float(scaled @ scaled) + float(np.sum(((numbers - self.mean) / self.width) ** 2))
        for fixed, values in zip(self.fixed, at, strict=True):
            cost += float(np.sum((values - fixed[:, size:] @ scaled[size:]) ** 2))
        return 0.5 * cost

    def search(self, numbers: Array, base: Array | None = None) -> Refit | None:
        """Find the most probable numbers from a start; None where the start has no shapes.

        base: scaled position of all other unknowns to begin with; else that of the design.
        """
        scaled = base
        if scaled is None:
            known = self.design.position
            scaled = np.concatenate([known, np.zeros(self.fixed[0].shape[1] - known.size)])
        numbers = np.clip(numbers, self.low, self.high)
        at = self.residuals(scaled, numbers)
        problem = None if at is None else self.linear(scaled, numbers, at)
        if at is None or problem is None:
            return None
        here = Trial(scaled, numbers, at, self.cost(scaled, numbers, at))
        search = gauss_newton(
            (here, problem),
            self.newton_step,
            self.lower,
            self.relinearize,
            small=SMALL,
            most_steps=MOST_STEPS,
            most_halvings=MOST_HALVINGS,
        )
        (scaled, numbers, at, cost), problem = search.last
        converged = search.end is End.CONVERGED
        count = numbers.size
        covariance = problem.covariance[-count:, -count:] if count else np.zeros((0, 0))
        return Refit(
            design=self.design,
            hypotheses=self.hypotheses,
            numbers=numbers,
            covariance=covariance * np.outer(self.width, self.width),
            base=scaled,
            linear=problem,
            cost=cost,
            converged=converged,
        )

    def blocked(self, numbers: Array, step: Array) -> list[int]:
        """Return which unknowns are at a bound that the step would cross."""
        first = step.size - numbers.size
        change = step[first:]
        low = (numbers <= np.asarray(self.low)) & (change < 0.0)
        high = (numbers >= np.asarray(self.high)) & (change > 0.0)
        return [first + int(place) for place in np.flatnonzero(low | high)]

    def newton_step(self, last: tuple[Trial, GaussianModel]) -> tuple[Array, float]:
        """Return the full step within the bounds, and by how much it lowers the cost."""
        here, problem = last
        return problem.step_without(self.blocked(here.numbers, problem.step))

    def lower(self, last: tuple[Trial, GaussianModel], step: Array) -> Trial | None:
        """Return where a step leads; None where that is no better, or has no shapes."""
        here, size = last[0], last[0].scaled.size
        scaled = here.scaled + step[:size]
        numbers = np.clip(here.numbers + step[size:] * self.width, self.low, self.high)
        at = self.residuals(scaled, numbers)
        if at is None:
            return None
        cost = self.cost(scaled, numbers, at)
        return Trial(scaled, numbers, at, cost) if cost < here.cost else None

    def relinearize(self, trial: Trial) -> tuple[Trial, GaussianModel] | None:
        """Return the linear problem there; None where a neighbor has no shapes."""
        problem = self.linear(trial.scaled, trial.numbers, trial.residuals)
        return None if problem is None else (trial, problem)


def refit(
    design: Linearization, hypotheses: Sequence[Hypothesis], numbers: Array, rounds: int
) -> Refit | None:
    """Fit jointly, with the answer of the base model taken anew so many times at most."""
    found = Refitting(design, hypotheses).search(numbers)
    return None if found is None else finished(found, rounds)


def finished(found: Refit, rounds: int) -> Refit:
    """Take the answer of the base model anew, so many times at most, until the fit is settled."""
    for _ in range(rounds):
        if found.settled:
            break
        design = found.design.at(found.point)
        again = Refitting(design, found.hypotheses).search(found.numbers, found.base)
        if again is None:
            break
        gain, found = found.cost - again.cost, again
        if abs(gain) < SETTLED:
            found = replace(found, settled=True)
    return found
