"""The virtual lab at work: what a recording holds, and that it is the same every time."""

from __future__ import annotations

import dataclasses

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.protocols import SlowRamp
from pneunet_ros.lab.simulation import simulate
import pytest
from support.lab_pairs import recorded
from support.lab_run import run_of
from support.refusals import refused

SHIPPED = (
    'unloaded_ramp', 'unloaded_staircase', 'dead_weights', 'force_sweeps', 'strings', 'random_mix',
)  # fmt: skip


@pytest.mark.parametrize('name', SHIPPED)
def test_every_shipped_scenario_becomes_a_run(name):
    recording = recorded(name)
    run = run_of(recording)
    assert run.name == name
    assert run.stamp_ns.size == 400
    assert run.loaded == (not name.startswith('unloaded'))
    assert np.abs(run.stamp_ns - run.reading_stamp_ns[run.reading]).max() < 15e6
    assert 0.95 < run.seen.mean() < 1.0
    if not run.loaded:
        assert not run.force.any()
        assert recording.wrench_stamp_ns.size == 0


def test_a_scenario_makes_the_same_recording_every_time():
    first = recorded('strings')
    assert same_values(first, simulate(first.scenario))


def test_a_run_of_a_recording_begins_when_the_scenario_says():
    first, second = recorded('unloaded_ramp'), recorded('unloaded_staircase')
    apart = (second.reading_stamp_ns[0] - first.reading_stamp_ns[0]) / 1e9
    assert apart == pytest.approx(600.0, abs=0.01)
    assert first.memory.time == 40.0


def test_pressures_for_which_the_arm_is_not_described_are_refused():
    scenario = recorded('unloaded_ramp').scenario
    with refused(RequestError, 'out_of_bounds'):
        simulate(dataclasses.replace(scenario, protocol=SlowRamp(top=70e3)))


def test_a_recording_of_fewer_than_two_frames_is_refused():
    scenario = recorded('unloaded_ramp').scenario
    slow = dataclasses.replace(scenario.rates, frames=0.1)
    short = SlowRamp(duration=15.0)
    with refused(RequestError, 'too_short'):
        simulate(dataclasses.replace(scenario, protocol=short, rates=slow))
