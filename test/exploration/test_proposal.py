"""The recording that a diagnosis proposes."""

from __future__ import annotations

from dataclasses import replace
import functools

from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import UnsettledDiagnosis
from pneunet_ros.exploration.proposal import with_proposal
from pneunet_ros.exploration.safe_set import SafeSet
from support.lab_designs import frame, recorded


@functools.cache
def of_no_load() -> Investigation:
    """Return what two recordings without a load show."""
    found = investigate(frame(), [run for run in recorded() if not run.loaded], [])
    assert isinstance(found, Investigation)
    return found


def proposed(*unseen: str, one_pressure: bool = False, **changed) -> str:
    """Return the proposal where only these effects could not be seen so far."""
    found = of_no_load()
    seen = {
        name: replace(item, observable=name not in unseen)
        for name, item in found.diagnosis.detectable.items()
    }
    diagnosis = replace(found.diagnosis, detectable=seen, **changed)
    safe = SafeSet.of(frame())
    safe = replace(safe, high=safe.low) if one_pressure else safe
    return with_proposal(replace(found, diagnosis=diagnosis), safe).diagnosis.proposal


def test_what_acts_under_load_is_shown_by_a_load():
    found = with_proposal(of_no_load(), SafeSet.of(frame())).diagnosis
    assert found.answer in ('none', 'unobservable')
    assert 'force' in found.proposal.partition('. It')[0]
    shown = proposed('load_offset')
    assert shown.startswith('Record next: a')
    assert shown.endswith('It would show load_offset best.')
    assert 'force' in proposed('load_offset', one_pressure=True)


def test_history_needs_pressure_that_moves():
    assert 'pressure' in proposed('hysteresis').partition('. It')[0]


def test_where_nothing_is_wanted_nothing_is_proposed():
    assert proposed() == ''
    found = proposed('creep', alternatives=('extensibility', 'load_offset'))
    assert 'It would best distinguish' in found
    assert 'extensibility' in found
    assert 'load_offset' in found


def test_more_recordings_do_not_help_where_targets_are_too_few():
    uneven = replace(of_no_load().best.record, names=('creep',))
    found = replace(of_no_load(), best=replace(of_no_load().best, record=uneven))
    found = replace(found, diagnosis=replace(found.diagnosis, answer='unobservable'))
    assert with_proposal(found, SafeSet.of(frame())).diagnosis.proposal == ''


def test_without_a_fit_nothing_is_proposed():
    diagnosis = UnsettledDiagnosis(sentence='It did not converge.', notes=(), seed=0)
    found = UnsettledInvestigation(diagnosis=diagnosis)
    assert with_proposal(found, SafeSet(low=0.0, high=1e3, force=0.1)) is found
