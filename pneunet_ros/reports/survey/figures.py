"""Comparison of the arms of a fleet: numbers, missing effects and shapes."""

from __future__ import annotations

import textwrap

from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
import numpy as np
from pneunet_ros.calibration.fleet import ArmNumber
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import millimeters
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import (
    BAND_SIGMAS,
    FIRST,
    GREY,
    legend,
    panels,
    PressureColors,
    SECOND,
    short,
    small_multiples,
    THIRD,
)
from pneunet_ros.reports.survey.survey_data import SurveyData

NUMBERS = 4  # beside each other
ROW_HEIGHT = 0.19  # inches an arm
TITLE = 30  # letters a line
INTERVALS = 3  # between ticks, at most; the labels of more overlap

ANSWER_MARKS = {'none': '·', 'unknown': '?', 'unobservable': '∅'}

SHAPES = 7  # beside each other
PRESSURES = 5  # from zero to the pressure of the comparison
STATIONS = 25
PANEL_HEIGHT = 1.55  # inches


def numbers(data: SurveyData) -> Picture | None:
    """Draw every compared number, arm by arm."""
    fleet = data.fleet
    if not fleet.numbers:
        return None
    height = 1.2 + ROW_HEIGHT * len(fleet.names)
    figure, axes, columns = small_multiples(len(fleet.numbers), NUMBERS, height)
    places = np.arange(len(fleet.names))[::-1]
    for which, (panel, number) in enumerate(zip(axes, fleet.numbers, strict=True)):
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
    return Picture(
        '01_numbers',
        'The same numbers of every arm',
        'Bars are two standard errors. Line and band: center of the fleet, and two standard '
        'deviations of the scatter of similar arms beyond their error bars. Red diamonds: arms '
        'that are outliers by all numbers together, even if no single number is unusual.',
        figure,
    )


def title_of(number: ArmNumber) -> str:
    """Return the title of a panel: the dotted name for a parameter of an effect."""
    words = number.meaning
    if words == number.name:
        words = words.replace('.', ' ').replace('_', ' ')
    unit = '' if number.unit == '-' else f' ({number.unit})'
    return '\n'.join(textwrap.wrap(words + unit, TITLE))


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


def shapes(data: SurveyData) -> Picture | None:
    """Draw the unloaded shape of every arm, with the median of the fleet."""
    arms = [(item.name, item.arm) for item in data.done if item.arm is not None]
    if not arms:
        return None
    pressures = np.linspace(0.0, data.fleet.pressure, PRESSURES)
    curves = np.array([curves_of(arm, pressures) for _, arm in arms])
    median = median_curves(curves)
    figure, axes, columns = small_multiples(len(arms), SHAPES, PANEL_HEIGHT, more=0.5)
    colors = PressureColors(low=0.0, high=data.fleet.pressure)
    for panel, (name, _), curve in zip(axes, arms, curves, strict=True):
        for place, pressure in enumerate(pressures.tolist()):
            panel.plot(*median[place], color='0.82', linewidth=2.6, zorder=1)
            panel.plot(*curve[place], color=colors(pressure), linewidth=1.1, zorder=2)
        odd = name in data.odd
        panel.set_title(short(name), fontsize=7, color=SECOND if odd else GREY)
        panel.set_aspect('equal')
        panel.tick_params(labelsize=6, length=0)
        if odd:
            panel.spines[:].set(visible=True, color=SECOND, linewidth=1.6)
    low, high = np.nanmin(curves, axis=(0, 1, 3)), np.nanmax(curves, axis=(0, 1, 3))
    margin = 0.05 * float(np.max(high - low))
    for place, panel in enumerate(axes):
        panel.set_xlim(low[0] - margin, high[0] + margin)
        panel.set_ylim(low[1] - margin, high[1] + margin)
        left, bottom = place % columns == 0, place + columns >= len(arms)
        panel.tick_params(labelleft=left, labelbottom=bottom)
        panel.set_xlabel('x (mm)' if bottom else '', fontsize=7)
        panel.set_ylabel('y (mm)' if left else '', fontsize=7)
    colors.bar(figure, axes[columns - 1])
    return Picture(
        '03_shapes',
        'Every arm under the same pressures',
        'Unloaded centerlines, predicted by the models with the missing effects, all to the same '
        'scale; grey: the median of the fleet. Red frames: outliers. Pressures to which an arm '
        'was not calibrated are not drawn.',
        figure,
    )


def curves_of(arm: Arm, pressures: Array) -> Array:
    """Return centerlines in mm, (pressures, 2, stations), NaN beyond the calibrated range."""
    out = np.full((pressures.size, 2, STATIONS), np.nan)
    for place, pressure in enumerate(pressures.tolist()):
        if pressure <= arm.pressure_range[1]:
            shape = solve(arm, pressure, stations=STATIONS)
            out[place] = millimeters(1.0) * np.stack([shape.x, shape.y])
    return out


def median_curves(curves: Array) -> Array:
    """Return the median centerline at each pressure, NaN where no arm has one."""
    out = np.full(curves.shape[1:], np.nan)
    known = np.isfinite(curves).any(axis=0)
    out[known] = np.nanmedian(curves[:, known], axis=0)
    return out
