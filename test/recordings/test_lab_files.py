"""Files of the virtual lab: the recording reads as the run it is, and the truth lies beside it."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.lab.lab_recording import LabTruth
from pneunet_ros.lab.scenario import describe
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.lab_files import memory_after, message_count, truth_file, write_lab
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.lab_pairs import recorded
from support.lab_run import run_of
from support.refusals import refused


def write(name, path, overwrite=False):
    calls = []
    recording = recorded(name)
    write_lab(recording, path, overwrite=overwrite, on_progress=lambda: calls.append(1))
    assert len(calls) == message_count(recording)
    return recording


@pytest.mark.parametrize('name', ['unloaded_staircase', 'dead_weights'])
def test_a_written_recording_reads_as_the_run_it_is(name, tmp_path):
    recording = write(name, tmp_path / 'lab.mcap')
    made = run_of(recording)
    read, sentences = read_run(tmp_path / 'lab.mcap', 23)
    assert not sentences
    for item in dataclasses.fields(made):
        got, expected = getattr(read, item.name), getattr(made, item.name)
        if item.name in ('x', 'y'):  # float32 in the file
            assert got == pytest.approx(expected, abs=1e-8, nan_ok=True)
        elif item.name != 'name':
            assert np.array_equal(got, expected), item.name
    topics = {topic.name: topic.count for topic in open_recording(tmp_path / 'lab.mcap').topics}
    wrenches = {'/pneunet/end_wrench': 2000} if made.loaded else {}
    assert topics == {'/pneunet/pressure': 2000, '/pneunet/targets': 400, **wrenches}


def test_the_same_scenario_makes_the_same_bytes(tmp_path):
    scenario = recorded('strings').scenario
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        path = tmp_path / name / 'lab.mcap'
        write_lab(simulate(scenario), path, overwrite=False, on_progress=lambda: None)
    for file in ('lab.mcap', 'lab.truth.npz'):
        assert (tmp_path / 'a' / file).read_bytes() == (tmp_path / 'b' / file).read_bytes()


def test_the_truth_is_complete_and_needs_no_pickle(tmp_path):
    recording = write('strings', tmp_path / 'lab.mcap')
    with np.load(tmp_path / 'lab.truth.npz', allow_pickle=False) as content:
        for item in dataclasses.fields(LabTruth):
            assert np.array_equal(content[item.name], getattr(recording.truth, item.name))
        assert np.array_equal(content['stamp_ns'], recording.stamp_ns)
        assert json.loads(str(content['scenario'])) == describe(recording.scenario)


def test_a_folder_has_its_truth_beside_it(tmp_path):
    write('unloaded_ramp', tmp_path / 'lab')
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ['lab', 'lab.truth.npz']
    assert truth_file(tmp_path / 'lab') == truth_file(tmp_path / 'lab.mcap')


@pytest.mark.parametrize('there', ['lab.mcap', 'lab.truth.npz'])
def test_neither_file_is_replaced_unasked_nor_left_alone(there, tmp_path):
    (tmp_path / there).write_text('precious')
    with refused(RecordingError, 'exists'):
        write('unloaded_ramp', tmp_path / 'lab.mcap')
    assert [entry.name for entry in tmp_path.iterdir()] == [there]
    write('unloaded_ramp', tmp_path / 'lab.mcap', overwrite=True)
    assert len(list(tmp_path.iterdir())) == 2


def test_an_interrupted_write_leaves_nothing(tmp_path):
    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_lab(recorded('strings'), tmp_path / 'lab.mcap', overwrite=False, on_progress=stop)
    assert not list(tmp_path.iterdir())


def test_the_memory_of_an_arm_is_in_its_truth(tmp_path):
    scenario = recorded('strings').scenario.with_effects({'hysteresis': {'width': 2e3}})
    first = simulate(scenario)
    write_lab(first, tmp_path / 'lab.mcap', overwrite=False, on_progress=lambda: None)
    memory = memory_after(tmp_path / 'lab.mcap')
    assert (memory.time, memory.pressure) == (2440.0, 66e3)
    assert memory.past == {'hysteresis': (65e3, 65e3, 65e3)}
    assert memory.past == first.memory.past
    (tmp_path / 'lab.truth.npz').write_text('no truth')
    for path in ('lab.mcap', 'none.mcap'):
        with refused(RequestError, 'no_truth'):
            memory_after(tmp_path / path)
