"""Tables with named unit columns: what they mean in SI, and what is refused with its place."""

from __future__ import annotations

import math
import re
import shlex

import numpy as np
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.tables import csv_table
from pneunet_ros.tables.columns import column_of, KINDS, known_names, likely_name, standard_name
from pneunet_ros.tables.reading_table import columns
from pneunet_ros.tables.table_reader import ImportRequest, read_table, string_force
import pytest
from support.refusals import reasons, refused


def read(tmp_path, text, **request):
    """Read a table of this text."""
    path = tmp_path / 'table.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_table(path, ImportRequest(**request))[0]


def test_all_columns_at_once(tmp_path):
    table = read(
        tmp_path,
        '\ufefftime_s,pressure_kpa,force_x_n,force_y_mn,moment_n_mm,x0_m,y0_m,x2_mm,y2_mm\r\n'
        '0.5,31.5,0.175,70,2,0.001,0.002,30,-4\r\n'
        '0.51,32,0.17,71,,0,0,nan,5\r\n'
        '\r\n'
        '0.52,,,,,,,,\r\n',
    )
    assert table.stamp_ns.tolist() == [500_000_000, 510_000_000, 520_000_000]
    np.testing.assert_array_equal(table.values['pressure'][:, 0], [31.5e3, 32e3, np.nan])
    np.testing.assert_allclose(table.values['end_wrench'][0], [0.175, 0.07, 0.002], rtol=1e-15)
    np.testing.assert_allclose(table.values['targets'][0, 0], [0.001, np.nan, 0.03])
    np.testing.assert_allclose(table.values['targets'][0, 1], [0.002, np.nan, -0.004])
    assert math.isnan(table.values['targets'][1, 0, 2])
    assert table.present()['targets'].tolist() == [True, True, False]
    # A wrench with a hole is none.
    assert table.counts() == {
        'pressure': 2,
        'end_wrench': 1,
        'targets': 2,
        'tip_pose': 0,
        'base_imu': 0,
    }


def test_an_imu_need_not_read_an_angular_velocity(tmp_path):
    table = read(tmp_path, 'time_s,imu_ax_g,imu_ay_g,imu_wz_deg_s\n1,0,1,90\n2,0,1,\n3,,,90\n')
    assert table.present()['base_imu'].tolist() == [True, True, False]
    np.testing.assert_allclose(table.values['base_imu'][0, 2:], [0.0, math.pi / 2.0])
    assert 'imu_wz_rad_s' in columns(table)
    with refused(RecordingError, 'missing_column'):  # it would be gravity of 0 g
        read(tmp_path, 'time_s,pressure_kpa,imu_wz_deg_s\n1,20,90\n')
    without = read(tmp_path, 'time_s,imu_ax_g,imu_ay_g\n1,0,1\n')
    assert 'imu_wz_rad_s' not in columns(without)
    assert without.present()['base_imu'].all()


def test_the_pose_of_the_tip_may_be_known_in_part(tmp_path):
    table = read(
        tmp_path, 'time_s,tip_x_mm,tip_y_mm,tip_heading_deg\n1,100,20,90\n2,,,45\n3,90,30,\n4,,,\n'
    )
    pose = table.values['tip_pose']
    np.testing.assert_allclose(pose[0], [0.1, 0.02, math.pi / 2.0])
    np.testing.assert_array_equal(np.isfinite(pose).sum(axis=1), [3, 1, 2, 0])
    assert table.present()['tip_pose'].tolist() == [True, True, True, False]
    only = read(tmp_path, 'time_s,pressure_pa,tip_heading_rad\n1,0,0.5\n')
    np.testing.assert_array_equal(only.values['tip_pose'], [[np.nan, np.nan, 0.5]])


@pytest.mark.parametrize(
    ('headings', 'is_lost'),
    [
        ((300.0, 0.0, 187.5), True),  # more than half a turn from pressure to pressure
        ((300.0, 200.0, 250.0), True),  # begins beyond half a turn
        ((4400.0, 0.0, 1000.0), True),  # another unit
        ((300.0, 0.0, 150.0), False),
        ((-100.0, 170.0, -170.0), False),  # without whole turns already
    ],
)
def test_headings_that_lose_whole_turns_are_reported(tmp_path, headings, is_lost):
    path = tmp_path / 'turns.csv'
    path.write_text(
        'time_s,pressure_kpa,tip_heading_deg\n1,60,{}\n2,0,{}\n3,30,{}\n'.format(*headings)
    )
    found = reasons(read_table(path, ImportRequest())[1])
    assert found == (['lost_turns'] if is_lost else [])


@pytest.mark.parametrize(
    ('column', 'si'),
    [
        ('pressure_pa', 1.0),
        ('pressure_hpa', 100.0),
        ('pressure_kpa', 1e3),
        ('pressure_mbar', 100.0),
        ('pressure_bar', 1e5),
        ('pressure_psi', 0.45359237 * 9.80665 / 0.0254**2),
        ('force_x_gf', 9.80665e-3),
        ('force_y_g', 9.80665e-3),
        ('force_a_kg', 9.80665),
        ('force_b_kgf', 9.80665),
        ('moment_mn_m', 1e-3),
        ('x3_um', 1e-6),
        ('y17_cm', 1e-2),
        ('tip_x_in', 0.0254),
        ('angle_a_deg', math.pi / 180.0),
        ('time_ms', 1e-3),
    ],
)
def test_units(column, si):
    assert column_of(column).si_per_unit == pytest.approx(si, rel=1e-12)


def test_every_known_name_is_known():
    for quantity, kind in KINDS.items():
        for unit in SI_PER_UNIT[kind]:
            name = f'{quantity}7_{unit}' if quantity in 'xy' else f'{quantity}_{unit}'
            assert column_of(name).quantity == quantity
        assert quantity in known_names()


@pytest.mark.parametrize(
    'name', ['pressure', 'pressure_mm', 'x_m', 'x-1_m', 'z0_m', 'force_n', 'x3m', 'tip', 'x1.0_m']
)
def test_other_names_are_not(name):
    assert column_of(name) is None


def test_stamps_are_kept_to_the_nanosecond(tmp_path):
    table = read(tmp_path, 'stamp_ns,time_s,pressure_pa\n1700000000123456789,0,1\n')
    assert table.stamp_ns.tolist() == [1700000000123456789]
    table = read(tmp_path, 'time_s,pressure_pa\n1700000000.123456789,1\n')
    assert table.stamp_ns.tolist() == [1700000000123456789]


