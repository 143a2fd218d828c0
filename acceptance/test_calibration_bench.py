"""The bench of calibration: names every goal that is missed, and ends with it."""

from __future__ import annotations

import calibration as bench
import numpy as np
import pytest


def row(error=0.0, covered=0.95):
    """Return what a seed came to: relative errors, and the share of intervals that cover."""
    random = np.random.default_rng(2)
    within = [random.uniform(size=shape) < covered for shape in ((3, 5), (5, 9))]
    force = {
        'found': 1.0, 'covered': np.ones(2), 'median_sigma': np.ones(2), 'trusted': 0.0,
        'trusted_within_5': None, 'trusted_worst': None,
    }  # fmt: skip
    return {
        'seconds': 1.0, 'converged': True, 'chi_squared_per_coordinate': 1.0,
        'held_out_rms': 1.0 + 10.0 * error, 'true_rms': 1.0, 'alpha_error': np.full(2, error),
        'split_error': error, 'curvature_error': error, 'law_covered': within[0],
        'curvature_covered': within[1], 'forces': {'all_targets': force, 'tip': force},
    }  # fmt: skip


@pytest.mark.parametrize(('wrong', 'missed'), [({}, 1), ({'error': 0.9, 'covered': 0.5}, 7)])
def test_the_exit_code_says_whether_a_goal_is_missed(monkeypatch, capsys, wrong, missed):
    monkeypatch.setattr(bench, 'run_seeds', lambda *_: [row(**wrong)])
    monkeypatch.setattr('sys.argv', ['calibration.py'])
    assert bench.main() == 1  # one arm covers single quantities in 0 or 1
    assert capsys.readouterr().out.count(', wanted ') == missed
    monkeypatch.setitem(bench.GOALS, ('covered', 'least_of_one'), (0.0, 1.0))
    assert bench.main() == (1 if wrong else 0)
