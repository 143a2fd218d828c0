"""What `calibrate` and `diagnose` ask of recordings: which are unloaded, static, under a load."""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path

import numpy as np
from pneunet_ros.cli.experiments import add_experiments, Experiments, read_experiments
from pneunet_ros.cli.verb import progress_bar
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.messages.readings import wrench_message
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
import pytest
from support.example_arms import paper_arm
from support.recorded_datasets import BASE, readings, record
from support.refusals import refused

NOISE = SensorNoise(pressure_std=60.0, force_std=1e-3, moment_std=1e-5, target_std=1e-4)
ARM = replace(paper_arm(), target_arclength=np.array([0.0, 0.05, 0.1]), sensors=NOISE)


def with_wrench(force: float, moment: float = 0.0) -> list:
    """Return readings in which every wrench is this one, its sign turning."""
    said = []
    for place, entry in enumerate(readings()):
        if entry[0] == 'end_wrench':
            sign = (-1.0) ** place
            row = np.array([sign * force, 0.0, sign * moment])
            message = wrench_message(entry[1], row, BASE, ROSBAGS_TYPES)
            entry = (entry[0], entry[1], message)
        said.append(entry)
    return said


@pytest.fixture
def lab(tmp_path, monkeypatch) -> Path:
    """Stand in a folder with recordings: no wrench, an idle sensor, a load."""
    monkeypatch.chdir(tmp_path)
    record(tmp_path / 'bare.mcap', readings(loaded=False))
    record(tmp_path / 'idle.mcap', with_wrench(0.0039, 3.9e-5))
    record(tmp_path / 'light.mcap', with_wrench(0.0045))
    record(tmp_path / 'twisted.mcap', with_wrench(0.0, 5e-5))
    record(tmp_path / 'loaded.mcap', with_wrench(0.2))
    return tmp_path


def read(*words: str) -> Experiments:
    """Read by a command line `--first REC... --second REC...` and the common options."""
    parser = ArgumentParser()
    for name in ('first', 'second', 'unloaded'):
        parser.add_argument(f'--{name}', type=Path, nargs='+', default=[])
    add_experiments(parser)
    arguments = parser.parse_args(words)
    with progress_bar(shown=False) as bar:
        return read_experiments((arguments.first, arguments.second), ARM, arguments, bar)


def loaded(found: Experiments) -> list[list[bool]]:
    return [[run.loaded for run in group] for group in found.groups]


def test_a_recording_is_unloaded_without_a_wrench_or_where_every_one_is_noise(lab):
    found = read(
        '--first',
        'bare.mcap',
        'idle.mcap',
        'light.mcap',
        '--second',
        'twisted.mcap',
        'loaded.mcap',
    )
    assert loaded(found) == [[False, False, True], [True, True]]
    for word in ('bare.mcap', 'idle.mcap', '0.004 N'):
        assert word in found.unloaded
    for name in ('light', 'twisted', 'loaded.mcap'):
        assert name not in found.unloaded
    assert not found.groups[0][1].force.any()
    assert found.groups[1][1].force.any()


def test_unloaded_recordings_that_are_given_win(lab):
    found = read('--first', 'idle.mcap', 'light.mcap', '--unloaded', 'light.mcap')
    assert loaded(found)[0] == [True, False]
    assert 'light.mcap (given)' in found.unloaded
    with refused(RecordingError, 'loaded'):
        read('--first', 'loaded.mcap', '--unloaded', 'loaded.mcap')
    with refused(RequestError, 'not_found'):
        read('--first', 'bare.mcap', '--unloaded', 'idle.mcap')


def test_a_known_end_load(lab):
    found = read('--first', './bare.mcap', 'idle.mcap', '--end-load', 'bare.mcap', '0.02', '-0.1')
    bare, idle = found.groups[0]
    assert bare.loaded
    assert bare.load_known
    np.testing.assert_array_equal(bare.force, np.tile([0.02, -0.1], (10, 1)))
    assert not bare.moment.any()
    assert not idle.load_known
    assert 'of 0.102 N, the weight of 10.4 g;' in ' '.join(found.left_out)
    for name, load, reason in (
        ('loaded.mcap', ('0', '0.1'), 'exclusive'),
        ('bare.mcap', ('0', 'one'), 'not_a_number'),
        ('bare.mcap', ('0', 'nan'), 'not_a_number'),
        ('idle.mcap', ('0', '1'), 'not_found'),
    ):
        with refused(RequestError, reason):
            read('--first', 'bare.mcap', 'loaded.mcap', '--end-load', name, *load)
    once = ('--end-load', 'bare.mcap', '0', '1')
    with refused(RequestError, 'given_twice'):
        read('--first', 'bare.mcap', *once, *once)
    with refused(RequestError, 'exclusive'):
        read('--first', 'bare.mcap', '--unloaded', 'bare.mcap', *once)


def test_a_string_pulls_from_the_tip_of_every_frame(lab):
    found = read('--first', 'bare.mcap', 'idle.mcap', '--string', 'bare.mcap', '10g', '0.4', '0.1')
    bare = found.groups[0][0]
    assert bare.loaded and bare.load_known
    np.testing.assert_allclose(np.hypot(*bare.force.T), 0.01 * 9.80665)
    assert 'pulls with 0.0981 N, the weight of 10 g' in ' '.join(found.left_out)
    both = ('--string', 'bare.mcap', '10g', '0.4', '0', '--end-load', 'bare.mcap', '0.1', '0')
    with refused(RequestError, 'exclusive'):
        read('--first', 'bare.mcap', *both)
    with refused(RequestError, 'exclusive'):
        read('--first', 'loaded.mcap', '--string', 'loaded.mcap', '10g', '0.4', '0')


def test_static_frames(lab):
    found = read('--first', 'bare.mcap', '--static')
    assert found.groups[0][0].static
    assert not read('--first', 'bare.mcap').groups[0][0].static
