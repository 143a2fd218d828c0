"""Summary of the blind trials, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from blind.scoring import (
    apart,
    claims,
    confusion,
    detectable,
    exactly,
    first_name,
    gap,
    hides,
    middle,
    Pair,
    rate,
    Row,
    settled,
    size_of,
    within,
    wrong,
)
from blind.trials import MOVING_PREFIX

TARGETS = (
    ('nothing', 'any_name', 'any name, nothing hidden', '<= 3 of 300'),
    ('nothing', 'none', '    says so', ''),
    ('single', 'first_right', 'one effect, detectable: right name first', '>= 0.95'),
    ('single', 'first_or_alike', '    first, or not to be told from it', ''),
    ('single', 'wrong', '    wrong name, of faint ones too', '<= 0.01'),
    ('single', 'within', '    in the set', '>= 0.99'),
    ('single', 'size_covered', '    95 % interval covers its size', '0.92 to 0.98'),
    ('single', 'size_error', '    median error of its size', '<= 0.05'),
    ('pairs', 'both_right', 'two effects: both right', '>= 0.85'),
    ('confusable', 'right', 'of those easily confused: right', ''),
    ('confusable', 'wrong', '    wrong name', ''),
    ('outside', 'unknown', 'outside the library: unknown', '>= 0.90'),
    ('outside', 'false_name', '    false name', '<= 0.05'),
    ('newer', 'right', 'contact, lens, tilt of the camera: right', ''),
    ('newer', 'wrong', '    wrong name', ''),
    ('unobservable', 'says_so', 'not observable: says so', '>= 0.98'),
    ('rated_nothing', 'any_name', '5 to 50 Hz, nothing hidden: any name', '<= 2 of 200'),
    ('rated_nothing', 'none', '    says so', ''),
    ('rare_readings', 'unknown', 'read at 2 Hz, nothing hidden: unknown', '<= 1 of 10'),
    ('rated_single', 'alone', '    one effect: right name alone', '>= 0.95'),
    ('rated_single', 'alone_apart', '        of those that no other effect explains', '>= 0.95'),
    ('rated_single', 'honest', '    right name alone, or not to be told from it', ''),
    ('rated_single', 'companion', '    right name and a false one', '<= 0.02'),
    ('rated_single', 'wrong', '    wrong name, of faint ones too', ''),
    ('rated_single', 'size_covered', '    95 % interval covers its size', '0.92 to 0.98'),
    ('rated_pairs', 'both_right', '    two effects: both right', '>= 0.85'),
    ('moving_nothing', 'any_name', 'an arm with mass, nothing else hidden: any other name', ''),
    ('moving_nothing', 'none', '    says so', ''),
    ('moving_single', 'alone', '    one effect: right name alone', ''),
    ('moving_single', 'wrong', '    wrong name, of faint ones too', ''),
    ('moving_pairs', 'both_right', '    two effects: both right', ''),
    ('moving_outside', 'false_name', '    outside the library: false name', ''),
)


LIBRARY = (
    'single',
    'pairs',
    'confusable',
    'rated_single',
    'rated_pairs',
    'moving_single',
    'moving_pairs',
)  # blocks that hide effects of the library


def summary_of(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the rates of every block that was tried."""
    blocks: dict[str, list[Pair]] = {}
    pairs = [(truth, beside_inertia(truth, answer)) for truth, answer in pairs]
    for pair in pairs:
        blocks.setdefault(pair[0]['block'], []).append(pair)
    failed = [pair for pair in pairs if pair[1]['failed']]
    library = [pair for name in LIBRARY for pair in blocks.get(name, [])]
    result: dict[str, Any] = {
        'trials': len(pairs),
        'failed': sorted({f'{truth["key"]}: {answer["failed"]}' for truth, answer in failed}),
        'unsettled': sum(not settled(answer) for _, answer in pairs),
        'seconds': middle([answer['seconds'] for _, answer in pairs]),
        'gap': gap(library),
        'confusion': confusion(pairs),
    }
    return result | {name: SCORERS[name](blocks[name]) for name in SCORERS if name in blocks}


def beside_inertia(truth: Row, answer: Row) -> Row:
    """Return an answer without `inertia` where the arm has mass, as all have of such a block."""
    if not truth['block'].startswith(MOVING_PREFIX):
        return answer
    named = [effect for effect in answer['effects'] if effect['name'] != 'inertia']
    known = answer['answer'] == 'named' and not named
    return answer | {'effects': named, 'answer': 'none' if known else answer['answer']}


def nothing(pairs: Sequence[Pair]) -> Row:
    """Score trials in which nothing is hidden; names of those that settled."""
    return {
        'any_name': rate(bool(claims(answer)) for _, answer in pairs if settled(answer)),
        'none': rate(answer['answer'] == 'none' for _, answer in pairs),
        'unknown': rate(answer['answer'] == 'unknown' for _, answer in pairs),
    }


