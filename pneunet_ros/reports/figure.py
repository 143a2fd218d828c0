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
from typing import TypeVar

from matplotlib.figure import Figure
from pneunet_ros.core.progress import OnProgress

DOTS_PER_INCH = 120


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A drawn figure: `number` as in the paper or '', a title, and what one should see."""

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


Data = TypeVar('Data')
Figures = Mapping[str, Sequence[Callable[[Data], Picture | None]]]  # by part of the page
Pictures = Mapping[str, Sequence[Picture]]


def picture(name: str, title: str, caption: str, figure: Figure, number: str = '') -> Picture:
    """Return a drawn figure as a picture."""
    out = io.BytesIO()
    # Without software and date, so that the same result gives the same file.
    figure.savefig(out, dpi=DOTS_PER_INCH, format='png', metadata={'Software': None})
    return Picture(name=name, number=number, title=title, caption=caption, png=out.getvalue())


def draw_figures(figures: Figures[Data], data: Data, on_progress: OnProgress) -> Pictures:
    """Draw all figures of a table that there is something for, by part of the page."""
    total, done = sum(map(len, figures.values())), 0
    pictures: dict[str, list[Picture]] = {part: [] for part in figures}
    for part, draws in figures.items():
        for draw in draws:
            on_progress('pictures', done, total)
            drawn = draw(data)
            pictures[part] += [] if drawn is None else [drawn]
            done += 1
    on_progress('pictures', total, total)
    return pictures
