"""Pictures of a report: sharp in the page where that is small, the same for the same figure."""

from __future__ import annotations

import base64

from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.reports import figure as report_figure
from pneunet_ros.reports.figure import draw_figures, Picture


def drawn(name: str = '01_dots') -> Picture:
    figure = Figure()
    axes = figure.subplots()
    axes.plot(*np.random.default_rng(1).normal(size=(2, 50)), 'o')
    axes.set(xlabel='x (mm)', ylabel=r'$\kappa$ (1/m)')
    return Picture(name, 'Dots', 'See the dots.', figure)


def content(item: Picture, kind: str) -> bytes:
    head = f'data:image/{kind};base64,'
    assert item.inline.startswith(head)
    return base64.b64decode(item.inline.removeprefix(head))


def test_the_page_has_an_svg_without_anything_from_elsewhere():
    svg = content(drawn(), 'svg+xml').decode()
    assert svg.count('<svg') == 1
    assert '<script' not in svg
    assert 'date' not in svg  # the same result gives the same file
    assert content(drawn(), 'svg+xml').decode() == svg


def test_a_large_figure_stands_in_the_page_as_png(monkeypatch):
    item = drawn()
    monkeypatch.setattr(report_figure, 'LARGEST_SVG', 1000)
    assert content(item, 'png').startswith(b'\x89PNG')


def test_the_file_beside_the_page_is_a_png_of_its_name():
    item = drawn('07_moments')
    assert item.file == 'figure_07_moments.png'
    assert item.png.startswith(b'\x89PNG')
    assert item.png == drawn('07_moments').png


def test_figures_of_a_table_are_drawn_where_there_is_something_to_show():
    table = {'part': (lambda data: drawn(), lambda data: None)}
    told = []
    found = draw_figures(table, None, lambda *news: told.append(news))
    (item,) = found['part']
    (axes,) = item.figure.get_axes()
    assert axes.get_xlabel() == 'x (mm)'
    assert told[-1] == ('pictures', 2, 2)
