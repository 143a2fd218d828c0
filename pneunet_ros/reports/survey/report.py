"""The page of a survey, its figures, and the content of `survey.json`."""

from __future__ import annotations

from collections.abc import Mapping
import shlex
from typing import Any

import numpy as np
from pneunet_ros.calibration.fleet import FEWEST_COMPARED, LEVEL
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.files.json_text import plain
from pneunet_ros.reports.calibration.tables import flat
from pneunet_ros.reports.figure import Figures, Pictures, render_page
from pneunet_ros.reports.survey.figures import effects, numbers, shapes
from pneunet_ros.reports.survey.survey_data import SurveyData, SurveyedArm

TEMPLATE = 'survey_report.html.jinja'
NUMBERS, PAGE = 'survey.json', 'survey.html'
REPLACEABLE = (NUMBERS, PAGE, 'figure_*.png')
FIGURES: Figures[SurveyData] = {'numbers': (numbers,), 'effects': (effects,), 'shapes': (shapes,)}


def survey_page(data: SurveyData, pictures: Pictures, provenance: Mapping[str, Any]) -> str:
    """Return the page with its figures; arms link to their own reports."""
    next_step, command = next_steps(data)
    return render_page(
        TEMPLATE,
        data=data,
        certainty=certainty(data),
        next_step=next_step,
        command=command,
        fleet=data.fleet,
        level=LEVEL,
        effects=effects_sentence(data),
        rare=rare_sentences(data),
        failed=[item for item in data.arms if item.failed],
        rows=[arm_row(item, data) for item in data.done],
        pressure=f'{kilopascals(data.fleet.pressure):.4g} kPa',
        pictures=pictures,
        provenance=flat(provenance),
    )


def survey_sentences(data: SurveyData) -> list[str]:
    """Return the results of a survey in sentences: outliers, effects, failures."""
    failed = [item for item in data.arms if item.failed]
    return [
        data.fleet.sentence,
        effects_sentence(data),
        *rare_sentences(data),
        *(f'{item.name} failed: {item.failed}' for item in failed),
        *(
            f'{name} is excluded: none of its recordings has a name that begins with unloaded, '
            'loaded or heldout.'
            for name in data.left_out
        ),
    ]


def effects_sentence(data: SurveyData) -> str:
    """Describe the number of arms with a missing effect, and with each other answer."""
    done = len(data.done)
    counts = data.effect_counts()
    named = ', '.join(f'{name} in {count}' for name, count in counts.items())
    answers = {name: count for name, count in data.answer_counts().items() if name != 'named'}
    other_answers = ', '.join(f'{name} {count}' for name, count in answers.items())
    text = f'Named as missing, of {done} arms: {named}'
    if not named:
        text = f'In none of {done} arms was an effect named as missing'
    return f'{text}{f"; other answers: {other_answers}" if other_answers else ""}.'


def rare_sentences(data: SurveyData) -> list[str]:
    """Name the arms with an effect that most arms do not have."""
    return [
        f'{name} is named in {", ".join(arms)} only; {data.could_show(name)} of the other '
        f'{len(data.done) - len(arms)} could have shown it.'
        for name, arms in data.rare_effects().items()
    ]


def certainty(data: SurveyData) -> str:
    """Describe the basis of the comparison and of the model errors."""
    fleet, done = data.fleet, len(data.done)
    compared = int(np.count_nonzero(np.isfinite(fleet.p_values)))
    text = f'Too few arms to find outliers: at least {FEWEST_COMPARED} are needed.'
    if compared:
        text = (
            f'{compared} of {done} arms are compared, with their error bars; in about 6 % of '
            'fleets of similar arms, one is an outlier by chance (17 of 270 drawn fleets).'
        )
    held_out = sum(item.held_out for item in data.done)
    return f'{text} Model errors of {held_out} of {done} arms are from held-out recordings.'


def next_steps(data: SurveyData) -> tuple[str, str]:
    """Return the next step and its command."""
    failed = [item for item in data.arms if item.failed]
    if failed:
        return (
            f'Check the recordings of {failed[0].name}, then repeat the survey: '
            'finished arms are kept.',
            f'pneunet check {shlex.join([*failed[0].recordings, "--model", failed[0].arm_file])}',
        )
    places = data.fleet.odd
    name = data.fleet.names[places[0]] if places else data.done[0].name
    (arm,) = (item for item in data.done if item.name == name)
    step = f'Test the model of {name} on a recording that it has not seen.'
    if places:
        step = f'Record {name} again, and check whether its model holds: it deviates most.'
    model = shlex.quote(f'{data.output}/{arm.folder}/{arm.found["model"]}')
    return step, f'pneunet replay FRESH.mcap --model {model}'


def arm_row(arm: SurveyedArm, data: SurveyData) -> dict[str, Any]:
    """Return the row of an arm in the table of the page."""
    place = data.fleet.names.index(arm.name)
    chance = data.fleet.p_values[place]
    errors = arm.errors
    answer = ' + '.join(arm.effects) or arm.answer
    return {
        'name': arm.name,
        'link': f'{arm.folder}/report.html',
        'odd': arm.name in data.odd,
        'finding': ' or '.join([answer, *arm.alternatives]),
        'answer': arm.answer,
        'before': '-' if errors is None else f'{millimeters(errors[0]):.3f}',
        'after': '-' if errors is None else f'{millimeters(errors[1]):.3f}',
        'held_out': 'held out' if arm.held_out else 'training',
        'distance': '-' if chance != chance else f'{chance:.2g}',
        'notes': len(arm.found['notes']),
    }


def survey_content(data: SurveyData, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of `survey.json`; see docs/survey.md."""
    fleet = data.fleet
    places = {name: row for row, name in enumerate(fleet.names)}
    arms = []
    for item in data.arms:
        row: dict[str, Any] = {'name': item.name, 'folder': item.folder, 'failed': item.failed}
        if not item.failed:
            place = places[item.name]
            row |= dict(item.found) | {
                'numbers': {
                    number.name: {
                        'value': fleet.values[place, which],
                        'std': fleet.stds[place, which],
                        'unit': number.unit,
                        'deviation': fleet.deviations[place, which],
                    }
                    for which, number in enumerate(fleet.numbers)
                },
                'p_value': fleet.p_values[place],
            }
        arms.append(row)
    content: dict[str, Any] = plain(
        {
            'source': data.source,
            'left_out': data.left_out,
            'sentence': fleet.sentence,
            'odd': [
                {
                    'name': fleet.names[place],
                    'p_value': fleet.p_values[place],
                    'sentence': fleet.describe(place),
                }
                for place in fleet.odd
            ],
            'answers': data.answer_counts(),
            'effects': data.effect_counts(),
            'pressure': fleet.pressure,
            'numbers': [
                {
                    'name': number.name,
                    'meaning': number.meaning,
                    'unit': number.unit,
                    'center': fleet.center[which],
                    'scatter': fleet.scatter[which],
                }
                for which, number in enumerate(fleet.numbers)
            ],
            'arms': arms,
            **provenance,
        }
    )
    return content
