"""Damped Gauss-Newton search: full steps, halved until they lower the cost.

With bounds, the full step is the optimum within the bounds: clipping an unbounded step may not
lower the cost, and the search would get stuck.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

import numpy as np
from pneunet_ros.core.arrays import Array

NO_STEP = 1e-12  # violation of a bound by rounding

Linear = TypeVar('Linear')
Trial = TypeVar('Trial')


class End(Enum):
    """Result of a search."""

    CONVERGED = 'the next step gains almost nothing'
    STUCK = 'no step lowers the cost'
    UNFINISHED = 'the maximum number of steps was reached'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Search(Generic[Linear]):
    """The final linearization, the number of evaluated steps, and the possible gain."""

    last: Linear
    steps: int
    gain: float
    end: End


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bounds:
    """Bounds low and high (m,) on linear functions (m, n) @ (n,) of a step."""

    rows: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, rows: Array, values: Array, limits: tuple[Array, Array]) -> Bounds:
        """Evaluate the bounded functions: present values (m,) and limits (m,)."""
        low, high = limits
        bounded = np.isfinite(low) | np.isfinite(high)
        return cls(rows=rows[bounded], low=(low - values)[bounded], high=(high - values)[bounded])

    def hold(
        self, step: Array, gain: float, solved: Callable[[Array], Array]
    ) -> tuple[Array, float]:
        """Return the optimal step (n,) within the bounds, and its reduction of the cost.

        step and gain: of the unbounded optimum; solved: returns the inverse of the Hessian times
        (n, k). Functions that would exceed a bound are fixed at that bound, and the step is solved
        again for the rest.
        """
        best, best_gain = step, gain
        at_bound = np.zeros(len(self.rows), dtype=bool)
        while True:
            change = self.rows @ best
            beyond = ~at_bound & ((change < self.low - NO_STEP) | (change > self.high + NO_STEP))
            if not beyond.any():
                return best, best_gain
            at_bound |= beyond
            rows = self.rows[at_bound]
            free = rows @ step
            excess = free - np.clip(free, self.low[at_bound], self.high[at_bound])
            response = solved(rows.T)
            forces = np.linalg.lstsq(rows @ response, excess)[0]
            best, best_gain = step - response @ forces, gain - 0.5 * float(forces @ excess)


def gauss_newton(
    start: Linear,
    newton_step: Callable[[Linear], tuple[Array, float]],
    lower: Callable[[Linear, Array], Trial | None],
    relinearize: Callable[[Trial], Linear | None],
    *,
    small: float,
    most_steps: int,
    most_halvings: int,
    predict_end: bool = False,
    on_step: Callable[[int, Linear], None] = lambda step, last: None,
) -> Search[Linear]:
    """Search from a linearization for the lowest cost.

    newton_step: returns the full step from a linearization, and its gain in any measure; the
    search ends if the gain is below `small`. lower: returns the end of a step, or None if the cost
    does not fall enough. relinearize: linearizes at that end; None if the linearization fails.
    predict_end: whether to end one step earlier if gains fall so fast that the step after the next
    would gain less than `small`; the caller then takes the next step, for which the problem is
    practically linear. on_step: called with the number and the start of each step.
    """
    last, gain = start, float('inf')
    for count in range(1, most_steps + 1):
        previous_gain = gain
        step, gain = newton_step(last)
        on_step(count, last)
        predicted_gain = (
            gain * min(gain / previous_gain, 1.0) if predict_end and count > 1 else gain
        )
        if predicted_gain < small:
            return Search(last=last, steps=count, gain=gain, end=End.CONVERGED)
        shares = (0.5**halvings for halvings in range(most_halvings))
        trials = (lower(last, share * step) for share in shares)
        trial = next((item for item in trials if item is not None), None)
        following = None if trial is None else relinearize(trial)
        if following is None:
            return Search(last=last, steps=count, gain=gain, end=End.STUCK)
        last = following
    return Search(last=last, steps=most_steps, gain=gain, end=End.UNFINISHED)
