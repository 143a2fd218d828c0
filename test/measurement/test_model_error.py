"""What a model lacks: its scale from innovations, and the memory of the pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.unknowns import STIFFNESS_SHARE, unknowns_of
from pneunet_ros.measurement.blocks.model_error import (
    curvature_off,
    ModelDiscrepancy,
    stiffness_off,
)
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth
from pneunet_ros.model.moment_law import LinearLaw
import pytest
from scipy.stats import multivariate_normal

ARM = load_model(share_path('config/paper_arm.yaml'))
LACK = unknowns_of(ARM).block(ModelDiscrepancy)
GRID = LACK.grid
RANDOM = np.random.default_rng(4)
MOVED = RANDOM.standard_normal((6, 2)) * [30.0, 5.0]  # what two errors move, of scale 1
OTHER = np.diag([1.0, 2.0, 0.5, 1.0, 1.0, 3.0])  # the covariance of all else


def information_of(innovation, assumed):
    """Return what a frame says of the scale: H^T S^-1 v and H^T S^-1 H."""
    covariance = OTHER + assumed**2 * MOVED @ MOVED.T
    solved = np.linalg.solve(covariance, np.column_stack([innovation, MOVED]))
    return MOVED.T @ solved[:, 0], MOVED.T @ solved[:, 1:]


def after(frames, seconds=0.0, assumed=0.016):
    """Return the log weights after frames, which are innovations."""
    weights = GRID.first
    growth = ErrorGrowth(size=assumed, grown=np.ones(2), seconds=seconds)
    for innovation in frames:
        weights = GRID.after(weights, growth, information_of(innovation, assumed))
    return weights


@pytest.mark.parametrize('assumed', [0.001, 0.016, 0.12])
def test_the_likelihood_of_all_scales_follows_from_one_fit(assumed):
    innovation = RANDOM.standard_normal(6)
    expected = [
        multivariate_normal.logpdf(innovation, cov=OTHER + scale**2 * MOVED @ MOVED.T)
        for scale in GRID.sizes
    ]
    found = after([innovation], assumed=assumed) - GRID.first
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=1e-6)


@pytest.mark.parametrize('true', [0.0, 0.03, 0.12])
def test_frames_tell_the_scale(true):
    random = np.random.default_rng(7)
    noise = random.standard_normal((200, 6)) * np.sqrt(np.diagonal(OTHER))
    frames = noise + true * random.standard_normal((200, 2)) @ MOVED.T
    found = GRID.size_of(after(frames))
    assert found == pytest.approx(true, rel=0.35) if true else found < 0.008


def test_without_frames_the_scale_becomes_what_it_was():
    loud = after([np.full(6, 8.0)] * 5)
    assert GRID.size_of(loud) > 3.0 * GRID.size_of(GRID.first)
    growth = ErrorGrowth(size=0.016, grown=np.zeros(2), seconds=1e4)
    later = GRID.after(loud, growth, (np.zeros(2), np.zeros((2, 2))))
    assert GRID.size_of(later) == pytest.approx(GRID.size_of(GRID.first))


def test_pressures_that_lag_follow_and_a_play_stays_behind():
    rested = LACK.remember((), 20e3, 0.0)
    assert rested == (20e3,) * (len(LACK.lag_times) + 1)
    half = 0.5 * LACK.play * LACK.range
    jumped = LACK.remember(rested, 30e3, LACK.lag_times[0])
    assert jumped[0] == pytest.approx(30e3 - 10e3 * np.exp(-1.0))
    assert jumped[-1] == 30e3 - half
    back = LACK.remember(jumped, 30e3 - 0.5 * half, 0.0)
    assert back == jumped  # within the play, and no time has passed


def test_the_curvature_that_is_lacking_is_that_of_the_whole_range():
    column = curvature_off(ARM)
    moved = ARM.with_changes({name: 0.1 * change for name, change in column.items()})
    low, high = ARM.pressure_range
    places = np.linspace(0.0, 1.0, 5)
    field = ARM.intrinsic_curvature
    between = moved.intrinsic_curvature.at(20e3, places) - field.at(20e3, places)
    expected = 0.1 * (field.at(high, places) - field.at(low, places))
    assert between == pytest.approx(expected, abs=1e-9)
    single = replace(field, pressure=field.pressure[:1], curvature=field.curvature[1:2])
    column = curvature_off(replace(ARM, intrinsic_curvature=single))
    assert list(column.values()) == pytest.approx(single.curvature[0])


@pytest.mark.parametrize('law', [ARM.moment_law, LinearLaw(bending_stiffness=2e-4)])
def test_the_stiffness_that_is_lacking_is_a_share_of_it_everywhere(law):
    arm = replace(ARM, moment_law=law, covariance=None)
    column = stiffness_off(arm, STIFFNESS_SHARE)
    moved = arm.with_changes(column).moment_law
    pressures = np.linspace(0.0, 50e3, 5)
    was, found = (item.sections(pressures, arm.length, arm.weight) for item in (law, moved))
    share = found[:, :, 1] / was[:, :, 1] - 1.0
    assert share == pytest.approx(np.full(share.shape, STIFFNESS_SHARE))
