"""CSV files, damaged in any way, and hostile ones: readings or a sentence, in bounded memory."""

from __future__ import annotations

from pathlib import Path

from hypothesis import strategies as st
import numpy as np
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.tables import csv_table, table_reader
from pneunet_ros.tables.reading_table import ReadingTable
from pneunet_ros.tables.table_reader import ImportRequest, read_table
import pytest
from support.fuzzing import AMOUNTS, answer, damaged_bytes, damaged_text, fuzz

TABLE = (
    'time_s,pressure_kpa,force_x_n,force_y_mn,moment_n_mm,x0_m,y0_m,x2_mm,y2_mm\n'
    '0.5,31.5,0.175,70,2,0.001,0.002,30,-4\n'
    '0.51,32,0.17,71,,0,0,nan,5\n'
    '0.52,,,,,,,,\n'
)
NAMES = [
    'stamp_ns', 'time_s', 'time_us', 'pressure_kpa', 'pressure_psi', 'force_x_n', 'force_a_gf',
    'angle_a_deg', 'force_b_n', 'angle_b_rad', 'moment_n_m', 'x0_m', 'y0_m', 'x499_mm', 'y499_mm',
    'x500_m', 'x1_m', 'estimate_x', 'other', '',
]  # fmt: skip
FORMULAS = ['=1+1', "=cmd|' /C calc'!A0", '@SUM(A1)', '+1', '-2+3', '=HYPERLINK("http://x")']
NUMBERS = ['0', '1', '-0', '1e308', '-1e308', '1e-320', '0e999999999', '0e-999999999', '1e400']
NUMBERS += [
    'nan',
    'NaN',
    'sNaN',
    'inf',
    '١٢',
    '1_000',
    '0x10',
    ' 1 ',
    '1.',
    '.5',
    '1,5',
    '"2"',
    '9' * 199,
]
CELLS = st.sampled_from([*FORMULAS, *NUMBERS, '', '"', '\0', '\r', 'x' * 300]) | st.floats().map(
    repr
)
REQUESTS = st.builds(
    ImportRequest,
    select=st.sampled_from([{}, {'other': '1'}, {'pressure_kpa': '31.5'}]),
    rename=st.sampled_from([{}, {'other': 'pressure_pa'}, {'x0_m': 'y0_m'}]),
    ignore=st.sampled_from([(), ('other',), ('x0_m', 'y0_m')]),
    offsets=st.sampled_from(
        [{}, {'time_s': 1e300}, {'pressure_kpa': 1e308}, {'x0_m': float('nan')}]
    ),
    rate=st.sampled_from([None, 10.0, 1e-6, 0.0, float('nan'), -1.0]),
)


def check(path: Path, request: ImportRequest) -> None:
    """Read a table: readings in order, or an error that names the file or the option."""
    found = answer(read_table, path, request)
    if isinstance(found, (RecordingError, RequestError)):
        assert str(path) in str(found) or '--' in str(found)
        return
    table, sentences = found
    assert isinstance(table, ReadingTable)
    assert np.all(np.diff(table.stamp_ns) > 0)
    assert not np.any(np.isinf(table.values['pressure'][:, 0]))
    assert all(isinstance(sentence, str) for sentence in sentences)


@AMOUNTS
def test_any_bytes_are_read_or_refused(tmp_path, examples):
    path = tmp_path / 'table.csv'

    def body(raw: bytes, request: ImportRequest) -> None:
        path.write_bytes(raw)
        check(path, request)

    texts = damaged_text(TABLE, CELLS | st.text(max_size=4) | st.sampled_from(NAMES))
    raw = damaged_bytes(TABLE.encode()) | texts.map(lambda text: text.encode('utf-8', 'ignore'))
    fuzz(examples, body, raw=raw, request=REQUESTS)


@AMOUNTS
def test_any_table_is_read_or_refused(tmp_path, examples):
    path = tmp_path / 'table.csv'
    names = st.lists(st.sampled_from(NAMES), min_size=1, max_size=6, unique=True)
    cells = st.lists(CELLS, min_size=6, max_size=6)

    def body(names: list[str], rows: list[list[str]], request: ImportRequest) -> None:
        lines = [names, *(row[: len(names)] for row in rows)]
        path.write_text('\n'.join(','.join(line) for line in lines), encoding='utf-8')
        check(path, request)

    rows = st.lists(cells, max_size=4)
    fuzz(examples, body, names=names, rows=rows, request=REQUESTS)


@pytest.mark.parametrize('formula', FORMULAS)
def test_formulas_are_texts_and_no_numbers(tmp_path, formula):
    path = tmp_path / 'table.csv'
    path.write_text(f'time_s,pressure_pa\n1,"{formula.replace(chr(34), chr(34) * 2)}"\n')
    found = answer(read_table, path, ImportRequest())
    if formula == '+1':
        assert found[0].values['pressure'].tolist() == [[1.0]]
    else:
        assert found.reason == 'not_a_number'


def refusal(path: Path) -> Note:
    found = answer(read_table, path, ImportRequest())
    assert isinstance(found, RecordingError)
    return Note(str(found), reason=found.reason)


def test_a_line_without_end_is_not_read_to_its_end(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_pa\n1,' + ' ' * 3_000_000 + '2\n')
    assert 'line 2' in refusal(path)
    endless = Path('/dev/zero')
    if endless.exists():
        assert refusal(endless).reason == 'unreadable'


def test_a_quoted_cell_over_the_whole_file_is_refused(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_pa\n1,"' + '2\n' * 500_000)
    assert str(path) in refusal(path)


def test_few_columns_do_not_make_many_targets(tmp_path, monkeypatch):
    monkeypatch.setattr(table_reader, 'MOST_PLACES', 999)
    path = tmp_path / 'table.csv'
    path.write_text('time_s,x499_m,y499_m\n1,0,0\n')
    assert answer(read_table, path, ImportRequest())[0].values['targets'].shape == (1, 2, 500)
    path.write_text('time_s,x499_m,y499_m\n1,0,0\n2,0,0\n')
    assert refusal(path).reason == 'too_large'


def test_the_cells_of_a_table_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(csv_table, 'MOST_CELLS', 5)
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_pa\n1,0\n2,0\n')
    answer(read_table, path, ImportRequest())[0]
    path.write_text('time_s,pressure_pa\n1,0\n2,0\n3,0\n')
    assert refusal(path).reason == 'too_large'
