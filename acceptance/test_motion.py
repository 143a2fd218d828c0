"""The bench of an arm with mass: its peg is touched, and its summary can say no."""

from __future__ import annotations

import dataclasses

from calibration import true_model
import motion as bench
import numpy as np
import pytest

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")


def test_the_peg_is_in_the_way_and_pushes_the_arm_back():
    recording = bench.peg_recording(77, 0, 0.1)
    touching = np.isfinite(recording.motion.contact_place)
    assert 0.2 < touching.mean() < 0.95
    assert np.hypot(*recording.motion.contact_force.T).max() > 5 * bench.TOUCHES


def test_nothing_is_read_of_a_force_where_nothing_pulls():
    recording = bench.recording_of(77, 0, bench.CAUSE_OF_STEPS, 4.0)
    arm = dataclasses.replace(true_model(recording.scenario), motion=bench.TRUE_MOTION)
    rows = bench.predict(arm, recording, bench.CAUSE_OF_STEPS, 77)
    # The noise of a force sensor (1 mN) would move the tip by a millimeter.
    assert bench.numbers_of(rows[None])['tip_rms'] < 0.3e-3


def test_numbers_of_the_peg_and_goals_that_are_missed():
    rows = np.full((1, 100, 4), np.nan)
    rows[0, :, 0] = 0.0
    rows[0, :50, 0], rows[0, :50, 1] = -0.02, 0.07
    rows[0, 10:60, 2], rows[0, 10:60, 3] = -0.022, 0.072
    found = bench.peg_numbers(rows)
    assert found['found'] == 0.8
    assert (found['false'], found['late']) == (6 / 46, 1.0)
    assert found['size'] == pytest.approx(0.1) and found['place'] == pytest.approx(2e-3)
    off = np.full((1, 200, len(bench.NUMBERS)), 5e-3)
    off[..., 1] = 50.0
    courses = {f'{course}: {bench.WAYS[0]}': off for course in bench.COURSES}
    said = np.array([['0.250000 a contact along the arm', '']])
    fused = {}
    for course in bench.COURSES:
        for way in bench.WAYS[1:]:
            fused |= {f'{course}: {way}': off, f'{course}: {way}: said': said}
    none = {'calibrate, slow ramps': np.full(3, np.nan)}
    summary = bench.summary_of([courses | fused | {'peg, steps': rows} | none])
    assert any('tip_covered' in one for one in summary['missed'])
    assert any('contacts' in one for one in summary['missed'])
    assert summary['calibrations']['calibrate, slow ramps']['models'] == 0
    bench.show(summary, 'title')


def test_a_rig_without_a_model_misses_the_goal_of_calibrations():
    name = 'calibrate, steps and plucks'
    right, none = {name: np.array([0.005, 1.0, 1.0])}, {name: np.full(3, np.nan)}
    assert bench.summary_of([right, right])['missed'] == []
    (missed,) = bench.summary_of([right, none])['missed']
    assert missed.startswith(f'{name}: given = 0.5')


def test_rows_of_another_part_are_kept_under_another_name(monkeypatch):
    names = []
    monkeypatch.setattr(bench, 'run_bench', lambda name, *_: names.append(name) or 0)
    for words in ([], ['--part', 'gravity'], ['--part', 'used'], ['--quick']):
        monkeypatch.setattr('sys.argv', ['motion.py', *words])
        assert bench.main() == 0
    assert len(set(names)) == len(names)
