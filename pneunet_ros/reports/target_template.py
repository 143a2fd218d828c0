"""A printable sheet for placing targets: strips of dots at full scale, and a ruler."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import millimeters

PAGES = {'A4': (210.0, 297.0), 'letter': (215.9, 279.4)}  # mm, width and height
MILLIMETERS_PER_INCH = 25.4
MARGIN = 12.0  # mm, margin that every printer can print
RULER = 100.0  # mm
STRIP = 12.0  # mm, least width
GAP = 6.0  # mm between strips
LABEL, CHARACTER = 5.0, 1.05  # points, and about the width of a character of it, mm
STRIPS = (
    ('black dots, for a pale arm', 'white', 'black', True),
    ('white dots, for a dark arm', 'black', 'white', True),
    ('outlines, to be punched out and painted through', 'white', 'none', False),
)


def write_template(path: Path, name: str, places: Array, diameter: float) -> None:
    """Write the PDF: one page for A4 and one for letter paper, each complete.

    places (targets,) and diameter in m. Raises RequestError for an arm longer than a page.
    """
    with PdfPages(path, metadata={'CreationDate': None, 'Creator': None, 'Producer': None}) as pdf:
        for paper in PAGES:
            pdf.savefig(template_page(paper, name, places, diameter))


def template_page(paper: str, name: str, places: Array, diameter: float) -> Figure:
    """Draw a page whose axes are in millimeters of paper."""
    width, height = PAGES[paper]
    shown, dot = np.array([millimeters(place) for place in places.tolist()]), diameter * 1e3
    length = float(shown[-1] - shown[0]) + 2.0 * dot
    if length > height - 2.0 * MARGIN:
        raise RequestError(
            f'a row of targets of {length:.0f} mm is longer than a page of {paper}: place the '
            'dots with a ruler (--no-template)',
            reason='too_large',
        )
    figure = Figure(figsize=(width / MILLIMETERS_PER_INCH, height / MILLIMETERS_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.set_axis_off()
    start = MARGIN + dot
    strip = max(STRIP, 2.0 * dot)
    left = MARGIN
    gaps = ', '.join(f'{gap:g}' for gap in np.unique(np.round(np.diff(shown), 4)))
    first = f'{shown[0]:g} mm from the clamp' if shown[0] else 'to the clamp'
    for words, paper_color, color, filled in STRIPS:
        _draw_strip(axes, (left, start - dot), strip, length, paper_color)
        for place in shown - shown[0]:
            center = (left + 0.5 * strip, start + place)
            _draw_dot(axes, center, dot, color, filled)
        _label_strip(
            axes,
            (left, start - dot),
            (strip, length),
            color,
            ('CLAMP SIDE' if shown[0] else 'CLAMP', 'FREE END'),
            name,
            f'dots {dot:g} mm, every {gaps} mm',
        )
        axes.text(
            left + strip + 1.5, start, words, rotation=90, fontsize=7, va='bottom', ha='left'
        )
        left += strip + GAP + 4.0
    _draw_places(axes, left, start, shown)
    _draw_ruler(axes, width - MARGIN - 8.0, MARGIN + 2.0)
    axes.text(
        0.5 * width + 20.0,
        height - MARGIN,
        f'Targets of {name}\n\n{shown.size} dots of {dot:g} mm, {gaps} mm apart\n{paper}: print '
        'at 100 %, never "fit to page";\nthen check the scale with a ruler: it must be '
        f'{RULER:g} mm.\n\nThe dot at the bottom (0) goes {first}.',
        fontsize=9,
        va='top',
        ha='center',
    )
    return figure


def _draw_strip(
    axes: Axes, corner: tuple[float, float], width: float, length: float, color: str
) -> None:
    axes.add_patch(
        Rectangle(corner, width, length, facecolor=color, edgecolor='0.6', linewidth=0.4)
    )


def _label_strip(
    axes: Axes,
    corner: tuple[float, float],
    size: tuple[float, float],
    color: str,
    ends: tuple[str, str],
    name: str,
    dots: str,
) -> None:
    """Label a strip for cutting out, with the arm and its ends.

    Ends and arm are named left of the dots, the dots on the right. Text that is too long for the
    strip is cut off.
    """
    room = int(size[1] / CHARACTER) - 2
    between = room - sum(map(len, ends)) - 4
    ink = 'black' if color == 'none' else color
    style: dict[str, Any] = {'rotation': 90, 'fontsize': LABEL, 'color': ink}
    x, y = corner
    left_edge, right_edge = x + 0.8, x + size[0] - 0.8
    axes.text(left_edge, y + 1.0, ends[0], va='bottom', ha='left', weight='bold', **style)
    axes.text(left_edge, y + size[1] - 1.0, ends[1], va='top', ha='left', **style)
    middle = y + 0.5 * size[1]
    axes.text(left_edge, middle, name[: max(between, 0)], va='center', ha='left', **style)
    axes.text(right_edge, y + 1.0, dots[:room], va='bottom', ha='right', **style)


def _draw_dot(
    axes: Axes, center: tuple[float, float], diameter: float, color: str, filled: bool
) -> None:
    line = 0.0 if filled else 0.3
    edge = 'none' if filled else 'black'
    axes.add_patch(Circle(center, 0.5 * diameter, facecolor=color, edgecolor=edge, linewidth=line))
    if not filled:
        for across, along in ((0.9, 0.0), (0.0, 0.9)):
            axes.plot(
                [center[0] - across * diameter, center[0] + across * diameter],
                [center[1] - along * diameter, center[1] + along * diameter],
                color='black',
                linewidth=0.2,
            )


def _draw_places(axes: Axes, left: float, start: float, shown: Array) -> None:
    """Write position (mm from the clamp) and number next to every target."""
    for number, place in enumerate(shown.tolist()):
        at = start + place - shown[0]
        axes.plot([left - 2.0, left], [at, at], color='0.4', linewidth=0.3)
        axes.text(left + 1.0, at, f'{number}: {place:g} mm', fontsize=6, va='center')


def _draw_ruler(axes: Axes, x: float, start: float) -> None:
    """Draw a scale with a line every millimeter."""
    axes.plot([x, x], [start, start + RULER], color='black', linewidth=0.4)
    for tick in range(int(RULER) + 1):
        size = 5.0 if tick % 10 == 0 else 3.5 if tick % 5 == 0 else 2.0
        axes.plot([x, x + size], [start + tick] * 2, color='black', linewidth=0.25)
        if tick % 10 == 0:
            axes.text(x - 1.0, start + tick, f'{tick}', fontsize=6, va='center', ha='right')
    axes.text(x + 2.0, start + RULER + 3.0, 'mm', fontsize=7, ha='center')
