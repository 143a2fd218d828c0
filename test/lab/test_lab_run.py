"""The lab beside calibration: runs without a file, and the model that knows the truth."""

from __future__ import annotations

import dataclasses

import numpy as np
from pneunet_ros import solve
from pneunet_ros.lab.lab_arm import vary_arm
import pytest
from support.lab_pairs import recorded
from support.lab_run import readings_at_frames, run_of, true_model


def test_frames_without_any_target_are_left_out():
    recording = recorded('strings')
    x = np.array(recording.x)
    x[[3, 7]] = np.nan
    run = run_of(dataclasses.replace(recording, x=x))
    assert run.stamp_ns.size == 398
    assert np.array_equal(run.reading, np.delete(readings_at_frames(recording)[0], [3, 7]))
    assert np.array_equal(run.y[3], recording.y[4], equal_nan=True)


@pytest.mark.parametrize('name', ['unloaded_staircase', 'strings'])
def test_the_true_model_lies_where_the_truth_does(name):
    recording = recorded(name)
    truth, arm = recording.truth, true_model(recording.scenario)
    for frame in range(0, 400, 25):
        force = tuple(truth.force[frame].tolist())
        shape = solve(arm, float(truth.pressure[frame]), force, stations=113)
        assert truth.x[frame] == pytest.approx(shape.x, abs=2e-6)
        assert truth.y[frame] == pytest.approx(shape.y, abs=2e-6)
        assert truth.intrinsic_curvature[frame] == pytest.approx(
            shape.intrinsic_curvature, abs=0.01
        )


def test_the_true_model_knows_plain_effects_and_the_noise():
    scenario = recorded('strings').scenario.with_effects({'gravity': {'weight_y': -1.0}})
    scenario = dataclasses.replace(scenario, arm=vary_arm(scenario.arm, 2))
    arm = true_model(scenario)
    assert [(effect.name, effect.weight_y) for effect in arm.effects] == [('gravity', -1.0)]
    assert arm.sensors.target_std == scenario.noise.target_std
    assert arm.sensors.drift_std == scenario.noise.drift_std
    assert np.array_equal(arm.moment_law.rigidity, scenario.arm.rigidity)
