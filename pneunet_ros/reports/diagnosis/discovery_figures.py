"""Figures of a discovery: kinds of cause, amplitude over time."""

from __future__ import annotations

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.discovery.result import AmplitudeSeries
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.diagnosis.localization_figures import borders
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import (
    draw_band,
    FIRST,
    legend,
    MEASURED,
    panels,
    short,
    small_multiples,
)

MOST_SERIES = 6  # recordings whose amplitude is shown


def causes(data: FigureData) -> Picture | None:
    """Draw the share that each kind of cause explains, over its position on the arm."""
    found = data.discovery.causes
    if found is None:
        return None
    figure, (axes,) = panels(1, height=1.2 + 0.26 * len(found.kinds))
    shares = 100.0 * found.share
    mesh = axes.pcolormesh(
        borders(found.positions),
        np.arange(len(found.kinds) + 1),
        np.ma.masked_invalid(shares),
        cmap='Blues',
        vmin=0.0,
        vmax=100.0,
    )
    names = [name.replace('_', ' ') for name in found.kinds]
    axes.set_yticks(np.arange(len(found.kinds)) + 0.5, names)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.set(xlabel='place where it acts, s / l (all along: of the whole arm, or of the image)')
    figure.colorbar(mesh, ax=axes, label='explains (%)', fraction=0.03, pad=0.01)
    return Picture(
        '10_causes',
        'Which kind of cause, and where',
        'Share of the remaining misfit that each kind of cause explains at each place of the '
        'arm, with the best law for its amplitude; kinds without a place are equally dark '
        'everywhere. This is a map of causes, not of motion: when the arm is touched, the whole '
        'arm beyond that place moves, but only a push at that place explains the motion.',
        figure,
    )


def amplitude(data: FigureData) -> Picture | None:
    """Draw the amplitude of the closest cause in every frame, and that of its law."""
    known = data.discovery.amplitudes
    if not known:
        return None
    series = known[:MOST_SERIES]
    figure, axes, columns = small_multiples(len(series), 3, height=2.3, more=0.6)
    for panel, item in zip(axes, series, strict=True):
        draw_amplitude(panel, item)
    for place in range(0, len(series), columns):
        unit = '' if series[0].unit == '-' else f' ({series[0].unit})'
        axes[place].set_ylabel(f'amplitude{unit}')
    legend(axes[0], loc='best')
    recordings = f'first {len(series)} of {len(known)} ' if len(series) < len(known) else ''
    return Picture(
        '11_amplitude',
        'How strong it is over time',
        f'Amplitude of the closest kind of cause in every frame of the {recordings}training '
        'recordings, estimated frame by frame (dots, band: two sigma) and predicted by its law '
        '(line). Both are relative to the previous model, which has already absorbed a part of '
        'the cause. The line should run through the dots.',
        figure,
    )


def draw_amplitude(axes: Axes, series: AmplitudeSeries) -> None:
    """Draw the amplitude of one recording."""
    order = np.argsort(series.seconds)
    seconds = series.seconds[order]
    draw_band(axes, seconds, series.value[order], series.std[order], MEASURED, alpha=0.15)
    axes.plot(seconds, series.value[order], '.', color=MEASURED, markersize=3.5, label='by frame')
    axes.plot(seconds, series.law[order], color=FIRST, linewidth=1.4, label='law')
    axes.set(title=short(series.recording), xlabel='time (s)')
