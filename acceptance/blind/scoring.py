"""Success rates of diagnoses with Wilson intervals, and a confusion matrix.

Everything here works on rows of numbers and names: `truth` of a sealed trial, `answer` to it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
import math
from typing import Any

import numpy as np

from blind.hidden import HIDEABLE

Z_95 = 1.959964
SEEN = 25.0  # delta chi^2 from which on an effect counts as detectable
CLAIMS = 'named', 'inseparable'  # answers that say a name
Row = dict[str, Any]
Pair = tuple[Row, Row]


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a rate; (0, 1) where nothing was tried."""
    if of == 0:
        return 0.0, 1.0
    share, spread = count / of, Z_95**2 / of
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = Z_95 * math.sqrt(share * (1.0 - share) / of + 0.25 * spread / of) / (1.0 + spread)
    low, high = middle - half, middle + half
    return (0.0 if count == 0 else low), (1.0 if count == of else high)


def rate(outcomes: Iterable[bool]) -> Row:
    """Return how many of them are true, with the interval of the share."""
    all_of_them = list(outcomes)
    count, of = sum(all_of_them), len(all_of_them)
    low, high = wilson(count, of)
    share = count / of if of else None
    return {'count': count, 'of': of, 'share': share, 'low': low, 'high': high}


def claims(answer: Row) -> list[set[str]]:
    """Return what an answer claims, strongest first: each a set of names, one of which it is.

    The first one stands with the alternatives that could not be told from it.
    """
    if answer['answer'] not in CLAIMS or not answer['effects']:
        return []
    first, *others = [effect['name'] for effect in answer['effects']]
    return [{first, *answer['alternatives']}, *({name} for name in others)]


def first_name(answer: Row) -> str | None:
    """Return the name that stands first, if any is said."""
    return answer['effects'][0]['name'] if claims(answer) else None


def wrong(truth: Row, answer: Row) -> bool:
    """Whether something is claimed that is not hidden."""
    return any(not claim & set(truth['effects']) for claim in claims(answer))


def within(truth: Row, answer: Row) -> bool:
    """Whether every hidden effect is in what is claimed."""
    return set(truth['effects']) <= set().union(*claims(answer))


def exactly(truth: Row, answer: Row) -> bool:
    """Whether the names said are those hidden, and no others."""
    said = {effect['name'] for effect in answer['effects']} if claims(answer) else set()
    return said == set(truth['effects'])


def detectable(truth: Row, answer: Row, name: str) -> bool:
    """Whether a hidden effect shows: by the truth of the lab it is worth SEEN to a fit.

    Without that number the fit of the diagnosis has to be better by SEEN with it: alone; beside
    the others where several are hidden, as one of them may explain what another does. Without that
    one either: whether it is as large as the smallest that the diagnosis could see. Where the
    diagnosis did not settle, it counts as one that shows: no failure hides itself.
    """
    if name in truth.get('shown_beside', ()):
        return bool(truth['shown_beside'][name] >= SEEN)
    if 'signal' in truth.get('shown_apart', ()):  # of the one effect that is hidden
        return bool(truth['shown_apart']['signal'] >= SEEN)
    for evidence in answer['evidence']:
        if evidence['effects'] == [name]:
            return bool(evidence['chi_squared'] >= SEEN)
    return not settled(answer) or not hides(truth, answer, name)


def settled(answer: Row) -> bool:
    """Whether the diagnosis came to numbers: it says then what it could see of each effect."""
    return bool(answer['detectable'])


def apart(truth: Row, answer: Row, name: str) -> bool:
    """Whether a hidden effect shows, apart from what any single other effect explains of it.

    By the truth of the lab: the part that no other effect of the library can take up lowers chi
    squared by SEEN. Without that number it counts as one that does.
    """
    left = truth.get('shown_apart')
    return detectable(truth, answer, name) and (not left or min(left.values()) >= SEEN)


def hides(truth: Row, answer: Row, name: str) -> bool:
    """Whether the diagnosis says itself that so little of an effect could not have been seen."""
    said, kind = answer['detectable'].get(name), HIDEABLE[name]
    if said is None or not said['observable'] or said['smallest'] is None:
        return True
    size = kind.strength(truth['effects'][name][kind.parameter])
    smallest = float(said['smallest'])
    return size < (1.0 / smallest if math.isinf(kind.neutral) else smallest)


def size_of(truth: Row, answer: Row, name: str) -> tuple[bool, float] | None:
    """Whether the 95 % interval covers the true main parameter, and the relative error of it.

    None where the answer does not say the size of this effect.
    """
    kind = HIDEABLE[name]
    for effect in answer['effects'] if claims(answer) else []:
        found = effect['parameters'].get(kind.parameter) if effect['name'] == name else None
        if found is not None and found['value'] is not None and found['std'] is not None:
            true = truth['effects'][name][kind.parameter]
            error = abs(found['value'] - true)
            neutral = 0.0 if math.isinf(kind.neutral) else kind.neutral
            return error <= Z_95 * found['std'], error / abs(true - neutral)
    return None


def confusion(pairs: Sequence[Pair]) -> Row:
    """Return how often what was hidden (rows) was called what (columns)."""
    table: dict[str, Counter[str]] = {}
    for truth, answer in pairs:
        table.setdefault(hidden_name(truth), Counter())[said(truth, answer)] += 1
    return {name: dict(sorted(table[name].items())) for name in sorted(table)}


def hidden_name(truth: Row) -> str:
    """Return what is hidden, in words."""
    strange = [name for name in truth['outside'] if name != 'harmless_mismatch']
    return ' + '.join(sorted([*truth['effects'], *strange])) or 'nothing'


def said(truth: Row, answer: Row) -> str:
    """Return the answer, in words."""
    if answer['answer'] == 'named':
        return ' + '.join(sorted(effect['name'] for effect in answer['effects']))
    if answer['answer'] == 'inseparable':
        return f'inseparable, {"with" if within(truth, answer) else "without"} it'
    return str(answer['answer'])


def gap(pairs: Sequence[Pair]) -> Row:
    """Return what is left on held-out recordings where all names were right.

    ratio: rms after over that of the model that knows the truth, same readings; closed: share of
    what that model would have removed, where it is 5 % or more.
    """
    ratio, closed = [], []
    for truth, answer in pairs:
        after, before, true = answer['held_out_after'], answer['held_out_before'], truth['rms']
        if not exactly(truth, answer) or None in (after, before, true):
            continue
        ratio.append(after / true)
        if before > 1.05 * true:
            closed.append((before**2 - after**2) / (before**2 - true**2))
    return {
        'trials': len(ratio),
        'ratio': middle(ratio),
        'closed': middle(closed),
        'closed_95': rate(value >= 0.95 for value in closed),
    }


def middle(values: Sequence[float]) -> float | None:
    """Return the median, None of nothing."""
    return float(np.median(values)) if values else None
