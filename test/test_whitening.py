"""Residuals made white; disturbances and their prior, against direct constructions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.measurement.disturbances import Disturbances, PATH_NODES
from pneunet_ros.measurement.whitening import Whitening
import pytest
from scipy.linalg import sqrtm
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

RANDOM = np.random.default_rng(5)


def test_whitening_is_the_inverse_root_of_the_covariance():
    sigma, sensed = 0.3, RANDOM.standard_normal((4, 7, 3))
    mask = np.ones((4, 7), dtype=bool)
    mask[1, [2, 5]] = False
    whitening = Whitening(sigma, sensed, mask)
    found = whitening(np.broadcast_to(np.eye(7), (4, 7, 7)))
    for frame in range(4):
        seen = mask[frame]
        part = sensed[frame, seen]
        root = np.real(sqrtm(sigma**2 * np.eye(seen.sum()) + part @ part.T))
        assert found[frame][np.ix_(seen, seen)] == pytest.approx(np.linalg.inv(root), abs=1e-12)
        assert np.all(found[frame][~seen] == 0.0)
        assert np.all(found[frame][:, ~seen] == 0.0)


def test_what_was_not_seen_counts_nothing_even_as_nan():
    mask = np.array([[True, False, True]])
    whitening = Whitening(1.0, np.array([[[2.0], [np.nan], [0.0]]]), mask)
    white = whitening(np.array([[[3.0], [np.nan], [1.0]]]))
    assert white[0, :, 0] == pytest.approx([3.0 / np.sqrt(5.0), 0.0, 1.0])


def test_white_residuals_are_white():
    sensed = RANDOM.standard_normal((1, 5, 2))
    noise = 0.5 * RANDOM.standard_normal((1, 5, 40_000))
    errors = noise + sensed @ RANDOM.standard_normal((1, 2, 40_000))
    white = Whitening(0.5, sensed, np.ones((1, 5), dtype=bool))(errors)[0]
    assert white @ white.T / 40_000 == pytest.approx(np.eye(5), abs=0.04)


def test_the_prior_of_disturbances():
    noise = replace(USUAL, placement_std=2e-4, registration_std=3e-4, drift_std=1e-4)
    prior = Disturbances(targets=3, runs=2, noise=noise).prior
    assert prior.shape == (6 + 4 * PATH_NODES,) * 2
    assert prior[:6, :6] == pytest.approx(4e-8 * np.eye(6), rel=1e-9)
    path = prior[6 : 6 + PATH_NODES, 6 : 6 + PATH_NODES]
    # a place, and a walk that has drift_std at the end and half its variance in the middle
    assert path[0] == pytest.approx(9e-8, rel=1e-3)
    assert path[-1, -1] == pytest.approx(9e-8 + 1e-8, rel=1e-3)
    assert path[PATH_NODES // 2, -1] == pytest.approx(9e-8 + 0.5e-8, rel=1e-3)
    for block in range(1, 4):
        part = slice(6 + block * PATH_NODES, 6 + (block + 1) * PATH_NODES)
        assert np.array_equal(prior[part, part], path)
        assert not prior[part, : part.start].any()
    assert np.linalg.eigvalsh(prior).min() > 0.0
    assert np.linalg.eigvalsh(Disturbances(targets=3, runs=1, noise=replace(
        noise, placement_std=0.0, registration_std=0.0, drift_std=0.0
    )).prior).min() > 0.0  # fmt: skip


def test_targets_answer_to_disturbances():
    arm = paper_arm()
    run = made(arm, np.linspace(0.0, 4e4, 17))
    targets = arm.target_arclength.size
    disturbances = Disturbances(targets=targets, runs=2, noise=USUAL)
    theta = RANDOM.standard_normal((17, targets))
    parameters = RANDOM.standard_normal(disturbances.prior.shape[0])
    own = disturbances.of_run(1)
    found = disturbances.answer(run, theta) @ parameters[own]
    along, across = parameters[:targets], parameters[targets : 2 * targets]
    nodes = parameters[2 * targets :].reshape(2, 2, PATH_NODES)[1]  # of the second run: x, y
    time = np.linspace(0.0, 1.0, 17)
    for frame in range(17):
        tangent = np.stack([np.cos(theta[frame]), np.sin(theta[frame])])
        normal = np.stack([-tangent[1], tangent[0]])
        camera = [np.interp(time[frame], np.linspace(0, 1, PATH_NODES), path) for path in nodes]
        wanted = along * tangent + across * normal + np.array(camera)[:, None]
        assert found[frame] == pytest.approx(wanted, abs=1e-12)


def test_a_run_of_one_frame_has_a_place():
    arm = paper_arm()
    run = made(arm, np.array([2e4]))
    disturbances = Disturbances(targets=arm.target_arclength.size, runs=1, noise=USUAL)
    answer = disturbances.answer(run, np.zeros((1, arm.target_arclength.size)))
    assert answer[0, 0, 0, -2 * PATH_NODES :].sum() == 1.0
