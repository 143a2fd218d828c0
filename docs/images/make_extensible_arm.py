"""Make the pictures of docs/extensible_arm.md and print its numbers; it takes some minutes.

python docs/images/make_extensible_arm.py [--output FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from extensible_arm_story import Forces, lines, Story, told, Z_95
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.diagnosis.result import Evaluation

FOLDER = Path(__file__).resolve().parent
TIP, ALL, AFTER, TRUE, CONTROL = '#d1603d', '#e0a030', '#1f5a96', '#222222', '#4c9a6a'
LOW, HIGH = -0.02, 0.6  # N, of the pictures of F1 and F2
LOST = 0.04  # N, where rows without a force are marked
LARGER = 25.0  # times, errors beside shapes
SHIFT = 0.35  # kPa, between the marks of a row
SHOWN_ROWS = (2, 6, 10, 14)  # of Table 1, whose shapes are drawn


def force_picture(story: Story) -> Figure:
    """Draw the forces of Table 1: true, from the tip, from all targets, after the diagnosis."""
    figure = Figure(figsize=(11.0, 4.8), layout='constrained')
    for component, axes in enumerate(figure.subplots(1, 2)):
        pressure = kilopascals(story.recorded.rows)
        axes.plot(pressure, story.true[:, component], '_', color=TRUE, markersize=16, label='true')
        for place, (item, color, words) in enumerate(
            (
                (story.tip, TIP, 'tip alone, inextensible'),
                (story.all_targets, ALL, 'all targets, inextensible'),
                (story.after, AFTER, 'all targets, with what was named'),
            )
        ):
            draw_forces(axes, pressure + SHIFT * (place - 1), item, component, color, words)
        lost = ~np.isfinite(story.tip.force).all(axis=1)
        if component == 0 and lost.any():
            axes.plot(pressure[lost], np.full(lost.sum(), LOST), 'x', color=TIP)
            axes.annotate(
                'x: no inextensible arm has its tip there',
                (pressure[lost][0] - 1.0, LOST + 0.015),
                color=TIP,
                fontsize=9,
            )
        axes.set(
            title=f'F{component + 1} in the rows of Table 1, 95 % intervals',
            xlabel='pressure (kPa)',
            ylabel='N',
            ylim=(LOW, HIGH),
        )
        plain(axes)
    below(figure, figure.axes[0])
    return figure


def draw_forces(
    axes: Axes, pressure: np.ndarray, item: Forces, component: int, color: str, words: str
) -> None:
    """Draw found forces; what is beyond the picture as an arrow with its number."""
    force, error = item.force[:, component], Z_95 * item.sigma[:, component]
    inside = force < HIGH
    axes.errorbar(
        pressure[inside],
        force[inside],
        error[inside],
        fmt='o',
        color=color,
        markersize=3.5,
        linewidth=1.0,
        label=words,
    )
    for place in np.flatnonzero(force >= HIGH):
        axes.annotate(
            f'{force[place]:.2f}',
            (pressure[place], HIGH),
            (pressure[place], 0.92 * HIGH),
            color=color,
            fontsize=9,
            ha='center',
            arrowprops={'arrowstyle': '->', 'color': color},
        )


def cause_picture(story: Story) -> Figure:
    """Draw what is conditioning and what is extensibility."""
    figure = Figure(figsize=(11.0, 4.4), layout='constrained')
    left, right = figure.subplots(1, 2)
    pressure, true = kilopascals(story.recorded.rows), story.true[:, 0]
    ways = (
        (story.control, CONTROL, 'an arm that does not stretch'),
        (story.tip, TIP, 'the arm that stretches, inextensible model'),
        (story.tip_after, AFTER, 'the arm that stretches, with what was named'),
    )
    for place, (item, color, words) in enumerate(ways):
        share, error = 100.0 * item.over(story.true), 100.0 * Z_95 * item.sigma[:, 0] / true
        at = pressure + SHIFT * (place - 1)
        left.errorbar(
            at, share, error, fmt='o', color=color, markersize=3.5, linewidth=1.0, label=words
        )
        right.plot(pressure, 100.0 * item.sigma[:, 0] / true, 'o-', color=color, label=words)
    sigma = 100.0 * story.after.sigma[:, 0] / true
    right.plot(pressure, sigma, 's--', color=AFTER, label='the same, all targets', markersize=4)
    left.axhline(0.0, color='0.5', linewidth=0.8)
    left.set(
        title='Extensibility: F1 from the tip, beside the truth',
        xlabel='pressure (kPa)',
        ylabel='too large by (%)',
        ylim=(-100.0, 200.0),
    )
    right.set(
        title='Conditioning: standard error of F1',
        xlabel='pressure (kPa)',
        ylabel='% of F1',
        yscale='log',
    )
    right.set_yticks([1, 10, 100], ['1', '10', '100'])
    for axes in (left, right):
        plain(axes)
    below(figure, right)
    return figure


def gap_picture(story: Story) -> Figure:
    """Draw where the model is off before and after, and what was tried."""
    figure = Figure(figsize=(11.0, 4.6), layout='constrained')
    shapes, along, tried = figure.subplots(1, 3, width_ratios=(1.15, 1.0, 0.9))
    found, run = story.diagnosis, story.recorded.held_out
    sides = ((found.before, TIP, 'before', '--'), (found.after, AFTER, 'after', '-'))
    measured = np.stack([run.x, run.y], axis=1)
    for row in SHOWN_ROWS:
        pressure = story.recorded.rows[row]
        frame = int(np.argmin(np.abs(run.frame_pressure - pressure)))
        shapes.plot(*(1e3 * measured[frame]), 'o', color=TRUE, markersize=3.5)
        for side, color, _, _ in sides:
            error = LARGER * side.held_out_scores[0].error[frame]
            ends = 1e3 * np.stack([measured[frame], measured[frame] + error])
            shapes.plot(ends[:, 0], ends[:, 1], color=color, linewidth=1.2)
        tip = 2.0 + 1e3 * measured[frame][:, np.flatnonzero(run.seen[frame])[-1]]
        shapes.annotate(f'{kilopascals(float(pressure)):.0f} kPa', tip, fontsize=8)
    shapes.set_aspect('equal', adjustable='datalim')
    shapes.set(
        title=f'Rows of Table 1, held out; errors x {LARGER:.0f}', xlabel='x (mm)', ylabel='y (mm)'
    )
    for side, color, words, style in sides:
        along.plot(
            1e3 * side.arm.target_arclength,
            millimeters(rms_along(side)),
            style,
            color=color,
            marker='o',
            markersize=3.5,
            label=words,
        )
    along.axhline(
        millimeters(found.noise_floor), color='0.5', linewidth=1.0, label='noise alone, mean'
    )
    along.set(title='Error along the arm, rms', xlabel='s (mm)', ylabel='mm', ylim=(0.0, None))
    along.legend(fontsize=8)
    items = [item for item in found.evidence if len(item.effects) == 1][:7][::-1]
    tried.barh(
        [item.effects[0].replace('_', ' ') for item in items],
        [item.chi_squared for item in items],
        color=[AFTER if item.adequate else '0.75' for item in items],
    )
    tried.set(title='What each effect explains', xlabel='chi squared falls by')
    for place, item in enumerate(items):
        tried.annotate(
            f' {item.chi_squared:.0f}', (item.chi_squared, place), va='center', fontsize=8
        )
    tried.margins(x=0.15)
    tried.tick_params(axis='y', labelsize=8)
    tried.tick_params(axis='x', labelsize=8)
    for axes in (shapes, along, tried):
        plain(axes)
    return figure


def below(figure: Figure, axes: Axes) -> None:
    """Put the legend of some axes under the picture."""
    marks, words = axes.get_legend_handles_labels()
    figure.legend(marks, words, loc='outside lower center', ncols=4, fontsize=9, frameon=False)


def rms_along(side: Evaluation) -> np.ndarray:
    """Return the rms of both coordinates per target (m), registration removed."""
    error = side.held_out_scores[0].error
    return np.asarray(np.sqrt(np.nanmean(error**2, axis=(0, 1))))


def plain(axes: Axes) -> None:
    """Leave out what is not needed to read a picture."""
    axes.grid(color='0.92', linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)


def main() -> None:
    """Print the numbers and draw."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--output', type=Path, default=FOLDER)
    folder = command.parse_args().output
    story = told()
    print('\n'.join(lines(story)))
    pictures = {'force': force_picture, 'cause': cause_picture, 'gap': gap_picture}
    for name, drawn in pictures.items():
        path = folder / f'extensible_arm_{name}.png'
        drawn(story).savefig(path, dpi=110, metadata={'Software': None})


if __name__ == '__main__':
    main()
