"""Filtered readings: less noise, every step and turning point, frames with their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.reading_filter import (
    filter_readings,
    filtered,
    FilteredReadings,
    without_reading_noise,
)
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

STD = 60.0  # Pa
NOISE = replace(USUAL, pressure_std=STD)
RATES = (5.0, 10.0, 25.0, 50.0)  # Hz
# Rest, a step, a hold, a slow ramp, a turning point, a hold, a short pulse.
CORNERS = (0.0, 4.0, 4.1, 10.0, 20.0, 26.0, 30.0, 30.1, 30.5, 30.6, 36.0)  # s
PRESSURES = (0.0, 0.0, 30e3, 30e3, 60e3, 20e3, 20e3, 25e3, 25e3, 20e3, 20e3)  # Pa


def with_readings(pressure: Array, rate: float = 50.0, frames: int = 30) -> RecordingData:
    """Return a run of so many readings, and a few frames spread over them."""
    run = made(paper_arm(), np.zeros(frames))
    reading = np.sort(np.random.default_rng(2).choice(pressure.size, frames, replace=False))
    period = NANOSECONDS_PER_SECOND / rate
    stamps = np.rint(period * (1 + np.arange(pressure.size))).astype(np.int64)
    return replace(
        run,
        reading_stamp_ns=stamps,
        pressure=pressure,
        stamp_ns=stamps[reading] + 7,
        reading=reading,
    )


def course(rate: float) -> Array:
    """Return true pressures (Pa) at this rate."""
    return np.interp(np.arange(0.0, CORNERS[-1], 1.0 / rate), CORNERS, PRESSURES)


def joined(run: RecordingData, filtered: FilteredReadings) -> Array:
    """Return filtered readings, joined by straight lines, at all readings of the run."""
    lines = filtered.run
    return np.interp(run.reading_stamp_ns, lines.reading_stamp_ns, lines.pressure)


@pytest.mark.parametrize('rate', RATES)
@pytest.mark.parametrize('std', [STD, 300.0])
def test_most_noise_goes_and_the_pressure_stays(rate: float, std: float):
    truth = course(rate)
    noise = std * np.random.default_rng([3, int(rate)]).standard_normal(truth.size)
    run = with_readings(truth + noise, rate)
    left = joined(run, filter_readings(run, replace(USUAL, pressure_std=std))) - truth
    assert left.std() < 0.62 * std  # at 5 Hz, where many lines have few readings
    assert np.abs(left).max() < 4.5 * std  # nothing but noise was taken for noise


def test_the_lines_through_an_hour_are_as_good_as_those_through_a_minute():
    """Differences of sums over all readings were rounding errors: 80 sigma beside the truth."""
    time = np.arange(0.0, 3600.0, 0.01)
    corners, pressures = (0, 1, 5, 5.2, 12, 12.05, 20), (0.0, 3e4, 3e4, 5e4, 5e4, 0.0, 0.0)
    truth = np.interp(time % 20.0, corners, pressures)
    noise = STD * np.random.default_rng(1).standard_normal(truth.size)
    stamps = np.rint(time * NANOSECONDS_PER_SECOND).astype(np.int64)
    left = np.abs(filtered(stamps, truth + noise, STD) - truth)
    assert left.max() < 10.0 * STD


@pytest.mark.parametrize('rate', RATES)
def test_straight_lines_without_noise_are_kept_to_the_last_corner(rate: float):
    truth = course(rate)
    run = with_readings(truth, rate)
    assert joined(run, filter_readings(run, replace(USUAL, pressure_std=0.0))) == pytest.approx(
        truth, abs=0.01
    )


def test_a_hold_is_level_so_that_no_play_moves_in_it():
    noise = STD * np.random.default_rng(5).standard_normal(2000)
    run = with_readings(np.where(np.arange(2000) < 900, 10e3, 40e3) + noise)
    filtered = filter_readings(run, NOISE).run
    levels = np.unique(np.round(filtered.pressure, 6))
    assert levels == pytest.approx([10e3, 40e3], abs=4.0 * STD / np.sqrt(900))
    # The noise of the readings themselves would drag it along by twice its largest value.
    (inputs,) = inputs_of(paper_arm((Hysteresis(width=200.0),)), [filtered])
    assert np.ptp(inputs.pressure[filtered.pressure[filtered.reading] < 2e4]) < 1e-6


def test_a_pulse_of_one_reading_and_what_swings_from_reading_to_reading_are_kept():
    noise = STD * np.random.default_rng(6).standard_normal(400)
    pulse = np.where(np.arange(400) == 200, 3e3, 0.0) + noise
    run = with_readings(pulse)
    assert joined(run, filter_readings(run, NOISE))[200] == pytest.approx(pulse[200])
    swinging = 3.0 * STD * (-1.0) ** np.arange(400)  # no two lines are much better than one
    run = with_readings(swinging)
    assert joined(run, filter_readings(run, NOISE)) == pytest.approx(swinging)


def test_there_are_fewer_readings_and_frames_keep_theirs():
    run = with_readings(course(50.0) + STD * np.random.default_rng(7).standard_normal(1800), 50.0)
    filtered = filter_readings(run, NOISE)
    assert filtered.run.pressure.size < 150
    own = filtered.run.reading_stamp_ns[filtered.run.reading]
    assert np.array_equal(own, run.reading_stamp_ns[run.reading])
    assert np.array_equal(filtered.run.stamp_ns, run.stamp_ns)
    ends = filtered.run.reading_stamp_ns[[0, -1]]
    assert ends.tolist() == run.reading_stamp_ns[[0, -1]].tolist()
    # Without a memory, a frame has the pressure that was read.
    np.testing.assert_allclose(filtered.run.frame_pressure + filtered.noise, run.frame_pressure)


@pytest.mark.parametrize('share', [0.25, 0.5, -1.0])
def test_no_delay_takes_noise_off_the_load_of_a_frame(share: float):
    """Between two readings their mean has half the variance, and a delay would come of it."""
    pressure = np.full(800, 2e4)
    run, random = with_readings(pressure, 25.0, 200), np.random.default_rng(8)
    stds = NOISE.force_std, NOISE.force_std, NOISE.moment_std
    wrench = [0.1, 0.05, 0.0] + np.array(stds) * random.standard_normal((800, 3))
    run = replace(
        run,
        loaded=True,
        wrench_stamp_ns=run.reading_stamp_ns,
        wrench=wrench,
        force=wrench[run.reading, :2],
        moment=wrench[run.reading, 2],
    )
    filtered = filter_readings(run, NOISE).run
    late = filtered.at_instants(share / 25.0)
    np.testing.assert_allclose(late.load, run.load, atol=0.2 * NOISE.force_std)
    raw = run.at_instants(0.5 / 25.0).load
    assert raw[:, 0].std() < 0.8 * run.force[:, 0].std()


def test_a_frame_between_two_readings_is_on_the_line_between_them():
    run = with_readings(np.linspace(0.0, 60e3, 1000), 10.0)
    period = NANOSECONDS_PER_SECOND // 10
    for late, shift in ((0.4, 0.4), (-0.4, -0.4), (0.05, 0.0)):
        moved = replace(run, stamp_ns=run.reading_stamp_ns[run.reading] + round(late * period))
        moved = replace(moved, stamp_ns=moved.stamp_ns.clip(*run.reading_stamp_ns[[0, -1]]))
        filtered = filter_readings(moved, NOISE)
        inner = slice(1, -1)
        wanted = (run.reading + shift) * 60e3 / 999
        assert filtered.run.frame_pressure[inner] == pytest.approx(wanted[inner], abs=0.01)
        assert np.abs(filtered.noise).max() < 0.01


@pytest.mark.parametrize('count', [1, 2])
def test_readings_too_few_for_a_line_are_left_alone(count: int):
    run = made(paper_arm(), np.linspace(0.0, 1e4, count))
    assert np.array_equal(filter_readings(run, NOISE).run.pressure, run.pressure)


def test_static_frames_have_no_order_in_which_to_lie_on_a_line():
    run = replace(made(paper_arm(), np.full(9, 1e4)), static=True)
    assert filter_readings(run, NOISE).run is run


@pytest.mark.parametrize('wrenches', [True, False])
def test_what_an_arm_with_mass_follows_has_little_noise(wrenches: bool):
    """Readings stay where they are in time; of loads without readings those of the frames."""
    truth, random = course(50.0), np.random.default_rng(5)
    run = with_readings(truth + STD * random.standard_normal(truth.size), frames=400)
    stamps = run.reading_stamp_ns if wrenches else run.stamp_ns
    force = 1e-6 * np.interp(stamps, run.reading_stamp_ns, truth)
    std = NOISE.force_std
    load = np.column_stack([force, 0.0 * force, 0.0 * force])
    noisy = load + std * random.standard_normal(load.shape)
    if wrenches:
        run = replace(run, wrench_stamp_ns=stamps, wrench=noisy, loaded=True)
    else:
        run = replace(run, force=noisy[:, :2], moment=noisy[:, 2], loaded=True)
    quiet = without_reading_noise(run, NOISE)
    assert np.array_equal(quiet.reading_stamp_ns, run.reading_stamp_ns)
    assert np.array_equal(quiet.reading, run.reading)
    assert np.std(quiet.pressure - truth) < 0.4 * STD
    left = (quiet.wrench if wrenches else quiet.load)[:, 0] - force
    assert np.std(left) < 0.6 * std


def test_static_frames_keep_their_readings():
    run = replace(made(paper_arm(), np.zeros(5)), static=True)
    assert without_reading_noise(run, NOISE) is run
