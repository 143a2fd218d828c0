"""Where along the arm a cause is searched for."""

from __future__ import annotations

from types import SimpleNamespace

from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.discovery.search import Search
import pytest


@pytest.mark.parametrize('lawful', [False, True])
def test_what_swings_by_itself_is_searched_along_the_arm(monkeypatch, lawful):
    """Where no law was found, its place was that of the first try, close to the clamp."""
    place = 0.6

    def found_at(position):
        return SimpleNamespace(left_out_gain=5.0 - abs(position - place))

    law = SimpleNamespace(left_out_gain=3.0, cause=SimpleNamespace(position=0.3))
    monkeypatch.setattr(Search, 'runs', (0, 1, 2))
    monkeypatch.setattr(Search, 'law', lambda *_: law if lawful else None)
    monkeypatch.setattr(Search, 'cause', lambda _, kind, at: SimpleNamespace(position=at))
    monkeypatch.setattr(Search, 'swing', lambda _, cause, *_a, **_k: found_at(cause.position))
    found = object.__new__(Search).suspect(KINDS['push'])
    assert found.law is None
    assert found.cause.position == pytest.approx(place, abs=0.02)


def test_what_swings_but_predicts_nothing_is_no_suspect(monkeypatch):
    swing = SimpleNamespace(left_out_gain=-7.0)
    monkeypatch.setattr(Search, 'runs', (0, 1, 2))
    monkeypatch.setattr(Search, 'law', lambda *_: None)
    monkeypatch.setattr(Search, 'cause', lambda _, kind, at: SimpleNamespace(position=at))
    monkeypatch.setattr(Search, 'swing', lambda *_, **__: swing)
    assert object.__new__(Search).suspect(KINDS['push']) is None
