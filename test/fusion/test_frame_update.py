"""One frame beside a prior: its Jacobian by differences, its posterior by the book, its gates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.fusion import hypothesis_update
from pneunet_ros.fusion.frame_fit import Complex, FrameLinearization, FrameProblem
from pneunet_ros.fusion.frame_update import (
    cold_starts,
    compared,
    excess,
    leave_out,
    search,
    take_frame,
    with_belief,
)
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.target_row import TargetRow
from pneunet_ros.measurement.blocks.tilt import Tilt
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.solver.solution import SolverNodes
import pytest

FORCE, PRESSURE = (0.05, -0.03), 40e3  # N, Pa
NAMES = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')
TARGET = 13  # one in the middle
FRAMES = 4


def moved(problem: FrameProblem, target: int, by: float) -> FrameProblem:
    """Return the problem with one target seen elsewhere (m)."""
    y = problem.sightings.y.copy()
    y[target] += by
    return replace(problem, sightings=replace(problem.sightings, y=y))


def asked(pressure: float, force: tuple[float, float], frames: int, closer: float) -> FrameProblem:
    """Return the problem of the last of a few frames of an arm, as the fusion poses it first.

    closer: spacing of the painted row relative to that of the model, which does not know it.
    """
    arm = load_model(share_path('config/lab_arm.yaml'))
    fusion = Fusion(arm=arm if closer == 1.0 else replace(arm, covariance=None))
    targets, random = fusion.arm.target_arclength, np.random.default_rng(5)
    shape = solve(fusion.arm, pressure=pressure, force=force)
    problems: list[FrameProblem] = []

    def noted(problem, **options):
        problems.append(problem)
        return take_frame(problem, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hypothesis_update, 'take_frame', noted)
        state, nothing = FusionState(), np.full(targets.size, np.nan)
        for frame in range(frames):
            problems.clear()
            stamp = 1_000_000_000 + 33_000_000 * frame
            x, y = (
                np.interp(closer * targets, shape.arclength, row)
                + fusion.arm.sensors.target_std * random.standard_normal(targets.size)
                for row in (shape.x, shape.y)
            )
            seen = TargetSightings(stamp_ns=stamp, x=x, y=y, **dict.fromkeys(NAMES, nothing))
            state, _ = fusion.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
            state, _ = fusion.step(state, seen)
    return problems[0]


@pytest.fixture(scope='module')
def problem() -> FrameProblem:
    """Return a frame of a loaded arm, behind a few others."""
    return asked(PRESSURE, FORCE, FRAMES, closer=1.0)


def fitted(problem: FrameProblem) -> FrameLinearization:
    found = problem.search(np.zeros(problem.root.shape[1]), problem.prior.solution)
    assert found is not None
    return found


def painted(problem: FrameProblem, row: tuple[float, float]) -> FrameProblem:
    """Return the problem with a row of other dots, and without errors of the model or a tilt.

    How what these move goes with pressure is left out of the slope by pressure.
    """
    unknowns, mean = problem.unknowns, problem.mean.copy()
    mean[unknowns.at(TargetRow)] = row
    mean[unknowns.at(ModelDiscrepancy)] = mean[unknowns.at(Tilt)] = 0.0
    return replace(problem, prior=replace(problem.prior, mean=mean))


def predicted(problem: FrameProblem, xi: Array, start: SolverNodes) -> Complex:
    """Return where the targets are predicted to be seen, x + i y m."""
    trial = problem.try_at(xi, start)
    residual = (trial.residual * problem.std).view(complex)
    return problem.measured - residual / trial.back


@pytest.mark.parametrize('row', [(0.0, 0.0), (0.02, 0.01)])
def test_slopes_are_those_of_differences(problem, row):
    """Spacing of the row of dots, and its offset over its length: on the arm or beside it."""
    problem = painted(problem, row)
    at = problem.linearize(problem.try_at(np.zeros(problem.root.shape[1]), problem.prior.solution))
    for column in range(problem.root.shape[1]):
        step = np.zeros(problem.root.shape[1])
        step[column] = 1e-3
        less, more = (
            predicted(problem, side * step, at.trial.bent.solution) for side in (-1.0, 1.0)
        )
        slope = problem.whiten((more - less) * at.trial.back / 2e-3)
        scale = max(float(np.abs(slope).max()), 1e-3)
        assert at.jacobian[:, column] == pytest.approx(slope, abs=5e-4 * scale), column


def test_nothing_nearby_costs_less(problem):
    fit = fitted(problem)
    random = np.random.default_rng(1)
    for _ in range(20):
        xi = fit.trial.xi + 0.05 * random.standard_normal(fit.trial.xi.size)
        assert problem.try_at(xi, fit.trial.bent.solution).cost > fit.cost - 1e-6


def test_no_search_along_a_straight_arm_ends_where_it_would_buckle():
    """Nothing shows the force along it, and all else is found from any such force."""
    straight = asked(0.0, (0.0, 0.0), 1, closer=0.97)
    found = [
        search(straight, trial.xi, trial.bent.solution) for trial in cold_starts(straight)[:6]
    ]
    assert [fit.cost for fit in found] == pytest.approx([found[0].cost] * 6, abs=1.0)


def test_the_posterior_is_that_of_the_information_form(problem):
    fit = fitted(problem)
    after = problem.posterior(fit)
    information = np.eye(problem.root.shape[1]) + fit.jacobian.T @ fit.jacobian
    covariance = problem.root @ np.linalg.solve(information, problem.root.T)
    scale = np.sqrt(np.diag(covariance)) + 1e-30
    found = after.root @ after.root.T
    np.testing.assert_allclose(found / scale / scale[:, None],
                               covariance / scale / scale[:, None], atol=1e-6)  # fmt: skip
    kept = fit.errors_after(problem.root) @ problem.root.T
    np.testing.assert_allclose(kept / scale / scale[:, None],
                               covariance / scale / scale[:, None], atol=1e-6)  # fmt: skip
    tip = problem.unknowns.at(TipForce)
    off = after.mean[tip] - FORCE
    assert off @ np.linalg.solve(found[tip, tip], off) < 13.8  # chi squared of 2, 1e-3


def test_a_target_against_the_others_is_what_leaving_it_out_saves(problem):
    fit = fitted(problem)
    against = problem.at_targets(fit)
    for target in np.flatnonzero(problem.used)[1:].tolist():
        used = problem.used.copy()
        used[target] = False
        saved = fit.cost - fitted(replace(problem, used=used)).cost
        assert against[target] == pytest.approx(saved, rel=0.01, abs=1e-3)


def test_a_swapped_dot_is_left_out_and_no_other(problem):
    wrong = moved(problem, TARGET, 4e-3)
    kept, fit = leave_out(wrong, fitted(wrong))
    assert np.flatnonzero(~kept.used).tolist() == [TARGET]
    assert excess((kept, fit)) < 1.0 < excess((wrong, fitted(wrong)))
    update = take_frame(wrong, cold=False, force_read=False)
    assert (update.left_out, update.reason) == (1, '')
    used = problem.used.copy()
    used[TARGET] = False
    without = take_frame(replace(problem, used=used), cold=False, force_read=False)
    tip = problem.unknowns.at(TipForce)
    assert update.belief.mean[tip] == pytest.approx(without.belief.mean[tip], abs=1e-4)


def test_cold_starts_without_a_target_are_the_same_shapes_compared_again(problem):
    used = problem.used.copy()
    used[TARGET] = False
    without = replace(problem, used=used)
    again, anew = compared(without, cold_starts(problem)), cold_starts(without)
    assert [one.cost for one in again] == [one.cost for one in anew]
    for one, other in zip(again, anew, strict=True):
        np.testing.assert_array_equal(one.residual, other.residual)


def test_what_is_believed_after_a_search_may_follow_later(problem):
    at_once = take_frame(problem, cold=False, force_read=False)
    searched = take_frame(problem, cold=False, force_read=False, believed=False)
    assert searched.belief is None
    later = with_belief(problem, searched)
    np.testing.assert_array_equal(later.belief.mean, at_once.belief.mean)
    np.testing.assert_array_equal(later.belief.root, at_once.belief.root)


def test_frames_that_cannot_be_used_have_their_reason(problem):
    few = np.zeros_like(problem.used)
    few[:2] = True
    update = take_frame(replace(problem, used=few), cold=False, force_read=False)
    assert (update.belief, update.reason) == (None, 'too_few_targets')
    random = np.random.default_rng(2)
    spread = replace(
        problem.sightings, y=problem.sightings.y + 0.02 * random.standard_normal(few.size)
    )
    update = take_frame(replace(problem, sightings=spread), cold=False, force_read=False)
    assert (update.belief, update.reason) == (None, 'inconsistent')
    assert update.nis > 100.0 * update.coordinates
