"""The suite of everyday causes: each does to a recording what its name says, and only that."""

from __future__ import annotations

import everyday_causes as bench
import numpy as np
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.fusion.causes import MotionCause, PressureCause
from pneunet_ros.model.domain_position import LOAD_BEYOND
import pytest

RIG, SECONDS = 77, 3.0
LOST = '3 % lost frames, stamped k / fps'


@pytest.fixture(scope='module')
def clean():
    return bench.recording_of(RIG, 0, 'nothing wrong', SECONDS)


def off(recording, clean):
    return np.stack([recording.x - clean.x, recording.y - clean.y], axis=-1)


def arrived(recording, name, **options):
    return list(bench.readings_of(recording, name, RIG, **options))


def test_dots_beside_the_neutral_line_stand_across_the_arm(clean):
    moved = off(bench.recording_of(RIG, 0, 'dots 3 mm beside the neutral line', SECONDS), clean)
    theta = bench.heading_at(clean)
    seen = np.isfinite(moved[..., 0])
    assert np.hypot(moved[seen, 0], moved[seen, 1]) == pytest.approx(3e-3)
    along = moved[..., 0] * np.cos(theta) + moved[..., 1] * np.sin(theta)
    assert np.nanmax(np.abs(along)) < 1e-12


def test_dots_that_are_closer_miss_their_places_by_a_twentieth(clean):
    moved = off(bench.recording_of(RIG, 0, 'dots 5 % closer', SECONDS), clean)
    size, places = np.hypot(*np.moveaxis(moved, -1, 0)), clean.scenario.arm.targets
    assert np.nanmax(np.abs(size[0] - 0.05 * places)) < 1e-4  # straight at the beginning


def test_a_rolling_shutter_shows_a_moving_arm_later(clean):
    truth = clean.truth
    moved = off(bench.rolling(clean, readout=33e-3, height=0.16), clean)[:-4, -1, 1]
    late = 33e-3 * (0.5 - truth.target_y[:, -1] / 0.16)
    expected = (late * np.gradient(truth.target_y[:, -1], truth.time))[:-4]
    seen = np.isfinite(moved)
    assert np.abs(expected).max() > 1e-4
    # At kinks of the ramps the speed is not that of the row that is read.
    assert np.std((moved - expected)[seen]) < 0.35 * np.std(expected[seen])


def test_a_mirrored_image_and_a_tilted_table(clean):
    mirrored = bench.recording_of(RIG, 0, 'mirrored image', SECONDS)
    assert np.array_equal(mirrored.y, -clean.y, equal_nan=True)
    tilted = bench.recording_of(RIG, 0, 'table tilted by 10 degrees', SECONDS)
    assert 2e-3 < clean.truth.y[-1, -1] - tilted.truth.y[-1, -1] < 30e-3


def test_lost_frames_make_stamps_fall_behind(clean):
    frames = {}
    for name in ('nothing wrong', LOST):
        events = [event for one in arrived(clean, name) for event in one]
        frames[name] = [one.stamp_ns for one in events if isinstance(one, TargetSightings)]
    period = bench.EVERY / bench.RATE * 1e9
    steps = np.diff(frames[LOST])
    assert np.allclose(steps, period, atol=2.0)
    assert len(frames[LOST]) < len(frames['nothing wrong'])
    assert frames[LOST][-1] < frames['nothing wrong'][-1] - 0.5 * period


def test_frames_arrive_late_and_the_ripple_is_in_the_reading_alone(clean):
    found = {}
    for name in ('nothing wrong', '2.5 kPa of valve ripple at 27 Hz'):
        events = arrived(clean, name, wrench=True)
        for instant, one in enumerate(events):
            for event in one:
                if isinstance(event, TargetSightings):
                    assert event.stamp_ns == clean.stamp_ns[instant - bench.LATE]
            assert isinstance(one[-2], WrenchReading)
        found[name] = np.array([one[-1].pressure for one in events])
        assert all(isinstance(one[-1], PressureReading) for one in events)
    ripple = np.subtract(*reversed(list(found.values())))
    assert ripple.std() == pytest.approx(2.5e3 / np.sqrt(2.0), rel=0.05)


