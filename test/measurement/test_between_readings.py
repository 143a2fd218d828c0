"""What lies between two readings, beside random courses that these do not tell apart."""

from __future__ import annotations

import numpy as np
from pneunet_ros.measurement.between_readings import (
    error_between,
    frames_sharing,
    furthest_error,
    interpolate,
    interpolated_noise,
    interpolation_error,
)
import pytest

PERIOD = 100_000_000  # ns
STAMPS = PERIOD * np.arange(8)
NOISE = 60.0  # Pa


def missed(course, shown: int, noise: float = 0.0) -> tuple[float, float]:
    """Return what the line misses of a course(ns) at a stamp, and what it is said to miss."""
    values = np.array([course(stamp) for stamp in STAMPS])
    at = np.array([shown])
    error = interpolation_error(at, STAMPS, values, noise)[0]
    return float(interpolate(at, STAMPS, values)[0] - course(shown)), float(error)


def test_a_ramp_that_goes_on_and_a_value_that_rests_are_on_the_line():
    for course in (lambda t: 3e-5 * t, lambda t: 7e3):
        for shown in (PERIOD // 4, 3 * PERIOD + 7, int(6.8 * PERIOD)):
            off, error = missed(course, shown, NOISE)
            assert abs(off) < 1e-6
            if PERIOD < shown < 6 * PERIOD:
                assert error == 0.0


@pytest.mark.parametrize('share', [0.1, 0.5, 0.8])
def test_a_jump_at_an_unknown_instant_is_missed_by_as_much_as_is_said(share):
    random = np.random.default_rng(1)
    shown = round((3 + share) * PERIOD)
    found = []
    for instant in random.uniform(3 * PERIOD, 4 * PERIOD, 4000):
        off, said = missed(lambda t, at=instant: 5e3 * (t >= at), shown)
        found.append(off)
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(said, rel=0.05)
    assert said == pytest.approx(5e3 * np.sqrt(share * (1.0 - share)))


def test_a_ramp_that_begins_between_readings_is_the_furthest_that_is_allowed_for():
    random = np.random.default_rng(2)
    for begins, share in random.uniform(size=(200, 2)):
        start = (3 + begins) * PERIOD
        off, said = missed(lambda t, at=start: 5e-5 * max(t - at, 0), round((3 + share) * PERIOD))
        assert off / said == pytest.approx(np.sqrt(3.0), rel=1e-3)


def test_nothing_is_further_off_than_is_said():
    random = np.random.default_rng(5)
    for begins, share in random.uniform(size=(300, 2)):
        start, shown = (3 + begins) * PERIOD, round((3 + share) * PERIOD)
        most = furthest_error(np.array([shown]), STAMPS)[0]
        for course in (lambda t, at=start: 5e3 * (t >= at), lambda t, at=start: max(t - at, 0)):
            off, said = missed(course, shown)
            assert abs(off) <= 1.001 * most * said
    assert furthest_error(np.array([9]), STAMPS[:1]).tolist() == [np.sqrt(3.0)]


@pytest.mark.parametrize('share', [0.05, 0.5, 0.9])
def test_a_step_that_a_reading_interrupts_is_missed_by_as_much_as_is_said(share):
    """It began before reading 3 and ended behind it, half of it on either side."""
    random = np.random.default_rng(6)
    found, told = [], []
    for half in random.uniform(0.01, 1.0, 4000) * PERIOD:

        def course(t, half=half):
            return 5e3 * np.clip((t - 3 * PERIOD) / half, -1.0, 1.0)

        for shown in ((3 + share) * PERIOD, (3 - share) * PERIOD):
            off, said = missed(course, round(shown))
            found.append(off)
            told.append(said)
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(np.mean(told), rel=0.15)


def test_a_smooth_course_keeps_most_of_its_weight():
    off, said = missed(lambda t: 2e4 * np.sin(t / (5 * PERIOD)), int(3.5 * PERIOD))
    assert abs(off) < said < 3.0 * abs(off)


def test_noise_alone_is_hardly_ever_taken_for_a_jump():
    random = np.random.default_rng(3)
    shown = np.array([int(3.5 * PERIOD)])
    said = [
        interpolation_error(shown, STAMPS, NOISE * random.standard_normal(8), NOISE)[0]
        for _ in range(2000)
    ]
    assert np.mean(np.square(said)) < 0.05 * NOISE**2


def test_many_values_are_as_one_by_one():
    random = np.random.default_rng(4)
    values = random.standard_normal((8, 3))
    shown = np.sort(random.integers(0, 9 * PERIOD, 20))
    together = interpolation_error(shown, STAMPS, values, [0.0, 0.1, 1.0])
    for column, noise in enumerate((0.0, 0.1, 1.0)):
        alone = interpolation_error(shown, STAMPS, values[:, column], noise)
        np.testing.assert_allclose(together[:, column], alone)


def test_beyond_the_last_reading_a_value_may_go_on():
    off, said = missed(lambda t: 3e-5 * t, int(7.5 * PERIOD))
    assert said == pytest.approx(abs(off))


def test_one_reading_tells_nothing_of_between():
    one = np.array([5]), np.array([3.0])
    assert interpolation_error(np.array([9]), *one, 1.0).tolist() == [0.0]
    assert interpolated_noise(np.array([9]), one[0]).tolist() == [1.0]


def test_frames_that_share_readings_are_counted():
    stamps = np.array([0, 100, 200, 300])
    shown = np.array([5, 10, 40, 100, 150, 250, 260, 299, 300])
    assert frames_sharing(shown, stamps).tolist() == [4, 4, 4, 1, 2, 4, 4, 4, 4]
    assert frames_sharing(shown, stamps[:1]).tolist() == [9] * 9
    for phase in (0, PERIOD // 3, PERIOD // 2):
        assert frames_sharing(STAMPS + phase, STAMPS).tolist() == [1] * STAMPS.size
        assert frames_sharing(STAMPS + phase, STAMPS[::4]).tolist() == [4] * STAMPS.size
    assert frames_sharing(STAMPS[::4], STAMPS).tolist() == [1, 1]
    assert frames_sharing(np.array([4, 5]), np.array([0, 10])).tolist() == [2, 2]


@pytest.mark.parametrize('frames', [1, 4, 25])
def test_frames_that_share_readings_tell_as_much_together_as_these(frames):
    """The mean of the values at all frames, each weighed as if its noise were its own."""
    random = np.random.default_rng(3)
    stamps = PERIOD * np.arange(401)
    shown = (PERIOD * (np.arange(400 * frames) + 0.5) / frames).astype(np.int64)
    weights = 1.0 / frames_sharing(shown, stamps)
    said = NOISE / np.sqrt(weights.sum())
    means = [
        np.average(
            interpolate(shown, stamps, NOISE * random.standard_normal(401)), weights=weights
        )
        for _ in range(1500)
    ]
    assert np.std(means) == pytest.approx(said, rel=0.08)


@pytest.mark.parametrize('ramps', [(0.2, 1.2), (1.0, 4.0)], ids=['short', 'long'])
def test_ramps_as_short_as_the_time_between_readings_are_missed_by_as_much_as_is_said(ramps):
    """A ramp through two intervals looks like one that went on evenly, and was steeper."""
    random = np.random.default_rng(7)
    off, said = [], []
    for _ in range(1500):
        time, value = [0.0], [0.0]
        while time[-1] < 40.0:
            time += [time[-1] + random.uniform(1.0, 6.0)]
            time += [time[-1] + random.uniform(*ramps)]
            value += [value[-1], random.uniform(0.0, 6e4)]
        stamps = PERIOD * np.arange(30)
        shown = PERIOD * np.arange(3, 27) + random.integers(0, PERIOD, 24)
        late = random.uniform(0.0, 1.0)
        true = np.interp([stamps / PERIOD + late], time, value)[0]
        read = true + NOISE * random.standard_normal(true.size)
        off.append(
            interpolate(shown, stamps, read) - np.interp(shown / PERIOD + late, time, value)
        )
        said.append(np.hypot(NOISE, interpolation_error(shown, stamps, read, NOISE)))
    sigma = np.abs(np.array(off) / np.array(said))
    assert np.sqrt(np.mean(sigma**2)) < 1.5
    assert np.mean(sigma > 10.0) < 2e-3
    assert np.mean(said) < 1.5 * np.sqrt(np.mean(np.square(off)))


def test_how_far_off_one_value_may_well_be():
    values = 5e3 * (STAMPS >= 4 * PERIOD)
    at = 3 * PERIOD + PERIOD // 4
    assert error_between(at, STAMPS, values, NOISE) == pytest.approx(0.75 * 5e3, rel=0.02)
    assert error_between(3 * PERIOD + 10, STAMPS, values, NOISE) < 10.0  # at a reading
    assert error_between(at, STAMPS[:5], values[:5], NOISE) > 3e3  # what comes is not known
    assert error_between(at, STAMPS, 1e-5 * STAMPS, NOISE) == 0.0
