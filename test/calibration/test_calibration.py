"""Whole calibrations: made runs, the virtual lab, continued ones, forces, what is handed on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from pneunet_ros import solve
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.checks.held_out import score
from pneunet_ros.calibration.experiments import FitSequence
from pneunet_ros.calibration.low_rank import shape_jacobian
from pneunet_ros.calibration.settings import EXPERIMENTS
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.effects.softening import Softening
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.exploration.exploration import rms_of_last
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import ModelCovariance, MOST_COLUMNS
from pneunet_ros.reports.paper_views.moment_curvature import curvature_std, law_view
from pneunet_ros.solver.columns import RIGIDITY
import pytest
from support.example_arms import paper_arm
from support.lab_run import true_model
from support.made_datasets import in_two, lab_run, made, noisy, USUAL
from support.refusals import reasons, refused

PAPER = paper_arm()
UP = np.linspace(2e3, 58e3, 15)
LOAD = np.stack([np.linspace(0.05, 0.2, 15), np.linspace(0.15, 0.05, 15)], axis=1)


@cache
def calibrated() -> Calibration:
    return calibrate(*noisy(), PAPER, compare=False)


@cache
def in_the_lab() -> Calibration:
    free = [lab_run('unloaded_ramp', 50), lab_run('unloaded_staircase', 50)]
    loaded = [lab_run(name, 50) for name in ('dead_weights', 'force_sweeps', 'strings')]
    arm = lab_arm()
    frame = replace(PAPER, target_arclength=arm.target_arclength, sensors=arm.sensors)
    return calibrate(free, loaded, frame, compare=False)


@cache
def lab_arm():
    return true_model(load_scenario(share_path('scenarios/strings.yaml')))


def errors(calibration: Calibration, true) -> np.ndarray:
    """Return the errors of all numbers of the curvature's table in their standard errors."""
    fit = calibration.joint
    cells = fit.parameters.cells
    rows, knots = fit.parameters.pressure, fit.parameters.arclength
    table = np.array([true.intrinsic_curvature.at(float(row), knots) for row in rows])
    off = fit.values[:cells].reshape(table.shape) - table
    return off / np.sqrt(np.diag(fit.covariance)[:cells]).reshape(table.shape)


@pytest.mark.parametrize(
    ('calibration', 'true'), [(calibrated, lambda: PAPER), (in_the_lab, lab_arm)],
    ids=['made', 'lab'],
)  # fmt: skip
def test_the_truth_is_found_within_the_errors(calibration, true):
    found, true = calibration(), true()
    fit, arm = found.joint, found.arm
    assert fit.converged
    # Thinned recordings of the lab: some of the motion between frames counts as noise.
    assert 0.7 < fit.chi_squared / fit.dof < 1.15
    pressures = np.linspace(12e3, 55e3, 5)
    law, wanted = (
        item.moment_law.sections(pressures, item.length, item.weight) for item in (arm, true)
    )
    assert law[:, :, 1] == pytest.approx(wanted[:, :, 1], rel=0.08)
    assert law[:, 1, 0] == pytest.approx(wanted[:, 1, 0], abs=0.02 * true.length)
    inner = np.linspace(0.1, 0.9, 9)
    largest = np.abs(true.intrinsic_curvature.curvature).max()
    for pressure in pressures.tolist():
        assert arm.intrinsic_curvature.at(pressure, inner) == pytest.approx(
            true.intrinsic_curvature.at(pressure, inner), abs=0.04 * largest
        )
    sigmas = errors(found, true)
    assert np.sqrt(np.mean(sigmas**2)) < 1.5
    assert np.abs(sigmas).max() < 5.0


def test_dots_that_do_not_tell_where_they_and_the_camera_are_do_not_make_a_stiffness_sure():
    painted = slice(3, None)  # none at the clamp

    def seen(name):
        run = lab_run(name, 50)
        return replace(run, x=run.x[:, painted], y=run.y[:, painted])

    true = lab_arm()
    frame = replace(PAPER, target_arclength=true.target_arclength[painted])
    found = calibrate(
        [seen('unloaded_ramp'), seen('unloaded_staircase')],
        [seen(name) for name in ('dead_weights', 'force_sweeps', 'strings')],
        frame,
        compare=False,
    )
    assert found.joint.chi_squared < 1.15 * found.joint.dof
    for pressure in (20e3, 50e3):
        right = true.moment_law.sections(np.array([pressure]), true.length, true.weight)[0]
        ours = found.arm.moment_law.sections(np.array([pressure]), true.length, true.weight)[0]
        assert ours[:, RIGIDITY] == pytest.approx(right[:, RIGIDITY], rel=0.04)


