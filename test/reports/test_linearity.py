"""The linearity check: a straight line is found straight, a bend is found, with its size."""

from __future__ import annotations

import numpy as np
from pneunet_ros.reports.paper_views.linearity import (
    fit_straight_line,
    intrinsic_linearity,
    PLACES,
)
import pytest
from support.small_calibration import calibration

PRESSURE = np.linspace(0.0, 60e3, 7)


def test_a_straight_line_is_straight():
    found = fit_straight_line(0.2, PRESSURE, 3.0 + 5e-4 * PRESSURE, 0.04 * np.eye(7))
    assert found.intercept == pytest.approx(3.0)
    assert found.slope == pytest.approx(5e-4)
    assert np.max(np.abs(found.departure)) < 1e-9
    assert found.sigmas < 1e-6


def test_what_departs_is_found_where_it_does():
    value = 5e-4 * PRESSURE
    value[4] += 2.0
    found = fit_straight_line(0.2, PRESSURE, value, 0.04 * np.eye(7))
    assert found.largest == 4
    assert found.sigmas == pytest.approx(
        2.0 / 0.2 * np.sqrt(found.departure_std[4] ** 2 / 0.04), rel=1e-6
    )
    assert found.departure_std[4] < 0.2


def test_departures_have_their_standard_errors():
    rng = np.random.default_rng(2)
    apart = np.subtract.outer(PRESSURE, PRESSURE) / 2e4
    covariance = 0.09 * np.exp(-0.5 * apart**2) + 0.01 * np.eye(7)
    draws = rng.multivariate_normal(5e-4 * PRESSURE, covariance, 400)
    found = [fit_straight_line(0.2, PRESSURE, value, covariance) for value in draws]
    spread = np.std([item.departure for item in found], axis=0)
    assert np.allclose(spread, found[0].departure_std, rtol=0.2)


def test_too_few_pressures_tell_nothing():
    assert fit_straight_line(0.2, PRESSURE[:2], PRESSURE[:2], np.eye(2)) is None
    assert fit_straight_line(0.2, np.zeros(4), np.arange(4.0), np.eye(4)) is None


def test_kappa0_is_looked_at_in_the_paper_s_places():
    fit = calibration().joint
    found = intrinsic_linearity(fit)
    assert [item.place for item in found] == list(PLACES)
    for item in found:
        table = [fit.arm.intrinsic_curvature.at(p, item.place) for p in item.pressure.tolist()]
        assert np.allclose(item.value, table)
        assert np.all(item.std > 0.0)
