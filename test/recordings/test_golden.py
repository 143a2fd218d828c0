"""Shipped recordings are what the scripts beside them make, and hold what they say."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from itertools import groupby, pairwise
from pathlib import Path
import subprocess
import sys

from pneunet_ros.messages.readings import (
    decode_pressure,
    decode_wrench,
    PRESSURE_TYPE,
    WRENCH_TYPE,
)
from pneunet_ros.recordings.recording import open_recording
import pytest
from rosbags.rosbag2 import Reader
from support.example_arms import TABLE_1

# kPa, N, N: typed from the paper twice, there and in the script that makes the recording.
ROWS = [(row.pressure / 1000, *row.force) for row in TABLE_1]


@pytest.fixture(scope='module')
def folder(checkout):
    return checkout / 'bags' / 'table1'


@pytest.fixture(scope='module')
def script(folder):
    spec = spec_from_file_location('make_table1', folder / 'make_table1.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def readings(folder):
    """Pressure and wrench readings by stamp."""
    recording = open_recording(folder)
    pressure = recording.find('pressure', PRESSURE_TYPE)
    wrench = recording.find('end_wrench', WRENCH_TYPE)
    found = {pressure: {}, wrench: {}}
    for topic, log_time, message, _ in recording.messages([wrench, pressure]):
        reading = (decode_pressure if topic == pressure else decode_wrench)(message)
        assert reading.stamp_ns == log_time
        found[topic][log_time] = reading
    return found[pressure], found[wrench]


def test_making_it_again_gives_the_same_messages(folder, tmp_path, foreign_environment):
    subprocess.run(
        [sys.executable, str(folder / 'make_table1.py'), '--output', str(tmp_path)],
        env={**foreign_environment, 'PYTHONPATH': str(folder.parent.parent)},
        check=True,
        timeout=600,
    )
    shipped, made = open_recording(folder), open_recording(tmp_path)
    assert made.topics == shipped.topics
    names = [topic.name for topic in shipped.topics]
    assert list(made.raw_messages(names)) == list(shipped.raw_messages(names))


def test_making_it_twice_gives_the_same_bytes(script, tmp_path):
    script.make(tmp_path / 'a' / 'table1')
    script.make(tmp_path / 'b' / 'table1')
    for file in ('table1.mcap', 'metadata.yaml'):
        first, second = (tmp_path / name / 'table1' / file for name in 'ab')
        assert first.read_bytes() == second.read_bytes()


def test_the_folder_is_a_recording_of_ros_with_its_script(folder):
    files = {file.name for file in folder.iterdir() if file.is_file()}
    assert files == {'README.md', 'make_table1.py', 'metadata.yaml', 'table1.mcap'}
    with Reader(Path(folder)) as reader:
        assert reader.message_count == 2 * 1721


def test_both_topics_come_together_every_50_ms_from_1_s_on(readings):
    pressures, wrenches = readings
    assert list(pressures) == list(wrenches)
    assert list(pressures) == [10**9 + index * 50_000_000 for index in range(1721)]


def test_holds_of_the_script_are_the_rows_of_the_paper(script, readings):
    pressures, wrenches = readings
    held = list(script.holds())
    assert [row for row, _, _ in held] == [*range(15), *range(13, -1, -1)]
    for row, first, last in held:
        assert last - first == 2 * 10**9
        for stamp in range(first, last + 1, 50_000_000):
            wrench = wrenches[stamp]
            assert [pressures[stamp].pressure, wrench.force_x, wrench.force_y] == pytest.approx(
                [ROWS[row][0] * 1000, *ROWS[row][1:]], rel=1e-15
            )
            assert wrench.moment == 0.0
            assert wrench.frame_id == 'pneunet_base'
            assert pressures[stamp].variance == 0.0


def test_holds_can_be_found_in_the_data_alone(script, readings):
    grouped = groupby(readings[0].values(), key=lambda reading: reading.pressure)
    runs = [[reading.stamp_ns for reading in run] for _, run in grouped]
    found = [(run[0], run[-1]) for run in runs if run[-1] - run[0] >= 1.5e9]
    assert found == [(first, last) for _, first, last in script.holds()]
    assert all(len(run) == 1 for run in runs if (run[0], run[-1]) not in found)


def test_ramps_are_straight(script, readings):
    pressures, wrenches = readings
    held = list(script.holds())
    for (row, _, start), (next_row, end, _) in pairwise(held):
        assert end - start == 10**9
        for stamp in range(start, end + 1, 50_000_000):
            share = (stamp - start) / (end - start)
            expected = [
                a + share * (b - a) for a, b in zip(ROWS[row], ROWS[next_row], strict=True)
            ]
            wrench = wrenches[stamp]
            assert [
                pressures[stamp].pressure / 1000,
                wrench.force_x,
                wrench.force_y,
            ] == pytest.approx(expected)
