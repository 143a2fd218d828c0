"""What the readings of a recording are taken for."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.starting_arm import INVENTED, starting_arm
from pneunet_ros.offline.judge import judge_recording
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.recordings.recording import open_recording
import pytest


@pytest.fixture(scope='module')
def loaded(tmp_path_factory):
    """Return a recording with a right force sensor, and the arm that it is of."""
    given = load_scenario(share_path('scenarios/random_mix.yaml'))
    lab = replace(given, protocol=replace(given.protocol, duration=20.0), rates=Rates(frames=10.0))
    path = tmp_path_factory.mktemp('loaded') / 'mix.mcap'
    write_lab(simulate(lab), path, overwrite=True, on_progress=lambda: None)
    return open_recording(path), lab.arm


@pytest.mark.parametrize('stiffness', [0.05, 0.25, 4.0])
def test_an_invented_stiffness_is_no_evidence_against_a_force_sensor(loaded, stiffness):
    recording, lab = loaded
    arm = starting_arm('finger', lab.length, stiffness * lab.weight, lab.targets, 66e3)
    for source, contradicted in ((INVENTED, set()), ('measured', {'end_wrench'})):
        arm = replace(arm, sources={'moment_law': source})
        found = judge_recording(recording, arm, EstimatorSettings(), {})
        assert set(found.contradicted) == contradicted