def weighed(arm, wrong=(0.0, 0.0), seed=0):
    """Return a free run and one under a weight of 0.2 N that is wrong by so much (N)."""
    pressures = np.linspace(2e3, 58e3, 10)
    true = np.tile([0.2 + wrong[0], wrong[1]], (10, 1))
    free = made(arm, pressures, noise=USUAL, seed=10 * seed, painted=seed, name='free')
    held = made(arm, pressures, true, noise=USUAL, seed=10 * seed + 1, painted=seed, start=10)
    return [free], [held.with_end_load(0.2, 0.0)]


def test_a_weight_that_is_wrong_throughout_is_in_the_standard_error():
    """Over weights wrong by their sigma the stiffness scatters as it says."""
    arm = replace(PAPER, moment_law=LinearLaw(bending_stiffness=1.3e-4), sensors=USUAL)
    sigmas = []
    for seed in range(8):
        wrong = USUAL.force_std * np.random.default_rng([seed, 7]).standard_normal(2)
        found = calibrate(*weighed(arm, wrong, seed), arm, compare=False)
        fit = found.joint
        off = found.arm.moment_law.bending_stiffness - 1.3e-4
        sigmas.append(off / np.sqrt(fit.covariance[-1, -1]))
        assert fit.chi_squared / fit.dof < 1.3
    assert 0.5 < np.sqrt(np.mean(np.square(sigmas))) < 1.5
    assert np.abs(sigmas).max() < 3.5


def test_many_frames_under_a_weight_know_it_no_better():
    """Sixteen times the frames average out the noise, not what the weight is wrong by."""
    arm = replace(PAPER, moment_law=LinearLaw(bending_stiffness=1.3e-4), sensors=USUAL)
    pressures = np.linspace(2e3, 58e3, 160)
    force = np.tile([0.2, 0.0], (160, 1))
    held = made(arm, pressures, force, noise=USUAL, start=200).with_end_load(0.2, 0.0)
    free = made(arm, pressures, noise=USUAL)
    stds = []
    for most in (10, 160):
        runs = [held.thin(most)]
        fit = calibrate([free], runs, arm, kind='linear', compare=False).joint
        stds.append(float(np.sqrt(fit.covariance[-1, -1])))
    assert stds[1] > 0.5 * stds[0]


def test_a_known_load_does_not_hide_how_the_stiffness_goes_with_the_pressure():
    """As an error of every frame it did: a far softer arm fitted as well as the noise."""
    rigidity = PAPER.moment_law.rigidity
    grows = rigidity * np.linspace(0.6, 1.8, len(rigidity))[:, None]
    law = replace(PAPER.moment_law, rigidity=grows)
    arm = replace(PAPER, moment_law=law, sensors=USUAL)
    found = calibrate(*weighed(arm), arm, kind='linear', compare=False)
    law = found.arm.moment_law
    assert grows.min() < law.bending_stiffness / (arm.weight * arm.length**2) < grows.max()
    assert found.joint.chi_squared / found.joint.dof > 4.0
    assert 'misfit' in reasons(found.notes)
    assert 'one_stiffness' not in reasons(found.notes)  # it was asked for
    more = calibrate(*weighed(arm), arm, kind='piecewise_linear', compare=False)
    assert more.joint.chi_squared / more.joint.dof < 1.5
    assert 'one_stiffness' not in reasons(more.notes)


def test_a_recording_held_out_is_predicted_as_by_the_truth():
    held = lab_run('random_mix', 100)
    truth, found = score(lab_arm(), held), score(in_the_lab().arm, held)
    assert found.missing == truth.missing == 0.0
    assert found.rms < 1.15 * truth.rms
    assert found.p95 < 1.3 * truth.p95


