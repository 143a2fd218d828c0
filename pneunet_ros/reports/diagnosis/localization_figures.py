"""Maps of the misfit over arclength and operating conditions, and its shares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, TwoSlopeNorm
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import AXES, Axis, HeatMap, Share
from pneunet_ros.diagnosis.settings import LACK_OF_FIT
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import FIRST, legend, panels, same_height

ALONE = 0.1  # s / l, width of the cell of a single target
HIGHEST = 8.0  # times the noise: larger values have the same color
WORDS: dict[Axis, tuple[str, float]] = {  # label and units shown per SI unit
    'arclength': ('arclength s / l', 1.0),
    'pressure': ('pressure (kPa)', kilopascals(1.0)),
    'force': ('end force (mN)', 1000.0),
    'time': ('time in the recording (s)', 1.0),
    'direction': ('pressure', 1.0),
}
HEAT: Colormap = LinearSegmentedColormap.from_list(  # white in its middle, where the noise is
    'heat',
    [(0.0, '#c6d8e8'), (0.5, '#ffffff'), (0.66, '#f2b27c'), (0.83, '#d1603d'), (1.0, '#5f1020')],
)


def misfit_maps(data: FigureData) -> Picture | None:
    """Draw heat maps of the whitened residual, before and after."""
    heat_maps = data.diagnosis.heat_maps
    if not heat_maps:
        return None
    columns = len(data.models)
    figure, axes = panels(columns, rows=len(heat_maps), height=0.8 + 2.3 * len(heat_maps))
    cells = np.concatenate(
        [cell.ravel() for item in heat_maps for cell in (item.before, item.after)]
    )
    cells = cells[np.isfinite(cells)]
    largest = float(cells.max()) if cells.size else 2.0
    norm = TwoSlopeNorm(1.0, vmin=0.0, vmax=min(max(largest, 2.0), HIGHEST))
    for row, item in enumerate(heat_maps):
        for column, (when, _) in enumerate(data.models):
            values = item.before if column == 0 else item.after
            draw_map(axes[columns * row + column], item, values, norm)
            if row == 0:
                axes[column].set_title(f'({"ab"[column]}) {when}')
    mesh = axes[0].collections[0]
    figure.colorbar(mesh, ax=axes, label='residual / noise', fraction=0.03, pad=0.01)
    return Picture(
        '04_where',
        'Residuals along the arm, over pressure, force and time',
        'Root mean square residual of the training recordings in units of the noise, along the '
        'arm (horizontal) and over the pressure, force or time (vertical). White: noise alone; '
        'red: not explained by the model; light blue: less than noise; grey: never measured. '
        'With the missing effect added, nothing red should remain.',
        figure,
    )


def draw_map(axes: Axes, item: HeatMap, values: Array, norm: TwoSlopeNorm) -> None:
    """Draw a map: arclength horizontal, the other axis vertical."""
    label, scale = WORDS[item.axis]
    edges = scale * item.edges
    if item.axis == 'direction':
        edges = np.arange(len(item.edges), dtype=np.float64)
        names = direction_names(len(edges) - 1)
        axes.set_yticks(edges[:-1] + 0.5, names)
    axes.pcolormesh(
        borders(item.arclength), edges, np.ma.masked_invalid(values), cmap=HEAT, norm=norm
    )
    axes.set_facecolor('0.85')
    axes.grid(visible=False)
    axes.set(xlabel=WORDS['arclength'][0], ylabel=label)


def direction_names(count: int) -> list[str]:
    """Name the directions of pressure, from falling to rising."""
    return ['falling', 'rising'] if count == 2 else ['falling', 'held', 'rising']


def borders(places: Array) -> Array:
    """Return the borders (s / l) of cells around increasing positions on the arm."""
    if places.size == 1:
        return np.array([places[0] - 0.5 * ALONE, places[0] + 0.5 * ALONE])
    middle = 0.5 * (places[1:] + places[:-1])
    first, last = 2.0 * places[0] - middle[0], 2.0 * places[-1] - middle[-1]
    # Not beyond the clamp, nor beyond the soft part or the visible part of a cap.
    return np.concatenate([[max(first, 0.0)], middle, [min(last, max(1.0, places[-1]))]])


def shares(data: FigureData) -> Picture | None:
    """Draw the shares of the misfit over every axis."""
    where, p_value = data.diagnosis.where, LACK_OF_FIT.level
    shown = [axis for axis in AXES if any(item.axis == axis for item in where)]
    if not shown:
        return None
    figure, axes = panels(len(shown), height=3.2)
    for panel, axis in zip(axes, shown, strict=True):
        draw_shares(panel, axis, [item for item in where if item.axis == axis], p_value)
    axes[0].set_ylabel('share of the misfit (%)')
    legend(axes[0], loc='best')
    same_height(axes, low=0.0)
    return Picture(
        '05_shares',
        'Which share of the misfit lies where',
        'Misfit of the previous model, split along each axis. Blue bars exceed noise (p-value '
        f'below {p_value:g}), grey bars do not. Dashed outlines: the share of all observations '
        'that lies there; if bars and outlines agree, the misfit is uniform. The axis on which '
        'they differ indicates the cause: force the load-bearing properties, direction or time '
        'an effect with memory, pressure alone the inflation.',
        figure,
    )


def draw_shares(axes: Axes, axis: Axis, shares: Sequence[Share], p_value: float) -> None:
    """Draw the shares of one axis as bars, significant ones (below p_value) in blue."""
    label, scale = WORDS[axis]
    heights = [100.0 * item.share for item in shares]
    seen = [100.0 * item.seen for item in shares]
    outline: dict[str, Any] = {
        'fill': False,
        'edgecolor': '0.25',
        'linewidth': 1.0,
        'linestyle': (0, (3, 2)),
    }
    colors = [FIRST if item.p_value < p_value else '#b5b5b5' for item in shares]
    if axis == 'direction':
        places = np.arange(len(shares))
        signs = {-1: 'falling', 0: 'held', 1: 'rising'}
        names = [signs[int(np.sign(item.start))] for item in shares]
        axes.bar(places, heights, 0.6, color=colors)
        axes.bar(places, seen, 0.6, label='of the observations', **outline)
        axes.set_xticks(places, names)
    else:
        start = scale * np.array([item.start for item in shares])
        width = scale * np.array([item.stop for item in shares]) - start
        axes.bar(start, heights, width, align='edge', color=colors, edgecolor='white')
        axes.bar(start, seen, width, align='edge', label='of the observations', **outline)
    axes.grid(visible=False, axis='x')
    axes.set(xlabel=label)
