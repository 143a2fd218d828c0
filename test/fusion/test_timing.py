"""The rate of the pressure around a frame, and a frame with the readings of another time."""

from dataclasses import replace

import numpy as np
from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.fusion.readings import (
    NearWrench,
    pressure_at,
    PressureInstant,
    rate_around,
    ReadFrame,
)
import pytest

MS = 1_000_000
STD = 50.0


def readings(course, *, count=40, every_ns=10 * MS, std=STD):
    """Return pressures every 10 ms, from stamp 0 on; course: Pa of s."""
    stamps = range(0, count * every_ns, every_ns)
    return tuple(
        PressureInstant(
            stamp_ns=stamp_ns, gauge=value, chamber=value, std=std, history=(), memory=()
        )
        for stamp_ns, value in ((one, course(1e-9 * one)) for one in stamps)
    )


def ramp(time):
    return 1e3 + 2e4 * time


def test_the_rate_of_a_ramp_is_its_slope_on_both_sides_and_at_its_end():
    known = readings(ramp, std=1e-6)
    for stamp_ns in (200 * MS, 203 * MS, 390 * MS, 0):
        assert rate_around(known, stamp_ns, 0.03) == pytest.approx(2e4)


def test_noise_has_no_rate_and_a_faint_ramp_a_smaller_one():
    random = np.random.default_rng(3)
    rates = []
    for _ in range(300):
        noise = iter(STD * random.standard_normal(40))
        rates.append(rate_around(readings(lambda _, noise=noise: next(noise)), 200 * MS, 0.033))
    sigma = STD / (0.01 * np.sqrt(60.0))  # of a line through nine readings
    assert np.mean(np.array(rates) == 0.0) > 0.6
    assert np.abs(rates).max() < 4.0 * sigma
    faint = rate_around(readings(lambda time: 2.0 * sigma * time), 200 * MS, 0.033)
    assert faint == pytest.approx(1.5 * sigma, rel=0.01)


def test_a_ripple_is_noise():
    known = readings(lambda time: 2.5e3 * np.sin(2.0 * np.pi * 27.0 * time))
    rates = [rate_around(known, stamp_ns * MS, 0.033) for stamp_ns in range(50, 350, 7)]
    assert np.mean(np.array(rates) == 0.0) > 0.7


@pytest.mark.parametrize('count', [0, 1])
def test_without_two_readings_there_is_no_rate(count):
    assert rate_around(readings(ramp, count=count), 200 * MS, 0.03) == 0.0


def frame(stamp_ns=200 * MS):
    nothing = np.full(3, np.nan)
    names = ('x', 'y', 'std', 'u', 'v', 'area', 'major', 'minor', 'angle')
    known = readings(ramp)
    pulls = tuple(
        WrenchReading(
            stamp_ns=one.stamp_ns,
            force_x=0.0,
            force_y=1e-9 * one.stamp_ns,
            moment=0.0,
            frame_id='pneunet_base',
        )
        for one in known
    )
    return ReadFrame(
        stamp_ns=stamp_ns,
        sightings=TargetSightings(stamp_ns=stamp_ns, **dict.fromkeys(names, nothing)),
        instant=pressure_at(known, stamp_ns),
        alone=False,
        pressure_still=False,
        wrench=NearWrench(reading=pulls[20], age=0.0, std=1e-3),
        before=known,
        pulls=pulls,
    )


def test_a_frame_at_another_delay_has_the_readings_of_then():
    late = frame().delayed(-104 * MS, 0.03)
    assert late.stamp_ns == 96 * MS
    assert late.instant.stamp_ns == 96 * MS
    assert late.instant.chamber == pytest.approx(ramp(0.096))
    assert late.instant.rate == pytest.approx(2e4, rel=1e-2)
    assert late.wrench.reading.stamp_ns == 100 * MS
    assert late.wrench.age == pytest.approx(-4e-3)
    again = late.delayed(0, 0.03)
    assert again.instant.chamber == pytest.approx(frame().instant.chamber)
    assert again.wrench.reading.stamp_ns == 200 * MS


def test_a_known_delay_changes_nothing():
    seen = frame()
    assert seen.delayed(0, 0.0) is seen
    assert seen.instant.rate == 0.0


def test_without_pressure_only_the_time_changes():
    alone = replace(frame(), alone=True, wrench=None)
    late = alone.delayed(-100 * MS, 0.03)
    assert late.stamp_ns == 100 * MS
    assert late.instant.chamber == alone.instant.chamber
    assert late.instant.rate == 0.0