def test_progress_says_what_is_done():
    free, _ = noisy()
    said = []
    found = calibrate(
        [run.thin(20) for run in free], [], PAPER, on_progress=lambda *stage: said.append(stage)
    )
    assert {stage.split(', step')[0] for stage, _, _ in said} == {'kappa_p0, search', 'kappa_p0'}
    assert found.joint is found.free
    assert found.laws == ()
    assert found.arm.moment_law is PAPER.moment_law


@pytest.mark.slow
def test_half_after_half_comes_to_what_all_at_once_does():
    free, loaded = noisy()
    first = calibrate([free[0]], loaded[:2], PAPER, compare=False)
    frame = replace(PAPER, sensors=first.arm.sensors)
    both = calibrate([free[1]], loaded[2:], frame, earlier=first.posterior, compare=False)
    assert both.joint.converged
    at, inner = np.linspace(10e3, 50e3, 4), np.linspace(0.1, 0.9, 9)
    one, other = law_view(both.joint, at), law_view(calibrated().joint, at)
    assert np.all(np.abs(one.rigidity - other.rigidity) < 1.5 * other.rigidity_std)
    # Less is known of it after two halves: at first two loads hardly tell, and not as a Gaussian.
    assert np.all(np.abs(one.split - other.split) < 1.5 * one.split_std)
    assert np.all(one.split_std < 2.0 * other.split_std)
    before = law_view(first.joint, at)
    assert np.all(one.rigidity_std < before.rigidity_std)
    std = curvature_std(calibrated().joint, at, inner)
    for pressure, sigma in zip(at.tolist(), std, strict=True):
        apart = np.subtract(
            *(item.arm.intrinsic_curvature.at(pressure, inner) for item in (both, calibrated()))
        )
        assert np.sqrt(np.mean((apart / sigma) ** 2)) < 1.5


@pytest.mark.slow
def test_loads_may_come_later():
    free, loaded = noisy()
    first = calibrate(free, [], PAPER)
    assert first.posterior.kind == ''
    frame = replace(PAPER, sensors=first.arm.sensors)  # placement, which loads do not show
    later = calibrate([], loaded, frame, earlier=first.posterior, compare=False)
    assert later.joint.converged
    at = np.linspace(12e3, 55e3, 4)
    found = law_view(later.joint, at)
    true = PAPER.moment_law.sections(at, PAPER.length, PAPER.weight)[:, :, RIGIDITY]
    apart = found.rigidity - true / (PAPER.weight * PAPER.length**2)
    # Two steps of a nonlinear fit: not quite as good as all recordings at once.
    assert np.all(np.abs(apart) < 4.0 * found.rigidity_std)


def test_what_cannot_be_continued_is_refused():
    free, _ = noisy()
    known = replace(calibrated().posterior, low=0.0, high=30e3)
    with refused(RequestError, 'out_of_range'):
        calibrate(free, [], PAPER, earlier=known)
    with refused(RequestError, 'other_law'):
        calibrate(free, [], PAPER, earlier=calibrated().posterior, kind='linear')
    with refused(RequestError, 'unknown_kind'):
        calibrate(free, [], PAPER, kind='cubic')


def test_one_pressure_is_continued_at_the_same_within_its_noise():
    law = LinearLaw(bending_stiffness=3e-4)
    truth, force = replace(PAPER, moment_law=law), np.zeros((12, 2))
    force[:, 1] = np.linspace(-0.02, 0.02, 12)
    runs = [
        made(truth, np.full(12, pressure), force, noise=USUAL, seed=seed)
        for seed, pressure in enumerate((20e3, 20.02e3, 21e3))
    ]
    first = calibrate([], runs[:1], truth)
    frame = replace(truth, sensors=first.arm.sensors)
    assert calibrate([], runs[1:2], frame, earlier=first.posterior).joint.converged
    with refused(RequestError, 'out_of_range'):
        calibrate([], runs[2:], frame, earlier=first.posterior)


