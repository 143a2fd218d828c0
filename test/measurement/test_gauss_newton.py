"""The damped Gauss-Newton search on a function of one number."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.measurement.gauss_newton import End, gauss_newton, Search


def search(start: float, **limits: float) -> Search[float]:
    """Find the lowest cost (arctan x)^2 / 2: from afar a full step leads far beyond."""

    def cost(x: float) -> float:
        return 0.5 * math.atan(x) ** 2

    def newton_step(x: float) -> tuple[np.ndarray, float]:
        return np.array([-math.atan(x) * (1.0 + x**2)]), abs(math.atan(x))

    def lower(x: float, step: np.ndarray) -> float | None:
        there = x + float(step[0])
        return there if cost(there) < cost(x) else None

    settings = {'small': 1e-9, 'most_steps': 20, 'most_halvings': 8} | limits
    return gauss_newton(start, newton_step, lower, lambda there: there, **settings)


def test_steps_that_are_too_long_are_halved():
    found = search(20.0)
    assert found.end is End.CONVERGED
    assert abs(found.last) < 1e-9
    assert found.gain < 1e-9
    assert search(20.0, most_halvings=1).end is End.STUCK


def test_the_steps_allowed_are_not_exceeded():
    found = search(20.0, most_steps=2)
    assert (found.end, found.steps) == (End.UNFINISHED, 2)
    assert abs(found.last) < 20.0


def test_a_place_that_cannot_be_linearized_ends_it():
    found = gauss_newton(
        1.0,
        lambda x: (np.array([-x]), abs(x)),
        lambda x, step: x + float(step[0]),
        lambda there: None,
        small=1e-3,
        most_steps=9,
        most_halvings=1,
    )
    assert (found.end, found.last) == (End.STUCK, 1.0)
