"""The bench of calibration by other sensors: what it draws, and what it sums up."""

from __future__ import annotations

import numpy as np
from other_recordings import draw_recording, FEWEST_DOTS, NOISE, numbers_of, summary_of
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario


def test_what_is_drawn_is_of_the_seed_and_within_its_limits():
    for seed in range(50):
        found = draw_recording(seed, 23)
        assert found == draw_recording(seed, 23)
        assert all(low <= found.noise[name] <= high for name, (low, high) in NOISE.items())
        assert len(set(found.dots)) == len(found.dots) >= FEWEST_DOTS
    assert draw_recording(1, 23) != draw_recording(2, 23)


def test_a_scenario_is_changed_in_all_that_is_drawn():
    scenario, other = load_scenario(share_path('scenarios/strings.yaml')), draw_recording(3, 23)
    changed = other.change(scenario)
    assert changed.noise.pressure_std == other.noise['pressure_std']
    assert (changed.rates.frames, changed.rates.wrench) == (other.frames, other.readings)
    assert np.array_equal(changed.arm.targets, scenario.arm.targets[other.dots])
    assert np.allclose(changed.arm.rigidity, other.stiffer * scenario.arm.rigidity)


def row(law: float, frames: float = 10.0, *, settled: bool = True, **other) -> dict:
    return {
        'refused': '',
        'settled': settled,
        'frames': frames,
        'readings': 5.0,
        'held_out_over_true': 1.0,
        'law_error': np.full((3, 5), law),
        'curvature_error': np.full((5, 9), 1.0),
        **other,
    }


def test_goals_are_missed_by_errors_that_are_not_honest_and_by_fits_that_do_not_settle():
    good = summary_of([row(1.0), row(-1.0, frames=1.0)])
    assert not good['missed']
    assert good['rare readings']['arms'] == 1
    (missed,) = summary_of([row(1.0), row(9.0)])['missed']
    assert missed.startswith('law_error = 6.4')
    lawless = {key: value for key, value in row(1.0).items() if key != 'law_error'}
    (missed,) = summary_of([row(1.0), lawless])['missed']
    assert missed.startswith('with_law = 0.5')
    refused = {'refused': 'why', 'settled': False, 'frames': 1.0, 'readings': 50.0}
    assert any(item.startswith('settled') for item in summary_of([row(1.0), refused])['missed'])
    assert numbers_of([refused])['refused'] == 1.0
