"""Innovation of a frame, against dense covariances, and how often it is how large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.readings import TargetSightings, unseen_targets
from pneunet_ros.measurement.innovation import innovation
from pneunet_ros.measurement.predicted_targets import PredictedTargets
import pytest
from support.made_datasets import USUAL


def frame_at(x, y, std=np.nan) -> TargetSightings:
    """Return a frame of targets seen at x, y."""
    seen = unseen_targets(1, len(x))
    return replace(seen, x=np.array(x), y=np.array(y), std=np.full(len(x), std))


def predicted(share, errors) -> PredictedTargets:
    """Return targets of a straight arm, painted where they should be."""
    return PredictedTargets(
        x=0.1 * share,
        y=np.zeros(share.size),
        errors=errors,
        by_load=np.zeros((3, 2, share.size)),
        theta=np.zeros(share.size),
        share=share,
        placed=np.zeros((2, share.size)),
        placed_std=np.full(share.size, 0.0),
    )


def test_chi_square_is_that_of_the_whole_covariance():
    random = np.random.default_rng(3)
    errors = 1e-4 * random.standard_normal((4, 2, 5))
    share = np.linspace(0.0, 1.0, 5)
    expected = predicted(share, errors)
    apart = 2e-4 * random.standard_normal((2, 5))
    apart[0, 2] = np.nan
    frame = frame_at(expected.x + apart[0], expected.y + apart[1], std=7e-5)
    found = innovation(expected, frame, USUAL)
    variance = 7e-5**2 + USUAL.placement_std**2  # the tracker's std is more than the model's
    camera = USUAL.registration_std**2 + USUAL.drift_std**2
    columns = errors.reshape(4, 10)
    covariance = variance * np.eye(10) + columns.T @ columns
    covariance += camera * np.kron(np.eye(2), np.ones((5, 5)))
    seen = np.tile(np.arange(5) != 2, 2)
    apart = apart.ravel()
    inverse = np.linalg.inv(covariance[np.ix_(seen, seen)])
    assert found.coordinates == 8
    assert found.chi_square == pytest.approx(apart[seen] @ inverse @ apart[seen])
    assert np.isnan(found.at_targets[2])
    own = covariance[np.ix_([4, 9], [4, 9])]
    pair = apart[[4, 9]]
    assert found.at_targets[4] == pytest.approx(0.5 * pair @ np.linalg.inv(own) @ pair)


def test_the_tip_is_as_often_outside_of_its_ellipse_as_it_says():
    random = np.random.default_rng(7)
    share, size = np.linspace(0.0, 1.0, 21), 1e-4
    bend = np.stack([np.zeros(21), share**2])
    expected = predicted(share, 2.0 * size * bend[None])
    still = replace(USUAL, target_std=size, placement_std=0.0, registration_std=0.0, drift_std=0.0)

    def outside(further):
        found = []
        for _ in range(2000):
            apart = 2.0 * size * random.standard_normal() * bend
            apart = apart + size * random.standard_normal((2, 21)) + further
            frame = frame_at(expected.x + apart[0], expected.y + apart[1], std=size)
            found.append(innovation(expected, frame, still))
        beyond = np.mean([one.at_tip > -2.0 * np.log(0.05) for one in found])
        return beyond, np.mean([one.chi_square / one.coordinates for one in found])

    assert outside(0.0) == pytest.approx((0.05, 1.0), abs=0.015)
    # A camera that is elsewhere is no error of the tip:
    assert outside(3.0 * size)[0] == pytest.approx(0.05, abs=0.015)
    # A bend along x that no error explains, as large as the noise of one target:
    tips, targets = outside(2.0 * size * bend[::-1])
    assert targets < 1.5
    assert tips > 0.5


def test_too_few_targets_tell_no_tip():
    expected = predicted(np.array([0.0, 0.5, 1.0]), np.zeros((1, 2, 3)))
    assert np.isnan(innovation(expected, frame_at(expected.x, expected.y), USUAL).at_tip)
