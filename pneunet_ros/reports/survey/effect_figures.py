"""Missing effect of each arm, and the model error before and after adding it."""

from __future__ import annotations

from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np
from pneunet_ros.core.units import millimeters
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import FIRST, GREY, legend, panels, SECOND, short, THIRD
from pneunet_ros.reports.survey.number_figures import ROW_HEIGHT
from pneunet_ros.reports.survey.survey_data import SurveyData

ANSWER_MARKS = {'none': '·', 'unknown': '?', 'unobservable': '∅'}


def effects(data: SurveyData) -> Picture | None:
    """Draw the effects by arm, with the model error."""
    arms = [item for item in data.done if item.errors is not None]
    if not arms:
        return None
    names = sorted({name for item in arms for name in (*item.effects, *item.alternatives)})
    figure, (matrix, gap) = panels(2, height=1.8 + ROW_HEIGHT * len(arms))
    places = np.arange(len(arms))[::-1]
    for row, item in zip(places.tolist(), arms, strict=True):
        fill = THIRD if item.answer == 'named' else 'white'
        for name in (*item.effects, *item.alternatives):
            place = names.index(name)
            matrix.plot(place, row, 's', markersize=6.5, color=THIRD, markerfacecolor=fill)
        if mark := ANSWER_MARKS.get(item.answer):
            matrix.text(len(names), row, mark, ha='center', va='center', fontsize=9)
        before, after = (millimeters(error) for error in item.errors or ())
        gap.plot([before, after], [row, row], color='0.75', linewidth=1.2, zorder=1)
        gap.plot(before, row, 'o', color=SECOND, markersize=4)
        gap.plot(after, row, 'o', color=FIRST, markersize=4)
    matrix.set_xticks(range(len(names) + 1), [*names, 'no name'], rotation=30, ha='right')
    matrix.set_xlim(-0.6, len(names) + 0.6)
    matrix.set_title('(a) missing effects')
    for panel in (matrix, gap):
        panel.set_ylim(-0.8, len(arms) - 0.2)
        panel.tick_params(labelsize=8)
    matrix.set_yticks(places, [short(item.name) for item in arms], fontsize=7)
    gap.set_yticks(places, [''] * len(arms))
    gap.set_xscale('log')
    gap.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    gap.xaxis.set_major_formatter('{x:g}')
    gap.xaxis.set_minor_formatter(NullFormatter())
    gap.set(title='(b) model error, rms per coordinate', xlabel='mm, logarithmic')
    gap.plot([], [], 'o', color=SECOND, label='before')
    gap.plot([], [], 'o', color=FIRST, label='after')
    legend(gap, loc='best')
    for label, item in zip(matrix.get_yticklabels(), arms, strict=True):
        label.set_color(SECOND if item.name in data.odd else GREY)
    where = 'held-out' if all(item.held_out for item in arms) else 'held-out or else training'
    return Picture(
        '02_effects',
        'Missing effects, and the error that they explain',
        '(a) Filled: named. Empty: one of several effects that the recordings cannot '
        'distinguish. A dot: no effect is missing that these recordings could show; ?: an effect '
        'is missing that is not in the library; ∅: these recordings cannot show whether an '
        f'effect is missing. (b) on {where} recordings.',
        figure,
    )
