"""The answer of a diagnosis, in values and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.confirmation import Confirmer
from pneunet_ros.diagnosis.result import Answer, Evaluation
from pneunet_ros.diagnosis.scores.lack_of_fit import worst_p_value, worst_test
from pneunet_ros.diagnosis.selection import Record, Selection, Trial


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The answer: the accepted model, and sets of effects that fit the recordings equally well.

    probability: of each effect to be missing; mimicked: effects that cannot be distinguished from
    uneven bending between the targets; unconfirmed: effects that fit the recordings but are not
    named; notes: why the best set of effects is not named, or which parts of it were not tested.
    """

    answer: Answer
    trial: Trial
    alike: tuple[tuple[str, ...], ...] = ()
    probability: Mapping[str, float] = field(default_factory=dict)
    mimicked: tuple[str, ...] = ()
    unconfirmed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Effects that cannot be distinguished from those of the model."""
        return tuple(
            sorted({name for names in self.alike for name in names} - {*self.trial.names})
        )


def describe_verdict(
    verdict: Verdict, before: Evaluation, after: Evaluation, noise: tuple[float, float]
) -> str:
    """Return the answer in one sentence; noise: rms (m) of a perfect model, and its scatter."""
    names = ' and '.join(verdict.trial.names)
    match verdict.answer:
        case 'none':
            return 'The residuals are consistent with noise: no detectable effect is missing.'
        case 'unobservable' if verdict.mimicked:
            return (
                f'The misfit may be {" and ".join(verdict.mimicked)}, or an arm that bends '
                'unevenly. These targets cannot distinguish them, so no effect of the library is '
                'observable in these recordings; more targets along the arm would help.'
            )
        case 'unobservable':
            return 'No effect of the library is observable in these recordings.'
        case 'unknown' if verdict.unconfirmed:
            closest = ' and '.join(verdict.unconfirmed)
            return (
                f'The model lacks an effect. {closest} would explain it, but is not confirmed; '
                'the notes say why.'
            )
        case 'unknown':
            closest = ' The notes name the closest one.' if verdict.notes else ''
            return (
                'No effect of the library explains the misfit: the model lacks another one, or '
                f'the noise is correlated from frame to frame (smoothed tracks).{closest}'
            )
        case 'named':
            gained = describe_gain(verdict.trial.record, before.rms, after.rms, noise)
            return f'The model lacks {names}: {gained}'
    sets = [' and '.join(names) for names in (verdict.trial.names, *verdict.alike)]
    either = (', or ' if any(' and ' in item for item in sets) else ' or ').join(sets)
    gained = describe_gain(verdict.trial.record, before.rms, after.rms, noise)
    return f'The model lacks {either}, which cannot be distinguished with these data: {gained}'


def describe_gain(record: Record, before: float, after: float, noise: tuple[float, float]) -> str:
    """Describe the improvement by a set of effects, in rms (m) if visible there.

    noise: rms (m) of a perfect model, and its scatter.
    """
    if before - after <= noise[1]:
        return (
            'with this added, the training recordings, each predicted from the others, are more '
            f'probable by {record.evidence:.0f} nats in total. The rms error cannot show this '
            f'({millimeters(after):.3f} mm with it, {millimeters(before):.3f} mm without, noise '
            f'alone {millimeters(noise[0]):.3f} ± {millimeters(noise[1]):.3f} mm).'
        )
    return (
        f'adding {"it" if len(record.names) == 1 else "them"} reduces the model error from '
        f'{millimeters(before):.3f} to {millimeters(after):.3f} mm rms.'
    )


def describe_certainty(selection: Selection, first: Trial, best: Trial) -> str:
    """Describe the comparison that led to the answer, and the size of the difference."""
    confirmer, base, record = Confirmer.of(selection, first.record), first.record, best.record
    tested = (
        f'the residuals of the base model have p-value {worst_p_value(base.tests):.2g} at worst, '
        f'in {worst_test(base.tests).name}'
    )
    if not best.names:
        strongest = selection.score_candidates(first)[:1]
        score = ''.join(
            f'; the strongest single effect, {item.name}, would reduce chi squared by '
            f'{item.gain:.1f}'
            for item in strongest
        )
        return f'Compared with clean data, {tested}{score}.'
    if not record.adequate:
        record = closest_set(selection)
        if not record.names:
            return (
                f'Compared with clean data, {tested}; no set of effects explains any of the '
                'misfit.'
            )
        return (
            f'Compared with clean data, {tested}; with {" + ".join(record.names)}, which comes '
            f'closest ({record.evidence:.0f} nats of evidence), it is '
            f'{worst_p_value(record.tests):.2g}.'
        )
    names = ' + '.join(best.names)
    sentence = (
        f'{names} adds {record.evidence:.0f} nats of evidence (log probability of each training '
        f'recording predicted from the others), and chi squared falls by {record.gain:.0f}'
    )
    if confirmer.has_held_out:
        fall = confirmer.held_out_fall(record)
        less = f'by {fall:.0f}' if fall >= 0.0 else f'it rises by {-fall:.0f}'
        sentence += f', and in held-out recordings {less}'
    others = [item for item in selection.tried.values() if not {*best.names} <= {*item.names}]
    others = [item for item in others if item.names]
    if not others:
        return f'{sentence}; no other effect was worth a fit.'
    second = max(others, key=lambda item: item.evidence)
    more = '' if second.adequate else ', but leaves more than noise'
    return (
        f'{sentence}; of the others, {" + ".join(second.names)} adds most: '
        f'{second.evidence:.0f}{more}.'
    )


def closest_set(selection: Selection) -> Record:
    """Return the set with the largest evidence among the sets that reduce chi squared."""
    lower = [item for item in selection.tried.values() if item.gain >= 0.0]
    return max(lower, key=lambda item: item.evidence)
