"""What is fitted, as one vector: to an arm and back, its prior, and how shapes answer to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters, PosteriorState
from pneunet_ros.core.errors import ModelError
from pneunet_ros.effects.camera_rotation import CameraRotation
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.hysteresis import Hysteresis
from pneunet_ros.effects.softening import Softening
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
import pytest
from support.example_arms import ALL_MECHANICS, paper_arm
from support.made_datasets import made
from support.refusals import refused

LOW, HIGH = 0.0, 60e3
SMOOTHNESS = Hyperparameters(amplitude=40.0, std=4.0, length_scale=0.3)
PASTS = (Hysteresis(width=3e3), Creep(amplitude=0.2, time_constant=1.5), Softening(loss=0.2))
KINDS = tuple(MOMENT_LAW_PARAMETERS)


def law_parameters(kind: str):
    arm = paper_arm()
    return MOMENT_LAW_PARAMETERS[kind](
        stiffness=1.5e-4, low=LOW, high=HIGH, length=arm.length, weight=arm.weight
    )


def parameters(kind: str | None, effects=(), rows: int = 4, knots: int = 6) -> Parameters:
    return Parameters(
        frame=paper_arm(tuple(effects)),
        pressure=np.linspace(LOW, HIGH, rows),
        arclength=np.linspace(0.0, 1.0, knots),
        hyperparameters=SMOOTHNESS,
        law=None if kind is None else law_parameters(kind),
    )


def values_of(some: Parameters, seed: int = 3) -> np.ndarray:
    """Return values near those of an arm, a bit off everywhere."""
    table = some.frame.intrinsic_curvature
    cells = np.array([table.at(float(row), some.arclength) for row in some.pressure]).ravel()
    law = some.mean[some.cells :]
    random = np.random.default_rng(seed)
    off = 0.05 * np.sqrt(np.diag(some.prior)[some.cells :]) * random.standard_normal(law.size)
    return np.concatenate([cells + random.standard_normal(cells.size), law + off])


@pytest.mark.parametrize(
    ('kind', 'effects'),
    [
        *((kind, ()) for kind in KINDS),
        ('piecewise_linear', ALL_MECHANICS),
        ('piecewise_linear', (*PASTS, CameraRotation(angle=0.03))),
        ('linear', PASTS),
    ],
)
def test_points_answer_to_unknowns_as_finite_differences(kind, effects):
    some = parameters(kind, effects)
    values = values_of(some)
    pressure = np.concatenate([np.linspace(1e3, 59e3, 7), np.linspace(50e3, 8e3, 5)])
    force = np.stack([np.linspace(0.05, 0.2, 12), np.linspace(0.1, 0.0, 12)], axis=1)
    run = made(some.frame, pressure, force)

    def points(values):
        arm = some.arm(values)
        (inputs,) = inputs_of(arm, [run])
        series = ForwardModel(arm.target_arclength)
        assert series.solve(arm, inputs).all()
        return series, arm, inputs

    series, arm, inputs = points(values)
    answer = series.jacobian(arm, inputs, some.columns)[:, :, :2]
    found = np.einsum('fcks,fcu->fksu', answer, some.input_jacobian(values, inputs))
    for unknown in range(values.size):
        step = 1e-3 * np.sqrt(some.prior[unknown, unknown]) * np.eye(values.size)[unknown]
        sides = [points(values + sign * step)[0].points for sign in (-1, 1)]
        wanted = (sides[1] - sides[0]) / (2.0 * step[unknown])
        assert found[..., unknown] == pytest.approx(wanted, abs=2e-3 * np.abs(wanted).max())


@pytest.mark.parametrize('kind', KINDS)
def test_quantities_are_the_numbers_of_the_model(kind):
    some = parameters(kind)
    values = values_of(some)
    names, change = some.quantities()
    assert len(set(names)) == len(names) == change.shape[0]
    step = (
        0.01 * np.sqrt(np.diag(some.prior)) * np.random.default_rng(1).standard_normal(values.size)
    )
    moved = some.arm(values).with_changes(dict(zip(names, (change @ step).tolist(), strict=True)))
    wanted = some.arm(values + step)
    table, law = wanted.intrinsic_curvature, wanted.moment_law
    assert moved.intrinsic_curvature.curvature == pytest.approx(table.curvature, rel=1e-9)
    at = np.linspace(1e3, 59e3, 9)
    sections = law.sections(at, wanted.length, wanted.weight)
    assert moved.moment_law.sections(at, wanted.length, wanted.weight) == pytest.approx(
        sections, rel=1e-9
    )


def test_every_number_of_the_law_that_may_move_is_named():
    names, _ = law_parameters('piecewise_linear').quantities()
    law = law_parameters('piecewise_linear').law(law_parameters('piecewise_linear').mean)
    assert len(names) == law.rigidity.size + law.split.size


@pytest.mark.parametrize('kind', [None, *KINDS])
def test_the_prior_is_positive_definite_and_of_the_size_said(kind):
    some = parameters(kind, rows=10, knots=11)
    np.linalg.cholesky(some.prior)
    assert np.allclose(some.prior, some.prior.T)
    std = np.sqrt(np.diag(some.prior))[: some.cells].reshape(10, 11)
    assert std[0] == pytest.approx(4.0, rel=1e-3)
    assert std[-1] == pytest.approx(np.hypot(40.0, 4.0), rel=1e-3)
    assert not some.mean[: some.cells].any()


def test_the_prior_of_the_law_leaves_it_free():
    some = law_parameters('piecewise_linear')
    alpha = 1.5e-4 / (0.17 * 0.112**2)
    _, change = some.quantities()
    rows = some.rows.size
    mean, std = change @ some.mean, np.sqrt(np.diag(change @ some.prior @ change.T))
    assert mean[: 2 * rows] == pytest.approx(alpha)
    assert np.all(std[: 2 * rows] > 0.9 * alpha)
    assert np.all(mean[2 * rows :] - 3.0 * std[2 * rows :] < 0.0)
    # One size, and less of a change over the range.
    apart = change[0] - change[2 * rows - 2]
    assert np.sqrt(apart @ some.prior @ apart) < 1.1 * alpha


def test_a_law_through_zero_is_no_law():
    some = parameters('piecewise_linear')
    values = some.mean.copy()
    values[some.cells] = -values[some.cells]
    with refused(ModelError, 'singular_rigidity'):
        some.arm(values)


def test_what_is_known_takes_the_place_of_the_prior():
    free = parameters(None)
    random = np.random.default_rng(2)
    root = random.standard_normal((free.cells, free.cells))
    mean, covariance = random.standard_normal(free.cells), root @ root.T
    known = replace(
        parameters('piecewise_linear'),
        earlier=PosteriorState(
            pressure=free.pressure,
            arclength=free.arclength,
            kind='',
            stiffness=0.0,
            low=0.0,
            high=0.0,
            values=mean,
            placement=np.zeros(0),
            covariance=covariance,
            information=np.zeros_like(covariance),
        ),
    )
    assert np.array_equal(known.mean[: free.cells], mean)
    assert np.array_equal(known.prior[: free.cells, : free.cells], covariance)
    assert not known.prior[: free.cells, free.cells :].any()
    law = law_parameters('piecewise_linear')
    assert np.array_equal(known.mean[free.cells :], law.mean)
    assert np.array_equal(known.prior[free.cells :, free.cells :], law.prior)


def test_an_arm_without_unknowns_of_its_law_keeps_its_own():
    some = parameters(None, ALL_MECHANICS)
    arm = some.arm(values_of(some))
    assert arm.moment_law is some.frame.moment_law
    assert arm.effects == some.frame.effects
    assert arm.intrinsic_curvature.curvature.shape == (4, 6)
