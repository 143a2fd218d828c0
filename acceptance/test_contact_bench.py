"""The bench of contacts: reaches its goals where contacts are right, and can say no."""

from __future__ import annotations

import contact as bench
import contact_map
import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.fusion import Fusion
from support.lab_run import true_model

FRAMES, PUSHED = 200, slice(60, 140)


def rows(what, size=0.02, place=1e-3, alarms=0, late=1, seed=3):
    """Return what a recording gave: errors of these sizes, so many false alarms."""
    random = np.random.default_rng(seed)
    found = np.full((FRAMES, len(bench.COLUMNS)), np.nan)
    column = {name: found[:, number] for number, name in enumerate(bench.COLUMNS)}
    column['true_force'][:] = column['ambiguous'][:] = 0.0
    column['true_place'][:], column['seconds'][:] = 0.06, 4e-3
    if what == 'push':
        column['true_force'][PUSHED] = 0.02
        named = slice(PUSHED.start + late, PUSHED.stop)
        count = named.stop - named.start
        column['force'][named] = 0.02 * (1.0 + size * random.standard_normal(count))
        column['std_force'][named] = 0.02 * size
        column['place'][named] = 0.06 + place * random.standard_normal(count)
        column['std_place'][named] = place
    column['force'][:alarms] = 0.01
    return found


def rigs(**options):
    return [{f'{way} {what}': rows(what, **options)[None] for way, what in bench.CASES}]


def test_right_contacts_reach_the_goals_and_others_miss_them():
    good = bench.summary_of(rigs())
    assert good['missed'] == []
    numbers = good['cases']['wrench push']
    assert (numbers['onset'], numbers['release']) == (1.0, 0.0)
    assert 0.85 < numbers['size_covered'] < 1.0
    assert any('size' in one for one in bench.summary_of(rigs(size=0.1))['missed'])
    assert any('place' in one for one in bench.summary_of(rigs(place=5e-3))['missed'])
    assert any('false_alarms' in one for one in bench.summary_of(rigs(alarms=1))['missed'])


def test_a_push_is_named_when_it_is_ambiguous_no_more():
    found = rows('push')
    found[:70, bench.COLUMNS.index('ambiguous')] = 1.0
    assert bench.delays_of(found) == (10.0, 0.0)
    found[:, bench.COLUMNS.index('ambiguous')] = 1.0
    onset, release = bench.delays_of(found)
    assert onset == np.inf and np.isnan(release)


def test_a_contact_that_is_never_named_misses_its_goals():
    found = rigs()
    column = bench.COLUMNS.index('ambiguous')
    for way in ('wrench', 'free tip'):
        found[0][f'{way} push'][..., column] = 1.0
        found[0][f'{way} clean'][..., column] = 1.0
    summary = bench.summary_of(found)
    assert [one for one in summary['missed'] if 'found' in one] == [
        f'{way} push: found = 0, wanted 0.9 to 1' for way in ('wrench', 'free tip')
    ]
    assert summary['cases']['wrench clean']['ambiguous_in_vain'] == 1.0
    silent = rigs()
    silent[0]['no wrench clean'][..., column] = np.nan
    assert bench.summary_of(silent)['missed'] == [
        'no wrench clean: estimates = 0, wanted 0.95 to 1'
    ]


def test_a_push_of_the_lab_is_found_where_it_is():
    recording = bench.recording_of(77, 1, 'wrench', 'push')
    found = bench.fuse(Fusion(arm=true_model(recording.scenario)), recording, 'wrench', 77)
    numbers = bench.numbers_of(found[None])
    assert numbers['found'] > 0.9
    assert numbers['size'] < 0.1
    assert numbers['place'] < 3e-3
    assert numbers['false_alarms'] < 0.02


def test_a_known_tip_force_tells_a_contact_better():
    fusion = Fusion(arm=load_model(share_path('config/paper_arm.yaml')))
    numbers = {}
    for way in contact_map.WAYS:
        belief = contact_map.posterior(fusion, 0.6, 20e3, (0.1, 0.05), way)
        assert belief is not None
        numbers[way] = contact_map.numbers_of(fusion.model.unknowns, belief)
    (blind, _, alike, _), (read, _, told, _) = (numbers[way] for way in contact_map.WAYS)
    assert read < 0.5 * blind
    assert told < alike
