"""The shipped model of the shipped lab arm is what its script makes, and predicts the live lab."""

from __future__ import annotations

import dataclasses
import runpy

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import model_hash
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.lab.live import LiveLab, Load
import pytest
from support.lab_pairs import NOISELESS

MODEL = load_model(share_path('config/lab_arm.yaml'))


def test_it_is_what_its_script_makes():
    made = runpy.run_path(str(share_path('config/make_lab_arm.py')))['lab_model']()
    assert model_hash(made) == model_hash(MODEL)
    assert all('invented' in source for name, source in MODEL.sources.items() if name != 'domain')


def test_an_arm_alone_and_a_scenario_are_both_labs():
    arm = load_lab(share_path('scenarios/lab_arm.yaml'))
    scenario = load_lab(share_path('scenarios/strings.yaml'))
    assert (arm.name, scenario.name) == ('lab-arm', 'strings')
    assert np.array_equal(arm.arm.modes, scenario.arm.modes)


@pytest.mark.parametrize(
    ('pressure', 'load'), [(0.0, Load()), (3e4, Load()), (5e4, Load(force_x=0.1, force_y=0.05))]
)
def test_it_predicts_the_live_lab(pressure, load):
    scenario = dataclasses.replace(load_lab(share_path('scenarios/lab_arm.yaml')), noise=NOISELESS)
    lab = LiveLab(scenario=scenario)
    _, shape = lab.shape(lab.step(lab.begin(), 60.0, pressure, load))
    x, y, theta = (float(rows[0, 0]) for rows in shape.points([MODEL.length]))
    tip = solve(MODEL, pressure, (load.force_x, load.force_y)).tip
    assert (x, y) == pytest.approx(tip[:2], abs=5e-6)
    assert theta == pytest.approx(tip[2], abs=1e-3)
