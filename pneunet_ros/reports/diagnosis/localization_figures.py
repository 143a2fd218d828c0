"""Maps of the misfit over arclength and operating conditions."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, TwoSlopeNorm
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import kilopascals
from pneunet_ros.diagnosis.result import Axis, HeatMap
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.figure import Picture
from pneunet_ros.reports.style import panels

ALONE = 0.1  # s / l, width of the cell of a single target
HIGHEST = 8.0  # times the noise: more is drawn alike
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


def maps(data: FigureData) -> Picture | None:
    """Draw heat maps of the whitened residual, before and after."""
    heat_maps = data.diagnosis.heat_maps
    if not heat_maps:
        return None
    wide = len(data.models)
    figure, axes = panels(wide, rows=len(heat_maps), height=0.8 + 2.3 * len(heat_maps))
    cells = np.concatenate(
        [cell.ravel() for item in heat_maps for cell in (item.before, item.after)]
    )
    cells = cells[np.isfinite(cells)]
    largest = float(cells.max()) if cells.size else 2.0
    norm = TwoSlopeNorm(1.0, vmin=0.0, vmax=min(max(largest, 2.0), HIGHEST))
    for row, item in enumerate(heat_maps):
        for column, (when, _) in enumerate(data.models):
            values = item.before if column == 0 else item.after
            draw_map(axes[wide * row + column], item, values, norm)
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
    return np.concatenate([[max(first, 0.0)], middle, [min(last, 1.0)]])
