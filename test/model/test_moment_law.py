"""Moment laws: constants of the rod per section, and what is refused."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.model.moment_law import (
    law_fields,
    LinearLaw,
    MajidiLaw,
    MOMENT_LAWS,
    PiecewiseLinearLaw,
)
import pytest
from support.example_arms import LENGTH
from support.refusals import refused

WEIGHT = 0.17
TABLE = {
    'pressure': [0.0, 40e3, 60e3],
    'split': [0.10, 0.10, 0.20],
    'rigidity': [[0.06, 0.03], [0.08, 0.05], [0.09, 0.05]],
    'moment_offset': [[0.0, 0.0], [-0.01, 0.02], [-0.02, 0.02]],
}


def eq_10(**changes):
    return PiecewiseLinearLaw(**(TABLE | changes))


def test_eq_10_at_a_row_is_the_row_in_units():
    (first, second) = eq_10().sections(np.array([40e3]), LENGTH, WEIGHT)[0]
    assert first == pytest.approx([0.0, 0.08 * WEIGHT * LENGTH**2, -0.01 * WEIGHT * LENGTH])
    assert second == pytest.approx(
        [0.10 * LENGTH, 0.05 * WEIGHT * LENGTH**2, 0.02 * WEIGHT * LENGTH]
    )


def test_eq_10_is_linear_between_rows_and_beyond():
    low, high, between, beyond = eq_10().sections(
        np.array([40e3, 60e3, 45e3, 62e3]), LENGTH, WEIGHT
    )
    assert between == pytest.approx(0.75 * low + 0.25 * high, rel=1e-12)
    assert beyond == pytest.approx(-0.1 * low + 1.1 * high, rel=1e-12)


def test_negative_rigidity_is_allowed_in_either_section():
    law = eq_10(rigidity=[[-0.03, 0.05], [-0.029, 0.05], [-0.02, 0.04]])
    assert law.sections(np.array([20e3]), LENGTH, WEIGHT)[0, 0, 1] < 0.0
    assert eq_10(rigidity=[[0.1, -0.05]] * 3).rigidity[0, 1] == -0.05


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'rigidity': [[0.06, 0.03], [-0.01, 0.03], [0.05, 0.03]]}, 'must not be zero or change'),
        ({'rigidity': [[0.06, 0.03], [0.06, 0.0], [0.05, 0.03]]}, 'must not be zero or change'),
        ({'rigidity': [[0.0, 0.03]] * 3}, 'must not be zero or change sign'),
        ({'rigidity': [0.06, 0.03, 0.02]}, 'rigidity must be a list of rows'),
        ({'rigidity': [[0.06], [0.03], [0.02]]}, r'3 rows .* of 2, not 3 x 1'),
        ({'rigidity': [[0.06, 0.03]] * 2}, r'3 rows .* of 2, not 2 x 2'),
        ({'moment_offset': [[0.0, 0.0]] * 4}, r'moment_offset must have 3 rows'),
        ({'moment_offset': [[0.0, np.nan]] * 3}, 'moment_offset contains NaN'),
        ({'split': [0.1, 0.1]}, 'split must hold 3 values, one per pressure'),
        ({'split': [0.1, 0.0, 0.1]}, 'split must lie between 0 and 1'),
        ({'split': [0.1, 1.0, 0.1]}, 'split must lie between 0 and 1'),
        ({'pressure': [0.0, 60e3, 40e3]}, 'strictly increasing'),
    ],
)
def test_wrong_tables_of_eq_10_are_refused(changes, sentence):
    with pytest.raises(ModelError, match=sentence) as caught:
        eq_10(**changes)
    assert str(caught.value).startswith('moment_law.')


def test_the_linear_law_holds_everywhere():
    law = LinearLaw(bending_stiffness=2e-4)
    assert law.sections(np.array([0.0, 9e4]), LENGTH, WEIGHT).tolist() == [[[0.0, 2e-4, 0.0]]] * 2
    assert law.pressure_range == (-np.inf, np.inf)
    assert law.table_pressures.size == 0


def test_the_linear_law_takes_negative_stiffness_but_not_zero():
    assert LinearLaw(bending_stiffness=-2e-4).bending_stiffness == -2e-4
    with refused(ModelError, 'singular_rigidity'):
        LinearLaw(bending_stiffness=0.0)
    with refused(ModelError, 'out_of_bounds'):
        LinearLaw(bending_stiffness=np.inf)


def test_the_ranges_of_laws():
    assert eq_10().pressure_range == (0.0, 60e3)
    assert eq_10().table_pressures.tolist() == TABLE['pressure']


GEOMETRY = {'width': 0.015, 'thickness': 0.003, 'height': 0.012, 't1': 0.002, 't2': 0.008}


def test_majidi_stays_positive_over_its_range():
    law = MajidiLaw(modulus=1e6, **GEOMETRY)
    low, high = law.pressure_range
    assert high == np.inf
    assert law.rigidity(low) == pytest.approx(0.5 * law.flexural_rigidity)
    assert law.sections(np.array([low]), LENGTH, WEIGHT)[0, 0, 1] > 0.0


@pytest.mark.parametrize('name', ['modulus', *GEOMETRY])
@pytest.mark.parametrize('value', [0.0, -1.0, np.nan, 'thick'])
def test_majidi_refuses_what_is_no_size(name, value):
    with refused(ModelError, 'not_a_number' if value == 'thick' else 'out_of_bounds'):
        MajidiLaw(**({'modulus': 1e6, **GEOMETRY} | {name: value}))


def test_laws_are_known_by_their_kind():
    assert set(MOMENT_LAWS) == {'piecewise_linear', 'linear', 'majidi'}
    assert law_fields(LinearLaw) == ('bending_stiffness',)
    assert set(law_fields(PiecewiseLinearLaw)) == set(TABLE)
    assert set(law_fields(MajidiLaw)) == {'modulus', *GEOMETRY}
