"""A law in words, and what is looked for at all."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from pneunet_ros.diagnosis.result import Estimated
from pneunet_ros.diagnosis.settings import DEFAULTS
from pneunet_ros.discovery.discovery import discover, starting_point
from pneunet_ros.discovery.kinds import KINDS
from pneunet_ros.discovery.result import NOTHING_SEARCHED, TermOfLaw
from pneunet_ros.discovery.sentence import law_sentence, swing_sentence
from pneunet_ros.discovery.time_law import Swing
import pytest

PLACE = Estimated(value=0.618, std=0.021, unit='-')


def term(name: str, coefficient: float, unit: str) -> TermOfLaw:
    """Return a term of a law."""
    return TermOfLaw(name=name, function='', coefficient=coefficient, std=0.1, unit=unit)


def test_a_law_is_said_with_place_size_and_rivals():
    terms = [term('1', 0.05, 'N'), term('p', -2e-7, 'N/Pa')]
    assert law_sentence(KINDS['push'], PLACE, terms, ('bump',)) == (
        'A force pushes the arm along its normal, at 0.62 of its length (± 0.02): the force is '
        'constant and depends on the pressure (0.05 N - 2e-07 N/Pa x p). These recordings cannot '
        'distinguish it from bump (the free shape of a short stretch of the arm changes). This is '
        'a proposal until other recordings confirm it.'
    )


def test_two_terms_that_depend_on_something_share_the_verb():
    terms = [term('p^2', 3e-10, '1/Pa^2'), term('p', 8e-6, '1/Pa')]
    sentence = law_sentence(KINDS['section_stiffness'], PLACE, terms, ())
    assert 'depends on the square of the pressure and the pressure (' in sentence


def test_what_comes_out_of_the_equilibrium_has_words_of_its_own():
    terms = [term('moment at the clamp', 8.5, 'rad/(N m)')]
    sentence = law_sentence(KINDS['clamp_turn'], None, terms, ())
    assert '(8.5 rad/(N m)' in sentence


def test_of_what_goes_by_itself_it_is_said_that_nothing_predicts_it():
    swing = Swing(
        period=12.6,
        period_std=0.1,
        modulation='p',
        size=0.5,
        size_std=0.02,
        left_out_gain=50.0,
        factors=(),
        std=0.1,
    )
    sentence = swing_sentence(KINDS['chamber_pressure'], None, swing, ())
    assert sentence.startswith('It looks as if the pressure in the chamber differs from its ')
    assert sentence.endswith(' None of the quantities tried predicts it.')
    assert ' 12.6 s' in sentence
    wandering = replace(swing, period=9.0, periodic=False)
    sentence = swing_sentence(KINDS['push'], PLACE, wandering, ())
    assert (' 0.62 ' in sentence, ' 9 s' in sentence) == (True, True)
    assert wandering.form != swing.form


def found(answer: str, p_value: float) -> SimpleNamespace:
    """Return a diagnosis with this answer, and one test of what it leaves."""
    tests = (SimpleNamespace(p_value=p_value, excess=5.0),)
    trial = SimpleNamespace(record=SimpleNamespace(tests=tests))
    return SimpleNamespace(
        diagnosis=SimpleNamespace(answer=answer),
        selection=SimpleNamespace(settings=DEFAULTS),
        base='base',
        trial=trial,
    )


@pytest.mark.parametrize('answer', ['none', 'unobservable'])
def test_nothing_is_looked_for_where_nothing_is_left(answer):
    assert starting_point(found(answer, 1e-9)) is None
    assert discover(found(answer, 1e-9)) is NOTHING_SEARCHED


def test_beside_a_name_it_is_looked_for_where_something_is_left():
    assert starting_point(found('unknown', 1e-9)) == 'base'
    clear = found('named', 0.3)
    assert starting_point(clear) is None
    left = found('named', 1e-9)
    assert starting_point(left) is left.trial
