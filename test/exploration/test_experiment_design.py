"""Experiments that are tried out with the model: their recordings, and what they would show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.exploration.experiment_design import Experiment, linearize_experiments
import pytest
from support.lab_designs import asked, fitted

RANGE, STAMP = (1e3, 61e3), 7_000_000_000


def test_an_experiment_is_a_recording_of_its_corners():
    experiment = Experiment(words='up', corners=((0, 0, 0, 0), (10, 1, 0.5, -1)))
    run = experiment.recording(RANGE, 0.2, STAMP, 23, frames=11)
    assert (run.name, run.loaded, run.x.shape) == ('up', True, (11, 23))
    assert np.diff(run.reading_stamp_ns).tolist() == [50_000_000] * 199
    assert run.reading_stamp_ns[0] == STAMP
    seconds = 1e-9 * (run.stamp_ns - STAMP)
    assert run.pressure[run.reading] == pytest.approx(1e3 + 60e3 * seconds / 10.0)
    assert run.force == pytest.approx(np.outer(seconds / 10.0, [0.1, -0.2]))


def test_every_experiment_is_tried_as_if_it_came_next():
    step = Experiment(words='up', corners=((0, 0, 0, 0), (5, 1, 0, 0), (10, 0, 0, 0)))
    low = Experiment(words='low', corners=((0, 0, 1, 0), (5, 0.2, 1, 0), (10, 0, 1, 0)))
    softened = asked('softening').effect(np.array([0.1]))

    def history(*experiments: Experiment) -> Array:
        tried = linearize_experiments(fitted('softening'), experiments, (0.0, 90e3), 0.1)
        assert tried is not None
        arm = replace(tried.point, effects=(softened,)).arm
        past = tried.known_inputs.of(arm)[-1].histories
        assert past is not None
        return past[0]

    # What the other would have done to a virgin arm was not done to it.
    assert np.array_equal(history(step, low), history(low))
    assert history(step)[:, 0].max() == pytest.approx(90e3, rel=0.05)
    assert history(low)[:, 0].max() < 70e3