def test_the_range_is_that_of_the_chamber():
    free, _ = noisy()
    frame = paper_arm((PressureOffset(offset=5e3),))
    found = calibrate([run.thin(20) for run in free], [], frame)
    assert found.posterior.low == pytest.approx(5e3, abs=400.0)
    assert found.posterior.high == pytest.approx(65e3, abs=400.0)
    assert all(run.solved.all() for run in found.joint.runs)


def test_few_columns_have_the_variance_of_the_shape():
    found = calibrated()
    fit, covariance = found.joint, found.arm.covariance
    assert covariance.factor.shape[1] <= MOST_COLUMNS
    assert 0.8 < found.explained_variance <= 1.0
    moved = shape_jacobian(fit, 24)
    whole = np.einsum('pi,ij,pj->', moved, fit.covariance, moved)
    names, change = fit.parameters.quantities()
    assert covariance.quantities == names
    columns = np.linalg.pinv(change) @ covariance.factor
    assert np.sum((moved @ columns) ** 2) == pytest.approx(whole, rel=1e-3)


def test_the_placement_goes_with_the_columns():
    found = calibrated()
    fit, placement = found.joint, found.arm.covariance.placement
    size = fit.values.size
    variance = np.diagonal(fit.shared_covariance)[size:]
    assert placement.mean == pytest.approx(fit.placement.ravel(), abs=1e-9)
    known = np.sum(placement.factor**2, axis=1) + placement.std**2
    assert known == pytest.approx(variance, rel=1e-4)
    # What the columns say of model and placement together is what the fit says of both.
    _, change = fit.parameters.quantities()
    columns = np.linalg.pinv(change) @ found.arm.covariance.factor
    share = np.sqrt(found.explained_variance)
    precision = np.linalg.inv(fit.covariance)
    cross = share * columns.T @ precision @ fit.shared_covariance[:size, size:]
    assert np.abs(placement.factor.T - cross).max() < 1e-3 * np.abs(cross).max()


def test_the_estimator_takes_the_model_and_its_covariance():
    arm = calibrated().arm
    step = {'stamp_ns': 1, 'pressure': 40e3}

    def tip(arm):
        estimator = Estimator(arm=arm, settings=EstimatorSettings(wrench_required=False))
        _, estimate = estimator.step(EstimatorState(), PressureReading(**step))
        return estimate

    sure, honest = tip(replace(arm, covariance=None)), tip(arm)
    assert np.array_equal(sure.shape.x, honest.shape.x)
    model = np.sqrt(np.diag(honest.tip_covariance - sure.tip_covariance))[:2]
    # Some hundredths of a millimeter, from targets with a placement of 0.05 mm.
    assert np.all((model > 2e-6) & (model < 2e-4))
    off = np.hypot(
        solve(PAPER, 40e3).x[-1] - honest.shape.x[-1],
        solve(PAPER, 40e3).y[-1] - honest.shape.y[-1],
    )
    assert off < 4.0 * np.hypot(*model)


def test_exact_forces_are_found():
    run = made(PAPER, UP, LOAD)
    unread = replace(run, force=LOAD + np.array([0.02, -0.02]))
    for tip_only in (False, True):
        found = end_forces(PAPER, unread, tip_only=tip_only)
        assert found.force == pytest.approx(LOAD, abs=2e-4 if tip_only else 1e-4)
    all_targets, tip = (
        end_forces(PAPER, run, tip_only=tip_only).sigma for tip_only in (False, True)
    )
    assert np.all(all_targets < tip)


@pytest.mark.parametrize('tip_only', [False, True], ids=['all targets', 'tip'])
def test_forces_scatter_as_much_as_their_sigma_says(tip_only):
    arm = replace(PAPER, sensors=USUAL)
    drawn = []
    for seed in range(24):
        run = made(arm, UP, LOAD, noise=USUAL, seed=seed, painted=seed)
        found = end_forces(arm, run, tip_only=tip_only)
        drawn.append((found.force - LOAD) / found.sigma)
    white = np.array(drawn)
    white = white[np.isfinite(white)]
    assert white.size > 0.9 * 24 * LOAD.size
    assert np.sqrt(np.mean(white**2)) == pytest.approx(1.0, abs=0.25)
    assert np.mean(np.abs(white) < 1.96) == pytest.approx(0.95, abs=0.04)


