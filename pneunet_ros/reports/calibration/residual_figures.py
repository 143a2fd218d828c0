"""Residuals of a calibration: over frames and targets, by law."""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.experiments import LawScore
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array, root_mean_square
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.reports.calibration.figure_data import FigureData
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import (
    draw_bars,
    FIRST,
    GREY,
    legend,
    MEASURED,
    panels,
    SECOND,
    short,
)
from pneunet_ros.solver.columns import THETA

MICRO = 1e6  # um per m
SMOOTHED = 15  # frames of the running mean
LAW_COLORS = (FIRST, '#d1a13d', SECOND)


def draw_residuals_by_frame(data: FigureData) -> Picture:
    """Draw the whitened residuals of every frame, run after run."""
    figure, (axes,) = panels(1, height=3.8)
    start, edges = 0, []
    for item in data.calibration.joint.runs:
        size = whitened_size(item)
        x = start + np.arange(size.size)
        axes.plot(x, size, linestyle='', marker='.', markersize=2.5, color=FIRST, alpha=0.45)
        axes.plot(x, running_mean(size), color=SECOND, linewidth=1.5)
        edges.append((start, start + size.size, item))
        start += size.size
    for index, (left, right, item) in enumerate(edges):
        axes.axvspan(left, right, color=GREY, alpha=0.07 * (index % 2), linewidth=0)
        kind = 'loaded' if item.run.loaded else 'unloaded'
        rms = MICRO * root_mean_square(item.residual[item.solved])
        axes.text(
            0.5 * (left + right),
            0.97,
            f'{short(item.run.name)}\n{kind}, {rms:.0f} um rms',
            transform=axes.get_xaxis_transform(),
            ha='center',
            va='top',
            fontsize=9,
        )
    axes.axhline(1.0, color=MEASURED, linewidth=0.9)
    low, high = axes.get_ylim()
    axes.set(xlabel='frame, recording after recording', ylabel='residual / expected')
    axes.set(xlim=(0, start), ylim=(min(low, 0.0), max(1.25 * high, 2.0)))
    fit = data.calibration.joint
    return Picture(
        '12_residuals_over_frames',
        'Residuals over frames',
        'Root mean square residual of every frame, relative to the expectation from noise, '
        'placement, camera and readings (dots; line: running mean). It should scatter about 1 '
        'without a trend. A hump means that an effect is missing in the model, a constant level '
        'other than 1 that the stated noise is wrong, and one recording above the others that '
        'this recording is unusual or has the wrong role. Over all frames chi squared per '
        f'coordinate is {fit.chi_squared / fit.dof:.3f}.',
        figure,
    )


def whitened_size(item: FittedRun) -> Array:
    """Return the rms whitened residual of every frame with a residual; 1 is expected."""
    solved = item.solved & (item.dof > 0)
    return np.asarray(np.sqrt(item.whitened[solved] / item.dof[solved]))


def running_mean(values: Array) -> Array:
    """Return the running mean over neighboring frames, fewer at the ends."""
    kernel = np.ones(min(SMOOTHED, values.size))
    weight = np.convolve(np.ones_like(values), kernel, mode='same')
    return np.asarray(np.convolve(values, kernel, mode='same') / weight)


def draw_residuals_by_target(data: FigureData) -> Picture:
    """Draw the estimated placement and the mean remaining residual per target."""
    fit, noise = data.calibration.joint, data.calibration.noise.noise
    share = data.calibration.arm.target_arclength / data.calibration.arm.length
    residuals = mean_residuals(fit)
    figure, axes = panels(2, height=3.8)
    for panel, name, placed, mean in zip(
        axes, ('along the arm', 'across the arm'), fit.placement, residuals, strict=True
    ):
        panel.axhspan(
            -2.0 * MICRO * noise.placement_std,
            2.0 * MICRO * noise.placement_std,
            color=GREY,
            alpha=0.12,
            linewidth=0,
            label='2 sigma of placement',
        )
        panel.axhline(0.0, color='0.5', linewidth=0.8)
        panel.plot(
            share, MICRO * placed, color=FIRST, marker='o', markersize=4, label='placement found'
        )
        panel.plot(
            share,
            MICRO * mean,
            color=SECOND,
            marker='s',
            markersize=3.5,
            label='mean residual left',
        )
        panel.set(title=name, xlabel='target, arclength $s / l$', ylabel='um')
    legend(axes[0], loc='best')
    return Picture(
        '13_residuals_over_targets',
        'Residuals over targets',
        'Distance of each target from its position in the arm file, along and across the arm, '
        'and the mean residual that remains. Placement should stay within the band without a '
        'pattern. The remaining residual should be much smaller; errors of the readings move the '
        'whole arm and leave a small residual that grows towards the tip.',
        figure,
    )


def mean_residuals(fit: Fit) -> Array:
    """Return the mean residual along and across the arm, (2, targets) m; NaN where never seen."""
    parts = []
    for item in fit.runs:
        theta, residual = item.fields[:, THETA], item.residual[:]
        along = np.cos(theta) * residual[:, 0] + np.sin(theta) * residual[:, 1]
        across = -np.sin(theta) * residual[:, 0] + np.cos(theta) * residual[:, 1]
        parts.append(np.stack([along, across], axis=1)[item.solved])
    errors = np.concatenate(parts)
    count = np.isfinite(errors).sum(axis=0)
    total = np.where(np.isfinite(errors), errors, 0.0).sum(axis=0)
    return np.asarray(total / np.where(count > 0, count, np.nan))


def law_comparison(data: FigureData) -> Picture | None:
    """Draw the errors of moment laws on left-out recordings."""
    if not data.calibration.laws:
        return None
    laws = data.calibration.laws
    figure, (axes,) = panels(1, height=3.8)
    names = [short(score.name) for score in laws[0].scores]
    width = 0.8 / len(laws)
    for place, item in enumerate(laws):
        draw_bars(
            axes,
            [millimeters(score.rms) for score in item.scores],
            '{:.3f}',
            place=np.arange(len(names)) + (place - 0.5 * (len(laws) - 1)) * width,
            width=0.94 * width,
            color=LAW_COLORS[place % len(LAW_COLORS)],
            label=f'{item.kind}, all: {millimeters(item.rms):.3f} mm',
        )
    axes.set_xticks(np.arange(len(names)), [f'without {name}' for name in names])
    axes.set(ylabel='rms on the left-out recording (mm)')
    axes.margins(y=0.35)
    legend(axes, loc='upper center', ncols=len(laws))
    return Picture(
        '14_laws',
        'Moment laws on left-out recordings',
        'Each law was fitted without one loaded recording and then predicted that recording: '
        f'rms per coordinate, without the registration error. {best_sentence(laws)}',
        figure,
    )


def best_sentence(laws: tuple[LawScore, ...]) -> str:
    """Name the law that predicts best."""
    ranked = sorted(laws, key=lambda item: item.rank)
    first, second = ranked[0], ranked[1] if len(ranked) > 1 else ranked[0]
    if second.missing > first.missing:
        return (
            f'{first.kind} is best, the next one ({second.kind}) has no equilibrium in '
            f'{second.missing - first.missing} frames more.'
        )
    return (
        f'Smaller is better: {first.kind} is best, the error of the next one ({second.kind}) is '
        f'{second.rms / first.rms:.2f} times as large.'
    )
