"""Bad input through `pneunet replay`, end to end: the exit code, the sentence, and no output."""

from __future__ import annotations

from dataclasses import dataclass
import errno
import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.made_recordings import PRESSURE, pressure, STEP_NS, WRENCH, wrench

COUNT = 20
MODEL = share_path('config/paper_arm.yaml')


def good_readings() -> list[tuple]:
    """Make (topic, log time, message) of wrenches and pressures, in turn, that can all be used."""
    readings = []
    for index in range(1, COUNT + 1):
        stamp = index * STEP_NS
        readings += [(WRENCH, stamp, wrench(stamp)), (PRESSURE, stamp, pressure(stamp))]
    return readings


def record(path: Path, readings) -> Path:
    """Write (topic, log time, message) as a recording."""
    with write_recording(path) as writer:
        connections = {}
        for topic, log_time, message in readings:
            if topic not in connections:
                kind = WRENCH_TYPE if hasattr(message, 'wrench') else PRESSURE_TYPE
                connections[topic] = writer.add(topic, kind)
            writer.write(connections[topic], log_time, message)
    return path


@dataclass
class Run:
    """What a replay came to."""

    code: int
    out: str
    error: str

    @property
    def summary(self) -> dict:
        assert self.error == ''
        return json.loads(self.out)


@pytest.fixture
def output(tmp_path):
    """Name the file that a replay shall write, in a folder of its own."""
    (tmp_path / 'output').mkdir()
    return tmp_path / 'output' / 'out.mcap'


@pytest.fixture
def replay(tmp_path, output, capsys):
    """Replay readings, or a file, into `output`."""

    def replay(readings, *options) -> Run:
        source = readings
        if not isinstance(readings, Path):
            source = record(tmp_path / 'in.mcap', readings)
        arguments = ['replay', source, '--output', output, '--json', *options]
        code = main([str(argument) for argument in arguments])
        return Run(code, *capsys.readouterr())

    return replay


def estimates_in(path: Path) -> set[int]:
    """Count the messages of each topic of the estimator."""
    recording = open_recording(path)
    return {recording.topic(f'/pneunet/{item.name}').count for item in OUTPUTS}


def refusal(run: Run) -> str:
    """Return the sentence of a refused request, which persons and programs are told alike."""
    assert run.code == 2
    sentence = json.loads(run.out)['error']
    assert run.error == f'pneunet replay: {sentence}\n'
    return sentence


def refused(run: Run, output: Path, reason: str, *words: str) -> None:
    """Check that the request was refused in one sentence and that nothing is left."""
    assert refusal(run)
    assert json.loads(run.out)['reason'] == reason, run.error
    assert run.error.count('\n') == 1
    for word in words:
        assert word in run.error
    assert os.listdir(output.parent) == []


# Readings: those that can be used give estimates, the others are counted


def test_without_faults_every_pressure_gives_an_estimate(replay, output):
    run = replay(good_readings())
    assert (run.code, run.summary['estimates'], run.summary['rejected']) == (0, COUNT, {})
    assert estimates_in(output) == {COUNT}


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
def test_a_pressure_that_is_no_number_is_dropped(replay, output, value):
    readings = good_readings()
    readings[9][2].fluid_pressure = value
    run = replay(readings)
    assert run.code == 0
    assert run.summary['rejected'] == {'not_finite': 1}
    assert estimates_in(output) == {COUNT - 1}


@pytest.mark.parametrize('value', [math.nan, math.inf])
def test_a_wrench_that_is_no_number_is_dropped_and_the_one_before_used(replay, output, value):
    readings = good_readings()
    readings[8][2].wrench.force.y = value
    run = replay(readings)
    assert run.code == 0
    assert run.summary['rejected'] == {'not_finite': 1}
    assert estimates_in(output) == {COUNT}


def test_a_recording_without_end_wrench_is_refused_with_what_is_there(replay, output):
    run = replay([item for item in good_readings() if item[0] == PRESSURE])
    refused(run, output, 'no_topic', 'end_wrench', '--no-wrench-required')


def test_a_recording_without_pressure_is_refused_with_what_is_there(replay, output):
    run = replay([item for item in good_readings() if item[0] == WRENCH])
    refused(run, output, 'no_topic', 'pressure', 'pneunet import')


