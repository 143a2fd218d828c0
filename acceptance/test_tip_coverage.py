"""The bench of the tip's covariance: right where the model is the truth, and able to say no."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from support.lab_run import true_model
import tip_coverage as bench

SEED = 77


def errors(**changes):
    """Return what comes of the model that knows the truth, with other noise of its sensors."""
    scenario = load_scenario(share_path('scenarios/strings.yaml'))
    arm = true_model(replace(scenario, arm=vary_arm(scenario.arm, SEED)))
    arm = replace(arm, sensors=replace(arm.sensors, **changes))
    return {
        name: bench.errors_of(arm, bench.truth_of(SEED, name), SEED)
        for name in ('paper', 'light, low pressure')
    }


def test_the_true_model_covers_and_one_that_is_too_sure_does_not():
    right = bench.summary_of([errors()])
    assert right['pooled']['refused'] == 0
    assert 0.90 < right['pooled']['covered'] < 0.99
    assert 1.4 < right['pooled']['nees'] < 2.6
    assert np.all(np.array(right['pooled']['places_covered']) > 0.88)
    sure = bench.summary_of([errors(force_std=4e-4, pressure_std=25.0)])
    assert {'pooled', 'least', 'nees'} <= set(sure['missed'])
    unsure = bench.summary_of([errors(force_std=2e-3, pressure_std=150.0)])
    assert {'pooled', 'nees'} <= set(unsure['missed'])


def test_a_history_without_any_estimate_is_counted():
    found = errors()
    for item in found.values():
        item['nees'][:100] = np.nan
    summary = bench.summary_of([found])
    assert summary['pooled']['refused'] == 200
    assert 'refused' in summary['missed'] and 'least' not in summary['missed']
    found['paper']['nees'][:] = np.nan
    assert 'least' in bench.summary_of([found])['missed']
