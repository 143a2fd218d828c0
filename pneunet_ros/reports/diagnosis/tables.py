"""The tables of a diagnosis as text, for report and terminal."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
import math
from typing import Any

from pneunet_ros.core.units import millimeters, quantities
from pneunet_ros.diagnosis.result import Adequacy, Diagnosis, Evidence, Misfit, Shift
from pneunet_ros.discovery.result import Discovery, NOTHING_SEARCHED
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.reports.calibration.tables import describe_quantity
from pneunet_ros.reports.diagnosis.words import p_value_text, round_value, unit_text, with_error

ANSWERS = {
    'none': 'none: the residuals are consistent with noise',
    'named': 'named: it explains the misfit, and no test contradicts it',
    'inseparable': 'inseparable: several effects cannot be distinguished with these data',
    'unknown': 'unknown: an effect is missing, and none of the library can be named',
    'unobservable': 'unobservable: these recordings cannot show whether an effect is there',
}
WITHIN_LAW = 'no, but within the error of its law'
MOST_SHIFTS = 25  # quantities in the table of the report


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of texts; `numbers`: right-aligned columns."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: tuple[int, ...] = ()


def added_effects(diagnosis: Diagnosis) -> list[str]:
    """Return the named effects in the augmented model."""
    there = {effect.name for effect in diagnosis.after.arm.effects}
    if diagnosis.after.arm.inertia is not None:  # of which the model file has a block of its own
        there.add(Inertia.name)
    return [effect.name for effect in diagnosis.effects if effect.name in there]


def error_table(diagnosis: Diagnosis, discovery: Discovery = NOTHING_SEARCHED) -> Table:
    """Return the errors of all models, on training and held-out recordings."""
    models = {'before': diagnosis.before}
    if added_effects(diagnosis):
        models['after'] = diagnosis.after
    if discovery.evaluation is not None:
        models['discovered'] = discovery.evaluation
    rows = [('training', when, *misfit_texts(model.training)) for when, model in models.items()]
    rows += [
        ('held out', when, *misfit_texts(model.held_out))
        for when, model in models.items()
        if model.held_out is not None
    ]
    floor = f'{millimeters(diagnosis.noise_floor):.3f}'
    return Table(
        columns=('recordings', 'model', 'rms (mm)', '95 % within (mm)', 'chi2 per coordinate'),
        rows=(*rows, ('noise alone', '', floor, '', '1')),
        numbers=(2, 3, 4),
    )


def misfit_texts(misfit: Misfit) -> tuple[str, str, str]:
    """Return rms and 95th percentile (mm), and chi squared."""
    rms, p95 = millimeters(misfit.rms), millimeters(misfit.p95)
    return f'{rms:.3f}', f'{p95:.3f}', f'{misfit.chi_squared:.3g}'


def effect_table(diagnosis: Diagnosis) -> Table:
    """Return the named effects with their numbers."""
    rows = [
        (
            effect.name,
            EFFECTS[effect.name].meaning,
            name,
            with_error(found),
        )
        for effect in diagnosis.effects
        for name, found in effect.parameters.items()
    ]
    return Table(
        columns=('effect', 'meaning', 'parameter', 'value, standard error'),
        rows=tuple(rows),
        numbers=(3,),
    )


def rank_evidence(diagnosis: Diagnosis) -> list[Evidence]:
    """Return trials by strength, followed by effects that were not fitted, by score."""
    fitted = [item for item in diagnosis.evidence if not math.isnan(item.evidence)]
    rest = [item for item in diagnosis.evidence if math.isnan(item.evidence)]
    return [
        *sorted(fitted, key=lambda item: -item.evidence),
        *sorted(rest, key=lambda item: -item.chi_squared),
    ]


def evidence_table(diagnosis: Diagnosis) -> Table:
    """Return the evidence for each effect that was tried, strongest first."""
    return Table(
        columns=(
            'effects',
            'delta chi2',
            'gain on left-out recordings',
            'consistent with noise',
            'similar to',
        ),
        rows=tuple(
            (
                ' + '.join(item.effects),
                round_value(item.chi_squared),
                'not fitted' if math.isnan(item.evidence) else round_value(item.evidence),
                passes_text(item, diagnosis),
                ', '.join(item.alike),
            )
            for item in rank_evidence(diagnosis)
        ),
        numbers=(1, 2),
    )


def passes_text(item: Evidence, diagnosis: Diagnosis) -> str:
    """State whether only noise remains with a set of effects, with the p-value."""
    if math.isnan(item.evidence):
        return ''
    p_value = '' if math.isnan(item.p_value) else f' (p {p_value_text(item.p_value)})'
    if not item.adequate:
        return f'no{p_value}'
    noise = not item.p_value <= diagnosis.settings.lack_of_fit.level
    return f'{"yes" if noise else WITHIN_LAW}{p_value}'


def adequacy_table(diagnosis: Diagnosis) -> Table:
    """Return whether the residuals are consistent with noise, before and after.

    It has the worst test before, the same test after, and the worst test after.
    """
    before, same, after = (
        diagnosis.adequacy_before,
        diagnosis.adequacy_same,
        diagnosis.adequacy_after,
    )
    rows = [('before', before)]
    if added_effects(diagnosis):
        rows += [('after', same)] + ([] if after == same else [('after, worst', after)])
    return Table(
        columns=(
            'model',
            'test',
            'statistic',
            'clean data stay below',
            'p-value',
            'consistent with noise',
        ),
        rows=tuple(
            (
                when,
                item.test,
                f'{item.statistic:.4g}',
                f'{item.threshold:.4g}',
                p_value_text(item.p_value),
                consistent_text(item, item is not before),
            )
            for when, item in rows
        ),
        numbers=(2, 3, 4),
    )


def consistent_text(test: Adequacy, added: bool) -> str:
    """State whether residuals pass a test; added: the model has new effects."""
    if test.statistic <= test.threshold:
        return 'yes'
    return WITHIN_LAW if added else 'no'


def where_table(diagnosis: Diagnosis) -> Table:
    """Return the table with the location of the misfit."""
    return Table(
        columns=('axis', 'observation', 'of the misfit', 'of the observations', 'p-value'),
        rows=tuple(
            (
                item.axis,
                item.sentence,
                f'{100.0 * item.share:.0f} %',
                f'{100.0 * item.seen:.0f} %',
                p_value_text(item.p_value),
            )
            for item in diagnosis.where
            if item.sentence
        ),
        numbers=(2, 3, 4),
    )


def where_text(diagnosis: Diagnosis) -> str:
    """Describe the location of the misfit in one sentence."""
    return f'Where: {diagnosis.where_sentence.rstrip(".")}.'


def shift_table(diagnosis: Diagnosis, most: int = MOST_SHIFTS) -> Table:
    """Return the base quantities that moved most, in standard errors."""
    ranked = sorted(diagnosis.shift.items(), key=lambda item: -sigmas(item[1]))[:most]
    return Table(
        columns=(
            'quantity',
            'before',
            'after',
            'standard error',
            'unit',
            'moved by (sigma)',
            'name',
        ),
        rows=tuple(
            (
                describe_quantity(name, diagnosis.after.arm),
                f'{item.before:.4g}',
                f'{item.after:.4g}',
                f'{item.std:.2g}',
                item.unit,
                f'{sigmas(item):.1f}',
                name,
            )
            for name, item in ranked
        ),
        numbers=(1, 2, 3, 5),
    )


def sigmas(item: Shift) -> float:
    """Return the shift of a quantity in standard errors."""
    moved = abs(item.after - item.before)
    return moved / item.std if item.std > 0.0 else 0.0


def detectable_table(diagnosis: Diagnosis) -> Table:
    """Return the detection limit of each effect, and its plausible range."""
    rows = []
    for name, item in diagnosis.detectable.items():
        parameter = parameter_field(name, item.parameter)
        low, high = parameter.metadata['prior']
        unit = unit_text(item.unit)
        # Of a stiffness that is infinite when nothing is missing, less is more.
        neutral = float(getattr(EFFECTS[name](), item.parameter))
        within = 'below' if neutral == math.inf else 'from'
        if 0.0 < neutral < math.inf:
            within = f'{neutral:g} ±'
        rows.append(
            (
                name,
                EFFECTS[name].meaning,
                item.parameter,
                f'{within} {item.smallest:.3g}{unit}' if item.observable else 'none',
                f'{low:g} to {high:g}{unit}',
                'yes' if item.observable else 'no',
            )
        )
    return Table(
        columns=(
            'effect',
            'meaning',
            'parameter',
            'detection limit',
            'expected',
            'observable',
        ),
        rows=tuple(rows),
    )


def parameter_field(effect: str, parameter: str) -> dataclasses.Field[Any]:
    """Return the declaration of a parameter of an effect."""
    return next(item for item in quantities(EFFECTS[effect]) if item.name == parameter)


def similarity_table(diagnosis: Diagnosis, least: float) -> Table:
    """Return pairs of effects that are hard to distinguish with these data, with cosines."""
    ranked = sorted(diagnosis.cosines.items(), key=lambda item: -abs(item[1]))
    return Table(
        columns=('effect', 'other effect', 'cosine'),
        rows=tuple((*pair, f'{value:.2f}') for pair, value in ranked if abs(value) >= least),
        numbers=(2,),
    )


def undetectable_sentence(diagnosis: Diagnosis) -> str:
    """Name the effects that these recordings cannot show at any plausible size."""
    unseen = [name for name, item in diagnosis.detectable.items() if not item.observable]
    if not unseen:
        return 'Every effect of the library would have been detected at a usual size.'
    return f'Not detectable at any usual size: {", ".join(unseen)}.'