def test_an_end_wrench_that_falls_silent_stops_the_estimates(replay, output):
    late = 60 * STEP_NS
    readings = good_readings()
    readings += [
        (PRESSURE, late + after, pressure(late + after)) for after in (STEP_NS, 30 * STEP_NS)
    ]
    run = replay(readings)
    assert run.code == 0
    assert run.summary['rejected'] == {'stale_wrench': 1}
    assert estimates_in(output) == {COUNT + 1}


def test_an_end_wrench_in_another_frame_gives_no_estimate(replay, output):
    readings = good_readings()
    for _, _, message in readings[::2]:
        message.header.frame_id = 'tool0'
    run = replay(readings)
    assert run.code == 1
    assert run.summary['verdicts']['end_wrench']['settings'] == {'wrench_frame': 'tool0'}
    assert not output.exists()
    unjudged = replay(readings_file(output), '--no-judge-readings')
    assert unjudged.code == 1
    assert unjudged.summary['rejected'] == {'wrong_frame': COUNT, 'no_wrench': COUNT}
    assert estimates_in(output) == {0}
    assert replay(readings_file(output), '--wrench-frame', 'tool0', '--overwrite').code == 0
    assert estimates_in(output) == {COUNT}


def readings_file(output: Path) -> Path:
    return output.parent.parent / 'in.mcap'


def test_absolute_pressure_is_refused_with_the_setting_that_helps(replay, output):
    readings = good_readings()
    for _, _, message in readings[1::2]:
        message.fluid_pressure += 101_325.0
    model = ('--model', str(share_path('config/paper_arm.yaml')))
    run = replay(readings, *model)
    assert run.code == 1
    assert run.summary['estimates'] == 0
    settings = run.summary['verdicts']['pressure']['settings']
    assert settings == {'pressure_reference': 'absolute'}
    source = readings_file(output)
    helped = replay(source, *model, '--pressure-reference', 'absolute', '--overwrite')
    assert (helped.code, helped.summary['estimates']) == (0, COUNT)


def test_a_pressure_out_of_range_gives_no_estimate(replay, output):
    readings = good_readings()
    readings[9][2].fluid_pressure = 70e3
    run = replay(readings)
    assert run.code == 0
    assert run.summary['rejected'] == {'out_of_range': 1}
    assert estimates_in(output) == {COUNT - 1}


def test_duplicate_and_backward_stamps_are_dropped(replay, output):
    readings = good_readings()
    readings[11][2].header.stamp.nanosec = 5 * STEP_NS  # as the pressure before
    readings[15][2].header.stamp.nanosec = 3 * STEP_NS
    run = replay(readings)
    assert run.code == 0
    assert run.summary['rejected'] == {'duplicate': 1, 'older': 1}
    assert run.summary['resets'] == 0
    assert estimates_in(output) == {COUNT - 2}


def test_a_clock_that_starts_again_is_followed(replay, output):
    readings = good_readings()
    for topic, log_time, message in good_readings():
        message.header.stamp.sec = 100
        readings.append((topic, log_time + 10**9, message))
    for topic, log_time, message in good_readings():
        readings.append((topic, log_time + 2 * 10**9, message))
    run = replay(readings)
    assert (run.code, run.summary['resets'], run.summary['rejected']) == (0, 1, {})
    assert estimates_in(output) == {3 * COUNT}


# Files


