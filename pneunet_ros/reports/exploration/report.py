"""Results of an exploration, round by round: numbers, a picture, a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.exploration.choice import allowed_experiments
from pneunet_ros.exploration.exploration import is_clear, is_name_confirmed, Round
from pneunet_ros.exploration.rivals import named_effects, NOTHING
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.files.json_text import plain
from pneunet_ros.reports.calibration.tables import flat
from pneunet_ros.reports.figure import Picture, render_page
from pneunet_ros.reports.style import FIRST, GREY, legend, panels, SECOND, THIRD

TEMPLATE = 'exploration_report.html.jinja'
SHOWN = 5  # rivals listed on a line of their own
COLORS = (FIRST, SECOND, THIRD, '#8a5fb0', '#b08a2e')


def exploration_page(rounds: Sequence[Round], safe: SafeSet, provenance: Mapping[str, Any]) -> str:
    """Return the page after this many rounds, with its figure."""
    return render_page(
        TEMPLATE,
        sentence=last_sentence(rounds),
        safe=safe_sentence(safe),
        rows=[round_row(place, item) for place, item in enumerate(rounds, start=1)],
        pictures=[gap_picture(rounds)],
        provenance=flat(provenance),
    )


def last_sentence(rounds: Sequence[Round]) -> str:
    """Describe the result of the last round, and whether a name was confirmed."""
    count = f'after {len(rounds)} recording{"" if len(rounds) == 1 else "s"}'
    sentence = f'{rounds[-1].investigation.diagnosis.sentence} ({count})'
    if rounds[-1].investigation.diagnosis.answer == 'none' and rounds[-1].undetectable:
        unseen = ', '.join(rounds[-1].undetectable)
        return (
            f'{sentence} However, these recordings cannot show some effects of usual size, so '
            f'any of these may be missing: {unseen}.'
        )
    if not named_effects(rounds[-1].investigation):
        return sentence
    if is_name_confirmed(rounds):
        return (
            f'{sentence} Recording {len(rounds)}, which was not used to find the answer, '
            'confirmed it.'
        )
    return f'{sentence} No recording has been made since then that could test it.'


def safe_sentence(safe: SafeSet) -> str:
    """Describe the limits of the experiments."""
    low, high = kilopascals(safe.low), kilopascals(safe.high)
    sentence = f'{low:g} to {high:g} kPa, with at most {safe.force:.3g} N at the free end'
    if any(item.loaded for item in allowed_experiments(safe)):
        return sentence
    return f'{sentence}; without a load, because no force of an experiment is a calibrated one'


def round_row(number: int, item: Round) -> dict[str, str]:
    """Return the row of a round, for the page and the terminal."""
    diagnosis = item.diagnosis
    sides = () if diagnosis is None else (diagnosis.before, diagnosis.after)
    before, after = [f'{millimeters(side.rms):.3f}' for side in sides] or ('-', '-')
    rivals = sorted(item.rivals.items(), key=lambda pair: -pair[1])[:3]
    return {
        'number': str(number),
        'recorded': item.choice.experiment.words,
        'why': item.choice.words,
        'answer': answer_of(item),
        'before': before,
        'after': after,
        'predicted': '-' if item.predicted is None else f'{millimeters(item.predicted):.3f}',
        'rivals': ', '.join(f'{name} {value:.2g}' for name, value in rivals) or '-',
    }


def answer_of(item: Round) -> str:
    """Return the answer of a round, with the names of effects."""
    found = item.investigation.diagnosis
    diagnosis = item.diagnosis
    names = '' if diagnosis is None else ' + '.join(effect.name for effect in diagnosis.effects)
    alternatives = () if diagnosis is None else diagnosis.alternatives
    return ' or '.join([f'{found.answer}{f": {names}" if names else ""}', *alternatives])


def gap_picture(rounds: Sequence[Round]) -> Picture:
    """Draw the model error and the remaining hypotheses over the rounds."""
    figure, (gap, chance) = panels(2, height=4.2)
    number = np.arange(1, len(rounds) + 1)
    known = [item.diagnosis for item in rounds]
    before = [millimeters(item.before.rms) if item else np.nan for item in known]
    after = [millimeters(item.after.rms) if item else np.nan for item in known]
    floors = [millimeters(item.noise_floor) if item else np.nan for item in known]
    predicted = [millimeters(item.predicted or np.nan) for item in rounds]
    gap.plot(number, before, 's--', color=SECOND, label='given model, refitted')
    gap.plot(number, after, 'o-', color=FIRST, label='with the missing effect')
    gap.plot(number, predicted, 'D:', color=GREY, label='new recording, predicted')
    gap.plot(number, floors, '-', color='0.75', label='noise alone')
    gap.set(title='(a) model error', xlabel='recording', ylabel='rms per coordinate (mm)')
    gap.set_ylim(0.0, 1.4 * gap.get_ylim()[1])  # room for the legend
    names = sorted(
        {name for item in rounds for name in item.rivals},
        key=lambda name: -max(item.rivals.get(name, 0.0) for item in rounds[-2:]),
    )[:SHOWN]
    for name, color in zip(names, COLORS, strict=False):
        values = [item.rivals.get(name, np.nan) for item in rounds]
        label = 'nothing else is missing' if name == NOTHING else name
        chance.plot(number, values, 'o-', color=color, label=label)
    chance.set(title='(b) remaining possibilities', xlabel='recording', ylabel='probability')
    chance.set_ylim(-0.03, 1.03)
    for panel in (gap, chance):
        panel.set_xticks(number)
        legend(panel, loc='best')
    return Picture(
        'gap',
        'Model error after each recording',
        '(a) Red: the best fit of the given model; blue: with the effect named so far; '
        'diamonds: the newest recording, predicted by the model of the previous round. (b) '
        'Probability that another effect is missing, or that none is.',
        figure,
    )


def exploration_content(
    rounds: Sequence[Round], safe: SafeSet, provenance: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the content of `exploration.json`; see docs/explore.md."""
    rows = []
    for item in rounds:
        found, diagnosis = item.investigation.diagnosis, item.diagnosis
        best = sorted(item.choice.divergence.items(), key=lambda pair: -pair[1])[:SHOWN]
        rows.append(
            {
                'recording': item.run.name,
                'recorded': item.choice.experiment.words,
                'seconds': item.choice.seconds,
                'divergence_per_second': item.choice.rate,
                'divergence': [{'rivals': pair, 'expected': value} for pair, value in best],
                'answer': found.answer,
                'sentence': found.sentence,
                'effects': [] if diagnosis is None else [e.name for e in diagnosis.effects],
                'alternatives': () if diagnosis is None else diagnosis.alternatives,
                'rivals': item.rivals,
                'rms_before_m': None if diagnosis is None else diagnosis.before.rms,
                'rms_after_m': None if diagnosis is None else diagnosis.after.rms,
                'rms_predicted_m': item.predicted,
                'noise_floor_m': None if diagnosis is None else diagnosis.noise_floor,
                'notes': found.notes,
            }
        )
    last = rounds[-1].investigation.diagnosis
    content: dict[str, Any] = plain(
        {
            'answer': last.answer,
            'sentence': last.sentence,
            'clear': is_clear(rounds),
            'undetectable': rounds[-1].undetectable,
            'recordings': len(rounds),
            'safe': {'pressure': [safe.low, safe.high], 'force': safe.force},
            'rounds': rows,
            **provenance,
        }
    )
    return content
