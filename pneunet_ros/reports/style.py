"""What the pictures of a report have in common: size, axes, one color per pressure, captions."""

from __future__ import annotations

import base64
from dataclasses import dataclass
import io
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.core.units import kilopascals

WIDTH = 11.0  # inches, a page
HEIGHT = 4.6
DOTS_PER_INCH = 120
FIRST, SECOND, THIRD, GREY = '#1f5a96', '#d1603d', '#4c9a6a', '#6f6f6f'
MEASURED = '#222222'
BAND_SIGMAS = 2.0
SHORTEST_NAME = 22  # letters of a recording's name under an axis
Color = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A figure of a report: `number` as in the paper or '', a title, and what one should see."""

    name: str
    number: str
    title: str
    caption: str
    png: bytes

    @property
    def file(self) -> str:
        """Name of its file."""
        return f'figure_{self.name}.png'

    @property
    def inline(self) -> str:
        """The picture as a URL that holds it."""
        return f'data:image/png;base64,{base64.b64encode(self.png).decode()}'


def picture(name: str, title: str, caption: str, figure: Figure, number: str = '') -> Picture:
    """Return a drawn figure as a picture."""
    out = io.BytesIO()
    # Without software and date, so that the same calibration gives the same file.
    figure.savefig(out, dpi=DOTS_PER_INCH, format='png', metadata={'Software': None})
    return Picture(name=name, number=number, title=title, caption=caption, png=out.getvalue())


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureColors:
    """A color for every pressure between low and high (Pa): dark is low; readable on white."""

    low: float
    high: float

    @property
    def scale(self) -> ScalarMappable:
        """Colors over kPa."""
        # The last tenth of viridis is too bright for thin lines on white.
        colors = ListedColormap(colormaps['viridis'](np.linspace(0.0, 0.9, 256)))
        high = max(self.high, self.low + 1.0)
        return ScalarMappable(Normalize(kilopascals(self.low), kilopascals(high)), colors)

    def __call__(self, pressure: float) -> Color:
        """Return the color of a pressure (Pa)."""
        ((red, green, blue, alpha),) = self.scale.to_rgba(np.array([kilopascals(pressure)]))
        return float(red), float(green), float(blue), float(alpha)

    def bar(self, figure: Figure, axes: Axes) -> None:
        """Draw the scale beside some axes."""
        figure.colorbar(self.scale, ax=axes, label='pressure (kPa)', fraction=0.05, pad=0.02)


def panels(columns: int, rows: int = 1, height: float = HEIGHT) -> tuple[Figure, list[Axes]]:
    """Return a figure of page width and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for one in axes:
        one.grid(color='0.92', linewidth=0.7)
        one.set_axisbelow(True)
        one.spines[['top', 'right']].set_visible(False)
    return figure, axes


def as_shapes(axes: Axes, title: str) -> None:
    """Label axes that show centerlines, and mark the clamp."""
    axes.plot(0.0, 0.0, marker='s', color='black', markersize=7, zorder=5)
    axes.set(title=title, xlabel='x (mm)', ylabel='y (mm)')
    axes.set_aspect('equal', adjustable='datalim')


def legend(axes: Axes, **where: Any) -> None:
    """Draw a legend that hides as little as it can."""
    axes.legend(frameon=True, framealpha=0.85, edgecolor='none', fontsize=9, **where)


def short(name: str) -> str:
    """Shorten the name of a recording: the file, without its folder and suffix."""
    last = name.rstrip('/').rsplit('/', 1)[-1]
    stem = last.removesuffix('.mcap')
    return stem if len(stem) <= SHORTEST_NAME else f'{stem[: SHORTEST_NAME - 1]}…'
