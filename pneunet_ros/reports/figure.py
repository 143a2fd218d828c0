"""Interface of figures in reports, and drawing of the figures in a table.

A figure is a function in the package of its report that takes the data of the report and returns a
`Picture`, or None if there is nothing to show. `figures.py` of this package lists the figure under
its part of the page.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import io
from typing import Any, TypeVar

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure
from pneunet_ros.core.printable import printable
from pneunet_ros.core.progress import OnProgress

DOTS_PER_INCH = 120
LARGEST_SVG = 400_000  # bytes; a larger figure is embedded in the page as PNG


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A drawn figure: title, caption, and its `number` in the paper or ''."""

    name: str
    title: str
    caption: str
    figure: Figure
    number: str = ''

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
        """The picture as a data URL: SVG, unless it is too large."""
        # Letters as outlines, so that the figure looks the same everywhere.
        with rc_context({'svg.fonttype': 'path', 'svg.hashsalt': self.name}):
            svg = self._rendered(format='svg', metadata={'Date': None, 'Creator': None})
        kind, content = ('svg+xml', svg) if len(svg) <= LARGEST_SVG else ('png', self.png)
        return f'data:image/{kind};base64,{base64.b64encode(content).decode()}'

    def _rendered(self, **how: Any) -> bytes:
        if self.figure.get_layout_engine() is not None:
            # The layout is computed once: otherwise every savefig would draw the figure twice.
            self.figure.draw_without_rendering()
            self.figure.set_layout_engine(None)
        out = io.BytesIO()
        self.figure.savefig(out, **how)
        return out.getvalue()


Data = TypeVar('Data')
Figures = Mapping[str, Sequence[Callable[[Data], Picture | None]]]  # by part of the page
Pictures = Mapping[str, Sequence[Picture]]


def draw_figures(figures: Figures[Data], data: Data, on_progress: OnProgress) -> Pictures:
    """Draw all figures of a table that have data, by part of the page."""
    total, done = sum(map(len, figures.values())), 0
    pictures: dict[str, list[Picture]] = {part: [] for part in figures}
    for part, draws in figures.items():
        for draw in draws:
            on_progress('pictures', done, total)
            drawn = draw(data)
            if drawn is not None:
                pictures[part].append(drawn)
            done += 1
    on_progress('pictures', total, total)
    return pictures


def render_page(template: str, **content: Any) -> str:
    """Return the page; its content is escaped as text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader('pneunet_ros.reports'),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return printable(environment.get_template(template).render(**content))
