"""When a law may take the place of a name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from pneunet_ros.diagnosis.selection import Record
from pneunet_ros.discovery import discovery as searched
from pneunet_ros.discovery.discovery import (
    objections_to,
    overrule,
    predicts_better,
    untestable_law,
)
from pneunet_ros.discovery.result import Discovery
import pytest

NAME = Record(
    names=('gravity',), dof=2, evidence=50.0, gain=110.0, tests=(), adequate=True,
    plausible=True,
    predicted=-2500.0,
)  # fmt: skip
LAW = replace(NAME, names=('proposed_push',), evidence=70.0, predicted=-2490.0)


@pytest.mark.parametrize(
    ('law', 'better'),
    [
        ({}, True),
        ({'evidence': 59.0}, False),
        ({'evidence': 61.0}, True),
        ({'predicted': -2503.0}, True),
        ({'predicted': -2505.0}, False),
        ({'outside_prior': ('push = 9 N lies outside its prior range',)}, False),
    ],
)
def test_a_law_meets_what_a_name_has_to_meet_by_far_better(law, better):
    assert predicts_better(replace(LAW, **law), NAME) is better


def test_beside_a_strong_effect_a_tenth_counts():
    strong = replace(NAME, evidence=1000.0)
    assert not predicts_better(replace(LAW, evidence=1080.0), strong)
    assert predicts_better(replace(LAW, evidence=1120.0), strong)


@pytest.mark.parametrize(('evidence', 'said'), [(70.0, True), (55.0, False)])
def test_a_law_that_explains_more_and_is_not_confirmed_is_said(monkeypatch, evidence, said):
    diagnosis = SimpleNamespace(answer='named', alternatives=())
    trial = SimpleNamespace(record=NAME, names=NAME.names, refit=None)
    investigation = SimpleNamespace(
        diagnosis=diagnosis, base=trial, trial=trial, selection=SimpleNamespace()
    )
    suspect = SimpleNamespace(
        kind=SimpleNamespace(name='end_moment'),
        law=SimpleNamespace(terms=('pressure',)),
        left_out_gain=60.0,
    )
    record = replace(LAW, evidence=evidence)
    proposal = SimpleNamespace(terms=('pressure',), trial=SimpleNamespace(record=record))
    best = SimpleNamespace(suspect=suspect, proposal=proposal, gain=evidence)
    why = 'the closest cause is end_moment; no law is given: half does not predict half'
    unconfirmed = Discovery(searched=True, notes=(why,))
    monkeypatch.setattr(searched, 'look_for_law', lambda *_: (unconfirmed, best))
    monkeypatch.setattr(searched, 'Search', lambda *_: SimpleNamespace(suspects=lambda: [suspect]))
    found = overrule(investigation, lambda *_: None)
    assert found.overruling is None
    note = f'a law of another kind explains more than gravity, unconfirmed: {why}'
    assert found.notes == ((note,) if said else ())


@pytest.mark.parametrize(
    ('recordings', 'evidence', 'gives_way'), [(2, 70.0, True), (6, 70.0, False), (2, 55.0, False)]
)
def test_of_few_recordings_a_name_gives_way_to_a_law_beside_it(recordings, evidence, gives_way):
    selection = SimpleNamespace(linearization=SimpleNamespace(training=recordings))
    named, record = SimpleNamespace(record=NAME), replace(LAW, evidence=evidence)
    best = SimpleNamespace(
        suspect=SimpleNamespace(kind=SimpleNamespace(name='push')),
        proposal=SimpleNamespace(trial=SimpleNamespace(record=record)),
    )
    found = SimpleNamespace(selection=selection, base=SimpleNamespace())
    said = untestable_law(found, named, best)
    assert said.startswith('together with push ') is gives_way
    assert bool(said) is gives_way
    # An unknown that has no name: nothing gives way.
    assert untestable_law(SimpleNamespace(selection=selection, base=named), named, best) == ''


@pytest.mark.parametrize(('recordings', 'confirmed'), [(2, False), (3, False), (4, True)])
def test_few_recordings_do_not_confirm_a_law(monkeypatch, recordings, confirmed):
    monkeypatch.setattr(searched, 'split_p_value', lambda *_: 0.0)
    first = SimpleNamespace()
    fits = SimpleNamespace(
        base=first,
        first=first,
        search=SimpleNamespace(runs=range(recordings)),
        selection=SimpleNamespace(seed=0),
    )
    found = objections_to(SimpleNamespace(suspect=None, share=1.0, proposal=None), fits)
    assert found == (() if confirmed else (f'{recordings} training recordings cannot confirm it',))


@pytest.mark.parametrize(('answer', 'asked'), [('unknown', True), ('named', False)])
def test_a_course_of_its_own_is_sought_only_where_nothing_is_named(monkeypatch, answer, asked):
    """Beside a named effect it follows whatever the law of the effect leaves out."""
    diagnosis = SimpleNamespace(answer=answer)
    base, named = (SimpleNamespace(refit=None) for _ in range(2))
    investigation = SimpleNamespace(
        diagnosis=diagnosis, base=base, trial=named, selection=SimpleNamespace()
    )
    law, course = Discovery(searched=True), Discovery(searched=True, notes=('a course',))
    monkeypatch.setattr(searched, 'overrule', lambda *_: Discovery(searched=False))
    monkeypatch.setattr(
        searched, 'starting_point', lambda item: base if answer == 'unknown' else named
    )
    monkeypatch.setattr(searched, 'look_for_law', lambda *_: (law, None))
    monkeypatch.setattr(searched, 'consider_aperiodic', lambda *_: course)
    monkeypatch.setattr(searched, 'Search', lambda *_: SimpleNamespace(suspects=list))
    assert bool(searched.discover(investigation).notes) is asked
