"""Text from files on a terminal: it says what it says, and does nothing."""

from __future__ import annotations

from pneunet_ros.cli.verb import output_console
from pneunet_ros.core.errors import LONGEST_SENTENCE, RecordingError, shorten
from pneunet_ros.core.printable import printable
import pytest
from rich.table import Table


@pytest.mark.parametrize(
    ('text', 'shown'),
    [
        ('/arm/κ₀ – 5 µm\n\tx', '/arm/κ₀ – 5 µm\n\tx'),
        ('\x1b[2J\x07', r'\x1b[2J\x07'),
        ('a\rb\0', r'a\rb\x00'),
        ('\u202etxt.exe', r'\u202etxt.exe'),
        ('\udcff\ud800', r'\udcff\ud800'),
    ],
)
def test_what_would_move_the_cursor_is_an_escape(text, shown):
    assert printable(text) == shown
    assert printable(text).encode()


def test_no_line_cell_or_title_of_a_console_is_markup_or_a_command(capsys):
    name = '[/] [bold]x[/bold] :smile: \x1b[31m'
    table = Table(title=f'title {name}')
    table.add_column(f'head {name}')
    table.add_row(f'cell {name}')
    console = output_console()
    console.print(table)
    console.print(f'line {name}')
    told = capsys.readouterr().out
    assert '\x1b' not in told
    for place in ('title', 'head', 'cell', 'line'):
        assert f'{place} [/] [bold]x[/bold] :smile: \\x1b[31m' in told


def test_a_sentence_keeps_its_beginning_and_its_end():
    sentence = str(RecordingError(f'r.mcap has no topic {"a" * 10**6}: give --topic'))
    assert len(sentence) < LONGEST_SENTENCE + 10
    assert sentence.startswith('r.mcap has no topic aaa')
    assert sentence.endswith('aaa: give --topic')
    assert str(RecordingError(RecordingError('short'))) == 'short'
    assert shorten('as it is') == 'as it is'
