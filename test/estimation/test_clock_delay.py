"""The delay between film and table: found within its error, and refused where nothing tells it."""

from __future__ import annotations

import math
import re

import numpy as np
from pneunet_ros.estimation.clock_delay import box_average, estimate_delay, follow_play
import pytest
from scipy.signal import lfilter

LENGTH, TARGETS, NOISE = 0.112, 7, 1e-4  # m, -, m
SECONDS = 30.0
TOP = 5e4  # Pa


def steps(random):
    """Return the corners (s, Pa) of quick steps at no regular times."""
    edges = np.sort(random.uniform(2.0, SECONDS - 2.0, 10))
    levels = random.uniform(0.1, 1.0, 10) * TOP
    before = np.concatenate([[0.0], levels[:-1]])
    times = np.stack([edges, edges + 0.15], axis=1).ravel()
    return np.append(-60.0, times), np.append(0.0, np.stack([before, levels], axis=1).ravel())


def ramps(random):
    """Return the corners of ramps up and down, of many rates."""
    edges = np.cumsum(random.uniform(0.6, 4.0, 10)) + 1.0
    levels = np.where(np.arange(10) % 2, random.uniform(0.0, 0.3, 10), random.uniform(0.6, 1, 10))
    return np.concatenate([[-60.0, 1.0], edges]), np.concatenate([[0.0, 0.0], levels * TOP])


def triangles(_):
    """Return the corners of the same ramps again and again."""
    return np.arange(-60.0, 100.0, 3.0), TOP * (np.arange(54) % 2)


def one_ramp(_):
    """Return the corners of a single ramp."""
    return np.array([2.0, SECONDS - 2.0]), np.array([0.0, TOP])


def rest(_):
    """Return the corners of nothing at all."""
    return np.array([0.0, 1.0]), np.array([0.0, 0.0])


