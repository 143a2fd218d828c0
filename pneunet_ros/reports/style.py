"""Common style of figures: size, axes, one color per pressure, dots, bands and bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.printable import printable
from pneunet_ros.core.units import kilopascals

WIDTH = 11.0  # inches, a page
HEIGHT = 4.6
FIRST, SECOND, THIRD, GREY = '#1f5a96', '#d1603d', '#4c9a6a', '#6f6f6f'
MEASURED = '#222222'
BAND_SIGMAS = 2.0
FORCE_SCALE = 100.0  # mm of arrow per newton
SHORTEST_NAME = 22  # letters of a recording's name under an axis
Color = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureColors:
    """Colors for pressures from low to high (Pa), dark for low ones; readable on white."""

    low: float
    high: float

    @property
    def scale(self) -> ScalarMappable:
        """The color scale in kPa."""
        # The last tenth of viridis is too bright for thin lines on a white background.
        colors = ListedColormap(colormaps['viridis'](np.linspace(0.0, 0.9, 256)))
        high = max(self.high, self.low + 1.0)
        return ScalarMappable(Normalize(kilopascals(self.low), kilopascals(high)), colors)

    def __call__(self, pressure: float) -> Color:
        """Return the color of a pressure (Pa)."""
        ((red, green, blue, alpha),) = self.scale.to_rgba(np.array([kilopascals(pressure)]))
        return float(red), float(green), float(blue), float(alpha)

    def bar(self, figure: Figure, axes: Axes) -> None:
        """Draw the color bar."""
        figure.colorbar(self.scale, ax=axes, label='pressure (kPa)', fraction=0.05, pad=0.02)


def panels(
    columns: int, rows: int = 1, height: float = HEIGHT, width: float = WIDTH
) -> tuple[Figure, list[Axes]]:
    """Return a figure with the width of a page, and its axes row by row."""
    figure = Figure(figsize=(width, height), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for panel in axes:
        panel.grid(color='0.92', linewidth=0.7)
        panel.set_axisbelow(True)
        panel.spines[['top', 'right']].set_visible(False)
    return figure, axes


def small_multiples(
    count: int, most: int, height: float, more: float = 0.0
) -> tuple[Figure, list[Axes], int]:
    """Return a figure, its axes, and the number of columns, at most `most`.

    height: of a row; more: additional height.
    """
    columns = min(most, count)
    rows = -(-count // columns)
    figure, axes = panels(columns, rows, height=more + height * rows)
    for panel in axes[count:]:
        panel.set_visible(False)
    return figure, axes[:count], columns


def as_shapes(axes: Axes, title: str) -> None:
    """Label axes that show centerlines, and mark the clamp."""
    axes.plot(0.0, 0.0, marker='s', color='black', markersize=7, zorder=5)
    axes.set(title=title, xlabel='x (mm)', ylabel='y (mm)')
    axes.set_aspect('equal', adjustable='datalim')


def legend(axes: Axes, **where: Any) -> None:
    """Draw a legend that covers as little data as possible; none if nothing is drawn."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=True, framealpha=0.85, edgecolor='none', fontsize=9, **where)


def same_height(axes: Sequence[Axes], low: float | None = None) -> None:
    """Give axes common vertical limits, from `low` if given."""
    limits = [panel.get_ylim() for panel in axes]
    bottom = min(limit[0] for limit in limits) if low is None else low
    for panel in axes:
        panel.set_ylim(bottom, max(limit[1] for limit in limits))


def draw_force(axes: Axes, tip: Array, force: Array, color: Any) -> None:
    """Draw an end force (N) as an arrow at the free end (mm)."""
    head = tip + FORCE_SCALE * force
    if np.all(np.isfinite(head)):
        arrow = {'arrowstyle': '->', 'color': color, 'linewidth': 1.0, 'alpha': 0.7}
        axes.annotate('', xy=tuple(head.tolist()), xytext=tuple(tip.tolist()), arrowprops=arrow)
        axes.update_datalim([head])


def draw_dots(axes: Axes, x: Array, y: Array, size: float, **style: Any) -> None:
    """Draw measured points as dots."""
    axes.plot(x, y, linestyle='', marker='o', markersize=size, markeredgewidth=0.0, **style)


def draw_band(
    axes: Axes, x: Array, value: Array, std: Array, color: Any, alpha: float = 0.25
) -> None:
    """Shade the 2 sigma band of a value."""
    width = BAND_SIGMAS * std
    axes.fill_between(x, value - width, value + width, color=color, alpha=alpha, linewidth=0)


def draw_errors(axes: Axes, x: Array, y: Array, std: Array, **style: Any) -> None:
    """Draw points with bars of 2 sigma."""
    style = {'marker': 'o'} | style
    axes.errorbar(x, y, yerr=BAND_SIGMAS * std, linestyle='', **style)


def draw_bars(
    axes: Axes,
    values: Sequence[float],
    form: str,
    *,
    place: Any = None,
    width: float = 0.6,
    label_style: Any = None,
    **style: Any,
) -> None:
    """Draw bars with their values on top, at 0, 1, ... or at these positions."""
    where = np.arange(len(values)) if place is None else place
    bars = axes.bar(where, values, width=width, **style)
    label_style = {'fontsize': 9, 'padding': 2} | (label_style or {})
    axes.bar_label(bars, labels=[form.format(value) for value in values], **label_style)
    axes.grid(visible=False, axis='x')


def short(name: str) -> str:
    """Shorten the name of a recording: the file, without its folder and suffix."""
    last = name.rstrip('/').rsplit('/', 1)[-1]
    stem = last.removesuffix('.mcap')
    return figure_text(stem if len(stem) <= SHORTEST_NAME else f'{stem[: SHORTEST_NAME - 1]}…')


def figure_text(text: str) -> str:
    """Escape a text for matplotlib, so that a $ does not start a formula."""
    return printable(text).replace('$', r'\$')