def single(pairs: Sequence[Pair]) -> Row:
    """Score trials with one hidden effect, those that show it apart from the faint ones."""
    shown = [pair for pair in pairs if all(detectable(*pair, name) for name in pair[0]['effects'])]
    faint = [pair for pair in pairs if not any(pair is other for other in shown)]
    alone = [pair for pair in shown if all(apart(*pair, name) for name in pair[0]['effects'])]
    by_effect: dict[str, list[Pair]] = {}
    for pair in shown:
        by_effect.setdefault(next(iter(pair[0]['effects'])), []).append(pair)
    return right_names(shown) | {
        'wrong': rate(wrong(*pair) for pair in pairs),  # also of those that are faint
        'alone_apart': rate(exactly(*pair) for pair in alone),
        'honest': rate(within(*pair) and not wrong(*pair) for pair in shown),
        'faint_wrong': rate(wrong(*pair) for pair in faint),
        'faint_none': rate(answer['answer'] == 'none' for _, answer in faint),
        'by_effect': {name: right_names(some) for name, some in sorted(by_effect.items())},
    }


def right_names(pairs: Sequence[Pair]) -> Row:
    """Return how often the name and the size of one hidden effect were right."""
    sizes = [size_of(*pair, name) for pair in pairs for name in pair[0]['effects']]
    told = [size for size in sizes if size is not None]
    return {
        'first_right': rate(first_name(answer) in truth['effects'] for truth, answer in pairs),
        'first_or_alike': rate(
            bool(claims(answer)) and within(truth, answer) and not wrong(truth, answer)
            for truth, answer in pairs
        ),
        'alone': rate(exactly(*pair) for pair in pairs),
        'companion': rate(within(*pair) and wrong(*pair) for pair in pairs),
        'wrong': rate(wrong(*pair) for pair in pairs),
        'within': rate(within(*pair) for pair in pairs),
        'size_covered': rate(covered for covered, _ in told),
        'size_error': middle([error for _, error in told]),
    }


def several(pairs: Sequence[Pair]) -> Row:
    """Score trials with two hidden effects that both show."""
    shown = [pair for pair in pairs if all(detectable(*pair, name) for name in pair[0]['effects'])]
    return {
        'both_right': rate(exactly(*pair) for pair in shown),
        'both_within': rate(within(*pair) and not wrong(*pair) for pair in shown),
        'wrong': rate(wrong(*pair) for pair in pairs),
    }


def confusable(pairs: Sequence[Pair]) -> Row:
    """Score trials by their names: effects that look alike, alone or together, and newer ones."""
    return {
        'right': rate(exactly(*pair) for pair in pairs),
        'within': rate(within(*pair) and not wrong(*pair) for pair in pairs),
        'wrong': rate(wrong(*pair) for pair in pairs),
    }


def outside(pairs: Sequence[Pair]) -> Row:
    """Score trials with something that the library does not have."""
    return {
        'unknown': rate(answer['answer'] == 'unknown' for _, answer in pairs),
        'false_name': rate(bool(claims(answer)) for _, answer in pairs if settled(answer)),
        'none': rate(answer['answer'] == 'none' for _, answer in pairs),
    }


def unobservable(pairs: Sequence[Pair]) -> Row:
    """Score trials whose recordings cannot show what is hidden."""
    return {
        'says_so': rate(
            answer['answer'] in ('none', 'unobservable')
            and all(hides(truth, answer, name) for name in truth['effects'])
            for truth, answer in pairs
        ),
        'false_name': rate(bool(claims(answer)) for _, answer in pairs),
    }


def baseline_rates(pairs: Sequence[Pair]) -> Row:
    """Return how the other methods did on the same trials, and the diagnosis beside them."""
    tried = [pair for pair in pairs if 'baselines' in pair[1]]
    methods = list(dict.fromkeys(name for _, answer in tried for name in answer['baselines']))
    result = {}
    for method in ['diagnosis', *methods] if methods else []:
        told = []
        for truth, answer in tried:
            other = answer if method == 'diagnosis' else as_answer(answer, method)
            if other is not None:
                told.append((truth, other))
        one = [
            pair
            for pair in told
            if pair[0]['block'] == 'single'
            and all(detectable(*pair, name) for name in pair[0]['effects'])
        ]
        result[method] = {
            'first_right': rate(first_name(answer) in truth['effects'] for truth, answer in one),
            'both_right': rate(exactly(*pair) for pair in told if pair[0]['block'] == 'pairs'),
            'false_names': rate(wrong(*pair) for pair in told),
            'held_out_over_true': middle(
                [answer['held_out_after'] / truth['rms'] for truth, answer in one if truth['rms']]
            ),
        }
    return result


def as_answer(answer: Row, method: str) -> Row | None:
    """Return what another method says in the form of an answer; None where it is not installed."""
    found = answer['baselines'][method]
    if found['names'] is None:
        return None
    return {
        'answer': 'named' if found['names'] else 'none',
        'effects': [{'name': name, 'parameters': {}} for name in found['names']],
        'alternatives': [],
        'evidence': answer['evidence'],
        'detectable': answer['detectable'],
        'held_out_after': found['held_out'],
    }


SCORERS = {
    'nothing': nothing,
    'single': single,
    'pairs': several,
    'confusable': confusable,
    'outside': outside,
    'newer': confusable,
    'unobservable': unobservable,
    'rated_nothing': nothing,
    'rare_readings': nothing,
    'rated_single': single,
    'rated_pairs': several,
    'moving_nothing': nothing,
    'moving_single': single,
    'moving_pairs': several,
    'moving_outside': outside,
}
