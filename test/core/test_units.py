"""Conversions, and what a declared quantity refuses."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.errors import ModelError, RequestError
from pneunet_ros.core.units import (
    check_quantities,
    kilopascals,
    millimeters,
    quantities,
    quantity,
    seconds_between,
    seconds_since,
)
import pytest
from support.refusals import refused


@dataclass(frozen=True, kw_only=True)
class Spring:
    stiffness: float = quantity(unit='N/m', meaning='k', bounds=(0.0, 10.0), source='a guess')
    rest: float = quantity(0.0, unit='m', prior=(-1.0, 1.0))
    name: str = 'spring'


def test_conversions():
    assert kilopascals(31_000.0) == 31.0
    assert millimeters(0.112) == pytest.approx(112.0)


def test_stamps_are_subtracted_before_they_become_seconds():
    year_2026 = 1_780_000_000_000_000_000
    assert seconds_since(year_2026, year_2026 + 1) == 1e-9
    assert seconds_since(year_2026 + 2_500_000_000, year_2026) == -2.5


def test_an_age_is_never_negative():
    assert seconds_between(1, 2_500_000_001) == seconds_between(2_500_000_001, 1) == 2.5


def test_a_quantity_carries_its_declaration():
    stiffness, rest = quantities(Spring)
    assert [stiffness.name, rest.name] == ['stiffness', 'rest']
    assert stiffness.metadata['unit'] == 'N/m'
    assert stiffness.metadata['meaning'] == 'k'
    assert stiffness.metadata['source'] == 'a guess'
    assert stiffness.metadata['prior'] == stiffness.metadata['bounds'] == (0.0, 10.0)
    assert rest.metadata['bounds'] == (-math.inf, math.inf)
    assert rest.metadata['prior'] == (-1.0, 1.0)


@pytest.mark.parametrize('value', [0.0, 10.0, 3, np.float64(2.5)])
def test_values_within_closed_bounds_pass(value):
    check_quantities(Spring(stiffness=value), 'arm')


@pytest.mark.parametrize('value', [-1e-9, 10.000001, math.nan, math.inf, -math.inf])
def test_values_outside_are_refused_by_name_with_bounds_and_unit(value):
    with refused(ModelError, 'out_of_bounds') as caught:
        check_quantities(Spring(stiffness=value), 'arm.spring')
    said = str(caught.value)
    assert said.startswith('arm.spring.stiffness ') and said.endswith('[0.0, 10.0] N/m')


@pytest.mark.parametrize('value', ['3', None, True, [1.0], 1j])
def test_what_is_no_number_is_refused(value):
    with refused(RequestError, 'not_a_number'):
        check_quantities(Spring(stiffness=value), '', RequestError)


def test_infinity_passes_where_the_bound_is_infinite_but_nan_does_not():
    check_quantities(Spring(stiffness=1.0, rest=math.inf), '')
    with refused(ModelError, 'out_of_bounds'):
        check_quantities(Spring(stiffness=1.0, rest=math.nan), '')
