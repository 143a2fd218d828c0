"""Joint fit of effects and the rest of the model, with free shape parameters.

Gauss-Newton: the Jacobian of the base model is that of its linearization, the Jacobian of the
effects is recomputed at every step, and residuals are those of the exact equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.settings import REFIT
from pneunet_ros.effects.effect import Effect
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
from pneunet_ros.measurement.gauss_newton import Bounds, gauss_newton

MOST_STEPS = 5  # Gauss-Newton steps per round
MOST_HALVINGS = 5  # of a step that does not lower the cost
# Step of numerical derivatives, of the prior's std. The base absorbs most of the effect of
# gravity: with a coarser step the curvature of the difference exceeds the rest, and counts as
# information.
DIFFERENCE = 5e-4
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
BASE_ROUNDS = 20  # most relinearizations of the base fit, without effects
UNSETTLED = 1e-3  # relative gain of a further step below which the fit has converged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refit:
    """Effects fitted jointly: their numbers and covariance, and the linear problem at the end.

    numbers (k,) of all hypotheses, in order; base (n,): scaled position of all other unknowns;
    gaussian: with columns base, departures, numbers. settled: whether another linearization would
    change nothing.
    """

    linearization: Linearization
    hypotheses: tuple[Hypothesis, ...]
    numbers: Array
    covariance: Array
    base: Array
    gaussian: GaussianModel
    cost: float
    settled: bool = False

    @property
    def gain(self) -> float:
        """Reduction of the cost by one more step, in the linearization."""
        gaussian = self.gaussian
        bounds = self.linearization.bounds(self.base, gaussian.position.size)
        return bounds.hold(gaussian.step, gaussian.gain, gaussian.solved)[1]

    @property
    def misfit(self) -> float:
        """The cost without the volume of errors: half of chi squared and prior."""
        return self.cost - sum(self.gaussian.log_volumes)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects with the fitted numbers."""
        return effects_of(self.hypotheses, self.numbers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(item.name for item in self.hypotheses)

    @property
    def point(self) -> LinearizationPoint:
        """The end point of the fit."""
        linearization = self.linearization
        values = linearization.mean + linearization.scale @ self.base[: linearization.mean.size]
        return replace(
            linearization.point,
            values=frozen_array(values[: linearization.size]),
            placement=frozen_array(values[linearization.size :].reshape(2, -1)),
            effects=self.effects,
        )


def split_numbers(hypotheses: Sequence[Hypothesis], numbers: Array) -> list[Array]:
    """Return the numbers of each hypothesis."""
    ends = np.cumsum([item.size for item in hypotheses])
    return list(np.split(numbers, ends[:-1])) if hypotheses else []


def effects_of(hypotheses: Sequence[Hypothesis], numbers: Array) -> tuple[Effect, ...]:
    """Return the effects with these numbers."""
    parts = split_numbers(hypotheses, numbers)
    return tuple(item.effect(part) for item, part in zip(hypotheses, parts, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Iterate:
    """A point of the search: scaled base (n,), numbers (k,), residuals (rows,) per run, cost.

    Residuals are those of the model alone; the cost is half of chi squared and prior, plus the log
    volume of the errors used for whitening, which are larger for a softer arm.
    """

    base: Array
    numbers: Array
    residuals: list[Array]
    cost: float


class JointFit:
    """Joint fit of hypotheses to the training runs, or to all runs."""

    def __init__(
        self,
        linearization: Linearization,
        hypotheses: Sequence[Hypothesis],
        *,
        all_runs: bool = False,
    ) -> None:
        self.linearization, self.hypotheses = linearization, tuple(hypotheses)
        self.runs = range(len(linearization.blocks) if all_runs else linearization.training)
        self.fixed = linearization.fixed[: self.runs.stop]
        self.grams = linearization.grams[: self.runs.stop]
        self.log_volumes = [item.log_volume for item in linearization.blocks[: self.runs.stop]]
        nothing = [np.zeros(0)]
        self.mean = np.concatenate([item.mean for item in hypotheses] or nothing)
        self.std = np.concatenate([item.std for item in hypotheses] or nothing)
        self.low = np.concatenate([item.low for item in hypotheses] or nothing)
        self.high = np.concatenate([item.high for item in hypotheses] or nothing)

    def residuals(self, base: Array, numbers: Array) -> list[Array] | None:
        """Return residuals (rows,) per run, without subtracting placement and departures."""
        linearization, size = self.linearization, self.linearization.size
        values = linearization.mean[:size] + linearization.scale[:size, :size] @ base[:size]
        return linearization.residual(values, effects_of(self.hypotheses, numbers), self.runs)

    def iterate(self, base: Array, numbers: Array) -> Iterate | None:
        """Return a point of the search; None if the model has no shape there."""
        residuals = self.residuals(base, numbers)
        if residuals is None:
            return None
        cost = float(base @ base) + float(np.sum(((numbers - self.mean) / self.std) ** 2))
        cost += 2.0 * sum(self.log_volumes)
        for values in self.without_departures(base, residuals):
            cost += float(np.sum(values**2))
        return Iterate(base=base, numbers=numbers, residuals=residuals, cost=0.5 * cost)

    def without_departures(self, base: Array, residuals: Sequence[Array]) -> list[Array]:
        """Return residuals after subtracting placement and departures."""
        size = self.linearization.size
        pairs = zip(self.fixed, residuals, strict=True)
        return [values - fixed[:, size:] @ base[size:] for fixed, values in pairs]

    def jacobian(self, at: Iterate) -> list[Array] | None:
        """Return the negative Jacobian of the residuals, (rows, numbers) per run."""
        columns: list[list[Array]] = [[] for _ in at.residuals]
        for place, delta in enumerate((DIFFERENCE * self.std).tolist()):
            moved = at.numbers.copy()
            moved[place] += delta if moved[place] + delta <= self.high[place] else -delta
            residuals = self.residuals(at.base, moved)
            if residuals is None:
                return None
            change = moved[place] - at.numbers[place]
            for run, values in enumerate(residuals):
                columns[run].append((at.residuals[run] - values) / change)
        return [
            np.column_stack(item) if item else np.zeros((values.size, 0))
            for item, values in zip(columns, at.residuals, strict=True)
        ]

    def linearize(self, at: Iterate) -> GaussianModel | None:
        """Return the linear problem at a point of the search; None if there is none."""
        jacobian = self.jacobian(at)
        if jacobian is None:
            return None
        pairs = zip(self.fixed, jacobian, strict=True)
        columns = [np.concatenate([fixed, item * self.std], axis=1) for fixed, item in pairs]
        if not all(np.isfinite(item).all() for item in columns):
            return None  # next to a shape at the limit of existence
        return GaussianModel.of(
            columns,
            self.without_departures(at.base, at.residuals),
            np.concatenate([at.base, (at.numbers - self.mean) / self.std]),
            [complete_gram(*pair) for pair in zip(self.grams, columns, strict=True)],
            self.log_volumes,
        )

    def start(self) -> Array:
        """Return the scaled position of the base in the linearization, without departures."""
        known = self.linearization.position
        return np.concatenate([known, np.zeros(self.fixed[0].shape[1] - known.size)])

    def fit(self, numbers: Array, base: Array | None = None) -> Refit | None:
        """Find the most probable numbers from a start; None if the arm has no shapes there.

        base: initial scaled position of all other unknowns; None: that of the linearization.
        """
        numbers = np.clip(numbers, self.low, self.high)
        at = self.iterate(self.start() if base is None else base, numbers)
        gaussian = None if at is None else self.linearize(at)
        if at is None or gaussian is None:
            return None
        search = gauss_newton(
            (at, gaussian),
            self.newton_step,
            self.lower,
            self.relinearize,
            small=REFIT.least_gain,
            most_steps=MOST_STEPS,
            most_halvings=MOST_HALVINGS,
        )
        at, gaussian = search.last
        count = numbers.size
        covariance = gaussian.covariance[-count:, -count:] if count else np.zeros((0, 0))
        return Refit(
            linearization=self.linearization,
            hypotheses=self.hypotheses,
            numbers=at.numbers,
            covariance=covariance * np.outer(self.std, self.std),
            base=at.base,
            gaussian=gaussian,
            cost=at.cost,
        )

    def active_bounds(self, numbers: Array, step: Array) -> list[int]:
        """Return a mask of unknowns at a bound that the step would cross."""
        first = step.size - numbers.size
        change = step[first:]
        low = (numbers <= self.low) & (change < 0.0)
        high = (numbers >= self.high) & (change > 0.0)
        return [first + int(place) for place in np.flatnonzero(low | high)]

    def newton_step(self, last: tuple[Iterate, GaussianModel]) -> tuple[Array, float]:
        """Return the full step within the bounds, and its reduction of the cost."""
        at, gaussian = last
        bounds = self.linearization.bounds(at.base, gaussian.position.size)
        active = self.active_bounds(at.numbers, gaussian.step)
        nothing = np.zeros(len(active))
        bounds = Bounds(
            rows=np.concatenate([bounds.rows, np.eye(gaussian.position.size)[active]]),
            low=np.concatenate([bounds.low, nothing]),
            high=np.concatenate([bounds.high, nothing]),
        )
        return bounds.hold(gaussian.step, gaussian.gain, gaussian.solved)

    def lower(self, last: tuple[Iterate, GaussianModel], step: Array) -> Iterate | None:
        """Return the end of a step; None if its cost is not lower, or it has no solution."""
        at, size = last[0], last[0].base.size
        numbers = np.clip(at.numbers + step[size:] * self.std, self.low, self.high)
        following = self.iterate(at.base + step[:size], numbers)
        return following if following is not None and following.cost < at.cost else None

    def relinearize(self, at: Iterate) -> tuple[Iterate, GaussianModel] | None:
        """Return the linear problem at a point of the search; None if there is no solution."""
        gaussian = self.linearize(at)
        return None if gaussian is None else (at, gaussian)


def complete_gram(known: Array, columns: Array) -> Array:
    """Complete columns^T columns (n, n), whose first block is known."""
    size = known.shape[0]
    gram = np.empty((columns.shape[1],) * 2)
    gram[:size, :size] = known
    gram[:, size:] = columns.T @ columns[:, size:]
    gram[size:, :size] = gram[:size, size:].T
    return gram


def refit(
    linearization: Linearization,
    hypotheses: Sequence[Hypothesis],
    numbers: Array,
    rounds: int | None = None,
) -> Refit | None:
    """Fit jointly with a limited number of relinearizations; None if there is no solution."""
    first = JointFit(linearization, hypotheses).fit(numbers)
    return None if first is None else settle(first, rounds)


def settle(fit: Refit, rounds: int | None = None) -> Refit:
    """Relinearize and fit to convergence, a limited number of times.

    Reading errors are weighted by the linearized model, so a search may alternate between two
    models: if the cost rises, the search continues halfway between them. If it does not converge,
    or if there is no arm halfway, the most probable fit among all converged rounds is returned,
    because a fit that was stopped far from its minimum may have a lower cost only because its
    initial model had larger errors.
    """
    around, best = fit, None
    for _ in range(REFIT.rounds if rounds is None else rounds):
        if fit.settled:
            break
        try:
            linearization = fit.linearization.at(around.point)
        except ModelError:  # a rigidity crosses zero between two signs
            break
        again = JointFit(linearization, fit.hypotheses).fit(around.numbers, around.base)
        if again is None:
            break
        around = again if again.cost < fit.cost else average_fits(around, again)
        fit = replace(again, settled=abs(fit.cost - again.cost) < REFIT.least_gain)
        pair = (fit,) if best is None else (fit, best)
        best = min(pair, key=lambda item: (not has_ended(item), item.cost))
    return fit if fit.settled else best or fit


def has_ended(fit: Refit) -> bool:
    """Whether the search of a fit has converged, relative to its misfit."""
    return fit.gain < max(REFIT.least_gain, UNSETTLED * fit.misfit)


def average_fits(one: Refit, other: Refit) -> Refit:
    """Return a fit with the average of the unknowns of two."""
    return replace(
        other, numbers=0.5 * (one.numbers + other.numbers), base=0.5 * (one.base + other.base)
    )


def linearize_all_runs(
    linearization: Linearization, fit: Refit
) -> tuple[Iterate, GaussianModel] | None:
    """Linearize all runs at a fit to some of them; None if one has no solution.

    Scores of fields in held-out recordings are then conditional on the training recordings: V^-1
    of all runs, with the fields of a subset, is that of the subset given the other runs.
    """
    search = JointFit(linearization, fit.hypotheses, all_runs=True)
    at = search.iterate(fit.base, fit.numbers)
    gaussian = None if at is None else search.linearize(at)
    return None if at is None or gaussian is None else (at, gaussian)


def effect_direction(
    linearization: Linearization, fit: Refit, residuals: Sequence[Array], effect: Effect
) -> tuple[Array, ...] | None:
    """Return the reduction of whitened residuals (rows,) per run by an additional effect.

    residuals: without that effect, of the first runs of the linearization. None if the arm has no
    shape with it.
    """
    effects = (*fit.effects, effect)
    changed = linearization.residual(fit.point.values, effects, range(len(residuals)))
    if changed is None:
        return None
    return tuple(before - after for before, after in zip(residuals, changed, strict=True))
