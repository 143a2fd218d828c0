"""The table of intrinsic curvature: what it says between its numbers, and what it refuses."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import pressure_rows
from pneunet_ros.core.errors import ModelError
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
import pytest
from scipy.interpolate import CubicSpline
from support.example_arms import LENGTH, paper_arm
from support.refusals import refused

PRESSURE = [0.0, 20e3, 55e3]
ARCLENGTH = [0.0, 0.3, 0.5, 0.8, 1.0]
CURVATURE = [[0, 0, 0, 0, 0], [5, 9, 8, 4, 3], [14, 27, 26, 17, 13]]


def table(**changes):
    values = {'pressure': PRESSURE, 'arclength': ARCLENGTH, 'curvature': CURVATURE} | changes
    return IntrinsicCurvature(**values)


def test_the_table_is_met_at_its_own_places():
    for pressure, row in zip(PRESSURE, CURVATURE, strict=True):
        assert table().at(pressure, ARCLENGTH) == pytest.approx(row, abs=1e-12)


def test_between_rows_it_is_linear_in_pressure_and_beyond_them_too():
    s = np.linspace(0, 1, 41)
    low, high = table().at(20e3, s), table().at(55e3, s)
    assert table().at(34e3, s) == pytest.approx(0.6 * low + 0.4 * high, abs=1e-12)
    assert table().at(62e3, s) == pytest.approx(-0.2 * low + 1.2 * high, abs=1e-12)
    assert table().at(-4e3, s) == pytest.approx(-0.2 * low, abs=1e-12)


def test_between_columns_it_is_the_cubic_spline_without_knots_at_the_ends():
    s = np.linspace(0, 1, 101)
    spline = CubicSpline(ARCLENGTH, CURVATURE[1], bc_type='not-a-knot')
    assert table().at(20e3, s) == pytest.approx(spline(s), abs=1e-12)
    cubic = 3 + 2 * s - 7 * s**2 + 4 * s**3
    exact = table(curvature=[np.polyval([4, -7, 2, 3], ARCLENGTH)] * 3)
    assert exact.at(10e3, s) == pytest.approx(cubic, abs=1e-12)


def test_one_place_gives_one_number():
    assert float(table().at(20e3, 0.3)) == pytest.approx(9.0)


@pytest.mark.parametrize('columns', [2, 3, 4])
def test_few_columns_are_a_line_a_parabola_a_cubic(columns):
    place = np.linspace(0, 1, columns)
    few = IntrinsicCurvature(
        pressure=[0.0, 1.0], arclength=place, curvature=[place ** (columns - 1)] * 2
    )
    s = np.linspace(0, 1, 21)
    assert few.at(0.5, s) == pytest.approx(s ** (columns - 1), abs=1e-14)


def test_rotation_is_the_integral_of_curvature():
    curvature = paper_arm().intrinsic_curvature
    pressure = np.array([12e3, 55e3, 64e3])
    pieces = curvature.rotation_of(pressure, LENGTH)
    knots = LENGTH * curvature.arclength
    points, weights = np.polynomial.legendre.leggauss(6)
    for p, row in zip(pressure, pieces, strict=True):
        turned = 0.0
        for k in range(knots.size - 1):
            width = knots[k + 1] - knots[k]
            for share in (0.0, 0.37, 1.0):
                s = knots[k] + share * width * (points + 1) / 2
                inside = 0.5 * share * width * weights @ curvature.at(p, s / LENGTH)
                here = np.polyval(row[k][::-1], share * width)
                assert here == pytest.approx(turned + inside, abs=1e-13)
            turned = here


def test_rows_and_weights():
    row, weight = pressure_rows(np.array(PRESSURE), [-10e3, 0.0, 10e3, 20e3, 55e3, 90e3])
    assert row.tolist() == [0, 0, 0, 1, 1, 1]
    assert weight.tolist() == [-0.5, 0.0, 0.5, 0.0, 1.0, 2.0]


def test_a_single_row_is_the_same_at_any_pressure():
    table = IntrinsicCurvature(
        pressure=[10e3], arclength=[0.0, 0.5, 1.0], curvature=[[1.0, 2.0, 4.0]]
    )
    pressures = np.array([-1e3, 10e3, 12e3])
    assert [table.at(p, [0.0, 1.0]).tolist() for p in pressures] == [[1.0, 4.0]] * 3
    assert not table.slope(pressures).any()
    turned = table.rotation_of(pressures, 0.1)
    assert np.array_equal(turned[0], turned[1])
    assert np.array_equal(turned[0], turned[2])
    assert np.array_equal(turned[0], table.mixed_rotation(np.ones((1, 1)), 0.1)[0])


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'pressure': []}, 'not_increasing'),
        ({'pressure': [0.0, 5e3, 5e3]}, 'not_increasing'),
        ({'pressure': [0.0, 30e3, 20e3]}, 'not_increasing'),
        ({'pressure': 5.0}, 'wrong_shape'),
        ({'pressure': [0.0, np.nan, 9.0]}, 'not_finite'),
        ({'pressure': ['low', 'high', 'top']}, 'not_a_table'),
        ({'arclength': [0.1, 0.3, 0.5, 0.8, 1.0]}, 'not_increasing'),
        ({'arclength': [0.0, 0.3, 0.5, 0.8, 0.112]}, 'not_increasing'),
        ({'arclength': [0.0, 0.5, 0.3, 0.8, 1.0]}, 'not_increasing'),
        ({'arclength': [0.0]}, 'not_increasing'),
        ({'curvature': CURVATURE[:2]}, 'wrong_shape'),
        ({'curvature': np.transpose(CURVATURE)}, 'wrong_shape'),
        ({'curvature': [1.0, 2.0]}, 'wrong_shape'),
        ({'curvature': [[1, 2], [3]]}, 'not_a_table'),
        ({'curvature': [[1, 2, 3, 4, np.inf]] * 3}, 'not_finite'),
        ({'curvature': None}, 'not_a_table'),
        ({'pressure': [False, 20e3, 55e3]}, 'not_a_table'),
        ({'pressure': ['0', '20e3', '55e3']}, 'not_a_table'),
        ({'pressure': [0, 1, 10**400]}, 'not_a_table'),
        ({'curvature': [[1.7e308, -1.7e308, 0, 0, 0]] * 3}, 'too_large'),
    ],
)
def test_wrong_tables_are_refused(changes, reason):
    with refused(ModelError, reason) as caught:
        table(**changes)
    assert str(caught.value).startswith('intrinsic_curvature.')


def test_a_table_cannot_be_changed():
    with pytest.raises(ValueError, match='read-only'):
        table().curvature[0, 0] = 1.0
    mine = np.array(CURVATURE, dtype=float)
    kept = table(curvature=mine)
    mine[0, 0] = 99.0
    assert kept.curvature[0, 0] == 0.0
