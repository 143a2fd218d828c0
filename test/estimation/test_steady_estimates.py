"""Holds of a recording: where pressure and end load stand still."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.steady_estimates import steady_estimates
from pneunet_ros.files.model_file import load_model
from pneunet_ros.offline.replay import input_topics, steps
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.example_arms import TABLE_1
from support.random_estimates import random_estimate


def stream(*pressures: float, period: float = 0.5) -> list[ShapeEstimate]:
    """Make estimates at these pressures, one per period (s)."""
    some = random_estimate(stations=2)
    return [
        replace(
            some,
            stamp_ns=round((index + 1) * period * 1e9),
            shape=replace(some.shape, pressure=pressure),
        )
        for index, pressure in enumerate(pressures)
    ]


def test_the_holds_of_table_1_are_its_rows_up_and_down_again():
    recording = open_recording(share_path('bags/table1'))
    estimator = Estimator(arm=load_model(share_path('config/paper_arm.yaml')))
    topics = input_topics(recording, estimator, {})
    estimates = [
        step.outcome
        for step in steps(recording, estimator, topics)
        if isinstance(step.outcome, ShapeEstimate)
    ]
    holds = steady_estimates(estimates)
    loads = [(hold.shape.pressure / 1000, *hold.shape.force) for hold in holds]
    assert len(loads) == 29
    for load, row in zip(loads, TABLE_1 + TABLE_1[-2::-1], strict=True):
        assert load == pytest.approx((row.pressure / 1000, *row.force), abs=1e-12)
    assert all(hold.shape.end_moment == 0.0 for hold in holds)


def test_a_hold_is_its_last_estimate():
    estimates = stream(1, 1, 1, 1, 2)
    assert steady_estimates(estimates) == [estimates[3]]


def test_the_last_hold_needs_nothing_after_it():
    estimates = stream(2, 1, 1, 1, 1)
    assert steady_estimates(estimates) == [estimates[-1]]


def test_a_short_stretch_is_no_hold():
    estimates = stream(1, 1, 1, 2, 2)
    assert steady_estimates(estimates) == []


@pytest.mark.parametrize(
    'change', [{'pressure': 9.0}, {'force': (0.175, 0.08)}, {'end_moment': 1e-6}]
)
def test_any_change_of_the_load_ends_a_hold(change):
    estimates = stream(*8 * (1,))
    changed = [
        replace(estimate, shape=replace(estimate.shape, **change)) for estimate in estimates[4:]
    ]
    assert steady_estimates(estimates[:4] + changed) == [estimates[3], changed[-1]]


def test_without_estimates_there_are_no_holds():
    assert steady_estimates([]) == []
