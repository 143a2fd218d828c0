"""A law in words."""

from __future__ import annotations

from collections.abc import Sequence

from pneunet_ros.diagnosis.result import Estimated
from pneunet_ros.discovery.covariates import CONSTANT, MEANINGS
from pneunet_ros.discovery.kinds import Kind, KINDS
from pneunet_ros.discovery.result import TermOfLaw
from pneunet_ros.discovery.time_law import Swing

MOST_TIED = 3  # kinds named in a sentence


def law_sentence(
    kind: Kind, location: Estimated | None, terms: Sequence[TermOfLaw], tied: Sequence[str]
) -> str:
    """Describe the kind of cause, its position, and the law of its amplitude."""
    words = terms_words(kind, terms)
    sizes = ' + '.join(term_size(item) for item in terms).replace('+ -', '- ')
    opening = clause(kind, location)
    return (
        f'{opening[:1].upper()}{opening[1:]}: the {kind.amplitude} {words} ({sizes}).'
        f'{describe_ties(tied)} This is a proposal until other recordings confirm it.'
    )


def swing_sentence(
    kind: Kind, location: Estimated | None, swing: Swing, tied: Sequence[str]
) -> str:
    """Describe an oscillating cause: its kind and period; nothing tried predicts it."""
    size = f'{swing.size * kind.prior:.2g} {kind.unit}'
    changes = f'varies without a period, over about {swing.period:.2g} s ({size} rms)'
    if swing.periodic:
        grows = ' and grows with the pressure' if swing.modulation != CONSTANT else ''
        changes = f'oscillates with a period of {swing.period:.3g} s{grows} (up to {size})'
    return (
        f'It looks as if {clause(kind, location)}: the {kind.amplitude} {changes}.'
        f'{describe_ties(tied)} None of the quantities tried predicts it.'
    )


def drift_sentence(
    kind: Kind, location: Estimated | None, terms: Sequence[TermOfLaw], tied: Sequence[str]
) -> str:
    """Describe a cause that depends on the time since the start of a recording."""
    words = terms_words(kind, terms)
    return (
        f'It looks as if {clause(kind, location)}: the {kind.amplitude} {words}.'
        f'{describe_ties(tied)} The time since the start of a recording is not a sensor reading, '
        'so no model can use it.'
    )


def clause(kind: Kind, location: Estimated | None) -> str:
    """Return what happens, and where."""
    if location is None:
        return kind.subject
    digits = 2 if location.std >= 0.005 else 3
    value, std = round(location.value, digits), max(round(location.std, digits), 0.001)
    return f'{kind.subject}, at {value:.{digits}f} of its length (± {std:.{digits}f})'


def term_words(kind: Kind, name: str) -> str:
    """Return the words for an amplitude and a term."""
    return kind.natives[name].words if name in kind.natives else MEANINGS[name].words


def term_size(term: TermOfLaw) -> str:
    """Return a term with its coefficient."""
    unit = '' if term.unit == '-' else f' {term.unit}'
    factor = '' if term.name == CONSTANT else f' x {term.name}'
    return f'{term.coefficient:.3g}{unit}{factor}'


def describe_ties(tied: Sequence[str]) -> str:
    """Describe the equally good explanations."""
    if not tied:
        return ''
    subjects = [f'{name} ({KINDS[name].subject})' for name in tied[:MOST_TIED]]
    more = f' or {len(tied) - MOST_TIED} others' if len(tied) > MOST_TIED else ''
    return f' These recordings cannot distinguish it from {" or ".join(subjects)}{more}.'


def terms_words(kind: Kind, terms: Sequence[TermOfLaw]) -> str:
    """Return the words for an amplitude and all terms of its law; the verb stands once."""
    words = [term_words(kind, item.name) for item in terms]
    verb = 'depends on '
    others = [word for word in words if not word.startswith(verb)]
    depends = join_words([word.removeprefix(verb) for word in words if word.startswith(verb)])
    return join_words([*others, *([verb + depends] if depends else [])])


def join_words(words: Sequence[str]) -> str:
    """Return words as a list in a sentence."""
    if len(words) < 2:
        return ''.join(words)
    return f'{", ".join(words[:-1])} and {words[-1]}'
