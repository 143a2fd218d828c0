"""Laws that are an effect of the library in other words."""

from __future__ import annotations

from pneunet_ros.diagnosis.fit.hypothesis import hypotheses
from pneunet_ros.discovery.covariates import MEANINGS
from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.discovery.library_words import is_equivalent_to, LIBRARY_WORDS
from pneunet_ros.effects import EFFECTS
import pytest
from support.lab_designs import frame


def test_every_effect_that_may_be_named_has_words_that_a_discovery_has():
    may_be_named = {
        item.name for item in hypotheses(frame()) if not item.confounded_with_pressure_scale
    }
    assert may_be_named <= set(LIBRARY_WORDS) <= set(EFFECTS)
    for kinds, terms in LIBRARY_WORDS.values():
        assert {*kinds} <= set(KINDS)
        natives = {term for kind in kinds for term in KINDS[kind].natives}
        assert {*terms} <= {*MEANINGS, *natives}
        assert terms


@pytest.mark.parametrize(
    ('kind', 'terms', 'name', 'said'),
    [
        ('line_load_y', ('1',), 'gravity', True),
        ('line_load_y', ('p',), 'gravity', False),
        ('line_load_y', ('1', 'p'), 'gravity', True),
        ('push', ('1',), 'gravity', False),
        ('push', ('1',), 'contact', True),
        ('chamber_pressure', ('side of a wide play',), 'hysteresis', True),
        ('chamber_pressure', ('side of a wide play', 'dp/dt'), 'hysteresis', True),
        ('chamber_pressure', ('dp/dt',), 'hysteresis', False),
        ('chamber_pressure', ('side of a wide play',), 'creep', False),
        ('stretch', ('tension',), 'extensibility', True),
        ('stretch', ('tension', 'p'), 'extensibility', True),
        ('stretch', ('tension',), 'an_effect_of_a_user', False),
    ],
)
def test_what_says_what(kind, terms, name, said):
    assert is_equivalent_to(kind, terms, [name]) is said
    assert is_equivalent_to(kind, terms, ['camera_delay', name]) is said
