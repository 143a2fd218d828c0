"""The decision: the answer from the base model, the best set of effects, and all trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.core.notes import Note
from pneunet_ros.diagnosis.confirmation import Confirmer
from pneunet_ros.diagnosis.result import Detectable
from pneunet_ros.diagnosis.scores.lack_of_fit import worst_test
from pneunet_ros.diagnosis.selection import Added, evidence_margin, Record, Selection, Trial
from pneunet_ros.diagnosis.settings import CONFIRMATION, LEAST_EVIDENCE
from pneunet_ros.diagnosis.verdict import closest_set, Verdict


def decide(
    selection: Selection, first: Trial, best: Trial, detectable: Mapping[str, Detectable]
) -> Verdict:
    """Decide on the answer from the base model, the best set of effects, and all trials."""
    if not best.record.adequate:
        notes = closest_notes(closest_set(selection))
        return Verdict(answer='unknown', trial=first, notes=notes)
    if not best.names:
        observable = any(item.observable for item in detectable.values())
        return Verdict(answer='none' if observable else 'unobservable', trial=first)
    confirmer = Confirmer.of(selection, first.record)
    uneven = confirmer.nonuniform_arm(best.record)
    if uneven:
        notes = closest_notes(best.record, uneven)
        return Verdict(answer='unobservable', trial=first, mimicked=best.names, notes=notes)
    rivals = [
        item
        for item in selection.tried.values()
        if item.adequate
        and item.plausible
        and item.gain > 0.0
        and item is not best.record
        and not confirmer.refutations(item)
    ]
    alike = tuple(
        item.names
        for item in sorted(rivals, key=lambda item: -item.evidence)
        if is_equivalent_rival(item, best.record) and not set(item.names) <= set(best.names)
    )
    verdict = Verdict(answer='inseparable' if alike else 'named', trial=best, alike=alike)
    objections = confirmer.objections(best.record, verdict.alternatives)
    untested = confirmer.untested(best.record)
    if objections:
        notes = closest_notes(best.record, objections)
        return Verdict(answer='unknown', trial=first, unconfirmed=best.names, notes=notes)
    return replace(
        verdict,
        probability=effect_probabilities([best.record, *rivals], confirmed=not untested),
        notes=(*untested, *notes_on_rest(selection, best)),
    )


def is_equivalent_rival(rival: Record, best: Record) -> bool:
    """Whether an adequate rival without more effects explains the recordings as well.

    The comparison is by evidence, or by chi squared alone; in the latter case, only the prior
    distinguishes the two.
    """
    if len(rival.names) > len(best.names):
        return False
    most, other = comparable_gains([best, rival])
    least = most.evidence - evidence_margin(most.evidence)
    return other.evidence > least or other.gain > most.gain - 2.0 * LEAST_EVIDENCE


def comparable_gains(records: Sequence[Record]) -> list[Added]:
    """Return the gain of sets over the set that all of them extend, or over the base."""
    added = [item.added for item in records if item.added is not None]
    if len(added) == len(records) and len({item.names for item in added}) == 1:
        return added
    return [Added(names=(), evidence=item.evidence, gain=item.gain) for item in records]


def effect_probabilities(records: Sequence[Record], *, confirmed: bool = True) -> dict[str, float]:
    """Return the probability that each effect is missing, over all candidate sets.

    Evidence is weighted by the accuracy of the laws, as for the answer. No probability exceeds the
    success rate of names in blind trials; confirmed: whether every requirement for the name was
    tested.
    """
    logs = np.array([item.evidence for item in comparable_gains(records)])
    margin = evidence_margin(float(logs.max()))
    weights = np.exp((logs - logs.max()) * LEAST_EVIDENCE / margin)
    wrong = CONFIRMATION.wrong if confirmed else CONFIRMATION.unconfirmed
    weights *= (1.0 - wrong) / weights.sum()
    names = sorted({name for item in records for name in item.names})
    pairs = list(zip(weights, records, strict=True))
    return {
        name: float(sum(weight for weight, item in pairs if name in item.names)) for name in names
    }


def closest_notes(best: Record, objections: Sequence[str] = ()) -> tuple[str, ...]:
    """Describe the closest explanation, and why it is not named."""
    if not best.names:
        return ()
    if not objections:
        objections = (f'it fails the lack-of-fit test of {worst_test(best.tests).name}',)
    names = ' + '.join(best.names)
    said = f'reduces chi squared by {best.gain:.0f}' if best.gain > 0.0 else 'explains nothing'
    return (
        Note(
            f'closest is {names}, which {said}; it is not named: {"; ".join(objections)}',
            reason='closest',
        ),
    )


def notes_on_rest(selection: Selection, best: Trial) -> tuple[str, ...]:
    """Describe further effects that may be missing, but are too weak next to a strong one."""
    item = selection.significant_candidate(best)
    if item is None:
        return ()
    names = ' + '.join(best.names)
    return (
        Note(
            f'{item.name} in addition to {names} would reduce chi squared by another '
            f'{item.gain:.0f}, more than the law error of {names} explains. Both together fail '
            f'the tests, so {item.name} is not named; recordings that show less of {names} would '
            'decide',
            reason='too_faint',
        ),
    )
