"""The trials of discovery: what is hidden is drawn by its seed alone, and answers are judged."""

from __future__ import annotations

from argparse import Namespace

import discovery_trials
from discovery_trials import judge, label_of, one_trial, summary_of, wanted
from pneunet_ros.discovery.covariates import MEANINGS
from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.lab.outside_effects import ALL_EFFECTS
import pytest
from unnamed.causes import add_causes, CAUSES, NEW


def row(name, kind=None, place=0.5, terms=('1',), tied=(), **more):
    """Return a trial with a law of this kind, or with none."""
    law = {
        'kind': kind, 'tied': list(tied), 'terms': list(terms), 'place': [place, 0.01],
        'coefficients': [[0.033, 0.001]] * len(terms),
    }  # fmt: skip
    return {
        'block': 'causes',
        'name': name,
        'answer': 'unknown',
        'excess': 5.0,
        'closed': 0.9,
        'found': [] if kind is None else [law],
        'truth': {name: {'place': 0.53, 'force': 0.03}},
        **more,
    }


def test_causes_are_of_kinds_and_terms_that_there_are():
    for cause in CAUSES.values():
        assert cause.effect in {*ALL_EFFECTS, *(effect.name for effect in NEW)}
        assert cause.kinds <= set(KINDS)
        natives = {term for kind in cause.kinds for term in KINDS[kind].natives}
        assert cause.terms <= {*MEANINGS, *natives, 'period'}
        assert cause.size[1] < cause.size[2]


def test_what_is_hidden_is_drawn_by_its_seed():
    one, same, other = (label_of('causes', 'push', 2, seed, 5) for seed in (1, 1, 2))
    assert one == same != other
    assert 'push' in one.outside
    assert not one.effects
    weakest, strongest = (
        label_of('causes', 'push', step, 1, 5).outside['push']['force'] for step in (0, 4)
    )
    assert (weakest, strongest) == (0.012, 0.08)
    assert set(label_of('clean', 'clean', 3, 1, 5).outside) == {'harmless_mismatch'}
    asked = Namespace(
        first=1, seeds=2, block=['causes', 'clean'], cause=['push'], step=None, sizes=5
    )
    assert len(list(wanted(asked))) == 2 * (5 + 1)


def test_an_answer_is_judged():
    right = judge(row('push', 'push', tied=('bump',)))
    assert (right['in_set'], right['alone'], right['term']) == (True, False, True)
    assert abs(right['off'] - 0.03) < 1e-9
    assert abs(right['size_off'] - 0.1) < 1e-9
    assert not right['covered']
    wrong = judge(row('push', 'bump', terms=('p',)))
    assert (wrong['in_set'], wrong['term'], 'off' in wrong) == (False, False, False)
    assert 'size_off' not in wrong
    assert judge(row('push')) == {'given': False}


def test_rates_are_over_causes_that_are_large_enough():
    rows = [
        row('push', 'push'),
        row('push'),
        row('push', 'bump', excess=discovery_trials.ABOVE),
        row('clean', 'push', block='clean'),
        row('clean', block='clean'),
        row('clean', block='clean', answer='failed', excess=0.0),
        row('push', answer='failed', excess=0.0),
        row('push', answer='none'),
        row('push', answer='not made', excess=0.0),
    ]
    summary = summary_of(rows)
    assert (summary['false_laws'], summary['without_cause']) == (1, 2)
    assert summary['unsettled'] == 2
    found = summary['causes']['push']
    assert (found['above'], found['given'], found['in_set'], found['alone']) == (4, 1, 1, 1)


@pytest.mark.slow
def test_a_law_that_is_not_in_the_library_takes_a_name_back():
    """A smooth play without `hysteresis` in the library: `creep` leaves noise, and is wrong."""
    add_causes()
    found = one_trial('causes', 'smooth_play', 1, 500, 5)
    assert found['overruled']
    assert found['answer'] == 'unknown'
    assert found['effects'] == []
    judged = judge({'name': 'smooth_play', **found})
    assert judged['alone']
    assert judged['term']
