"""The white noise of readings that move."""

from __future__ import annotations

import numpy as np
from pneunet_ros.measurement.errors.white_noise import white_std
import pytest

STD = 0.01


def read(course, count: int, period: float, seed: int = 1) -> np.ndarray:
    noise = STD * np.random.default_rng(seed).standard_normal((count, 2))
    return course(period * np.arange(count))[:, None] + noise


@pytest.mark.parametrize('period', [0.002, 0.02, 0.1, 0.3])
def test_a_swing_and_jumps_do_not_count(period):
    def course(time):
        return 0.125 * np.sin(2.1 * time) + 0.3 * (time > 20.0 * period)

    found = [white_std(read(course, 60, period, seed)) for seed in range(40)]
    assert np.mean(found) == pytest.approx(STD, rel=0.12)
    assert np.min(found) > 0.5 * STD
    assert np.max(found) < 1.5 * STD


def test_little_is_said_of_little():
    def resting(time):
        return np.zeros(time.size)

    assert white_std(read(resting, 7, 0.02)) == 0.0
    few = [white_std(read(resting, 8, 0.02, seed)) for seed in range(200)]
    assert np.median(few) == pytest.approx(STD, rel=0.3)
    assert white_std(np.zeros((60, 2))) == 0.0


@pytest.mark.parametrize('axis', [0, 1])
def test_an_axis_that_is_not_measured_does_not_hide_the_noise_of_the_other(axis):
    readings = read(np.zeros_like, 60, 0.02)
    readings[:, axis] = 0.0
    assert white_std(readings) == pytest.approx(STD, rel=0.3)
