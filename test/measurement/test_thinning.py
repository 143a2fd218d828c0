"""Long recordings are thinned: where nothing acts, frames repeat each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.measurement.dataset import RecordingData, thin_runs
import pytest

FRAMES, MOVING = 4000, 400
SECOND = 1_000_000_000


def run(pressure: np.ndarray) -> RecordingData:
    """Return a recording in which nothing was seen."""
    frames = len(pressure)
    stamps = SECOND * np.arange(1, frames + 1)
    return RecordingData(
        name='long',
        reading_stamp_ns=stamps,
        pressure=pressure,
        stamp_ns=stamps,
        reading=np.arange(frames),
        loaded=False,
        force=np.zeros((frames, 2)),
        moment=np.zeros(frames),
        x=np.zeros((frames, 3)),
        y=np.zeros((frames, 3)),
    )


def resting() -> np.ndarray:
    """Return a pressure that rests for nine tenths of the time."""
    way = np.clip(np.arange(FRAMES) - 2000, 0, MOVING)
    return 2e4 + 2e4 * np.sin(2.0 * np.pi * way / 100)


def test_half_of_the_frames_show_what_acts_for_a_tenth_of_the_time():
    (few,) = thin_runs([run(resting())], 100)
    assert 95 <= len(few.stamp_ns) <= 100
    moving = np.count_nonzero(np.abs(few.stamp_ns / SECOND - 2200) < 201)
    assert 45 <= moving <= 60
    assert (few.stamp_ns[0], few.stamp_ns[-1]) == (SECOND, FRAMES * SECOND)


def test_half_of_the_frames_are_shared_by_length_and_half_equally():
    every = [run(resting()), run(resting()[:1000])]
    assert thin_runs(every, 5000) == every
    long, short = (len(item.stamp_ns) for item in thin_runs(every, 500))
    assert long == pytest.approx(325, abs=1)
    assert short == pytest.approx(175, abs=1)


def test_a_short_recording_beside_a_long_film_keeps_all_frames():
    long, short = thin_runs([run(resting()), run(resting()[2000:2020])], 200)
    assert np.array_equal(short.stamp_ns, SECOND * np.arange(1, 21))
    assert 170 <= len(long.stamp_ns) <= 180


def test_what_short_recordings_leave_of_their_shares_goes_to_the_long_one():
    """Of 4060 frames where 4000 were allowed, 3040 were kept."""
    every = [run(np.full(FRAMES, 2e4)), *(run(np.full(20, 2e4)) for _ in range(3))]
    assert [len(item.stamp_ns) for item in thin_runs(every, FRAMES)] == [3940, 20, 20, 20]


def test_frames_in_no_order_and_those_on_which_nothing_acts_are_thinned_evenly():
    for item in (run(np.full(FRAMES, 2e4)), replace(run(resting()), static=True)):
        (few,) = thin_runs([item], 101)
        apart = np.diff(few.stamp_ns) / SECOND
        assert apart.max() - apart.min() <= 1.0
