"""What recordings could not determine is said in a few sentences."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from pneunet_ros.calibration.checks.identifiability import undetermined_quantities
from support.refusals import reasons

NAMES = [f'moment_law.rigidity.{place}.0' for place in range(2)] + [
    'moment_law.transition.0.0',
    'moment_law.transition.1.0',
]


def fit_with(correlation, *, width=0.1):
    """Return a fit of four quantities, all correlated alike, `width` times as wide as before."""
    count = len(NAMES)
    covariance = width**2 * (correlation + (1.0 - correlation) * np.eye(count))
    parameters = SimpleNamespace(prior=np.eye(count), quantities=lambda: (NAMES, np.eye(count)))
    return SimpleNamespace(
        parameters=parameters, covariance=covariance, converged=True, status='converged'
    )


def test_nothing_is_said_of_quantities_that_are_known_and_apart():
    """Each a tenth as wide as its prior, and hardly correlated."""
    assert undetermined_quantities(fit_with(0.3)) == []


def test_many_pairs_that_go_together_are_one_sentence():
    """The most alike are named, the others counted; one quantity at two pressures is no pair."""
    assert reasons(undetermined_quantities(fit_with(0.99))) == ['not_distinguished']


def test_quantities_that_stay_at_their_prior_are_named():
    """Nothing was learnt of them."""
    (sentence,) = undetermined_quantities(fit_with(0.0, width=0.999))
    assert all(name in sentence for name in NAMES)
