"""Is anything left? Chances and thresholds of the tests, and a misfit that they find."""

from __future__ import annotations

import functools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.fit.refit import linearize_all_runs
from pneunet_ros.diagnosis.scores.lack_of_fit import clean_moments, lack_of_fit_tests, LackOfFit
from pneunet_ros.diagnosis.settings import LACK_OF_FIT, LINEARIZATION
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import pytest
from scipy.stats import chi2
from support.lab_designs import design, fitted, TRAINING

LEVEL = 1e-4  # at which a test of these is taken for failed


def group(statistic: float, dof: int = 10, mean: float = 10.0, std: float = 20**0.5) -> LackOfFit:
    """Return a test of the moments of chi squared, unless told."""
    return LackOfFit(name='any', statistic=statistic, dof=dof, mean=mean, std=std)


def test_chance_and_threshold_are_the_same_thing():
    for mean, std in ((10.0, 20**0.5), (40.0, 30.0), (3.0, 9.0)):
        for level in (0.5, 1e-2, 1e-5):
            threshold = group(0.0, mean=mean, std=std).threshold(level)
            assert group(threshold, mean=mean, std=std).p_value == pytest.approx(level)
        assert group(2.0 * threshold, mean=mean, std=std).p_value < 1e-5


@pytest.mark.parametrize('statistic', [2.0, 10.0, 25.0, 60.0])
def test_moments_of_chi_squared_give_its_chances(statistic):
    assert group(statistic).p_value == pytest.approx(float(chi2.sf(statistic, 10)))


def test_what_is_more_than_in_clean_data():
    assert group(25.0).excess == 15.0
    assert group(8.0).excess == 0.0


def test_a_test_that_sees_nothing_finds_nothing():
    blind = group(0.0, dof=0, mean=0.0, std=0.0)
    assert (blind.p_value, blind.threshold(0.01)) == (1.0, np.inf)


def moments(
    dof: int, *disturbed: tuple[int, Array], name: str = 'any', seed: int = 3
) -> tuple[float, float]:
    """Return mean and variance in clean data."""
    mean, std = clean_moments(name, dof, disturbed, seed)
    return mean, std**2


def test_clean_data_without_disturbance_are_chi_squared():
    mean, variance = moments(40)
    assert mean == pytest.approx(40.0, rel=0.02)
    assert variance == pytest.approx(80.0, rel=0.12)
    assert moments(0) == (0.0, 0.0)


@pytest.mark.parametrize('dof', [LACK_OF_FIT.camera_dof, 20])
def test_disturbances_of_uncertain_size_make_clean_data_wilder(dof):
    answer = np.zeros((40, 3))
    answer[[0, 1, 2], [0, 1, 2]] = 10.0
    mean, variance = moments(40, (dof, answer))
    # E max(n / chi^2 - 1, 0) of each of three numbers, times 10^2.
    more = dof / np.random.default_rng(1).chisquare(dof, 1_000_000) - 1.0
    assert mean == pytest.approx(40.0 + 300.0 * np.maximum(more, 0.0).mean(), rel=0.1)
    assert variance > 4.0 * 80.0


def test_the_seed_and_the_name_say_what_is_drawn():
    first = moments(12)
    assert moments(12) == first
    assert moments(12, seed=4) != first
    assert moments(12, name='another') != first


@functools.cache
def whole(hidden: str, effect: str = '') -> tuple[Linearization, GaussianModel]:
    """Return all recordings around a joint fit as a linear problem."""
    found = fitted(effect, hidden)
    around = found.linearization.at(found.point, design(hidden).runs)
    at_fit = linearize_all_runs(around, found)
    assert at_fit is not None
    return around, at_fit[1]


@functools.cache
def groups(hidden: str, effect: str = '') -> dict[str, LackOfFit]:
    """Return the tests of a joint fit."""
    around, gaussian = whole(hidden, effect)
    return {item.name: item for item in lack_of_fit_tests(around, gaussian, 5)}


def test_clean_data_leave_nothing():
    found = groups('')
    assert len(found) == 6
    assert [name.split(':')[0] for name in found] == ['training'] * 3 + ['held out'] * 3
    assert min(item.p_value for item in found.values()) > LEVEL
    for item in found.values():
        assert item.dof > 5
        assert item.mean >= 0.98 * item.dof
        assert item.std**2 >= 1.8 * item.dof  # of all windows of all runs


@pytest.mark.parametrize('name', ['load_offset', 'extensibility'])
def test_what_is_missing_is_seen_until_it_is_in_the_model(name):
    without, known = groups(name), groups(name, name)
    assert without['training: smooth fields'].p_value < 1e-9
    assert without['held out: smooth fields'].p_value < 0.01
    assert min(item.p_value for item in known.values()) > LEVEL


def misfitting(change: Array, run: int) -> dict[str, LackOfFit]:
    """Return the tests with another misfit (frames, 2, targets) m in one run of clean data."""
    around, linear = whole('')
    block = around.blocks[run]
    more = block.white(change.reshape(*change.shape[:1], -1, 1))[:, 0]
    residuals = list(linear.residuals)
    residuals[run] = residuals[run] + more
    changed = GaussianModel.of(linear.columns, residuals, linear.position, linear.grams)
    return {item.name: item for item in lack_of_fit_tests(around, changed, 5)}


def test_a_target_that_moves_by_itself_with_the_load_is_seen():
    run = design().runs[2]
    change = np.zeros((len(run.stamp_ns), 2, run.x.shape[1]))
    force = np.hypot(*run.force.T)
    change[:, 1, 12] = 8e-4 * force / force.max()
    found = misfitting(change, 2)
    assert found['training: single targets'].p_value < 1e-6
    assert found['training: single targets'].excess > 3.0 * found['training: smooth fields'].excess


def test_what_happens_in_a_part_of_a_recording_is_seen():
    run = design().runs[len(TRAINING)]  # held out
    frames = len(run.stamp_ns)
    change = np.zeros((frames, 2, run.x.shape[1]))
    share = np.arange(run.x.shape[1]) / run.x.shape[1]
    change[frames // 3 : frames // 2, 1] = 1.5e-3 * share**2
    found = misfitting(change, len(TRAINING))
    assert found['held out: windows of time'].p_value < 1e-6
    assert found['training: windows of time'].p_value > LEVEL


def test_without_held_out_recordings_only_training_is_tested():
    found = fitted()
    part = lack_of_fit_tests(found.linearization.of_training(), found.gaussian, 5)
    assert [item.name.split(':')[0] for item in part] == ['training'] * 3


def test_harmless_departures_are_as_large_as_stated_whichever_fields_are_seen():
    found = fitted('', '')
    unloaded = [run for run in design('').runs if not run.loaded]
    linearization = found.linearization.at(found.point, unloaded)
    fields = [block.fields.generic for block in linearization.blocks]
    rows = sum(field.shape[0] * field.shape[1] for field in fields)
    rms = np.sqrt(sum(np.nansum(field**2, axis=(0, 1)) for field in fields) / rows)
    together = np.sqrt(np.sum((linearization.tolerances() * rms) ** 2))
    assert together == pytest.approx(LINEARIZATION.tolerance * linearization.length)
    assert np.count_nonzero(rms) < rms.size
