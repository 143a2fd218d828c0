"""The damped Gauss-Newton search: full steps, halved until they lower the cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from pneunet_ros.core.arrays import Array

Linear = TypeVar('Linear')
Trial = TypeVar('Trial')


class End(Enum):
    """How a search ended."""

    CONVERGED = 'the next step gains next to nothing'
    STUCK = 'no step lowers the cost'
    UNFINISHED = 'the allowed steps are used up'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Search(Generic[Linear]):
    """The linearization where it ended, how many steps were looked at, and what one may gain."""

    last: Linear
    steps: int
    gain: float
    end: End


def gauss_newton(
    start: Linear,
    newton_step: Callable[[Linear], tuple[Array, float]],
    lower: Callable[[Linear, Array], Trial | None],
    relinearize: Callable[[Trial], Linear | None],
    *,
    small: float,
    most_steps: int,
    most_halvings: int,
    on_step: Callable[[int, Linear], None] = lambda step, last: None,
) -> Search[Linear]:
    """Search from a linearization for the lowest cost.

    newton_step: the full step from a linearization and its gain, in any measure; below `small` the
    search ends. lower: where a step leads, None where that costs no less. relinearize: there; None
    where it cannot be. on_step: is told the number of each step and where it starts.
    """
    last, gain = start, float('inf')
    for count in range(1, most_steps + 1):
        step, gain = newton_step(last)
        on_step(count, last)
        if gain < small:
            return Search(last=last, steps=count, gain=gain, end=End.CONVERGED)
        shares = (0.5**halvings for halvings in range(most_halvings))
        trials = (lower(last, share * step) for share in shares)
        trial = next((item for item in trials if item is not None), None)
        following = None if trial is None else relinearize(trial)
        if following is None:
            return Search(last=last, steps=count, gain=gain, end=End.STUCK)
        last = following
    return Search(last=last, steps=most_steps, gain=gain, end=End.UNFINISHED)