def test_time_from_zero_begins_at_one_second(tmp_path):
    table = read(tmp_path, 'time_ms,pressure_pa\n-10,1\n0,1\n30,1\n')
    assert table.stamp_ns.tolist() == [10**9, 10**9 + 10**7, 10**9 + 4 * 10**7]


def test_a_rate_gives_rows_their_time(tmp_path):
    text = 'pressure_pa\n1\n2\n3\n'
    assert read(tmp_path, text, rate=50.0).stamp_ns.tolist() == [
        10**9,
        10**9 + 2 * 10**7,
        10**9 + 4 * 10**7,
    ]
    with refused(RequestError, 'no_time'):
        read(tmp_path, text)
    with refused(RequestError, 'exclusive'):
        read(tmp_path, 'Time,pressure_pa\n0,1\n', rate=1.0)
    with refused(RequestError, 'out_of_bounds'):
        read(tmp_path, text, rate=0.0)


def test_one_arm_of_a_table_of_many(tmp_path):
    text = 'arm,p,dx,dy,who\nA,0,0,0,x\nB,0,0,0,y\nB,50,2.3,-17.2,y\nA,50,1,1,x\n'
    request = {
        'select': {'arm': 'B'},
        'rename': {'p': 'pressure_mbar', 'dx': 'x0_mm', 'dy': 'y0_mm'},
        'offsets': {'x0_mm': 135.0},
        'ignore': ['who'],
        'rate': 1.0,
    }
    table = read(tmp_path, text, **request)
    np.testing.assert_array_equal(table.values['pressure'][:, 0], [0.0, 5000.0])
    np.testing.assert_allclose(table.values['targets'][:, 0], [[0.135], [0.1373]])
    np.testing.assert_allclose(table.values['targets'][:, 1], [[0.0], [-0.0172]])
    with refused(RecordingError, 'no_row'):
        read(tmp_path, text, **(request | {'select': {'arm': 'C'}}))
    with refused(RequestError, 'unknown_column'):
        read(tmp_path, text, **(request | {'offsets': {'x1_mm': 1.0}}))
    with refused(RecordingError, 'missing_column'):
        read(tmp_path, text, **(request | {'rename': {'q': 'pressure_pa'}}))
    with refused(RecordingError, 'given_twice'):
        read(tmp_path, text, **(request | {'rename': {'dx': 'x0_mm', 'dy': 'x0_mm'}}))


def test_strings_along_the_axes_give_the_forces_of_table_1():
    assert string_force(0.175, 0.0, 0.07, 0.0) == (0.175, 0.07)


def test_strings_turn_counter_clockwise(tmp_path):
    table = read(
        tmp_path,
        'time_s,force_a_n,angle_a_deg,force_b_n,angle_b_deg\n1,0.2,90,0.1,0\n2,0.2,0,0.1,90\n',
    )
    np.testing.assert_allclose(
        table.values['end_wrench'][:, :2], [[0.0, 0.3], [0.1, 0.0]], atol=1e-16
    )
    # Both strings turned together: the resultant turns with them.
    x, y = string_force(0.175, 0.3, 0.07, 0.3)
    assert math.atan2(y, x) == pytest.approx(math.atan2(0.07, 0.175) + 0.3)
    assert math.hypot(x, y) == pytest.approx(math.hypot(0.07, 0.175))


def test_one_string_is_enough_and_its_angle_0_if_not_given(tmp_path):
    table = read(tmp_path, 'time_s,force_b_n\n1,0.1\n')
    np.testing.assert_array_equal(table.values['end_wrench'], [[0.0, 0.1, 0.0]])


