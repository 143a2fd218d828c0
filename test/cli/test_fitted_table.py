"""Tables on narrow terminals: whatever the width, every word is there."""

from __future__ import annotations

import io

from pneunet_ros.cli.fitted_table import print_table
import pytest
from rich.console import Console
from rich.table import Table

HEADER = ('effect', 'parameter', 'detection limit', 'observable')
ROWS = [
    ('pressure_elongation', 'strain_per_pascal_squared', 'from 8.31e-13 1/Pa^2', 'yes'),
    ('clamp_compliance', 'compliance', 'from 1.42 rad/(N m)', 'no'),
]


def printed(width: int, table: Table) -> list[str]:
    console = Console(width=width, file=io.StringIO(), markup=False)
    print_table(console, table)
    return console.file.getvalue().splitlines()


def full_table() -> Table:
    table = Table(title='Detection limits')
    for name in HEADER:
        table.add_column(name)
    for row in ROWS:
        table.add_row(*row)
    return table


@pytest.mark.parametrize('width', [52, 60, 80, 100, 120])
def test_no_word_is_cut_or_broken(width):
    lines = printed(width, full_table())
    assert max(map(len, lines)) <= width
    words = set(' '.join(lines).split())
    assert {word for text in (*HEADER, *sum(ROWS, ())) for word in text.split()} <= words


def test_where_there_is_room_a_table_is_as_rich_prints_it():
    console = Console(width=120, file=io.StringIO())
    console.print(full_table())
    assert printed(120, full_table()) == console.file.getvalue().splitlines()


def test_every_part_says_of_what_it_is():
    lines = printed(60, full_table())
    assert sum('pressure_elongation' in line for line in lines) > 1
    assert sum('Detection limits' in line for line in lines) == 1


def test_names_of_topics_and_types_break_after_a_slash():
    table = Table()
    for name in ('topic', 'type', 'count'):
        table.add_column(name)
    table.add_row('/pneunet/image_raw/compressed', 'sensor_msgs/msg/CompressedImage', '241')
    table.add_row('/pneunet/pressure', 'sensor_msgs/msg/FluidPressure', '481')
    lines = printed(60, table)
    assert max(map(len, lines)) <= 60
    words = {word for line in lines for word in line.split()}
    assert {'/pneunet/image_raw/', 'compressed', '/pneunet/pressure'} <= words
    assert {'sensor_msgs/msg/', 'CompressedImage', 'FluidPressure'} <= words


def test_a_word_that_no_width_holds_is_folded():
    table = Table(show_header=False)
    for _ in range(2):
        table.add_column()
    table.add_row('output', 'a' * 30 + 'b' * 30 + 'c' * 30)
    lines = printed(40, table)
    assert max(map(len, lines)) <= 40
    assert [''.join(lines).count(letter) for letter in 'abc'] == [30, 30, 30]


def test_a_table_without_rows_is_a_sentence():
    table = Table(title='r.mcap, 0 s')
    table.add_column('topic')
    assert printed(80, table) == ['r.mcap, 0 s: none']
