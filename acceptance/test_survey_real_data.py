"""Real actuators as a fleet: what is written is what the table says."""

from __future__ import annotations

import json
import sys

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.cli.main import main
from pneunet_ros.offline.survey import read_fleet
from pneunet_ros.recordings.dataset_reader import read_run
import pytest
import real_data_fit as table
import survey_real_data as bench

MEASURED = pytest.mark.skipif(
    not table.DATA.is_file(), reason=f'no real measurements here: {table.DATA} is absent'
)


def made(name: str, turning: float) -> table.Actuator:
    pressure = np.linspace(0.0, 4e4, 9)
    bend = turning * pressure / 4e4 + 1e-9
    chord = table.LENGTH * np.sinc(bend / (2.0 * np.pi))
    tip = chord[:, None] * np.column_stack([np.cos(bend / 2.0), np.sin(bend / 2.0)])
    return table.Actuator(name=name, pressure=pressure, tip=tip)


def test_an_actuator_is_an_arm_of_a_fleet(tmp_path):
    actuators = [made('left', 1.0), made('right', -1.0)]
    bench.write_fleet(actuators, tmp_path, 0.3)
    left, right = read_fleet(tmp_path, tmp_path / 'none.yaml')
    assert (left.name, right.name) == ('left', 'right')
    arm = load_model(left.arm)
    assert arm.target_arclength.tolist() == [0.0, table.LENGTH]
    rows = []
    for role in ('unloaded', 'heldout'):
        (path,) = left.roles[role]
        run, _ = read_run(path, 2)
        assert not run.loaded
        rows += list(zip(run.pressure, run.x[:, 1], run.y[:, 1], strict=True))
    known = [*zip(actuators[0].pressure, *actuators[0].tip.T, strict=True)]
    assert np.array(sorted(rows)) == pytest.approx(np.array(known), abs=1e-6)


@pytest.mark.slow
@MEASURED
def test_all_real_arms_through_the_verb(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['survey_real_data.py', str(tmp_path / 'fleet')])
    bench.main()
    capsys.readouterr()
    fleet, out = str(tmp_path / 'fleet'), str(tmp_path / 'out')
    assert main(['survey', fleet, '--static', '--output', out, '--json']) == 0
    content = json.loads(capsys.readouterr().out)
    assert content['effects'] == {'pressure_elongation': 27}
    assert content['odd'] == []
