"""The paper's analysis as a view: Eq 9 from measured shapes, Eq 10 by lines, errors of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.reports.calibration.figure_data import smoother_of
from pneunet_ros.reports.paper_views.linearity import change_linearity, PLACES
from pneunet_ros.reports.paper_views.moment_curvature import (
    curvature_std,
    law_view,
    line,
    moment_view,
)
from pneunet_ros.reports.paper_views.steady_states import find_steady_states, predict_states, thin
from pneunet_ros.solver.columns import MOMENT, X, Y
import pytest
from support.small_calibration import ARM, calibration


@pytest.fixture(scope='module')
def views():
    """Return views of the loaded run of many pressures."""
    return views_without([])


def views_without(hidden):
    """Return views of the loaded run of many pressures in which some targets are never seen."""
    fit, hide = calibration().joint, np.zeros(ARM.target_arclength.size)
    hide[hidden] = np.nan
    some = [replace(one, x=one.x + hide, y=one.y + hide, count=np.where(hide == 0, one.count, 0))
            for one in thin(find_steady_states(fit.runs[2], fit.arm), 5)]  # fmt: skip
    return [moment_view(fit, smoother_of(fit), steady_state) for steady_state in some]


@pytest.mark.parametrize('tip_cap', [0.0, 0.02])
def test_on_a_shape_of_the_model_the_moment_is_the_model_s(tip_cap):
    fit, targets = calibration().joint, ARM.target_arclength
    some = thin(find_steady_states(fit.runs[2], fit.arm), 4)[1:]
    places = (1.0 + tip_cap / ARM.length) * targets
    frame = replace(fit.parameters.frame, tip_cap=tip_cap, target_arclength=places)
    fit = replace(fit, parameters=replace(fit.parameters, frame=frame))
    smoother, targets = smoother_of(fit), fit.arm.target_arclength
    for steady_state, field in zip(some, predict_states(fit.arm, some, targets), strict=True):
        exact = replace(steady_state, x=field[X], y=field[Y], count=np.full(targets.size, 1e4))
        view = moment_view(fit, smoother, exact)
        assert 0.9 * ARM.length < view.arclength[-1] <= ARM.length
        moment = predict_states(fit.arm, [steady_state], view.arclength)[0, MOMENT]
        assert np.max(np.abs(view.moment - moment)) < 0.01 * np.max(np.abs(moment))


def test_the_change_of_curvature_is_about_moment_over_rigidity(views):
    arm = calibration().joint.arm
    view = views[-1]
    sections = arm.moment_law.sections(
        np.array([view.steady_state.pressure]), ARM.length, ARM.weight
    )
    middle = (view.arclength > 0.25 * ARM.length) & (view.arclength < 0.8 * ARM.length)
    expected = view.moment[middle] / sections[0, 1, 1]
    assert np.max(np.abs(view.change[middle] - expected)) < 0.1 * np.max(np.abs(expected))


def test_where_the_last_target_is_hidden_no_moment_is_known():
    for view in views_without([-1]):
        assert not view.has_moment and view.lines == (None, None)
        assert np.isfinite(view.change).all()


def test_where_no_target_was_seen_nothing_is_straight_in_pressure(views):
    assert [item.place for item in change_linearity(views, ARM.length)] == list(PLACES)
    found = change_linearity(views_without(range(11, 23)), ARM.length)
    assert [item.place for item in found] == [0.2, 0.4]


def test_a_line_finds_rigidity_and_intercept(views):
    rng = np.random.default_rng(3)
    moment = np.linspace(-2e-3, 1e-3, 40)
    found = []
    for _ in range(200):
        change = (moment - 2e-4) / 1.5e-4 + rng.normal(0.0, 0.8, 40)
        view = replace(
            views[0],
            arclength=np.linspace(0.0, 0.1, 40),
            moment=moment,
            curvature=change,
            intrinsic=np.zeros(40),
            std=np.full(40, 0.8),
        )
        found.append(line(view, np.ones(40, dtype=bool), 40, 0.0, 0.1))
    rigidity = np.array([item.rigidity for item in found])
    offset = np.array([item.offset for item in found])
    assert abs(rigidity.mean() - 1.5e-4) < 0.01 * 1.5e-4
    assert abs(offset.mean() - 2e-4) < 1e-5
    assert 0.8 < rigidity.std() / found[0].rigidity_std < 1.25
    assert 0.8 < offset.std() / found[0].offset_std < 1.25


def test_too_few_targets_give_no_line(views):
    inside = np.zeros(views[0].arclength.size, dtype=bool)
    inside[:8] = True
    assert line(views[-1], inside, 2, 0.0, 0.01) is None
    assert line(views[-1], inside, 3, 0.0, 0.01) is not None


def test_bands_of_curvature_are_the_fit_s_errors_at_the_knots():
    fit = calibration().joint
    rows, knots = fit.parameters.pressure, fit.parameters.arclength
    std = curvature_std(fit, rows, knots)
    known = np.sqrt(np.diag(fit.covariance))[: fit.parameters.cells].reshape(rows.size, -1)
    assert np.allclose(std, known)


def test_the_law_has_the_errors_are_the_fit_s_errors_at_its_rows():
    fit = calibration().joint
    names, change = fit.parameters.quantities()
    stds = dict(zip(names, np.sqrt(np.diag(change @ fit.covariance @ change.T)), strict=True))
    law = fit.arm.moment_law
    view = law_view(fit, law.pressure)
    for row in range(law.pressure.size):
        assert np.allclose(view.rigidity[row], law.rigidity[row])
        assert view.split[row] == pytest.approx(law.split[row])
        assert view.split_std[row] == pytest.approx(stds[f'moment_law.split.{row}'], rel=1e-4)
        for section in range(2):
            expected = stds[f'moment_law.rigidity.{row}.{section}']
            assert view.rigidity_std[row, section] == pytest.approx(expected, rel=1e-4)


def test_a_law_keeps_its_errors_beside_an_elongation():
    fit = calibration().joint
    place = fit.parameters.before_law
    parameters = replace(fit.parameters, elongates=True)
    added = parameters.before_law - place
    covariance = fit.covariance
    for axis in (0, 1):
        covariance = np.insert(covariance, [place] * added, 0.0, axis=axis)
    longer = replace(
        fit,
        parameters=parameters,
        values=np.insert(fit.values, [place] * added, 0.0),
        covariance=covariance,
    )
    pressure = np.array([20e3, 40e3])
    before, after = law_view(fit, pressure), law_view(longer, pressure)
    assert np.all(before.rigidity_std > 0.0)
    assert np.allclose(after.rigidity_std, before.rigidity_std)
    assert np.allclose(after.split_std, before.split_std)
