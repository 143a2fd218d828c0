"""Experiments that are tried out with the model: their recordings, and what they would show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.experiment_design import (
    effect_information,
    Experiment,
    EXPERIMENTS,
    linearize_experiments,
    prior_end_factor,
    propose_experiment,
)
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import pytest
from support.lab_designs import asked, fitted

RANGE, STAMP = (1e3, 61e3), 7_000_000_000


def candidate(name: str, size: float) -> Candidate:
    """Return an effect that was tried with this size."""
    tried = np.zeros(asked(name).size)
    tried[0] = size
    return Candidate(
        hypothesis=asked(name), which=0, tried=tried, gain=0.0, start=tried, information=1.0,
        direction=(),
    )  # fmt: skip


def test_an_experiment_is_a_recording_of_its_corners():
    experiment = Experiment(words='up', corners=((0, 0, 0, 0), (10, 1, 0.5, -1)))
    run = experiment.recording(RANGE, 0.2, STAMP, 23, frames=11)
    assert (run.name, run.loaded, run.x.shape) == ('up', True, (11, 23))
    assert np.diff(run.reading_stamp_ns).tolist() == [50_000_000] * 199
    assert run.reading_stamp_ns[0] == STAMP
    seconds = 1e-9 * (run.stamp_ns - STAMP)
    assert run.pressure[run.reading] == pytest.approx(1e3 + 60e3 * seconds / 10.0)
    assert run.force == pytest.approx(np.outer(seconds / 10.0, [0.1, -0.2]))


@pytest.mark.parametrize('experiment', EXPERIMENTS, ids=lambda item: item.words[:20])
def test_what_is_proposed_stays_in_the_range_of_what_was_recorded(experiment):
    run = experiment.recording(RANGE, 0.2, STAMP, 3)
    assert run.pressure.min() >= RANGE[0]
    assert run.pressure.max() <= RANGE[1]
    assert np.abs(run.force).max() <= 0.2
    assert run.loaded == ('without a load' not in experiment.words)


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


def inner(gaussian: GaussianModel, *directions: tuple[float, ...]) -> Array:
    """Return the information of effects in one run, of how its rows answer to each."""
    columns = [np.column_stack(directions)]
    return gaussian.inner(columns, columns)


def test_what_a_rival_explains_as_well_is_no_information():
    nothing = GaussianModel.of([np.zeros((3, 1))], [np.zeros(3)], np.zeros(1))
    effect, rival, none = (3.0, 4.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    found = inner(nothing, effect, rival, none)
    assert effect_information(found, 0, []) == pytest.approx(25.0)
    assert effect_information(found, 0, [1, 2]) == pytest.approx(16.0)
    assert effect_information(found, 2, [1]) == 0.0
    same = inner(nothing, effect, effect)
    assert effect_information(same, 0, [1]) == pytest.approx(0.0, abs=1e-12)
    # What the base takes up is none, either.
    base = GaussianModel.of([np.array([[0.0], [1e6], [0.0]])], [np.zeros(3)], np.zeros(1))
    assert effect_information(inner(base, effect), 0, []) == pytest.approx(9.0)


def test_chi_squared_grows_with_the_square_of_the_size():
    std = asked('load_offset').coordinates[0].std
    assert prior_end_factor(candidate('load_offset', std)) == pytest.approx(4.0)
    assert prior_end_factor(candidate('load_offset', -0.1 * std)) == pytest.approx(400.0)


def test_where_nothing_is_wanted_nothing_is_proposed():
    assert propose_experiment(fitted(), [], []) == ''


def test_history_needs_pressure_that_moves_and_offsets_need_a_force():
    history = propose_experiment(fitted(), [candidate('hysteresis', 500.0)], [])
    assert 'hysteresis' in history
    offset = propose_experiment(fitted(), [candidate('load_offset', 1e-3)], [])
    assert 'force' in offset or 'load, ramps' in offset