def test_numbers_can_be_bad_and_what_is_said_is_counted():
    random = np.random.default_rng(5)
    nees = np.sum(random.standard_normal((1, 4000, 2)) ** 2, axis=-1)
    rows = np.stack([0.1 * nees, nees, 0.1 * nees, nees, 0.0 * nees], axis=-1)
    assert bench.numbers_of(rows)['tip_covered'] == pytest.approx(0.95, abs=0.015)
    rows[..., 1] *= 4.0
    rows[:, ::2, 3] = np.nan
    found = bench.numbers_of(rows)
    assert found['tip_covered'] < 0.6 and found['withheld'] == 0.5
    assert found['estimates'] == 1.0
    said = bench.shares_of([('a: b', 'c'), ('a: d',), (), ()])
    assert said[:2].tolist() == ['0.500000 a', '0.250000 c']


def test_silence_misses_its_goal_and_a_force_that_is_withheld_none():
    rows = np.zeros((1, 100, len(bench.NUMBERS)))
    rows[..., 3] = np.nan
    rig = dict.fromkeys(bench.CAUSES, rows)
    rig |= {f'{one}: said': np.array([['']]) for one in bench.CAUSES}
    assert bench.summary_of([rig])['missed'] == []
    silent = rows.copy()
    silent[:, :6] = np.nan
    (missed,) = bench.summary_of([rig | {'mirrored image': silent}])['missed']
    assert missed.startswith('mirrored image: estimates = 0.940')


def test_only_causes_and_contacts_accuse_an_arm_with_which_nothing_is_wrong(capsys):
    rows = np.zeros((2, 100, len(bench.NUMBERS)))
    rows[1, :40, 1] = 50.0
    rows[..., 3] = np.nan
    blames = bench.CONTACT, bench.kind_of(PressureCause.sentence)
    true = bench.kind_of(LOAD_BEYOND)
    assert true not in bench.ACCUSATIONS
    for name in bench.NOTHING:
        rig = dict.fromkeys(bench.CAUSES, rows)
        rig |= {f'{one}: said': np.array([[f'0.060000 {true}']]) for one in bench.CAUSES}
        rig[f'{name}: said'] = np.array([[f'0.006000 {one}' for one in blames]])
        summary = bench.summary_of([rig])
        missed, *worst = summary['missed']
        assert missed.startswith(f'{name}: 0.012')
        assert summary['causes'][name]['tip_covered_worst'] == 0.6
        assert all('tip_covered_worst = 0.600' in one for one in worst)
        assert len(worst) == len(bench.CAUSES)
    bench.show(summary, 'title')
    assert '| 0.80 (0.60) |' in capsys.readouterr().out


def test_a_cause_that_is_not_there_is_counted_and_the_right_one_is_not():
    rows = np.zeros((2, 100, len(bench.NUMBERS)))
    rows[..., 3] = np.nan
    swing = f'0.500000 {bench.kind_of(MotionCause.sentence)}'
    rig = dict.fromkeys(bench.CAUSES, rows)
    rig |= {f'{one}: said': np.array([[''], ['']]) for one in bench.CAUSES}
    rig |= {
        f'{one}: said': np.array([[swing], [swing.replace('0.5', '0.02')]])
        for one in ('the arm has mass, steps', 'table tilted by 10 degrees', *bench.NOTHING)
    }
    wrong = bench.summary_of([rig])['wrong']
    assert {name: count for name, count in wrong.items() if count} == {
        'table tilted by 10 degrees': 1,
        'nothing wrong': 1,
        'nothing wrong, unloaded': 1,
    }


def test_rows_of_shorter_recordings_are_kept_under_another_name(monkeypatch):
    names = []
    monkeypatch.setattr(bench, 'run_bench', lambda name, *_: names.append(name) or 0)
    for words in (['--quick'], ['--rigs', '1', '--recordings', '1']):
        monkeypatch.setattr('sys.argv', ['everyday_causes.py', *words])
        assert bench.main() == 0
    assert names == ['everyday_causes_quick', 'everyday_causes']
