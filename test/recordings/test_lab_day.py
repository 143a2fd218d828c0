"""The recordings of the lab day are what their script makes, small, and good for what they say."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.recording import open_recording
import pytest

NAMES = ('unloaded', 'loaded', 'heldout')
TARGETS = 23
LARGEST = 5_000_000  # bytes of all of it


@pytest.fixture(scope='module')
def folder(checkout):
    return checkout / 'bags' / 'lab_day'


@pytest.fixture(scope='module')
def script(folder):
    spec = spec_from_file_location('make_lab_day', folder / 'make_lab_day.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_folder_holds_recordings_truth_and_how_they_are_made(folder, script):
    assert script.NAMES == NAMES
    made = {f'{name}{suffix}' for name in NAMES for suffix in ('.mcap', '.truth.npz', '.yaml')}
    files = {file.name for file in folder.iterdir() if file.is_file()}
    assert files == made | {'README.md', 'arm.yaml', 'make_lab_day.py'}
    assert sum(file.stat().st_size for file in folder.iterdir()) < LARGEST


@pytest.mark.slow
def test_making_it_again_gives_the_same_readings_and_truth(folder, script, tmp_path, capsys):
    """To the rounding of numpy's own functions, which is not the same on every machine."""
    script.make(tmp_path)
    for name in NAMES:
        shipped, made = (read(place / f'{name}.mcap') for place in (folder, tmp_path))
        assert made.loaded == shipped.loaded
        for item in ('stamp_ns', 'pressure', 'force', 'x', 'y'):
            ours, theirs = getattr(made, item), getattr(shipped, item)
            np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-8, err_msg=item)
        with (
            np.load(folder / f'{name}.truth.npz') as true,
            np.load(tmp_path / f'{name}.truth.npz') as again,
        ):
            for item in ('x', 'y', 'theta', 'pressure', 'force'):
                np.testing.assert_allclose(again[item], true[item], rtol=1e-6, atol=1e-8)


def read(path):
    run, _ = read_run(path, TARGETS)
    return run


@pytest.mark.parametrize('name', NAMES)
def test_a_recording_is_whole(folder, name):
    run, sentences = read_run(folder / f'{name}.mcap', TARGETS)
    assert run.loaded == (name != 'unloaded')
    assert len(run.stamp_ns) >= 150
    assert not sentences
    topics = {topic.name for topic in open_recording(folder / f'{name}.mcap').topics}
    assert topics == {
        f'/pneunet/{item}'
        for item in ('pressure', 'targets', *['end_wrench'] * (name != 'unloaded'))
    }


@pytest.mark.parametrize('name', NAMES)
def test_the_truth_is_that_of_its_recording(folder, name):
    """Targets are where they truly are, but for the noise the README tells of."""
    run = read(folder / f'{name}.mcap')
    with np.load(folder / f'{name}.truth.npz') as truth:
        stamps, x, y = truth['stamp_ns'], truth['target_x'], truth['target_y']
    rows = np.searchsorted(stamps, run.stamp_ns)
    assert np.array_equal(stamps[rows], run.stamp_ns)
    away = np.hypot(run.x - x[rows], run.y - y[rows])
    assert 2e-5 < np.nanmedian(away) < 4e-4
    assert np.nanmax(away) < 1e-3
