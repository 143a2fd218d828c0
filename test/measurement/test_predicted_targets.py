"""Where targets are predicted to be seen."""

from __future__ import annotations

import numpy as np
from pneunet_ros.measurement.predicted_targets import along_the_arc
import pytest


def test_a_dot_further_along_is_on_the_arc_of_a_circle():
    theta, curvature, along = np.array([0.3]), np.array([20.0]), np.array([-5e-3])
    chord, heading = along_the_arc(theta, curvature, along)
    on_circle = (np.exp(1j * (theta + curvature * along)) - np.exp(1j * theta)) / (1j * curvature)
    assert heading == pytest.approx(np.exp(1j * (0.3 - 0.1)), abs=1e-15)
    assert abs(chord - on_circle)[0] < 3e-6  # third order; along the tangent 2.5e-4
    assert abs(along * np.exp(1j * theta) - on_circle)[0] > 2e-4
