"""The most probable model: truth found, derivatives right, errors honest, failure said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.map_estimation import fit, Posterior
from pneunet_ros.calibration.moment_law_parameters import ALPHAS, MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.measurement.inputs import inputs_of
import pytest
from support.example_arms import paper_arm
from support.made_datasets import exact, experiments, HARDLY_ANY, noisy, USUAL

PAPER = paper_arm()
SMOOTHNESS = Hyperparameters(amplitude=40.0, std=4.0, length_scale=0.3)
ROWS = np.linspace(0.0, 60e3, 4)
KNOTS = np.linspace(0.0, 1.0, 7)


def parameters(law: bool = True) -> Parameters:
    piecewise = MOMENT_LAW_PARAMETERS['piecewise_linear'](
        stiffness=1.3e-4, low=0.0, high=60e3, length=PAPER.length, weight=PAPER.weight
    )
    return Parameters(
        frame=PAPER,
        pressure=ROWS,
        arclength=KNOTS,
        hyperparameters=SMOOTHNESS,
        law=piecewise if law else None,
    )


def representable():
    """Return values that the unknowns can have exactly, and the arm with them."""
    some = parameters()
    table = PAPER.intrinsic_curvature
    cells = np.array([table.at(float(row), KNOTS) for row in ROWS]).ravel()
    drawn = np.random.default_rng(3).standard_normal(some.law.mean.size)
    law = some.law.mean + 0.2 * np.linalg.cholesky(some.law.prior) @ drawn
    values = np.concatenate([cells, law])
    return values, some.arm(values)


def near(values: np.ndarray, some: Parameters) -> np.ndarray:
    """Return values a bit off: 1/m of curvature, a twentieth of what is believed of the law."""
    random = np.random.default_rng(4)
    drawn = random.standard_normal(some.law.mean.size)
    law = 0.05 * np.linalg.cholesky(some.law.prior) @ drawn
    return values + np.concatenate([random.standard_normal(some.cells), law])


def test_the_truth_of_exact_runs_is_found():
    values, arm = representable()
    unloaded, loaded = experiments(arm, frames=16)
    some = parameters()
    found = fit(
        some, [*unloaded, *loaded], HARDLY_ANY, arm.target_arclength, start=near(values, some)
    )
    assert (found.converged, found.status) == (True, 'converged')
    off = found.values - values
    assert np.abs(off[: some.cells]).max() < 2e-2  # 1/m
    law, true = found.arm.moment_law, arm.moment_law
    assert law.rigidity == pytest.approx(true.rigidity, rel=2e-3)
    # The last row of l1 has but the last frames of one run.
    assert law.split[:-1] == pytest.approx(true.split[:-1], abs=1e-3)
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(found.covariance)))
    assert max(np.abs(run.residual).max() for run in found.runs) < 2e-6


def test_a_split_that_must_not_be_as_small_as_it_is_stands_at_its_bound(monkeypatch):
    _, arm = representable()
    least = float(arm.moment_law.split.max()) + 0.02
    monkeypatch.setattr('pneunet_ros.calibration.moment_law_parameters.LEAST_SPLIT', least)
    some = parameters()
    runs = [run for group in experiments(arm, frames=16) for run in group]
    found = fit(some, runs, HARDLY_ANY, arm.target_arclength)
    assert found.status == 'converged'
    splits = found.values[some.cells + ALPHAS :]
    assert splits.min() == pytest.approx(least)
    assert np.isclose(splits, least).sum() > 5


def posterior():
    unloaded, loaded = noisy()
    some = parameters()
    whole = Posterior(some, [unloaded[0], loaded[0]], USUAL, PAPER.target_arclength)
    values, _ = representable()
    scaled = np.zeros(whole.prior.mean.size)
    size = whole.prior.size
    scaled[:size] = np.linalg.solve(whole.prior.scale[:size, :size], values - some.mean)
    # Dots stay where they belong: that placement turns with the shape is left out of derivatives.
    camera = size + 2 * PAPER.target_arclength.size
    scaled[camera:] = 0.3 * np.random.default_rng(8).standard_normal(scaled.size - camera)
    return whole, scaled


def test_the_gradient_is_that_of_the_cost():
    whole, scaled = posterior()
    here = whole.linearize(scaled)
    assert whole.cost(scaled, here) == pytest.approx(here.cost, rel=1e-12)
    assert here.cost == pytest.approx(
        0.5 * scaled @ scaled + 0.5 * sum(run.fitted.whitened.sum() for run in here.runs)
    )
    random = np.random.default_rng(9)
    for _ in range(4):
        step = random.standard_normal(scaled.size)
        step *= 1e-4 / np.linalg.norm(step)
        slope = (whole.cost(scaled + step, here) - whole.cost(scaled - step, here)) / 2e-4
        # cost = |residual|^2 / 2, residual = measured - predicted
        assert (scaled - here.gradient) @ step / 1e-4 == pytest.approx(slope, rel=1e-3)


def test_the_normal_matrix_is_that_of_the_residuals():
    whole, scaled = posterior()
    here = whole.linearize(scaled)

    def residuals(scaled):
        values, disturbance = whole.prior.unscale(scaled)
        arm = whole.parameters.arm(values)
        out = []
        for which, (run, inputs) in enumerate(
            zip(here.runs, inputs_of(arm, whole.runs), strict=True)
        ):
            own = disturbance[whole.prior.disturbances.of_run(which)]
            out.append(run.residual_of(whole.models[which], arm, inputs, own).ravel())
        return np.concatenate(out)

    random = np.random.default_rng(10)
    for _ in range(3):
        step = random.standard_normal(scaled.size)
        step *= 1e-3 / np.linalg.norm(step)
        moved = (residuals(scaled + step) - residuals(scaled - step)) / 2e-3
        unit = step / 1e-3
        assert unit @ here.normal @ unit == pytest.approx(moved @ moved, rel=2e-3)


def test_what_the_fit_says_of_its_errors_is_the_inverse_hessian():
    unloaded, _ = noisy()
    some = parameters(law=False)
    found = fit(some, unloaded, USUAL, PAPER.target_arclength)
    # The information of the data and the prior, less what disturbances share, is the inverse.
    inverse = found.information + np.linalg.inv(some.prior)
    assert np.linalg.inv(inverse) == pytest.approx(found.covariance, rel=1e-5, abs=1e-12)
    assert np.linalg.solve(inverse, found.information_vector) == pytest.approx(
        found.values - some.mean, abs=0.1 * np.sqrt(np.diag(found.covariance)).min()
    )
    assert np.all(np.diag(found.covariance) < np.diag(some.prior))
    assert found.dof == 2 * sum(np.count_nonzero(run.seen) for run in unloaded)


def test_chi_squared_is_one_per_coordinate_with_noise_as_it_is():
    unloaded, loaded = noisy()
    some = parameters()
    values, _ = representable()
    found = fit(some, [*unloaded, *loaded], USUAL, PAPER.target_arclength, start=values)
    assert found.converged
    assert 0.9 < found.chi_squared / found.dof < 1.05


def test_white_noise_alone_does_not_explain_the_residuals():
    unloaded, _ = noisy()
    some = parameters(law=False)
    honest = fit(some, unloaded, USUAL, PAPER.target_arclength)
    assert honest.chi_squared / honest.dof < 1.1
    white = replace(USUAL, placement_std=0.0, registration_std=0.0, drift_std=0.0)
    blind = fit(some, unloaded, white, PAPER.target_arclength)
    assert blind.chi_squared / blind.dof > 1.7


def test_no_convergence_is_said(monkeypatch):
    unloaded, _ = exact()
    monkeypatch.setattr('pneunet_ros.calibration.map_estimation.MOST_STEPS', 1)
    found = fit(parameters(law=False), unloaded, HARDLY_ANY, PAPER.target_arclength)
    assert not found.converged
    assert np.isfinite(found.values).all()


def test_an_end_without_a_lower_cost_is_said(monkeypatch):
    unloaded, _ = exact()
    monkeypatch.setattr(Posterior, 'cost', lambda *_: np.inf)
    found = fit(parameters(law=False), unloaded, HARDLY_ANY, PAPER.target_arclength)
    assert not found.converged
    assert 'no step lowers the cost' in found.status


def test_a_wild_reading_and_a_frame_without_targets_cost_only_themselves():
    unloaded, _ = noisy()
    run = unloaded[0]
    pressure, x, y = np.array(run.pressure), np.array(run.x), np.array(run.y)
    pressure[7] = 300e3
    x[9], y[9] = np.nan, np.nan
    bent = replace(run, pressure=pressure, x=x, y=y)
    some = parameters(law=False)
    found = fit(some, [bent, unloaded[1]], USUAL, PAPER.target_arclength)
    clean = fit(some, unloaded, USUAL, PAPER.target_arclength)
    assert found.converged
    assert np.flatnonzero(~found.runs[0].solved).tolist() == [7]
    assert found.runs[0].dof[[7, 9]].tolist() == [0, 0]
    sigma = np.sqrt(np.diag(clean.covariance))
    assert np.all(np.abs(found.values - clean.values) < sigma)
