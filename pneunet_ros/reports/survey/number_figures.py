"""The numbers of all arms side by side, with error bars."""

from __future__ import annotations

import textwrap

from matplotlib.ticker import MaxNLocator
import numpy as np
from pneunet_ros.calibration.fleet import ArmNumber
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import BAND_SIGMAS, FIRST, GREY, panels, SECOND, short
from pneunet_ros.reports.survey.survey_data import SurveyData

COLUMNS = 4  # numbers beside each other
ROW_HEIGHT = 0.19  # inches an arm
TITLE = 30  # letters a line
INTERVALS = 3  # between ticks, at most; more run together


def numbers(data: SurveyData) -> Picture | None:
    """Draw every compared number, arm by arm."""
    fleet = data.fleet
    if not fleet.numbers:
        return None
    columns = min(COLUMNS, len(fleet.numbers))
    rows = -(-len(fleet.numbers) // columns)
    height = rows * (1.2 + ROW_HEIGHT * len(fleet.names))
    figure, axes = panels(columns, rows=rows, height=height)
    places = np.arange(len(fleet.names))[::-1]
    for which, (panel, number) in enumerate(zip(axes, fleet.numbers, strict=False)):
        center, scatter = float(fleet.center[which]), BAND_SIGMAS * float(fleet.scatter[which])
        panel.axvspan(center - scatter, center + scatter, color=FIRST, alpha=0.12, linewidth=0)
        panel.axvline(center, color=FIRST, linewidth=1.0)
        for arm, row in enumerate(places.tolist()):
            odd = fleet.names[arm] in data.odd
            panel.errorbar(
                fleet.values[arm, which],
                row,
                xerr=BAND_SIGMAS * fleet.stds[arm, which],
                fmt='D' if odd else 'o',
                color=SECOND if odd else GREY,
                markersize=4.5 if odd else 3.5,
                linewidth=1.0,
            )
        panel.set_title(title_of(number), fontsize=8)
        panel.xaxis.set_major_locator(MaxNLocator(INTERVALS))
        panel.ticklabel_format(axis='x', scilimits=(-3, 4), useOffset=False)
        panel.xaxis.get_offset_text().set_fontsize(7)
        panel.set_ylim(-0.8, len(fleet.names) - 0.2)
        first = which % columns == 0
        panel.set_yticks(places, [short(name) for name in fleet.names] if first else [])
        panel.tick_params(labelsize=7)
        for label, name in zip(panel.get_yticklabels(), fleet.names, strict=False):
            if name in data.odd:
                label.set_color(SECOND)
    for panel in axes[len(fleet.numbers) :]:
        panel.set_visible(False)
    return Picture(
        '01_numbers',
        'The same numbers of every arm',
        'Bars are two standard errors. Line and band: center of the fleet, and two standard '
        'deviations of the scatter of alike arms beyond their error bars. Red diamonds: arms '
        'that are odd by all numbers together; an arm may be odd although no single number is.',
        figure,
    )


def title_of(number: ArmNumber) -> str:
    """Return the title of a panel: the dotted name for a parameter of an effect."""
    words = number.meaning
    if words == number.name:
        words = words.replace('.', ' ').replace('_', ' ')
    unit = '' if number.unit == '-' else f' ({number.unit})'
    return '\n'.join(textwrap.wrap(words + unit, TITLE))