def moving_arm(times, corners, random, *, play=2e3, creep=0.08, lag=0.0):
    """Return targets (frames, 2 x targets) m of a bending arm with a play, creep and a lag (s)."""
    fine = np.arange(times[0] - 5.0, times[-1] + 0.01, 0.004)
    pressure = np.interp(fine, *corners)
    share = -math.expm1(-0.004 / lag) if lag else 1.0
    pressure = lfilter([share], [1.0, share - 1.0], pressure)
    acting = follow_play(pressure, 0.5 * play)
    late = np.empty_like(acting)
    level = acting[0]
    for place, value in enumerate(acting):
        level += (value - level) * 0.004 / 6.0
        late[place] = level
    bend = np.interp(times, fine, (1.0 - creep) * acting + creep * late) / TOP
    curvature = (1.1 * bend + 0.4 * bend**2)[:, None] / LENGTH + 1e-9
    along = np.linspace(0.0, LENGTH, TARGETS)
    angle = curvature * along
    points = np.concatenate([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    points = points / np.tile(curvature, (1, 2 * TARGETS))
    return points + NOISE * random.standard_normal(points.shape)


def filmed(protocol, seed, *, rate=25.0, readings=100.0, delay=None, seconds=SECONDS, lag=0.0):
    """Return what `estimate_delay` takes, and the true delay."""
    random = np.random.default_rng(seed)
    corners = protocol(random)
    delay = random.uniform(-2.0, 4.0) if delay is None else delay
    frames = np.cumsum(random.choice([0.5, 1.0, 1.5], int(seconds * rate))) / rate
    table = np.arange(0.0, SECONDS, 1.0 / readings)
    pressure = np.interp(table, *corners) + 60.0 * random.standard_normal(table.size)
    motion = moving_arm(frames - delay, corners, random, lag=lag)
    return (frames, motion, table, pressure[:, None]), delay


@pytest.mark.parametrize(
    ('protocol', 'options', 'share'),
    [
        (steps, {}, 0.2),
        (steps, {'rate': 12.0, 'readings': 5.0}, 1.0),
        (steps, {'rate': 60.0, 'readings': 1000.0}, 0.2),
        (ramps, {}, 2.0),
    ],
    ids=['steps', 'slow logger', 'quick logger', 'ramps'],
)
def test_the_delay_is_found_within_its_error(protocol, options, share):
    found = []
    for seed in (3, 4, 5):
        series, delay = filmed(protocol, seed, **options)
        found.append((estimate_delay(*series), delay))
    assert not any(item.trouble for item, _ in found)
    assert all(abs(item.delay - delay) < 3.0 * item.std for item, delay in found)
    assert np.median([item.std / item.frame_period for item, _ in found]) < share
    assert f'{found[0][0].std:.4f} s' in found[0][0].sentence


@pytest.mark.parametrize('lag', [0.02, 0.05, 0.1])
def test_a_lag_of_the_arm_counts_as_delay_and_the_sentence_says_so(lag):
    given, delay = filmed(steps, 3, lag=lag)
    found = estimate_delay(*given)
    assert not found.trouble
    assert 0.5 * lag < found.delay - delay < lag
    assert found.delay - delay > 5.0 * found.std
    assert 'a lag of less than 1 s counts as delay' in found.sentence


def test_a_film_that_begins_before_the_table_and_ends_after_it():
    series, delay = filmed(steps, 6, delay=8.0, seconds=45.0)
    found = estimate_delay(*series)
    assert not found.trouble
    assert abs(found.delay - delay) < 3.0 * found.std


def test_targets_that_are_lost_and_frames_that_are_empty_do_not_matter():
    (frames, motion, *table), delay = filmed(steps, 7)
    motion[::9] = np.nan
    motion[:, 3] = np.nan  # gone for good
    found = estimate_delay(frames, motion, *table)
    assert not found.trouble
    assert abs(found.delay - delay) < 3.0 * found.std


def test_a_load_that_changes_at_one_pressure_tells_the_delay_as_well():
    (frames, motion, table, pressure), delay = filmed(steps, 8)
    force = pressure / TOP
    found = estimate_delay(
        frames, motion, table, np.column_stack([np.full(table.size, 2e4), force])
    )
    assert not found.trouble
    assert abs(found.delay - delay) < 3.0 * found.std


@pytest.mark.parametrize(
    ('protocol', 'said'),
    [
        (triangles, 'fit equally well|repeats one cycle'),
        (one_ramp, 'fit equally well|changes too evenly'),
        (rest, 'the arm does not move'),
    ],
    ids=['triangles', 'one ramp', 'rest'],
)
def test_what_cannot_tell_is_refused(protocol, said):
    series, _ = filmed(protocol, 9)
    found = estimate_delay(*series)
    assert re.search(said, found.trouble), found
    assert not re.search('alike|evenly|again', found.trouble) or 'eight' in found.trouble


@pytest.mark.parametrize('rate', [25.0, 6.0])
def test_a_short_film_with_steps_is_not_told_that_it_has_none(rate):
    series, _ = filmed(steps, 10, rate=rate, seconds=10.0)
    assert estimate_delay(*series).trouble.reason == 'not_determined'


def test_film_and_table_of_two_runs_are_refused():
    frames, motion = filmed(steps, 10)[0][:2]
    table, pressure = filmed(steps, 11)[0][2:]
    found = estimate_delay(frames, motion, table, pressure)
    assert found.trouble.reason in ('nothing_in_common', 'not_determined')


def test_too_little_is_refused():
    (frames, motion, table, pressure), _ = filmed(steps, 12)
    few = estimate_delay(frames[:30], motion[:30], table, pressure)
    assert few.trouble.reason == 'too_few_frames'
    assert math.isnan(few.delay)
    none = estimate_delay(frames, np.full_like(motion, np.nan), table, pressure)
    assert none.trouble.reason == 'too_few_frames'
    short = estimate_delay(frames, motion, table[:120], pressure[:120])
    assert short.trouble.reason == 'too_short'
    motion[::2] = np.nan
    hidden = estimate_delay(frames, motion, table[:180], pressure[:180])
    assert hidden.trouble.reason == 'no_overlap'
    flat = estimate_delay(frames, motion, table, np.full_like(pressure, 2e4))
    assert flat.trouble.reason == 'no_change'


def test_means_over_boxes_are_those_of_straight_lines():
    time, values = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, -2.0])
    fine = np.linspace(0.5, 1.5, 100_001)
    exact = np.trapezoid(np.interp(fine, time, values), fine)
    assert box_average(time, values, np.array([1.0]), 1.0) == pytest.approx([exact], abs=1e-9)
    # At the ends, of what there is.
    assert box_average(time, values, np.array([0.0]), 1.0) == pytest.approx([0.5])


@pytest.mark.parametrize('protocol', [steps, ramps])
def test_pictures_that_repeat_the_one_before_are_named(protocol):
    (times, motion, *driven), _ = filmed(protocol, 3)
    lost = np.arange(9, len(motion), 10)
    lost = lost[np.diff(times)[lost - 1] < 1.4 * np.median(np.diff(times))]
    change = np.abs(motion[lost] - motion[lost - 1]).max(axis=1)
    motion[lost] = motion[lost - 1]
    found = estimate_delay(times, motion, *driven)
    moved = set(lost[change > 0.02 * LENGTH].tolist())
    assert moved <= set(found.repeated)  # at rest a picture more does no harm
    assert len(set(found.repeated) - set(lost.tolist())) <= 0.01 * len(motion)
    (times, motion, *driven), _ = filmed(protocol, 3)
    whole = estimate_delay(times, motion, *driven)
    assert len(whole.repeated) <= 0.01 * len(motion)