def test_a_truncated_recording_is_read_as_far_as_it_goes_and_that_is_said(
    replay, output, tmp_path
):
    whole = record(tmp_path / 'whole.mcap', good_readings()).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(whole[: len(whole) * 3 // 5])
    run = replay(cut)
    assert run.code == 0
    (sentence,) = run.summary['sentences']
    assert 'cut.mcap' in sentence
    assert 0 < run.summary['estimates'] <= COUNT
    assert estimates_in(output) == {run.summary['estimates']}


def test_a_file_that_is_no_recording_is_refused(replay, output, tmp_path):
    other = tmp_path / 'other.mcap'
    other.write_text('pressure,force\n')
    refused(replay(other), output, 'wrong_kind', 'other.mcap')


def test_two_candidates_are_listed_and_one_can_be_chosen(replay, output):
    readings = good_readings()
    for topic, log_time, message in good_readings():
        if topic == PRESSURE:
            readings.append(('/other/pressure', log_time, message))
    run = replay(readings)
    refused(run, output, 'ambiguous_topic', '/other/pressure, /pneunet/pressure')
    run = replay(readings_file(output), '--topic', 'pressure=/pneunet/pressure')
    assert (run.code, run.summary['topics']['pressure']) == (0, PRESSURE)


def test_a_topic_of_that_name_that_is_not_there_is_refused(replay, output):
    run = replay(good_readings(), '--topic', 'pressure=/their/pressure')
    refused(run, output, 'no_topic', '/their/pressure', '/pneunet/end_wrench')


@pytest.mark.parametrize(
    ('right', 'wrong', 'reason', 'words'),
    [
        ('clamp_angle:', 'clamp_angel:', 'unknown_key', ('arm.clamp_angel', 'clamp_angle')),
        ('split: [0.10, ', 'split: [', 'wrong_shape', ('moment_law.split', '6')),
        ('    - [0.0800, 0.0450]', '    - [0.0800]', 'not_a_table', ('moment_law.rigidity',)),
        ('length: 0.112', 'length: long', 'not_a_number', ('arm.length', 'long')),
        ('name: paper-arm', 'name: [', 'not_yaml', ()),
    ],
    ids=['unknown-key', 'short-table', 'ragged-table', 'no-number', 'no-yaml'],
)
def test_a_wrong_model_file_is_refused_by_file_and_key(
    replay, output, tmp_path, right, wrong, reason, words
):
    text = MODEL.read_text()
    assert right in text
    model = tmp_path / 'model.yaml'
    model.write_text(text.replace(right, wrong))
    refused(replay(good_readings(), '--model', model), output, reason, 'model.yaml', *words)


def test_an_output_that_exists_is_refused_and_stays(replay, output):
    output.write_text('precious')
    run = replay(good_readings())
    assert str(output) in refusal(run)
    assert json.loads(run.out)['reason'] == 'exists'
    assert output.read_text() == 'precious'


def test_the_input_is_no_output_even_with_overwrite(tmp_path, capsys):
    source = record(tmp_path / 'in.mcap', good_readings())
    before = source.read_bytes()
    assert main(['replay', str(source), '--output', str(source), '--overwrite', '--json']) == 2
    assert json.loads(capsys.readouterr().out)['reason'] == 'overwrites_input'
    assert source.read_bytes() == before


def test_a_full_disk_leaves_nothing(replay, output, tmp_path, monkeypatch):
    source = record(tmp_path / 'in.mcap', good_readings())

    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('pneunet_ros.recordings.recording_writer.MessageStorage.write', full)
    refused(replay(source), output, 'unwritable', 'out.mcap')


def test_after_a_kill_nothing_stands_under_the_name(output, checkout, foreign_environment):
    command = [sys.executable, '-m', 'pneunet_ros.cli', 'replay', str(share_path('bags/table1'))]
    process = subprocess.Popen(
        [*command, '--output', str(output)],
        env={**foreign_environment, 'PYTHONPATH': str(checkout)},
        stdout=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 300.0
    while not list(output.parent.glob('.*/*/*.mcap')) and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    assert process.wait(300) == -signal.SIGKILL
    assert not output.exists()
    assert all(name.startswith('.') for name in os.listdir(output.parent))


@pytest.mark.parametrize('verb', ['urdf', 'mjcf'])
def test_a_model_is_no_output_even_with_overwrite(tmp_path, capsys, verb):
    model = tmp_path / 'arm.yaml'
    model.write_bytes(share_path('config/paper_arm.yaml').read_bytes())
    written = model.read_bytes()
    arguments = [verb, '--model', str(model), '--output', str(model), '--overwrite', '--json']
    assert main(arguments) == 2
    assert json.loads(capsys.readouterr().out)['reason'] == 'overwrites_input'
    assert model.read_bytes() == written


@pytest.mark.parametrize('path', ['', '.', '/', '..'])
@pytest.mark.parametrize(
    'words',
    [
        ['simulate', 'strings', '--output', 'x.mcap', '--after'],
        ['calibrate', '--unloaded', 'x.mcap', '--arm', str(MODEL), '--output'],
    ],
)
def test_a_path_without_a_name_is_refused(tmp_path, monkeypatch, capsys, path, words):
    monkeypatch.chdir(tmp_path)
    assert main([*words, path, '--json']) == 2
    assert json.loads(capsys.readouterr().out)['reason'] == 'wrong_name'
