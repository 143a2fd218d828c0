"""Few targets and few frames: what they cannot resolve is not fitted, and not claimed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros import solve
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.checks.nonuniformity import (
    departure_prior,
    known_departure,
    shape_std,
)
from pneunet_ros.calibration.checks.resolution import resolve
from pneunet_ros.calibration.map_estimation import posterior_at
from pneunet_ros.core.errors import RequestError
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL
from support.refusals import reasons, refused

PAPER = paper_arm()
FEW = np.linspace(0.0, 6e4, 5)
NOISE = replace(USUAL, target_std=1e-4, placement_std=0.0, registration_std=0.0, drift_std=0.0)
# Nothing at all is stated of none: then as much is assumed as arms have by hand.
EXACT = replace(NOISE, placement_std=1e-9, registration_std=1e-9, drift_std=1e-9)


def with_targets(*shares: float, arm: Arm = PAPER) -> Arm:
    places = arm.length * np.array(shares)
    return replace(arm, target_arclength=places, sensors=EXACT, covariance=None)


def uniform(arm: Arm) -> Arm:
    """Return an arm of constant curvature, 20/m at 60 kPa."""
    table = IntrinsicCurvature(
        pressure=[0.0, 6.6e4], arclength=[0.0, 1.0], curvature=[[0.0, 0.0], [22.0, 22.0]]
    )
    return replace(arm, intrinsic_curvature=table)


@cache
def of_clamp_and_tip() -> Calibration:
    """Return the calibration of an arm that bends unevenly, of which clamp and tip are seen."""
    arm = with_targets(0.0, 1.0)
    return calibrate([made(arm, FEW, noise=NOISE)], [], arm)


def model_std(arm: Arm, pressure: float) -> np.ndarray:
    """Return how far one sigma of the model's covariance moves the arm, (stations,) m."""
    moved = []
    for column in arm.covariance.columns():
        sides = [
            solve(arm.with_changes({k: s * v for k, v in column.items()}), pressure)
            for s in (-0.5, 0.5)
        ]
        moved.append([sides[1].x - sides[0].x, sides[1].y - sides[0].y])
    return np.sqrt(np.sum(np.square(moved), axis=(0, 1)))


@pytest.mark.parametrize(
    ('shares', 'shapes'),
    [((0.0, 1.0), 1), ((1.0,), 1), ((0.0, 0.02, 1.0), 1), ((0.0, 0.5, 1.0), 2)],
)
def test_every_target_that_stands_apart_is_worth_a_number(shares, shapes):
    arm = with_targets(*shares)
    found = resolve(arm, [made(arm, FEW)], [])
    assert (found.shapes, found.free_shapes) == (shapes, shapes)
    reason = 'constant_curvature' if shapes == 1 else 'few_shapes'
    assert found.notes[0].reason == reason


def test_many_targets_resolve_all_knots():
    found = resolve(PAPER, [made(PAPER, np.linspace(0.0, 6e4, 30))], [])
    assert found.free_shapes is None
    assert found.notes == ()


def test_pressures_are_counted_through_their_noise():
    arm = with_targets(0.0, 1.0)
    pressures = np.repeat([0.0, 3e4, 6e4], 4) + np.tile([-90.0, -30.0, 30.0, 90.0], 3)
    found = resolve(arm, [made(arm, pressures)], [])
    assert found.pressures == 3
    assert 'few_pressures' in reasons(found.notes)


def test_few_loaded_frames_give_one_stiffness():
    free, force = made(PAPER, FEW), np.full((5, 2), 0.1)
    few = resolve(PAPER, [free], [made(PAPER, FEW, force)])
    many = resolve(PAPER, [free], [made(PAPER, np.tile(FEW, 5), np.tile(force, (5, 1)))])
    assert (few.law, many.law) == ('linear', 'piecewise_linear')
    assert reasons(few.law_notes) == ['one_stiffness']
    alone = resolve(PAPER, [free], [])
    assert alone.law_notes == many.law_notes == ()
    assert alone.notes == few.notes


@pytest.mark.parametrize('count', [3, 4, 9])
def test_clamp_and_tip_of_a_constant_curvature_are_enough(count):
    arm = uniform(with_targets(0.0, 1.0))
    run = made(arm, np.linspace(0.0, 6e4, count), noise=NOISE, seed=count)
    found = calibrate([run], [], replace(arm, intrinsic_curvature=PAPER.intrinsic_curvature))
    assert found.joint.converged
    table = found.arm.intrinsic_curvature
    assert np.all(np.ptp(table.curvature, axis=1) == 0.0)
    assert table.at(6e4, 0.5) == pytest.approx(20.0, abs=0.1)
    assert found.arm.moment_law == arm.moment_law
    assert np.array_equal(found.arm.target_arclength, arm.target_arclength)


