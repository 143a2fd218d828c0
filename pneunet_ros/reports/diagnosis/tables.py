"""The tables of a diagnosis as text, for report and terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math

from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.result import Adequacy, Diagnosis, Estimated, Evidence, Shift
from pneunet_ros.diagnosis.settings import LACK_OF_FIT
from pneunet_ros.discovery.result import Discovery, NOTHING_SEARCHED
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.reports.calibration.tables import describe_quantity

ANSWERS = {
    'none': 'none: the residuals are consistent with noise',
    'named': 'named: it explains the misfit, and no test contradicts it',
    'inseparable': 'inseparable: several effects cannot be distinguished with these data',
    'unknown': 'unknown: more than noise is left, but no effect of the library can be named',
    'unobservable': 'unobservable: these recordings cannot show whether an effect is missing',
}
WITHIN_LAW = 'no, but within the error of its law'
LEAST_P_VALUE = 1e-6  # smaller p-values are written as an upper limit
MOST_SHIFTS = 25  # quantities in the table of the report


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of texts; `numbers`: right-aligned columns."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: tuple[int, ...] = ()

    @classmethod
    def of(cls, rows: Iterable[Mapping[str, str]], numbers: tuple[int, ...] = ()) -> Table:
        """Return the table of these rows, texts by column; empty without rows."""
        rows = tuple(rows)
        columns = tuple(rows[0]) if rows else ()
        return cls(
            columns=columns, rows=tuple(tuple(row.values()) for row in rows), numbers=numbers
        )


def added_effects(diagnosis: Diagnosis) -> list[str]:
    """Return the named effects in the augmented model."""
    present = {effect.name for effect in diagnosis.after.arm.effects}
    if diagnosis.after.arm.inertia is not None:  # with a block of its own in the model file
        present.add(Inertia.name)
    return [effect.name for effect in diagnosis.effects if effect.name in present]


def error_table(diagnosis: Diagnosis, discovery: Discovery = NOTHING_SEARCHED) -> Table:
    """Return the errors of all models, on training and held-out recordings."""
    models = {'before': diagnosis.before}
    if added_effects(diagnosis):
        models['after'] = diagnosis.after
    if discovery.evaluation is not None:
        models['discovered'] = discovery.evaluation
    misfits = [('training', when, model.training) for when, model in models.items()]
    misfits += [
        ('held out', when, model.held_out)
        for when, model in models.items()
        if model.held_out is not None
    ]
    rows = [
        (
            recordings,
            when,
            f'{millimeters(misfit.rms):.3f}',
            f'{millimeters(misfit.p95):.3f}',
            f'{misfit.chi_squared:.3g}',
        )
        for recordings, when, misfit in misfits
    ]
    tested, floor = misfits[-1][0], f'{millimeters(diagnosis.noise_floor):.3f}'
    return Table(
        columns=('recordings', 'model', 'rms (mm)', '95 % within (mm)', 'chi2 per coordinate'),
        rows=(*rows, (tested, 'noise alone', floor, '', '1')),
        numbers=(2, 3, 4),
    )


def effect_table(diagnosis: Diagnosis) -> Table:
    """Return the named effects with their numbers."""
    rows = (
        {
            'effect': effect.name,
            'meaning': EFFECTS[effect.name].meaning,
            'parameter': name,
            'value, standard error': with_error(found),
        }
        for effect in diagnosis.effects
        for name, found in effect.parameters.items()
    )
    return Table.of(rows, numbers=(3,))


def rank_evidence(diagnosis: Diagnosis) -> list[Evidence]:
    """Rank trials by evidence, followed by the effects that were not fitted, by score."""
    fitted = [item for item in diagnosis.evidence if not math.isnan(item.evidence)]
    rest = [item for item in diagnosis.evidence if math.isnan(item.evidence)]
    return [
        *sorted(fitted, key=lambda item: -item.evidence),
        *sorted(rest, key=lambda item: -item.chi_squared),
    ]


def evidence_table(diagnosis: Diagnosis) -> Table:
    """Return the evidence for each effect that was tried, strongest first."""
    rows = (
        {
            'effects': ' + '.join(item.effects),
            'delta chi2': round_value(item.chi_squared),
            'gain on left-out recordings': (
                'not fitted' if math.isnan(item.evidence) else round_value(item.evidence)
            ),
            'consistent with noise': passes_text(item, diagnosis),
            'similar to': ', '.join(item.alike),
        }
        for item in rank_evidence(diagnosis)
    )
    return Table.of(rows, numbers=(1, 2))


def passes_text(item: Evidence, diagnosis: Diagnosis) -> str:
    """State whether residuals with a set of effects are consistent with noise, with p-value."""
    if math.isnan(item.evidence):
        return ''
    p_value = '' if math.isnan(item.p_value) else f' (p {p_value_text(item.p_value)})'
    if not item.adequate:
        return f'no{p_value}'
    noise = not item.p_value <= LACK_OF_FIT.level
    return f'{"yes" if noise else WITHIN_LAW}{p_value}'


def adequacy_table(diagnosis: Diagnosis) -> Table:
    """Return whether the residuals are consistent with noise, before and after.

    The rows are the worst test before, the same test after, and the worst test after.
    """
    before, same = diagnosis.adequacy_before, diagnosis.adequacy_same
    tests = {'before': before}
    if added_effects(diagnosis):
        tests['after'] = same
        if diagnosis.adequacy_after != same:
            tests['after, worst'] = diagnosis.adequacy_after
    rows = (
        {
            'model': when,
            'test': item.test,
            'statistic': f'{item.statistic:.4g}',
            'clean data stay below': f'{item.threshold:.4g}',
            'p-value': p_value_text(item.p_value),
            'consistent with noise': consistent_text(item, item is not before),
        }
        for when, item in tests.items()
    )
    return Table.of(rows, numbers=(2, 3, 4))


def consistent_text(test: Adequacy, added: bool) -> str:
    """State whether residuals pass a test; added: whether the model has new effects."""
    if test.statistic <= test.threshold:
        return 'yes'
    return WITHIN_LAW if added else 'no'


def where_table(diagnosis: Diagnosis) -> Table:
    """Return the table with the location of the misfit."""
    rows = (
        {
            'axis': item.axis,
            'observation': item.sentence,
            'of the misfit': f'{100.0 * item.share:.0f} %',
            'of the observations': f'{100.0 * item.seen:.0f} %',
            'p-value': p_value_text(item.p_value),
        }
        for item in diagnosis.where
        if item.sentence
    )
    return Table.of(rows, numbers=(2, 3, 4))


def where_text(diagnosis: Diagnosis) -> str:
    """Describe the location of the misfit in one sentence."""
    return f'Where: {diagnosis.where_sentence.rstrip(".")}.'


def shift_table(diagnosis: Diagnosis) -> Table:
    """Return the base quantities that moved most, in standard errors."""
    ranked = sorted(diagnosis.shift.items(), key=lambda item: -sigmas(item[1]))
    rows = (
        {
            'quantity': describe_quantity(name, diagnosis.after.arm),
            'before': f'{item.before:.4g}',
            'after': f'{item.after:.4g}',
            'standard error': f'{item.std:.2g}',
            'unit': item.unit,
            'moved by (sigma)': f'{sigmas(item):.1f}',
            'name': name,
        }
        for name, item in ranked[:MOST_SHIFTS]
    )
    return Table.of(rows, numbers=(1, 2, 3, 5))


def sigmas(item: Shift) -> float:
    """Return the shift of a quantity in standard errors."""
    change = abs(item.after - item.before)
    return change / item.std if item.std > 0.0 else 0.0


def detectable_table(diagnosis: Diagnosis) -> Table:
    """Return the detection limit of each effect, and its plausible range."""
    rows = []
    for name, item in diagnosis.detectable.items():
        low, high = item.expected
        unit = unit_text(item.unit)
        # A stiffness that is infinite without the effect: smaller values are stronger effects.
        neutral = float(getattr(EFFECTS[name](), item.parameter))
        within = 'below' if neutral == math.inf else 'from'
        if 0.0 < neutral < math.inf:
            within = f'{neutral:g} ±'
        limit = f'{within} {item.smallest:.3g}{unit}' if item.observable else 'none'
        rows.append(
            {
                'effect': name,
                'meaning': EFFECTS[name].meaning,
                'parameter': item.parameter,
                'detection limit': limit,
                'expected': f'{low:g} to {high:g}{unit}',
                'observable': 'yes' if item.observable else 'no',
            }
        )
    return Table.of(rows)


def similarity_table(diagnosis: Diagnosis, least: float) -> Table:
    """Return pairs of effects that are hard to distinguish with these data, with their cosines."""
    ranked = sorted(diagnosis.cosines.items(), key=lambda item: -abs(item[1]))
    pairs = tuple((*pair, f'{value:.2f}') for pair, value in ranked if abs(value) >= least)
    return Table(columns=('effect', 'other effect', 'cosine'), rows=pairs, numbers=(2,))


def undetectable_sentence(diagnosis: Diagnosis) -> str:
    """Name the effects that are undetectable in these recordings at any plausible size."""
    unseen = [name for name, item in diagnosis.detectable.items() if not item.observable]
    if not unseen:
        return 'Every effect of the library would have been detected at a usual size.'
    return f'Not detectable at any usual size: {", ".join(unseen)}.'


def with_error(found: Estimated) -> str:
    """Format a number and its standard error, rounded to significant digits."""
    unit = unit_text(found.unit)
    if not (math.isfinite(found.std) and math.isfinite(found.value)) or found.std <= 0.0:
        return f'{found.value:.4g}{unit}'
    last = math.floor(math.log10(found.std)) - 1  # two digits of the error
    scale = math.floor(math.log10(max(abs(found.value), found.std)))
    if -4 < scale < 6:
        scale = 0
    places = max(scale - last, 0)
    value, std = (round(item, -last) / 10.0**scale for item in (found.value, found.std))
    text = f'{value:.{places}f} ± {std:.{places}f}'
    return f'({text})e{scale}{unit}' if scale else f'{text}{unit}'


def p_value_text(p_value: float) -> str:
    """Format a p-value; values below the resolution are written as an upper limit."""
    return f'{p_value:.2g}' if p_value >= LEAST_P_VALUE else f'< {LEAST_P_VALUE:g}'


def unit_text(unit: str) -> str:
    """Return a unit as a suffix of a number."""
    return '' if unit == '-' else f' {unit}'


def round_value(value: float) -> str:
    """Round a number to its significant digits, as text."""
    return f'{value:.0f}' if abs(value) >= 10.0 else f'{value:.1f}'
