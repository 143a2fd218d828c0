"""Figure of `acceptance/real_data.py`: tips of a few actuators, errors of all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
import numpy as np
from real_data_fit import Actuator, Score

SHOWN = 5  # actuators, evenly from the one that turns most to the right to most to the left
REACH = np.linspace(-4.4, 4.4, 400)  # rad, turning of an arm of constant length
BEFORE, LINEAR, QUADRATIC = '#d1495b', '#e0a030', '#00798c'


def draw(
    actuators: Sequence[Actuator],
    scores: Sequence[dict[str, Score]],
    path: Path,
    marks: tuple[float, float],
    note: str,
) -> None:
    """Measured and predicted tips, and errors before and after, as a picture."""
    figure = Figure(figsize=(14.5, 8.0), layout='constrained')
    tips, errors = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    draw_tips(tips, actuators, scores)
    draw_errors(errors, actuators, scores, marks)
    for axes in (tips, errors):
        axes.grid(color='0.92', linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[['top', 'right']].set_visible(False)
    figure.suptitle(
        f'{len(actuators)} pneumatic actuators: what elongation under pressure explains',
        fontsize=14,
    )
    figure.supxlabel(f'{note}; no end force on the arms', fontsize=9)
    figure.savefig(path, dpi=130, format=path.suffix.lstrip('.') or 'png')


def draw_tips(
    axes: Axes, actuators: Sequence[Actuator], scores: Sequence[dict[str, Score]]
) -> None:
    """Tips of a few actuators, measured and predicted from the other pressures."""
    length = actuators[0].tip[0, 0]
    chord = length * np.sinc(REACH / (2.0 * np.pi))
    axes.plot(
        1e3 * chord * np.cos(REACH / 2.0),
        1e3 * chord * np.sin(REACH / 2.0),
        color='0.75',
        linewidth=1.5,
        label='reach of an arc of constant length',
    )
    order = np.argsort([item['quadratic'].numbers()['turning_rad'] for item in scores])
    chosen = np.unique(order[np.linspace(0, order.size - 1, min(SHOWN, order.size)).astype(int)])
    for index in chosen:
        actuator, score = actuators[index], scores[index]
        before, after = score['without'].left_out, score['linear'].left_out
        quadratic = score['quadratic'].left_out
        measured = 1e3 * actuator.tip
        for tip, miss in zip(measured[1:-1], 1e3 * before, strict=True):
            axes.plot(*np.stack([tip, miss], axis=1), color=BEFORE, linewidth=0.6, alpha=0.6)
        axes.plot(*measured.T, 'o', color='black', markersize=4)
        marks = (
            (before, BEFORE, 's', 4.5),
            (after, LINEAR, 'D', 7),
            (quadratic, QUADRATIC, 'o', 9),
        )
        for predicted, color, marker, size in marks:
            axes.plot(*(1e3 * predicted.T), marker, color=color, markersize=size, fillstyle='none')
        outward = 1.0 if measured[-1, 1] > 0.0 else -1.0
        axes.annotate(
            actuator.name,
            measured[-1],
            fontsize=8,
            xytext=(0.0, 9.0 * outward),
            textcoords='offset points',
            ha='center',
            va='center',
        )
    axes.plot([], [], 'o', color='black', markersize=4, label='measured tip')
    axes.plot([], [], 's', color=BEFORE, fillstyle='none', label='predicted without elongation')
    axes.plot([], [], 'D', color=LINEAR, fillstyle='none', label='with elongation linear in p')
    axes.plot(
        [],
        [],
        'o',
        color=QUADRATIC,
        fillstyle='none',
        markersize=9,
        label='with elongation quadratic in p',
    )
    axes.plot(0.0, 0.0, 's', color='black', markersize=8)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(
        title='Tips, each pressure predicted from the others',
        xlabel='x (mm), the straight arm points this way',
        ylabel='y (mm)',
    )
    axes.legend(
        loc='upper left',
        bbox_to_anchor=(-30.0, -10.0),
        bbox_transform=axes.transData,
        fontsize=8,
        frameon=False,
    )


def draw_errors(
    axes: Axes,
    actuators: Sequence[Actuator],
    scores: Sequence[dict[str, Score]],
    marks: tuple[float, float],
) -> None:
    """Error of every actuator before and after, with medians and the two marks."""
    numbers = [{model: score.numbers() for model, score in item.items()} for item in scores]
    series = {
        'no elongation, best curvature': (
            [item['best_curvature']['fitted_mean'] for item in numbers], BEFORE, 's',
        ),
        'linear in p, left out': (
            [item['linear']['left_out_mean'] for item in numbers], LINEAR, 'D',
        ),
        'quadratic in p, left out': (
            [item['quadratic']['left_out_mean'] for item in numbers], QUADRATIC, 'o',
        ),
    }  # fmt: skip
    order = np.argsort(series['linear in p, left out'][0])
    rows = np.arange(order.size)
    values = np.array([item[0] for item in series.values()])[:, order]
    axes.hlines(rows, values.min(axis=0), values.max(axis=0), color='0.85', linewidth=1.0)
    for label, (errors, color, marker) in series.items():
        median = float(np.median(errors))
        axes.plot(
            np.array(errors)[order],
            rows,
            marker,
            color=color,
            markersize=5.5,
            label=f'{label} (median {median:.3g} %)',
        )
        axes.axvline(median, color=color, linewidth=1.2)
    for mark, words, side in zip(marks, ('known', 'wanted'), ('right', 'left'), strict=True):
        axes.axvline(mark, color='black', linewidth=1.0, linestyle='--')
        axes.annotate(f' {mark} % {words} ', (mark, order.size - 0.2), fontsize=8, ha=side)
    axes.set_xscale('log')
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    axes.set_yticks(
        rows, [f'{actuators[k].name} ({actuators[k].pressure.size})' for k in order], fontsize=8
    )
    axes.set_ylim(-0.8, order.size + 0.5)
    axes.set(
        title='Mean error of the tip per actuator (number of pressures)',
        xlabel='% of the length, logarithmic',
    )
    axes.legend(loc='lower right', bbox_to_anchor=(0.86, 0.02), fontsize=8, framealpha=1.0)
