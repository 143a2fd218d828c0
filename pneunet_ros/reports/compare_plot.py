"""Plot of a comparison of shapes: shapes, errors along the arm, errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
import numpy as np
from pneunet_ros.core.units import millimeters, NANOSECONDS_PER_SECOND
from pneunet_ros.estimation.shape_error import CenterlineErrors, Comparison, TipErrors
from pneunet_ros.reports.style import (
    as_shapes,
    draw_dots,
    figure_text,
    FIRST,
    GREY,
    HEIGHT,
    legend,
    MEASURED,
    panels,
    SECOND,
    short,
)

SHOWN = 6  # frames whose shapes are drawn
WIDTH = 15.0  # inches
MM = millimeters(1.0)


def draw_comparisons(comparisons: Sequence[Comparison], path: Path, form: str) -> None:
    """Draw every comparison as a row of panels; form: png, svg or pdf."""
    rows = len(comparisons)
    figure, axes = panels(3, rows, height=HEIGHT * rows, width=WIDTH)
    for row, comparison in enumerate(comparisons):
        draw_comparison(axes[3 * row : 3 * row + 3], comparison)
    figure.savefig(path, dpi=120, format=form, metadata={'Date': None} if form == 'svg' else None)


def draw_comparison(axes: Sequence[Axes], comparison: Comparison) -> None:
    """Draw shapes, errors along the arm and errors over time of a comparison."""
    shapes, along, over_time = axes
    tip, place = comparison.tip, 'of the tip'
    if tip is not None and not tip.at_end:
        place = f'at s = {MM * tip.at:.4g} mm'
    as_shapes(shapes, f'{short(comparison.of.name)} against {short(comparison.to.name)}')
    along.set(title='Error along the arm', xlabel='arclength (mm)', ylabel='distance (mm)')
    over_time.set(title=f'Error {place}', xlabel='time (s)', ylabel='distance (mm)')
    if comparison.shape is not None:
        draw_shapes(shapes, comparison.shape, labels_of(comparison, comparison.shape))
        draw_along(along, comparison.shape)
    else:
        mark_empty_panel(shapes)
        mark_empty_panel(along)
    if tip is not None:
        draw_over_time(over_time, tip)
    else:
        mark_empty_panel(over_time)


def mark_empty_panel(axes: Axes) -> None:
    """State in an empty panel that there is nothing to draw."""
    axes.text(0.5, 0.7, 'nothing to compare', transform=axes.transAxes, ha='center', color=GREY)


def labels_of(comparison: Comparison, shape: CenterlineErrors) -> tuple[str, str]:
    """Return the label of each side: its name, or its topic if both are of one recording."""
    of, to = short(comparison.of.name), short(comparison.to.name)
    if of != to:
        return of, to
    return figure_text(shape.topics[0]), figure_text(shape.topics[1])


def draw_shapes(axes: Axes, shape: CenterlineErrors, labels: tuple[str, str]) -> None:
    """Draw both sides of a few frames, from the first to the last."""
    frames = np.unique(np.linspace(0, len(shape.stamp_ns) - 1, SHOWN).round().astype(int))
    for frame in frames.tolist():
        first = frame == frames[0]
        axes.plot(
            *(MM * shape.of[frame]), color=FIRST, linewidth=1.8, label=labels[0] if first else ''
        )
        x, y = MM * shape.to[frame]
        draw_dots(axes, x, y, 4.0, color=MEASURED, label=labels[1] if first else '')
    legend(axes)


def draw_along(axes: Axes, shape: CenterlineErrors) -> None:
    """Draw rms and 95th percentile of the distance over arclength."""
    distance = MM * shape.distance
    seen = np.isfinite(distance).any(axis=0)
    s, known = MM * shape.arclength[seen], distance[:, seen]
    axes.plot(s, np.sqrt(np.nanmean(known**2, axis=0)), color=FIRST, linewidth=1.8, label='rms')
    axes.plot(s, np.nanpercentile(known, 95.0, axis=0), color=SECOND, label='95 %')
    axes.set_ylim(bottom=0.0)
    legend(axes)


def draw_over_time(axes: Axes, tip: TipErrors) -> None:
    """Draw the distance of the tip in every frame, and its rms."""
    seconds = (tip.stamp_ns - tip.stamp_ns[0]) / NANOSECONDS_PER_SECOND
    distance = MM * tip.distance
    axes.plot(seconds, distance, color=FIRST, linewidth=1.0, marker='.', markersize=4)
    rms = float(np.sqrt(np.mean(distance**2)))
    axes.axhline(rms, color=GREY, linewidth=1.0, linestyle='--', label=f'rms {rms:.3f} mm')
    axes.set_ylim(bottom=0.0)
    legend(axes)
