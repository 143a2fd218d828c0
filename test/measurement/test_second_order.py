"""Errors to second order: the scatter of a straight arm, and what is said where there is none."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros import solve_many
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.errors.propagated_errors import (
    PlaceChanges,
    propagate_errors,
    SeenShape,
)
from pneunet_ros.measurement.errors.second_order import leading_error
from pneunet_ros.measurement.predicted_targets import predict_targets
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
import pytest
from support.example_arms import paper_arm

DRAWS = 2000


def estimate_at(arm: Arm, pressure: float, force, moment: float = 0.0) -> ShapeEstimate | Refusal:
    estimator, state = Estimator(arm=arm), EstimatorState()
    load = WrenchReading(
        stamp_ns=1, force_x=force[0], force_y=force[1], moment=moment, frame_id='pneunet_base'
    )
    state, _ = estimator.step(state, load)
    return estimator.step(state, PressureReading(stamp_ns=1, pressure=pressure))[1]


def first_order(estimate: ShapeEstimate):
    moved = estimate.noise @ estimate.second_order.sensitivity.tip
    return moved.T @ moved


@pytest.mark.parametrize(
    ('pressure', 'force'),
    [(0.0, (0.25, 0.0)), (0.0, (0.0, 0.0)), (5e3, (0.25, 0.0)), (31e3, (0.175, 0.07))],
    ids=['straight', 'free', 'nearly straight', 'bent'],
)
def test_the_covariance_is_the_scatter_about_the_estimate(pressure, force):
    arm = paper_arm()
    estimate = estimate_at(arm, pressure, force)
    sensors, random = arm.sensors, np.random.default_rng(5)
    size = (sensors.force_std, sensors.force_std, sensors.moment_std, sensors.pressure_std)
    drawn = np.array([*force, 0.0, pressure]) + random.standard_normal((DRAWS, 4)) * size
    shapes = solve_many(arm, drawn[:, 3], drawn[:, :2], drawn[:, 2], start=estimate.shape)
    assert shapes.converged.all()
    errors = (
        np.stack([shapes.x, shapes.y]) - np.stack([estimate.shape.x, estimate.shape.y])[:, None]
    )
    claimed, found = (
        np.stack([estimate.std_x, estimate.std_y]),
        np.sqrt(np.mean(errors**2, axis=1)),
    )
    # The square of a normal number scatters more than the number: 4 sigma of that.
    near = 4.0 * math.sqrt((105.0 / 9.0 - 1.0) / DRAWS) / 2.0
    np.testing.assert_allclose(claimed, found, rtol=near, atol=1e-9)
    tip = errors[:, :, -1] @ errors[:, :, -1].T / DRAWS
    std = np.sqrt(np.diag(tip))
    np.testing.assert_allclose(
        estimate.tip_covariance[:2, :2] / np.outer(std, std), tip / np.outer(std, std), atol=0.2
    )


def test_to_first_order_alone_a_straight_arm_would_be_far_too_sure():
    estimate = estimate_at(paper_arm(), 0.0, (0.25, 0.0))
    assert first_order(estimate)[0, 0] < 1e-4 * estimate.tip_covariance[0, 0]


def test_tip_stations_and_targets_have_the_same_error():
    arm = paper_arm()
    estimate = estimate_at(arm, 5e3, (0.25, 0.0))
    assert estimate.std_x[0] == estimate.std_y[0] == 0.0  # the clamp
    np.testing.assert_allclose(
        [estimate.std_x[-1] ** 2, estimate.std_y[-1] ** 2],
        np.diag(estimate.tip_covariance)[:2],
        rtol=1e-9,
    )
    predicted = predict_targets(Estimator(arm=arm).table, estimate.noise, estimate.second_order)
    total = np.sqrt(np.sum(predicted.errors**2, axis=0))
    along = estimate.shape.arclength
    for found, std in zip(total, (estimate.std_x, estimate.std_y), strict=True):
        np.testing.assert_allclose(
            found, np.interp(arm.target_arclength, along, std), rtol=0.01, atol=1e-7
        )


def test_the_leading_error_is_that_of_one_sigma_which_moves_the_tip_furthest():
    random = np.random.default_rng(3)
    noise, tip = random.standard_normal((6, 5)), random.standard_normal((5, 3))
    causes = leading_error(tip, noise)
    moved = noise @ tip[:, :2]
    sizes, directions = np.linalg.eigh(moved.T @ moved)
    reached = causes @ tip[:, :2]
    assert np.hypot(*reached) == pytest.approx(math.sqrt(sizes[-1]))
    assert abs(reached @ directions[:, -1]) == pytest.approx(math.sqrt(sizes[-1]))


def test_where_nothing_is_uncertain_nothing_is_added():
    sure = SensorNoise(pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=1e-4)
    estimate = estimate_at(replace(paper_arm(), sensors=sure), 5e3, (0.25, 0.0))
    assert not estimate.tip_covariance.any()
    assert not estimate.std_x.any()


@pytest.mark.parametrize(('force_std', 'step'), [(0.1, 1.0), (1.0, 0.5), (3.0, 0.125)])
def test_errors_that_lead_to_another_equilibrium_are_said_and_counted_for_more(force_std, step):
    arm = paper_arm()
    arm = replace(arm, sensors=replace(arm.sensors, force_std=force_std))
    estimate = estimate_at(arm, 5e3, (0.25, 0.0))
    assert estimate.second_order.step == step
    assert any('one sigma leads to' in note for note in estimate.warnings) == (step < 1.0)
    assert np.all(np.diag(estimate.tip_covariance) >= np.diag(first_order(estimate)))


def test_errors_without_any_equilibrium_are_refused():
    arm = paper_arm()
    arm = replace(arm, sensors=replace(arm.sensors, force_std=10.0))
    refusal = estimate_at(arm, 5e3, (0.25, 0.0))
    assert (refusal.reason, refusal.error) == ('no_uncertainty', True)


def test_where_the_shape_was_seen_the_second_order_is_bounded_by_that():
    arm = paper_arm()
    estimate = estimate_at(arm, 0.0, (0.25, 0.0))
    places, every = np.arange(4, 57, 4), np.arange(57)  # some of the stations are seen
    arclength = estimate.shape.arclength
    sensitivity = estimate.second_order.sensitivity

    def added(std):
        at = PlaceChanges(arclength=arclength, changes=sensitivity.stations(arclength))
        measured = SeenShape(at=at, stations=every, seen=places, std=np.full((2, 14), std))
        seen = None if std is None else measured
        errors = propagate_errors(sensitivity, estimate.noise, arclength, seen)
        return errors.tip_covariance - first_order(estimate)

    assert added(1.0) == pytest.approx(added(None))  # seen so badly that it tells nothing
    free, bounded = (np.sqrt(np.diagonal(added(std))[:2]).max() for std in (None, 1e-8))
    assert free > 1e-6
    assert 0.0 < bounded < 1e-8