def test_a_force_is_found_where_the_model_misses_by_much_more_than_noise():
    # A stretched arm of a stiffness that is known to 5 %: full steps swing, and never settled.
    arm = replace(PAPER, moment_law=LinearLaw(bending_stiffness=3e-4), covariance=None)
    pressure = np.linspace(30e3, 64e3, 8)
    force = np.column_stack([np.linspace(0.1, 0.2, 8), np.linspace(0.05, 0.3, 8)])
    run = made(arm, pressure, force, noise=USUAL)
    run = replace(run, x=1.02 * run.x, y=1.02 * run.y)
    known = ModelCovariance(
        quantities=('moment_law.bending_stiffness',), factor=np.array([[0.05 * 3e-4]])
    )
    found = end_forces(replace(arm, sensors=USUAL, covariance=known), run)
    assert found.force == pytest.approx(force, rel=0.3)


def test_what_the_tip_does_not_tell_is_not_said():
    table = PAPER.intrinsic_curvature
    straight = replace(
        PAPER, intrinsic_curvature=replace(table, curvature=np.zeros_like(table.curvature))
    )
    run = made(straight, np.array([1e4, 2e4]), np.array([[0.1, 0.0], [0.1, 0.05]]))
    found = end_forces(straight, run, tip_only=True)
    assert np.isnan(found.force[0, 0])
    assert np.isnan(found.sigma[0, 0])
    assert found.force[0, 1] == pytest.approx(0.0, abs=1e-6)
    assert np.isfinite(found.force[1]).all()
    unseen = replace(run, x=np.full_like(run.x, np.nan), y=np.full_like(run.y, np.nan))
    assert np.isnan(end_forces(straight, unseen).force).all()


def test_scores_do_not_count_the_place_of_the_camera():
    run = made(PAPER, UP, LOAD)
    moved = replace(run, x=run.x + 3e-3, y=run.y - 1e-3)
    assert score(PAPER, moved).rms < 1e-9
    stiffer = replace(
        PAPER, moment_law=replace(PAPER.moment_law, rigidity=1.2 * PAPER.moment_law.rigidity)
    )
    assert score(stiffer, run).rms > 1e-4
    beyond = replace(run, pressure=np.where(np.arange(15) < 5, 300e3, run.pressure))
    assert score(PAPER, beyond).missing == pytest.approx(1 / 3)
    nowhere = score(PAPER, replace(run, pressure=np.full(15, 300e3)))
    assert nowhere.missing == 1.0
    assert np.isnan(nowhere.rms)


def test_an_hour_of_film_is_thinned_and_that_is_said(monkeypatch):
    free, loaded = noisy()
    most = 20
    fewer = replace(EXPERIMENTS, most_frames=most)
    monkeypatch.setattr('pneunet_ros.calibration.prepared_recordings.EXPERIMENTS', fewer)
    found = calibrate(free, loaded, PAPER, compare=False)
    fitted = sum(len(run.solved) for run in found.joint.runs)
    every = sum(len(run.stamp_ns) for run in (*free, *loaded))
    assert fitted <= most < every
    assert any(f'{fitted} of {every} frames' in note for note in found.notes)
    # The noise is still that of all frames.
    assert found.noise.noise == calibrated().noise.noise


def test_a_recording_left_out_goes_on_from_those_before_it():
    arm = paper_arm((Softening(loss=0.3),))
    up_and_down = np.concatenate([np.linspace(0.0, 6e4, 11), np.linspace(3e4, 0.0, 11)])
    runs = in_two(made(arm, up_and_down, np.tile([0.1, 0.1], (22, 1))))
    fits = [SimpleNamespace(arm=arm, placement=None)] * 2
    sequence = SimpleNamespace(law=lambda *_: None, without_each=lambda *_: fits)
    for law in FitSequence.compare_laws(sequence, [], runs, None, 1.0):
        assert [item.rms for item in law.scores] == pytest.approx([0.0, 0.0], abs=1e-7)
    assert score(arm, runs[1]).rms > 1e-4
    assert rms_of_last(arm, runs) == pytest.approx(0.0, abs=1e-7)