def test_what_the_estimator_made_is_left_out(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_pa,estimate_tip_x_m\n1,2,3\n')
    table, sentences = read_table(path, ImportRequest())
    assert table.counts()['pressure'] == 1
    assert reasons(sentences) == ['estimates']


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('', 'is empty: the first line must name the columns'),
        ('\n\n', 'is empty: the first line must name the columns'),
        ('time_s,pressure_pa\n', 'has no rows below its first line'),
        ('time_s;pressure_pa\n1;2;5\n', 'line 2: 3 cells, but there are 2 columns; .*semicolons'),
        (
            'time_s;pressure_pa\n0,15;598\n0,2;1.060\n',
            "'1.060' in line 3 seems to have a thousands separator",
        ),
        (
            'time_s;pressure_pa\n0.2;1,060\n',
            "'1,060' in line 2 seems .* '0.2' in line 2 has another decimal mark",
        ),
        ('time_s;pressure_pa\n1;1.234,5\n', "column pressure_pa: '1.234,5' is not a number"),
        ('time_s;pressure_pa\n1;1,220.9\n', r"'1,220.9' is not a number \(no thousands"),
        ('time_s,pressure_pa\n1,1 220.9\n', r"'1 220.9' is not a number \(no thousands"),
        ('time_s,pressure_psi\n1,1.5psi\n', 'is not a number .put the unit into the column name'),
        ("time_s,pressure_pa\n1,1'220\n", 'is not a number .no thousands separators'),
        ('Logger XY\ntime_s;pressure_pa\n1;2\n', 'begin in line 2, .* put # before each of these'),
        ('# a\nLogger\n\nSerial\nTime,Pressure\n1,2\n', 'the table seems to begin in line 5'),
        ('Zeit [s];Druck [psi];Bemerkung\n0;0;an\n1;2,5;\n2;5;\n', 'no column has the name of a'),
        ('Logger XY,No 7\nTime,Pressure\n1,2\n', 'the table seems to begin in line 2'),
        ('Rig;B;3\nDate;;\nTime [s];p;fx (g)\n1;2;3\n', 'the table seems to begin in line 3'),
        ('# all\n# comments', 'is empty: the first line must name the columns'),
        ('Time,pressure_pa\n24:00:00,1\n', "line 2, column time_s: '24:00:00' is not a number"),
        ('Time,pressure_pa\n2026-02-30 10:00:00,1\n', "'2026-02-30 10:00:00' is not a number"),
        ('time_ms,pressure_pa\n10:00:00,1\n', "column time_ms: '10:00:00' is not a number"),
        ('Time,pressure_pa\n10:00:01,1\n10:00:01,1\n', 'line 3, .*fractions of a second miss'),
        ('time_s,pressure_pa\n1,2,5\n', 'line 2: 3 cells, but there are 2 columns; .*a point'),
        (
            'time_s,pressure_pa\n1,"2,5"\n',
            r"line 2, column pressure_pa: '2,5' is not a number \(use a dec",
        ),
        (
            'time_s,pressure_pa\n1,5\n2,abc\n',
            "line 3, column pressure_pa: 'abc' is not a number; write a",
        ),
        ('time_s,pressure_pa\n1,inf\n', "column pressure_pa: 'inf' is not a number"),
        ('time_s,pressure_pa\n1,1e999\n', "'1e999' is not a number"),
        ('time_s,pressure_pa\n1,1_0\n', "'1_0' is not a number"),
        ('time_s,pressure_pa\n1,=1+1\n', "'=1.1' is not a number"),
        ('time_s,pressure_pa\n1,0x1F\n', 'is not a number'),
        ('time_s,pressure_pa\n,1\n', 'line 2, column time_s: the time is missing'),
        ('time_s,pressure_pa\nnan,1\n', 'line 2, column time_s: the time is missing'),
        ('time_s,pressure_pa\n1,1\n1,1\n', 'line 3, column time_s: time must increase from row'),
        ('time_s,pressure_pa\n2,1\n1,1\n', 'line 3, .*earlier than the one above: sort the rows'),
        ('Time,pressure_pa\n1,1\n0.9,1\n0.8,1\n', 'line 3, .*earlier than the one above'),
        ('Time,pressure_pa\n1,1\n1,1\n', 'line 3, .* --ignore Time --rate HZ counts rows inst'),
        ('time_s,pressure_pa\n1772618400000,1\n', 'smaller unit, such as time_ms'),
        ('time_s,pressure_pa\nMar 4 10:00,1\n', r'a number \(nor a time such as 10:15:03.12'),
        (
            'time_s pressure_pa\n0 1\n',
            "'time_s pressure_pa' is a single cell: separate the cells by commas",
        ),
        (
            '# time_s pressure_pa\n0.0 1.0\n',
            "'0.0 1.0' is a single cell: separate the cells by commas",
        ),
        (
            'time_s|pressure_pa\n0|1\n',
            'is a single cell: separate the cells by commas, semicolons or tabs',
        ),
        ('1772618400,10,base,5.0\n', 'line 1 is already a row of values; write a line above it'),
        (
            'LabVIEW\t\nTime\t10:15:03,12\n***End***\t\nX_Value\tPressure\tComment\n0,1\t2,5\n',
            'the table seems to begin in line 4',
        ),
        ('Rig;3\nZeit;Druck\ns;kPa\n0,1;2,5\n', 'the table seems to begin in line 2'),
        ('time_s,pressure_pa\n1,1\n2\n3,1', 'line 3: 1 cell, but there are 2 columns'),
        ('time_s,pressure_pa\n1,1\n2\n', 'line 3: 1 cell, but there are 2 columns'),
        ('time_s,pressure_pa\n1e300,1\n', 'line 2, column time_s: .* not a valid time stamp'),
        (
            'time_s,pressure_pa\n1700000000000,1\n',
            'time_s: 1700000000000 s is not a valid time stamp',
        ),
        ('stamp_ns,pressure_pa\n0,1\n', 'line 2, column stamp_ns: 0 ns is not a valid time stamp'),
        ('time_s,pressure_pa\n1,\n', 'contains no readings: no pressure, no force, no target'),
        ('time_s,x0_m,y0_m\n1,,\n', 'contains no readings'),
        ('time_s\n1\n', 'contains no readings'),
        ('time_s,pressure_pa,pressure_pa\n1,1,1\n', "two columns have the name 'pressure_pa'"),
        (
            'time_s,pressure_pa,pressure_bar\n1,1,1\n',
            'pressure_pa and pressure_bar measure the same quantity',
        ),
        (
            'time_s,pressure\n1,1\n',
            r"column 'pressure' \(pressure_\(pa\|.*is not known: add --rename pressure=",
        ),
        ('time_s,Pressure [kPa],pressure_kpa\n1,1,1\n', 'two columns have the name pressure_kpa'),
        ('time_s,x0_m\n1,1\n', 'x0_m has no matching column y0'),
        ('time_s,x500_m,y500_m\n1,1,1\n', 'x500_m: at most 500 targets'),
        ('time_s,angle_a_deg\n1,1\n', 'angle_a_deg has no matching column force_a'),
        ('time_s,force_x_n,force_a_n\n1,1,1\n', 'both along the axes .* and by strings'),
        ('time_s,pressure_pa\n1,"2\n', 'is not a CSV file'),
        (b'time_s,pressure_pa\n1,\xff\n', 'is not UTF-8 text'),
        ('time_s,pressure_pa\n1,2\n'.encode('utf-16-le'), 'is not UTF-8 text .is it UTF-16'),
        (b'time_s,pressure_pa\n1,\x00\n', 'is not a number'),
        ('time_s,' + 'a' * 300 + '\n1,1\n', 'the name of a column has 300 characters'),
        ('time_s,' + ','.join(f'c{index}' for index in range(3000)) + '\n', 'more than 2000 col'),
    ],
)
def test_tables_that_cannot_be_read_are_refused_with_the_place(tmp_path, text, said):
    with pytest.raises(RecordingError, match=said) as caught:
        read(tmp_path, text)
    assert 'table.csv' in str(caught.value)


def test_a_preamble_that_is_ignored_as_a_column_is_none(tmp_path):
    with refused(RecordingError, 'no_header'):
        read(tmp_path, 'Logger XY\ntime_s,pressure_pa\n1,2\n', ignore=['Logger XY'])


