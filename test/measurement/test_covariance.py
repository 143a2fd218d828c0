"""Covariances of common errors, against dense ones."""

from __future__ import annotations

import numpy as np
from pneunet_ros.measurement.errors.covariance import Whitening
import pytest
from scipy.linalg import sqrtm

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


def test_every_coordinate_may_have_a_noise_of_its_own():
    std, columns = RANDOM.uniform(0.1, 2.0, 6), RANDOM.standard_normal((6, 2))
    root = Whitening(std, columns)(np.eye(6))
    inverse = np.linalg.inv(np.diag(std**2) + columns @ columns.T)
    assert root.T @ root == pytest.approx(inverse, abs=1e-12)
