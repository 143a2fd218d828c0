"""Filtered pressure readings: less noise, the same pressure, and frames that find their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.pressure_filter import PRESSURE_FILTER, smooth_pressure
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made


def with_readings(pressure: Array, frames: int) -> RecordingData:
    """Return a run of so many readings, and a few frames spread over them."""
    run = made(paper_arm(), np.zeros(frames))
    reading = np.sort(np.random.default_rng(2).choice(pressure.size, frames, replace=False))
    stamps = 1000 * (1 + np.arange(pressure.size))
    return replace(
        run,
        reading_stamp_ns=stamps,
        pressure=pressure,
        stamp_ns=stamps[reading] + 7,
        reading=reading,
    )


def test_most_noise_goes_and_the_pressure_stays():
    ramp = np.linspace(0.0, 60e3, 2000)
    noise = 60.0 * np.random.default_rng(3).standard_normal(2000)
    run = with_readings(ramp + noise, 30)
    quiet = smooth_pressure(run)
    truth = np.interp(quiet.reading_stamp_ns, run.reading_stamp_ns, ramp)
    inner = slice(PRESSURE_FILTER.width, -PRESSURE_FILTER.width)
    left = (quiet.pressure - truth)[inner]
    assert left.std() == pytest.approx(60.0 / np.sqrt(PRESSURE_FILTER.width), rel=0.12)
    assert abs(left.mean()) < 5.0


def test_a_straight_ramp_is_not_changed():
    run = with_readings(np.linspace(0.0, 60e3, 900), 12)
    quiet = smooth_pressure(run)
    before = np.interp(quiet.reading_stamp_ns, run.reading_stamp_ns, run.pressure)
    inner = slice(PRESSURE_FILTER.width // 2, -(PRESSURE_FILTER.width // 2))
    assert quiet.pressure[inner] == pytest.approx(before[inner], abs=1e-6)


def test_there_are_fewer_readings_and_frames_keep_theirs():
    run = with_readings(np.linspace(0.0, 60e3, 3000), 50)
    quiet = smooth_pressure(run)
    assert (
        PRESSURE_FILTER.most_readings <= quiet.pressure.size <= PRESSURE_FILTER.most_readings + 50
    )
    own = quiet.reading_stamp_ns[quiet.reading]
    assert np.array_equal(own, run.reading_stamp_ns[run.reading])
    assert np.array_equal(quiet.stamp_ns, run.stamp_ns)
    assert quiet.reading_stamp_ns[[0, -1]].tolist() == run.reading_stamp_ns[[0, -1]].tolist()
    # Neighbors that are left out have been averaged in all the same.
    step = with_readings(np.where(np.arange(3000) < 1500, 0.0, 1e4), 50)
    assert set(np.round(np.unique(smooth_pressure(step).pressure))) <= {
        0.0,
        2e3,
        4e3,
        6e3,
        8e3,
        1e4,
    }


def test_a_run_of_few_readings_is_left_alone():
    run = made(paper_arm(), np.linspace(0.0, 1e4, PRESSURE_FILTER.width - 1))
    assert smooth_pressure(run) is run
    assert (
        smooth_pressure(
            made(paper_arm(), np.linspace(0.0, 1e4, PRESSURE_FILTER.width))
        ).pressure.size
        == PRESSURE_FILTER.width
    )