@pytest.mark.parametrize(
    'text',
    [
        '# Logger XY\n#, of 2024\ntime_s,pressure_kpa\n1,2\n3,\n4,x\n',
        '#Logger\nsep=;\r\ntime_s;pressure_kpa\r\n\r\n1;2\r\n4;x',
        '# numpy writes it so\n# time_s,pressure_kpa\n\n1,2\n3,4\n4,x\n',
        '\ufeff# Logger\n# a\n\n# b\n\ntime_s,pressure_kpa\n1,2\n4,x\n',
        '# Logger XY\n# time, pressure\n# s, kPa\n1,2\n3,4\n4,x\n',
        '# time;pressure\n\n# [s];[kPa]\n\n1;2\n4;x\n',
        '# Logger XY, s\n# time [s], pressure [kPa]\n1,2\n4,x\n',
    ],
)
def test_lines_of_comment_stand_above_the_names(tmp_path, text):
    (bad,) = (place for place, line in enumerate(text.splitlines()) if 'x' in line)
    with refused(RecordingError, 'not_a_number'):
        read(tmp_path, text)
    table = read(tmp_path, '\n'.join(text.splitlines()[:bad]))
    assert table.values['pressure'][0, 0] == 2000.0


@pytest.mark.parametrize(
    ('names', 'row'),
    [
        ('# time_s,pressure_kpa,force_x_n', '0.5,2,'),
        ('# time_s,pressure_kpa,force_x_n', '0.5,2,NA'),
        ('# time; pressure; force x\n# s; kPa; N', '2026-11-22 10:15:03,12;2;'),
        ('# time [s];pressure [kPa];force x [N]', '0,5;2,0;0,1'),
        ('# time;pressure;force x\n# s;kPa;N', '10:15:03,12;2;0,1'),
        ('# time_s,pressure_kpa,force_x_n\n# recorded on Tuesday, by Anna, second try', '1,2,3'),
        ('# time,pressure,force x\n# s,kPa,N\n# recorded by Anna, valve on, air', '1,2,3'),
        ('# Rig 7, s, by Anna\n# time_s,pressure_kpa,force_x_n\n#\n# Fx is noisy', '1,2,3'),
        ('# time_s\tpressure_kpa\tforce_x_n\n# recorded on Tuesday, by Anna, twice', '1\t2\t3'),
    ],
)
def test_the_comment_that_holds_names_gives_them_above_any_row(tmp_path, names, row):
    """Whatever the first row lacks, and whatever prose stands between."""
    table = read(tmp_path, f'{names}\n{row}\n')
    assert table.values['pressure'].tolist() == [[2000.0]]
    assert table.counts()['end_wrench'] == row[-1].isdigit()


def test_a_name_that_was_asked_for_tells_the_names_from_prose(tmp_path):
    text = '# c1, c2\n# by Anna, twice\n1,2\n'
    table = read(tmp_path, text, rename={'c1': 'time_s', 'c2': 'pressure_kpa'})
    assert table.values['pressure'].tolist() == [[2000.0]]


def test_a_comment_above_a_line_of_names_names_nothing(tmp_path):
    text = '# time_s, pressure_kpa of old\npressure_bar,time_s\n1,2\n'
    assert read(tmp_path, text).values['pressure'][0, 0] == 1e5


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('# by Anna, second try\n0,1\n1,2\n', 'no_header'),
        ('# Rig 7\n\n# a, b\n0.5;\n', 'no_header'),
        ('0,1\n1,2\n', 'no_header'),
        ('# t, p\n0,1\n', 'unknown_column'),
        ('# time_s, pressure_kpa\n0,1,2\n', 'wrong_shape'),
    ],
)
def test_where_nothing_names_the_columns_this_is_said(tmp_path, text, reason):
    with refused(RecordingError, reason):
        read(tmp_path, text)


@pytest.mark.parametrize(
    'text',
    ['{"time": [0, 1]}', '[\n  {"t": 0}\n]', '[[0, 1], [1, 2]]', '\ufeff{"t": 0}\n{"t": 1}'],
)
def test_json_under_the_name_of_a_table_is_called_so(tmp_path, text):
    with refused(RecordingError, 'json'):
        read(tmp_path, text)


def test_columns_that_are_called_by_numbers_are_renamed(tmp_path):
    table = read(tmp_path, '0,1\n1,2\n', rename={'0': 'time_s', '1': 'pressure_kpa'})
    assert table.values['pressure'][:, 0].tolist() == [2000.0]


@pytest.mark.parametrize(
    ('written', 'read_as'),
    [
        ('Pressure [kPa]', 'pressure_kpa'),
        ('PRESSURE_kPa', 'pressure_kpa'),
        ('pressure (mbar)', 'pressure_mbar'),
        ('Pressure/bar', 'pressure_bar'),
        ('Time', 'time_s'),
        ('Time (ms)', 'time_ms'),
        ('time [\u00b5s]', 'time_us'),
        ('Force X (mN)', 'force_x_mn'),
        ('Moment [N\u00b7mm]', 'moment_n_mm'),
        ('moment (Nm)', 'moment_n_m'),
        ('X3 (mm)', 'x3_mm'),
        ('x3 [inch]', 'x3_in'),
        ('Y3 (″)', 'y3_in'),
        ('Tip-Heading [\u00b0]', 'tip_heading_deg'),
        ('Temperature (K)', 'Temperature (K)'),
        ('Pressure [in Hg]', 'pressure_inhg'),
        ('p (cm H\u2082O)', 'pressure_cmh2o'),
        ('Pressure [kgf/cm\u00b2]', 'pressure_at'),
        ('psig', 'pressure_psi'),
        ('Pressure, kPa(g)', 'pressure_kpa'),
        ('bar(a)', 'pressure_bar'),
        ('P abs [mmHg]', 'pressure_mmhg'),
        ('imu_ax [g]', 'imu_ax_g'),
        ('atm', 'atm'),
    ],
)
def test_names_may_be_written_as_people_do(written, read_as):
    assert standard_name(written) == read_as


@pytest.mark.parametrize(
    ('written', 'likely'),
    [
        ('presure_kpa', 'pressure_kpa'),
        ('p [kPa]', 'pressure_kpa'),
        ('Fx (N)', 'force_x_n'),
        ('forcey_mn', 'force_y_mn'),
        ('x3mm', ''),
        ('pressure_furlong', f'pressure_({"|".join(SI_PER_UNIT["pressure"])})'),
        ('valve', ''),
        ('Elapsed Time (s)', 'time_s'),
        ('chamber pressure [kPa]', 'pressure_kpa'),
        ('PT-101 Pressure kPa(g)', 'pressure_kpa'),
        ('/pneunet/pressure/fluid_pressure', 'pressure_pa'),
        ('fluid_pressure', 'pressure_pa'),
        ('force_x', 'force_x_(n|mn|gf|kgf|lbf|g|kg)'),
        ('field.wrench.force.y', 'force_y_n'),
        ('Date/Time', 'time_(s|ms|us|min|h|d)'),
        ('Zeit [s]', 'time_s'),
        ('angulo (deg)', 'tip_heading_deg'),
        ('Winkel', 'tip_heading_(rad|deg)'),
        ('Druck', f'pressure_({"|".join(SI_PER_UNIT["pressure"])})'),
        ('ata', 'pressure_at'),
    ],
)
def test_a_name_that_may_have_been_meant_is_asked_for(written, likely):
    assert likely_name(written) == likely


