"""The contract of a figure of a report, and how a report draws its table of them.

A figure is a function in a file of its report's room: it takes the report's data and returns a
`Picture`, or None where the data have nothing to show. The room's `figures.py` lists it under the
part of the page in which it stands.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import io
from typing import Any, TypeVar

from matplotlib import rc_context
from matplotlib.figure import Figure
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.core.unit_system import SI, UnitSystem
from pneunet_ros.reports.axis_units import use_units

DOTS_PER_INCH = 120
LARGEST_SVG = 400_000  # bytes; a figure with more to draw stands in the page as PNG


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A drawn figure: `number` as in the paper or '', a title, and what one should see."""

    name: str
    number: str
    title: str
    caption: str
    figure: Figure

    @property
    def file(self) -> str:
        """Name of its file."""
        return f'figure_{self.name}.png'

    @property
    def png(self) -> bytes:
        """The picture as PNG, for its file."""
        # Without software and date, so that the same result gives the same file.
        return self._rendered(format='png', dpi=DOTS_PER_INCH, metadata={'Software': None})

    @property
    def inline(self) -> str:
        """The picture as a URL that holds it: as SVG where that is not too large."""
        # Letters as outlines: it looks the same wherever it is opened.
        with rc_context({'svg.fonttype': 'path', 'svg.hashsalt': self.name}):
            svg = self._rendered(format='svg', metadata={'Date': None, 'Creator': None})
        kind, content = ('svg+xml', svg) if len(svg) <= LARGEST_SVG else ('png', self.png)
        return f'data:image/{kind};base64,{base64.b64encode(content).decode()}'

    def _rendered(self, **how: Any) -> bytes:
        out = io.BytesIO()
        self.figure.savefig(out, **how)
        return out.getvalue()


Data = TypeVar('Data')
Figures = Mapping[str, Sequence[Callable[[Data], Picture | None]]]  # by part of the page
Pictures = Mapping[str, Sequence[Picture]]


def picture(name: str, title: str, caption: str, figure: Figure, number: str = '') -> Picture:
    """Return a drawn figure as a picture."""
    return Picture(name=name, number=number, title=title, caption=caption, figure=figure)


def units_note(units: UnitSystem) -> str:
    """Describe what the axes of figures were divided by; '' where they are in SI."""
    if units is SI:
        return ''
    length, force = units.length, units.force
    return (
        f'Axes are dimensionless: lengths by l = {1000.0 * length.size:g} mm, forces by mg = '
        f'{force.size:g} N, moments by mg l, curvature by 1/l.'
    )


def draw_figures(
    figures: Figures[Data], data: Data, on_progress: OnProgress, units: UnitSystem = SI
) -> Pictures:
    """Draw all figures of a table that there is something for, by part of the page.

    units: of the axes; in SI they are as the figures have them, in mm and mN m.
    """
    total, done = sum(map(len, figures.values())), 0
    pictures: dict[str, list[Picture]] = {part: [] for part in figures}
    for part, draws in figures.items():
        for draw in draws:
            on_progress('pictures', done, total)
            drawn = draw(data)
            if drawn is not None:
                use_units(drawn.figure, units)
                pictures[part].append(drawn)
            done += 1
    on_progress('pictures', total, total)
    return pictures
