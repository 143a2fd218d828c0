"""Where targets are seen that are painted beside their places."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from pneunet_ros.measurement.painted_targets import along_the_arc, in_plane, paint
import pytest

STEP = 1e-6


def test_a_dot_further_along_is_on_the_arc_of_a_circle():
    theta, curvature, along = np.array([0.3]), np.array([20.0]), np.array([-5e-3])
    chord, heading = along_the_arc(theta, curvature, along)
    on_circle = (np.exp(1j * (theta + curvature * along)) - np.exp(1j * theta)) / (1j * curvature)
    assert heading == pytest.approx(np.exp(1j * (0.3 - 0.1)), abs=1e-15)
    assert abs(chord - on_circle)[0] < 3e-6  # third order; along the tangent 2.5e-4
    assert abs(along * np.exp(1j * theta) - on_circle)[0] > 2e-4


def test_every_derivative_is_a_difference():
    random = np.random.default_rng(2)
    at = {
        'theta': random.normal(size=(4, 3)),
        'curvature': 20.0 * random.normal(size=(4, 3)),
        'along': 5e-3 * random.normal(size=3),
        'across': 5e-3 * random.normal(size=3),
    }

    def displacement(**changed: np.ndarray) -> np.ndarray:
        now = {**at, **changed}
        placement = np.stack([now['along'], now['across']])
        return paint(now['theta'], now['curvature'], placement).displacement

    painted = paint(at['theta'], at['curvature'], np.stack([at['along'], at['across']]))
    assert {item.name for item in fields(painted)} == {
        'displacement',
        *(f'by_{name}' for name in at),
    }
    for name, value in at.items():
        sides = [displacement(**{name: value + sign * STEP}) for sign in (-1.0, 1.0)]
        found = getattr(painted, f'by_{name}')
        assert found == pytest.approx((sides[1] - sides[0]) / (2.0 * STEP), abs=1e-8), name


def test_the_jacobian_moves_each_target_by_its_own_place():
    random = np.random.default_rng(3)
    theta, placement = random.normal(size=(2, 5)), np.zeros((2, 5))
    jacobian = paint(theta, np.full((2, 5), 30.0), placement).jacobian()
    moved = 1e-3 * random.normal(size=(2, 5))
    wanted = (moved[0] + 1j * moved[1]) * np.exp(1j * theta)
    assert jacobian @ moved.ravel() == pytest.approx(in_plane(wanted), abs=1e-15)