def test_a_raw_signal_is_to_be_converted_unless_a_pressure_is_there(tmp_path):
    for name in ('pressure_V', 'ADC', 'raw'):
        with refused(RecordingError, 'raw_signal'):
            read(tmp_path, f'time_s,{name}\n0,512\n')
        with refused(RecordingError, 'unknown_column'):
            read(tmp_path, f'time_s,pressure_kpa,{name}\n0,1,512\n')
    for others in ('battery_V', 'frame_count', 'Druck (bar),ADC'):
        with refused(RecordingError, 'unknown_column'):
            read(tmp_path, f'time_s,{others}\n' + ','.join('0' * (others.count(',') + 2)) + '\n')


@pytest.mark.parametrize(
    'order', ['Druck;Zeit\n{0};{1}\n', 'Zeit;Druck\n{1};{0}\n', 'Zeit,Druck\n"{1}","{0}"\n']
)
def test_a_time_of_another_language_is_asked_for_and_no_pressure_that_rises(tmp_path, order):
    head, row = order.splitlines()
    rows = [row.format(f'1{place},5', f'0,{place}') for place in range(5)]
    with refused(RecordingError, 'no_time') as caught:
        read(tmp_path, '\n'.join([head, *rows, '']))
    assert '--rename Zeit=' in str(caught.value)


def test_all_unknown_columns_are_named_at_once_before_any_cell_is_read(tmp_path):
    with refused(RecordingError, 'unknown_column') as caught:
        read(tmp_path, 'time_s,presure_kpa,valve,note\n1,2,open,ok\n')
    assert all(name in str(caught.value) for name in ('presure_kpa', 'valve', 'note'))


@pytest.mark.parametrize(
    'text',
    [
        '\ufeffTime;Pressure [kPa];\r\n0,5;1,25;\r\n0,75;2;\r\n',
        'Time (s)\tPressure/kPa\n0.5\t1,25\n0.75\t2\n',
        'TIME_MS,"Pressure (kPa)"\n500,1.25\n750,2\n',
    ],
)
def test_exports_of_spreadsheets_and_of_measuring_programs_are_read(tmp_path, text):
    table = read(tmp_path, text)
    assert table.stamp_ns.tolist() == [500_000_000, 750_000_000]
    np.testing.assert_array_equal(table.values['pressure'][:, 0], [1250.0, 2000.0])


@pytest.mark.parametrize(
    'text',
    [
        'Time,Pressure,x0,y0\ns,kPa,mm,mm\n0,1.5,2,3\n',
        'Time,Pressure,x0,y0\n\n[s],[kPa],(mm),(mm)\n0,1.5,2,3\n',
        'Time;Pressure;x0;y0\r\ns;kPa;mm;mm\r\n0;1,5;2;3\r\n',
        'time_s,Pressure [kPa],x0_mm,y0_mm\ns,kPa,,mm\n0,1.5,2,3\n',
        'Time,p,x0,y0,Temp\nms,kPa(g),mm,mm,°C\n0,1.5,2,3,20\n',
        'Time,p,x0,y0,Temp [°C]\nms,-,mm,mm,-\n0,1.5,2,3,20\n',
    ],
)
def test_units_below_the_names_are_units(tmp_path, text):
    asked = {'rename': {'p': 'pressure_kpa'}, 'ignore': ['Temp [°C]']} if 'Temp' in text else {}
    table = read(tmp_path, text, **asked)
    assert table.stamp_ns.tolist() == [1_000_000_000]
    np.testing.assert_allclose(table.values['pressure'], [[1500.0]])
    np.testing.assert_allclose(table.values['targets'][0, :, 0], [2e-3, 3e-3])


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('Time,Pressure\ns,furlong\n0,1\n', 'unknown_column'),
        ('time_s,pressure_kpa\ns,mbar\n0,1\n', 'unknown_column'),
        ('Time,Pressure\ns,kPa\n0,1\nx,2\n', 'not_a_number'),
        ('Time,Pressure\ns,kPa\n', 'no_row'),
        ('time_s,pressure_kpa\ns,1\n', 'not_a_number'),
        ('time_s,pressure_kpa\nhello,world\n', 'not_a_number'),
    ],
)
def test_a_line_of_units_that_does_not_fit_is_refused(tmp_path, text, reason):
    with refused(RecordingError, reason):
        read(tmp_path, text)


def test_a_column_is_renamed_with_the_unit_below_it_or_without(tmp_path):
    text = 'Time,Luft\ns,kPa\n0,1\n'
    for name in ('Luft [kPa]', 'Luft'):
        table = read(tmp_path, text, rename={name: 'pressure_kpa'})
        assert table.values['pressure'].tolist() == [[1000.0]]


def test_how_names_were_read_is_said(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('Time,pressure_pa\n1,2\n')
    assert reasons(read_table(path, ImportRequest())[1]) == ['renamed']


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('1,2\n3', ': the last line, 4, is incomplete and was skipped'),
        ('1,2\n3,', ''),
        (
            '# valve on\n1,2\n# end, of, log\n',
            ': comment lines among the rows were skipped: line 3, 5',
        ),
        ('1,2\n# stopped by Anna', ': comment lines among the rows were skipped: line 4'),
    ],
)
def test_comments_among_the_rows_and_a_last_row_that_is_cut_off_are_left_out(tmp_path, text, said):
    path = tmp_path / 'table.csv'
    path.write_text(f'time_s,pressure_pa\n0,1\n{text}')
    table, sentences = read_table(path, ImportRequest())
    assert table.values['pressure'][:2, 0].tolist() == [1.0, 2.0]
    assert table.counts()['pressure'] == 2
    assert sentences == ((f'{path}{said}',) if said else ())


