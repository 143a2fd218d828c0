"""What the laws of effects may miss: its size and place, and what is then told beside them."""

from __future__ import annotations

from dataclasses import replace
import functools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.law_errors import along_arm, LawErrors, OpenLaws, SIZE
from pneunet_ros.diagnosis.fit.refit import Refit
from pneunet_ros.diagnosis.scores.score_test import score_effects
import pytest
from support.lab_designs import asked, fitted

NAME = 'load_offset'


@functools.cache
def found() -> tuple[Refit, LawErrors, OpenLaws]:
    """Return a fit of an effect that is there, what its law may miss, and the open problem."""
    fit = fitted(NAME, NAME)
    fit = replace(fit, linearization=fit.linearization.of_training())
    errors = LawErrors.of(fit.linearization, fit)
    return fit, errors, OpenLaws.of(fit.gaussian, fit.linearization.blocks, errors)


def test_what_grows_evenly_may_grow_more_and_unevenly():
    place = np.linspace(0.0, 1.0, 5)
    field = np.stack([2.0 * place, 0.0 * place])[None]
    shapes = np.column_stack([np.ones(5), 2.0 * place - 1.0])
    errors = along_arm(field, shapes)
    np.testing.assert_allclose(errors[..., 0], field)
    # From target to target by 0.5, times how far that one is from the middle.
    np.testing.assert_allclose(errors[0, 0, :, 1], np.cumsum([0.0, -0.25, 0.0, 0.25, 0.5]))


def test_errors_of_a_size_are_a_share_of_what_the_effect_does():
    fit, errors, _ = found()
    linearization, runs = fit.linearization, range(fit.linearization.training)
    doubled = fit.numbers * 1.01
    before = linearization.points(fit.point.arm, runs)
    more = Refit(
        linearization=linearization, hypotheses=fit.hypotheses, numbers=doubled,
        covariance=fit.covariance, base=fit.base, gaussian=fit.gaussian, cost=fit.cost,
    )  # fmt: skip
    after = linearization.points(more.point.arm, runs)
    assert before is not None
    assert after is not None
    loaded = linearization.training - 1
    moved = (after[loaded] - before[loaded]).reshape(len(before[loaded]), -1) / 0.01
    scale = np.abs(SIZE * moved).max()
    size_alone = errors.fields[loaded][:, :, 0]
    assert scale > 1e-4
    np.testing.assert_allclose(size_alone, SIZE * moved, atol=0.02 * scale)


def test_a_model_without_effects_has_no_laws_that_miss():
    fit = fitted()
    problem = OpenLaws.of(
        fit.gaussian, fit.linearization.blocks, LawErrors.of(fit.linearization, fit)
    )
    assert problem.gaussian is fit.gaussian
    assert problem.white(fit.gaussian.residuals)[0] == pytest.approx(fit.gaussian.residuals[0])


def test_scores_are_those_of_a_covariance_with_the_errors_in_it():
    fit, errors, problem = found()
    block, columns = fit.linearization.blocks[2], fit.gaussian.columns[2]
    frames, points, count = errors.fields[2].shape
    own: list[Array] = []
    for frame in range(frames):
        for error in range(count):
            alone = np.zeros((frames, points, 1))
            alone[frame, :, 0] = errors.fields[2][frame, :, error]
            own.append(block.white(alone)[:, 0])
    law = np.column_stack(own)
    covariance = np.eye(len(law)) + law @ law.T
    residual = fit.gaussian.residuals[2]
    white = problem.columns(2, np.column_stack([residual, columns]))
    rest, seen = white[:, 0], white[:, 1:]
    solved = np.linalg.solve(covariance, np.column_stack([residual, columns]))
    assert rest @ rest == pytest.approx(residual @ solved[:, 0])
    np.testing.assert_allclose(seen.T @ rest, columns.T @ solved[:, 0], rtol=1e-6, atol=1e-6)
    volume = problem.gaussian.log_volumes[2] - fit.gaussian.log_volumes[2]
    assert volume == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize('name', ['extensibility', 'camera_rotation'])
def test_what_acts_otherwise_is_seen_beside_it_as_well(name):
    fit, _, problem = found()
    (exact,) = score_effects(fit, [asked(name)])
    (opened,) = score_effects(fit, [asked(name)], problem=problem)
    assert 0.3 * exact.information < opened.information <= exact.information * (1.0 + 1e-9)
