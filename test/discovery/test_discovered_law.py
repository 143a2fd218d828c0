"""What is said of a law that was discovered."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from pneunet_ros.discovery.discovery import linear_terms
from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.discovery.proposed_effect import effect_class, effect_source, LAW_ERROR, Parameter
import pytest


def test_no_coefficient_is_known_better_than_a_law_is_followed():
    kind = KINDS['stretch']
    law = SimpleNamespace(
        terms=('tension', 'p'),
        coefficients=np.array([2.0, -0.5]),
        covariance=np.diag([1e-8, 0.09]),
    )
    pressure = SimpleNamespace(name='p', scale=1e4, meaning=SimpleNamespace(unit='Pa'))
    cause = SimpleNamespace(kind=kind, covariates=(pressure,))
    tension, by_pressure = linear_terms(SimpleNamespace(law=law, kind=kind, cause=cause))
    assert tension.std == pytest.approx(LAW_ERROR * tension.coefficient, rel=1e-6)
    sizes = -0.5 * kind.prior / 1e4, np.hypot(0.3, 0.5 * LAW_ERROR) * kind.prior / 1e4
    assert (by_pressure.coefficient, by_pressure.std) == pytest.approx(sizes)


def test_a_proposed_effect_says_how_well_its_law_is_followed():
    constant = Parameter(name='constant', term='1', unit='-', prior=0.02)
    source = effect_source(KINDS['stretch'], [constant], 'A law.', length=0.1, play=500.0)
    assert effect_class(source).law_error == LAW_ERROR
