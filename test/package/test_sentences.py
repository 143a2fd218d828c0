"""Every refusal and note of a room, as people see it, stands in one table beside its tests.

    python test/package/test_sentences.py      # rewrites the tables after a rewording

Read the table when you change a sentence: what happened, the likely cause, and what to do.
"""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.sentences import ROOMS, table_file, table_of


@pytest.mark.parametrize('room', [room for room in ROOMS if table_of(room)])
def test_the_table_has_the_sentences_of_the_room(room):
    assert table_file(room).read_text(encoding='utf-8') == table_of(room)


if __name__ == '__main__':
    for each in ROOMS:
        if table_of(each):
            table_file(each).write_text(table_of(each), encoding='utf-8')