def test_a_number_that_may_be_cut_off_is_said(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_kpa\n0,42.1\n0.1,42.4\n0.2,4')
    table, sentences = read_table(path, ImportRequest())
    assert table.counts()['pressure'] == 3
    assert reasons(sentences) == ['cut_off']


def test_the_first_target_is_unseen_at_zero_if_it_is_not_at_the_clamp(tmp_path):
    path = tmp_path / 'table.csv'
    for first, refusal in ((50.0, 'placeholder'), (0.0, '')):
        rows = ((first, 0.1), (0.0, 0.0), (first + 0.4, -0.2), (first - 0.3, 0.1))
        lines = [f'{0.1 * row},{x},{y}' for row, (x, y) in enumerate(rows)]
        path.write_text('\n'.join(['time_s,x0_mm,y0_mm', *lines, '']))
        if refusal:
            with refused(RecordingError, refusal):
                read_table(path, ImportRequest())
        else:
            assert read_table(path, ImportRequest())[0].counts()['targets'] == 4


def test_a_target_at_the_clamp_is_seen_at_zero_even_in_tenths_of_millimeters(tmp_path):
    path = tmp_path / 'table.csv'
    lines = [f'{0.1 * row:.1f},{0.1 * (row % 3 == 1):.1f},0' for row in range(30)]
    path.write_text('\n'.join(['time_s,x0_mm,y0_mm', *lines, '']))
    assert read_table(path, ImportRequest())[0].counts()['targets'] == 30


def test_the_days_of_a_spreadsheet_are_no_seconds(tmp_path):
    path = tmp_path / 'table.csv'
    rows = [f'{45000.0 + row * 10.0 / 86400.0:.8f},{row}' for row in range(9)]
    path.write_text('\n'.join(['Time,pressure_kpa', *rows, '']))
    with refused(RecordingError, 'no_unit'):
        read_table(path, ImportRequest())


def test_targets_that_are_counted_from_1_are_asked_for(tmp_path):
    path = tmp_path / 'table.csv'
    for first, words in ((0, []), (1, ['target 0 has no columns', 'numbered from 1?'])):
        path.write_text(f'time_s,x{first}_m,y{first}_m\n0,0,0\n')
        sentences = ' '.join(read_table(path, ImportRequest())[1])
        assert all(word in sentences for word in words)
        assert bool(sentences) == bool(words)


@pytest.mark.parametrize('unseen', ['0,0', '-1,-1'])
def test_targets_at_one_place_are_taken_for_unseen_ones_and_asked_for(tmp_path, unseen):
    path = tmp_path / 'table.csv'
    names = 'time_s,x0_mm,y0_mm,x1_mm,y1_mm,x2_mm,y2_mm'
    path.write_text(f'{names}\n0,0,0.1,5,0,10,0\n1,0,0.1,,,,\n2,0,0.1,{unseen},{unseen}\n')
    (note,) = read_table(path, ImportRequest(missing=()))[1]
    assert (note.reason, '1 of 3' in note, 'line 4' in note) == ('coincident', True, True)


def test_blank_lines_may_stand_above_the_names(tmp_path):
    with refused(RecordingError, 'not_a_number'):
        read(tmp_path, '\n \ntime_s,pressure_pa\n0,1\n1,x\n')


def test_columns_without_any_number_are_said(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,pressure_pa,x0_m,y0_m,x1_m,y1_m\n1,2,0,0,nan,\n2,3,,,NA,nan\n')
    (note,) = read_table(path, ImportRequest())[1]
    assert (note.reason, 'x1_m, y1_m' in note) == ('no_number', True)


@pytest.mark.parametrize(
    ('clock', 'seconds'),
    [
        ('10:15:03.120', 36_903.12),
        ('2026-11-22 10:15:03,120', 1_795_342_503.12),
        ('2026-11-22T10:15:03.12Z', 1_795_342_503.12),
        ('22.11.2026 10:15:03.12', 1_795_342_503.12),
        ('11/22/2026 10:15:03.12 AM', 1_795_342_503.12),
        ('2026/11/22 10:15:03.12', 1_795_342_503.12),
        ('22/11/2026 10:15 PM', 1_795_385_700.0),
        ('12:00:00 AM', 1.0),
    ],
)
def test_dates_and_times_of_day_are_times(tmp_path, clock, seconds):
    stamp_ns = read(tmp_path, f'Time;pressure_pa\n{clock};1\n').stamp_ns.tolist()
    assert stamp_ns == [round(seconds * 100) * 10**7]


@pytest.mark.parametrize(
    'times',
    [
        ('03/04/2026 23:59:59', '03/05/2026 00:00:00'),  # a month apart if the day comes first
        ('04/03/2026 23:59:59', '05/03/2026 00:00:00'),
        ('3/12/2026 23:59:59', '3/13/2026 00:00:00'),  # no month has the number 13
        ('12/3/2026 23:59:59', '13/3/2026 00:00:00'),
        ('11/12/2026 23:59:59', '12/12/2026 00:00:00'),
        ('9/30/2026 23:59:59', '10/1/2026 00:00:00'),
    ],
)
def test_day_and_month_have_one_order_in_a_column(tmp_path, times):
    rows = ''.join(f'{time};1\n' for time in times)
    assert np.diff(read(tmp_path, f'Time;kPa\n{rows}').stamp_ns).tolist() == [10**9]


def test_dates_in_two_orders_are_refused(tmp_path):
    with refused(RecordingError, 'not_a_number'):
        read(tmp_path, 'Time;kPa\n3/13/2026 10:00:00;1\n14/3/2026 10:00:00;1\n')


def test_times_that_may_be_of_a_stopwatch_are_refused(tmp_path):
    with refused(RecordingError, 'no_unit'):
        read(tmp_path, 'Time;kPa\n00:01;1\n00:02;1\n')


def test_sizes_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(csv_table, 'MOST_ROWS', 2)
    with refused(RecordingError, 'too_large'):
        read(tmp_path, 'time_s,pressure_pa\n1,1\n2,1\n3,1\n')
    monkeypatch.setattr(csv_table, 'MOST_BYTES', 10)
    with refused(RecordingError, 'too_large'):
        read(tmp_path, 'time_s,pressure_pa\n1,1\n')


def test_a_file_that_is_not_there_is_named(tmp_path):
    with refused(RecordingError, 'not_found'):
        read_table(tmp_path / 'missing.csv', ImportRequest())


@pytest.mark.parametrize(
    ('times', 'remedy'),
    [
        (('20000', '20050', '20100', '20151'), '--rename Time=time_ms'),
        (('45617.41667', '45617.4166705787', '45617.4166711574'), '--rename Time=time_d'),
    ],
)
def test_a_time_without_a_unit_that_is_no_seconds_is_asked_for(tmp_path, times, remedy):
    """Milliseconds and the days of a spreadsheet are not taken as seconds; the remedy works."""
    text = 'Time,pressure_kpa\n' + ''.join(f'{time},5\n' for time in times)
    with pytest.raises(RecordingError) as refusal:
        read(tmp_path, text)
    assert remedy in str(refusal.value)
    new = remedy.split()[1].partition('=')[2]
    table = read(tmp_path, text, rename={'Time': new})
    assert np.diff(table.stamp_ns) == pytest.approx(0.05e9, rel=0.03)
    if new == 'time_d':  # 45617 is the 21st of November 2024
        assert table.stamp_ns[0] // 86_400_000_000_000 == 20_048


def test_a_time_in_seconds_by_name_may_be_slow(tmp_path):
    """Who names the unit is believed, and so are times of day."""
    for name, times in (('time_s', '0 60 120'), ('Time', '10:00:00 10:01:00 10:02:00')):
        text = f'{name},pressure_kpa\n' + ''.join(f'{time},5\n' for time in times.split())
        table = read(tmp_path, text)
        assert np.diff(table.stamp_ns).tolist() == [60_000_000_000] * 2


def test_offsets_from_utc_are_read(tmp_path):
    """The hour that is put back in autumn is no step back in time."""
    text = (
        'Time,pressure_kpa\n2026-10-25T02:59:59.5+02:00,5\n2026-10-25T02:00:00.5+0100,6\n'
        '2026-10-25T01:00:01.5Z,7\n2026-10-24T20:30:02.5-04:30,8\n'
    )
    table = read(tmp_path, text)
    assert np.diff(table.stamp_ns).tolist() == [1_000_000_000] * 3
    assert table.stamp_ns[2] == 1_792_890_001_500_000_000


def test_a_time_of_day_may_pass_midnight(tmp_path):
    """A day is added, and said; a small step back is an error as before."""
    text = 'Time,pressure_kpa\n23:59:59.9,5\n00:00:00.1,6\n00:00:00.3,6\n'
    read(tmp_path, text)
    table, sentences = read_table(tmp_path / 'table.csv', ImportRequest())
    assert np.diff(table.stamp_ns).tolist() == [200_000_000] * 2
    assert 'midnight' in reasons(sentences)
    with refused(RecordingError, 'not_increasing'):
        read(tmp_path, 'Time,pressure_kpa\n10:00:01,5\n10:00:00,6\n')


def test_the_first_line_of_excel_names_the_separator(tmp_path):
    """Lines are counted as in the file."""
    table = read(tmp_path, 'sep=;\ntime_s;pressure_kpa\n0,1;1,5\n0,2;2,5\n')
    assert table.values['pressure'][:, 0].tolist() == [1500.0, 2500.0]
    for above in ('', '# from Excel\n'):
        with refused(RecordingError, 'not_a_number'):
            read(tmp_path, f'sep=;\n{above}time_s;pressure_kpa\n0,1;1,5\n0,2;broken\n')


@pytest.mark.parametrize('missing', ['', 'NA', 'N/A', '#N/A', 'nan', 'NaN', 'null', 'None'])
def test_missing_values_have_many_names(tmp_path, missing):
    """None of them is a reading."""
    table = read(tmp_path, f'time_s,pressure_kpa\n1,1\n2,{missing}\n')
    assert table.counts()['pressure'] == 1


@pytest.mark.parametrize(
    ('written', 'read_as'),
    [
        ('millis', 'time_ms'),
        ('micros', 'time_us'),
        ('millis()', 'time_ms'),
        ('MS', 'time_ms'),
        ('psi', 'pressure_psi'),
        ('kPa', 'pressure_kpa'),
        ('[hPa]', 'pressure_hpa'),
        ('t_s', 'time_s'),
        ('Timestamp (ms)', 'time_ms'),
        ('P [bar]', 'pressure_bar'),
    ],
)
def test_a_unit_that_says_what_is_measured_is_a_name(written, read_as):
    """As a sketch of an Arduino prints them: `millis,psi`."""
    assert standard_name(written) == read_as


@pytest.mark.parametrize('written', ['N', 'g', 'm', 'mm', 'deg', 'min', 'd', 'x', 'p', 't'])
def test_a_unit_or_letter_that_may_mean_several_things_is_no_name(written):
    assert standard_name(written) == written


def test_a_refusal_of_names_holds_the_options_to_paste(tmp_path):
    with pytest.raises(RecordingError) as caught:
        read(tmp_path, 'Zeit [s];Druck [kPa];Notiz\n0;1;a\n')
    line = str(caught.value).split(' add ')[1].split(', or ')[0]
    given = shlex.split(line)
    assert given == [
        '--rename',
        'Zeit [s]=time_s',
        'Druck [kPa]=pressure_kpa',
        '--ignore',
        'Notiz',
    ]


def test_what_the_serial_monitor_writes_before_a_line_is_passed_by(tmp_path):
    rows = ['millis,psi', '0,1', '20,2']
    lines = [f'12:00:0{second}.123 -> {row}' for second, row in enumerate(rows)]
    table = read(tmp_path, '\n'.join(lines))
    assert table.stamp_ns[1] - table.stamp_ns[0] == 20_000_000
    assert table.values['pressure'][1, 0] == pytest.approx(2 * 6894.757)


UNSEEN = """\
ms,kPa,x0_mm,y0_mm,x1_mm,y1_mm,tip_x_mm,tip_y_mm,tip_heading_deg
0,-1,0,0,50,1,90,2,3
20,0.1,0,0,{pair},{pose}
40,-1,0,0,51,2,91,3,4
60,5.2,0,0,52,3,92,4,5
"""


@pytest.mark.parametrize(
    ('pair', 'pose', 'asked'),
    [
        ('0,0', '90,2,3', '(0, 0)'),
        ('-1,-1', '90,2,3', '(-1, -1)'),
        ('50,1', '9999,9999,9999', '(9999, 9999)'),
        ('50,1', '90,2,9999', 'tip_heading_deg'),
        ('50,1', '90,2,3', 'pressure_kpa'),
    ],
)
def test_numbers_that_seem_to_stand_for_nothing_are_asked_about(tmp_path, pair, pose, asked):
    text = UNSEEN.format(pair=pair, pose=pose)
    if 'pressure' not in asked:
        text = text.replace(',-1,0,0,5', ',1,0,0,5')
    with refused(RecordingError, 'placeholder') as caught:
        read(tmp_path, text)
    assert asked in str(caught.value)
    assert '--missing' in str(caught.value)
    assert read(tmp_path, text, missing=()).counts()['pressure'] == 4


def test_numbers_that_stand_for_nothing_are_no_readings(tmp_path):
    text = UNSEEN.format(pair='0,0', pose='9999,9999,9999')
    table = read(tmp_path, text, missing=(0.0, -1.0, 9999.0))
    assert table.counts() == {
        'pressure': 2,
        'end_wrench': 0,
        'targets': 4,
        'tip_pose': 3,
        'base_imu': 0,
    }
    assert np.isnan(table.values['targets'][1, :, 1]).all()
    assert table.values['targets'][1, :, 0].tolist() == [0.0, 0.0]  # the clamp, which is there


@pytest.mark.parametrize(
    'column', ['-1,0,1,2', '0,0,0,5.5', '65535,64000,66000,65000', '-1,-1,-2.5,-3', '-1,5.5,2,3.1']
)
def test_readings_are_not_taken_for_placeholders(tmp_path, column):
    rows = [f'{row},{value}' for row, value in enumerate(column.split(','))]
    table = read(tmp_path, '\n'.join(['time_s,pressure_pa', *rows]))
    assert table.counts()['pressure'] == 4


@pytest.mark.parametrize('name', ['Zeit', 'tiempo', 'uptime counter'])
def test_the_time_is_asked_for_before_other_unknown_columns(tmp_path, name):
    rows = '\n'.join(f'{20 * row},{row % 3},{7 - row}' for row in range(5))
    with refused(RecordingError, 'no_time') as caught:
        read(tmp_path, f'{name},Druck [kPa],lamp\n{rows}\n')
    assert 'time_UNIT' in str(caught.value)
    assert '--ignore' not in str(caught.value)


@pytest.mark.parametrize(
    ('written', 'absolute'),
    [('psia', True), ('bar(a)', True), ('P abs [kPa]', True), ('psi', False), ('kPa(g)', False)],
)
def test_the_reference_of_a_pressure_is_read_from_its_name(tmp_path, written, absolute):
    path = tmp_path / 'table.csv'
    path.write_text(f'time_s,{written}\n0,14.7\n1,15.0\n', encoding='utf-8')
    table, sentences = read_table(path, ImportRequest())
    assert table.absolute == absolute
    assert ('absolute' in reasons(sentences)) == absolute


@pytest.mark.parametrize(
    'first',
    ['2026-03-04T10:00:0{}Z', '04-Mar-2026 10:00:0{}', '3/4/2026 10:00:0{} AM', '10:00:0{},5'],
)
def test_the_only_column_of_times_is_the_time_whatever_it_is_called(tmp_path, first):
    rows = '\n'.join(f'{first.format(row)};{row};open' for row in range(4))
    table = read(tmp_path, f'Timestamp;kPa;valve\n{rows}\n', ignore=['valve'])
    assert np.diff(table.stamp_ns).tolist() == [10**9] * 3


@pytest.mark.parametrize(
    ('start', 'step', 'meant'),
    [
        (1.77e9, 0.05, 'time_s'),
        (1.77e12, 50, 'time_ms'),
        (1.77e18, 5e7, 'stamp_ns'),
        (7, 0.05, 'time_UNIT'),
    ],
)
def test_the_unit_of_times_since_1970_is_named(tmp_path, start, step, meant):
    rows = '\n'.join(f'{start + step * row:.3f},{row},open' for row in range(4))
    with refused(RecordingError, 'no_time'):
        read(tmp_path, f'Timestamp,kPa,valve\n{rows}\n')


def test_a_proposed_name_keeps_that_a_pressure_is_absolute(tmp_path):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,AIN0 (kPa abs)\n0,101.3\n1,120.0\n', encoding='utf-8')
    new = 'pressure_kpa_abs'
    with refused(RecordingError, 'unknown_column'):
        read_table(path, ImportRequest())
    assert read_table(path, ImportRequest(rename={'AIN0 (kPa abs)': new}))[0].absolute


def test_a_second_pressure_is_not_proposed_as_the_pressure(tmp_path):
    with refused(RecordingError, 'unknown_column'):
        read(tmp_path, 'time_s,kPa,Setpoint pressure [kPa]\n0,1,1\n')


def test_a_date_that_never_changes_is_not_the_time(tmp_path):
    rows = '\n'.join(f'2026-11-28 10:15:00,{0.1 * row:.1f},{row}' for row in range(5))
    with refused(RecordingError, 'no_time'):
        read(tmp_path, f'Start,Elapsed,pressure_kpa\n{rows}\n')


def test_columns_left_out_are_no_second_clock(tmp_path):
    rows = '\n'.join(f'2026-11-28,2026-11-28 10:15:0{row},{row}' for row in range(5))
    table = read(tmp_path, f'Day,Datum,pressure_kpa\n{rows}\n', ignore=('Day',))
    assert np.diff(table.stamp_ns).tolist() == [10**9] * 4


def test_a_line_of_units_may_hold_digits(tmp_path):
    table = read(tmp_path, 'time,pressure\ns,kgf/cm2\n0,0.5\n1,1.0\n')
    assert table.values['pressure'][:, 0] == pytest.approx([49033.25, 98066.5])


@pytest.mark.parametrize(('readings', 'air'), [((0.0, 40.0), ''), ((101.3, 140.0), '101300')])
def test_only_an_air_that_was_read_is_proposed(tmp_path, readings, air):
    path = tmp_path / 'table.csv'
    path.write_text('time_s,P abs [kPa]\n0,{}\n1,{}\n'.format(*readings))
    _, sentences = read_table(path, ImportRequest())
    proposed = [re.search(r'--ambient-pressure (\d+)', sentence) for sentence in sentences]
    assert [one[1] for one in proposed if one] == ([air] if air else [])
