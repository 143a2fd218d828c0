"""The virtual lab at work: what a recording holds, and that it is the same every time."""

from __future__ import annotations

import dataclasses

from lab import recorded
import numpy as np
from pneunet_ros.lab.simulated import simulated
from pneunet_ros.lab_run import run_of
from pneunet_ros.shape import same_values
import pytest

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
    assert same_values(dataclasses.replace(first), simulated(first.scenario))