def test_where_no_target_shows_it_the_shape_is_uncertain_and_is_so():
    found = of_clamp_and_tip()
    assert found.joint.converged
    assert 'uncertain_between' in reasons(found.notes)
    std = model_std(found.arm, 5e4)
    estimated, true = solve(found.arm, 5e4), solve(PAPER, 5e4)
    off = np.hypot(estimated.x - true.x, estimated.y - true.y)
    middle = int(np.argmax(off))
    assert off[middle] > 1e-3  # a constant curvature is wrong by this
    assert np.all(off[1:] < 3.0 * std[1:])
    assert std.max() < 0.1 * PAPER.length  # and yet not all is open
    largest, share = shape_std(found.joint)
    assert std.max() == pytest.approx(largest, rel=0.3)
    assert 0.2 < share <= 1.0


def test_targets_are_misplaced_with_the_bend_that_a_fit_cannot_have():
    arm = uniform(with_targets(0.0, 0.4, 1.0))
    noise = replace(EXACT, placement_std=2e-4)
    run = made(arm, np.linspace(0.0, 6e4, 9), noise=noise)
    found = calibrate([run], [], replace(arm, sensors=noise))
    fit, size = found.free, found.free.values.size
    # What all unknowns come to when the arm departs: the normal equations, solved in full.
    posterior, linear = posterior_at(fit, found.noise.noise)
    scale, rest = posterior.prior.scale, np.eye(linear.scaled.size)
    come_to = scale @ np.linalg.solve(linear.normal + rest, linear.normal) @ np.linalg.inv(scale)
    cells, shared = fit.parameters.cells, fit.shared_covariance.shape[0]
    errors = (come_to - rest)[:shared, :cells]
    prior = departure_prior(fit.parameters, fit.values)
    # Two targets show that the arm bends evenly, and one number along it is what is fitted.
    assert fit.parameters.shapes == 1
    left = fit.information_vector - fit.information @ fit.values
    prior = known_departure(prior, fit.information, fit.covariance, left)
    wanted = errors @ prior @ errors.T
    added = found.joint.shared_covariance - fit.shared_covariance
    std = np.sqrt(np.diag(wanted))
    assert std[size:].max() > 1e-5  # placements too
    np.testing.assert_allclose(added, wanted, rtol=0.0, atol=1e-3 * np.outer(std, std).max())
    np.testing.assert_allclose(np.sqrt(np.diag(added)), std, rtol=0.01, atol=1e-8)


def test_what_a_constant_curvature_cannot_have_is_said():
    found = of_clamp_and_tip()
    assert 'misfit' in reasons(found.notes)
    arm = uniform(with_targets(0.0, 1.0))
    fits = calibrate([made(arm, FEW, noise=NOISE)], [], arm)
    assert 'misfit' not in reasons(fits.notes)
    # Along the way from the clamp to the tip nothing is known, across it the tip is.
    std = model_std(fits.arm, 1e4)
    assert std[-1] < 0.5 * std.max()


def test_what_is_resolved_is_as_sure_as_before():
    arm = with_targets(*np.linspace(0.0, 1.0, 23))
    run = made(arm, np.linspace(0.0, 6e4, 30), noise=NOISE)
    found = calibrate([run], [], arm)
    assert found.joint.parameters.shapes is None
    assert np.array_equal(found.joint.covariance, found.free.covariance)
    assert 'uncertain_between' not in reasons(found.notes)


def test_an_arm_of_higher_pressures_needs_a_law_that_holds_there():
    table = IntrinsicCurvature(
        pressure=[0.0, 2.2e5], arclength=[0.0, 1.0], curvature=[[0.0, 0.0], [22.0, 22.0]]
    )
    law = LinearLaw(bending_stiffness=1.5e-4)
    arm = replace(with_targets(0.0, 1.0), intrinsic_curvature=table, moment_law=law, domain=None)
    free = made(arm, np.linspace(0.0, 2e5, 5), noise=NOISE)
    force = np.array([[0.0, 0.1], [0.05, 0.05], [0.1, 0.1], [0.1, 0.02]])
    loaded = made(arm, np.linspace(2e4, 1.8e5, 4), force, noise=NOISE, seed=3)
    frame = with_targets(0.0, 1.0)
    with refused(RequestError, 'out_of_range'):
        calibrate([free], [], frame)
    assert calibrate([free], [], arm).arm.intrinsic_curvature.at(2e5, 0.5) == pytest.approx(
        20.0, abs=0.1
    )
    found = calibrate([free], [loaded], frame)
    assert found.joint.converged
    assert all(run.solved.all() for run in found.joint.runs)
    assert found.arm.moment_law.bending_stiffness == pytest.approx(1.5e-4, rel=0.05)


def test_a_calibration_of_few_targets_goes_on():
    arm = with_targets(0.0, 1.0)
    first = of_clamp_and_tip()
    more = made(arm, FEW + 2e3, noise=NOISE, seed=5).thin(4)
    found = calibrate([more], [], arm, earlier=first.posterior)
    assert found.joint.converged
    assert found.joint.parameters.shapes == 1
    before, after = (shape_std(item.joint)[0] for item in (first, found))
    assert after == pytest.approx(before, rel=0.2)  # no more of the arm is seen
    middle = [np.sqrt(item.free.covariance[5, 5]) for item in (first, found)]
    assert middle[1] <= middle[0]
