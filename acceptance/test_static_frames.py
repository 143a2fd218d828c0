"""The sets of few static frames: what they hold, and how an answer is scored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.measurement.tip_frame import TIP_FRAME
import pytest
from static_frames import diagnosed, Found, made, model, recorded, summary, WANTED


def found(**changes) -> Found:
    """Return what was said of a set."""
    usual = {
        'strain': 0.1, 'uneven': 0.0, 'frames': 5, 'held_out': 0, 'static': True,
        'answer': 'named', 'effects': ('pressure_elongation',), 'alternatives': (),
        'visible': True,
    }  # fmt: skip
    return Found(**(usual | changes))


def test_a_set_is_what_it_says():
    for which in range(24):
        bench = made(which, 0)
        assert np.array_equal(bench.tip, made(which, 0).tip)
        assert bool(bench.strain) == bool(which % 2)
        training, held_out = recorded(bench, which)
        frames = [len(run.stamp_ns) for run in (*training, *held_out)]
        assert 3 <= frames[0] <= 9
        assert sum(frames) == bench.pressure.size
        assert all(run.static == bench.static for run in training)
        assert model(bench).sensors.target_std == bench.noise
        if bench.uneven or bench.strain:
            continue
        # An arc: the tip turns by half the angle, and is the chord away.
        half = np.arctan2(bench.tip[:, 1], bench.tip[:, 0])[1:]
        chord = np.hypot(*bench.tip.T)[1:]
        np.testing.assert_allclose(chord, bench.length * np.sin(half) / half, rtol=1e-6)


@pytest.mark.parametrize(
    ('score', 'changes'),
    [
        ('right', {}),
        ('inseparable', {'answer': 'inseparable', 'effects': ('gravity',),
                         'alternatives': ('pressure_elongation',)}),
        ('inseparable', {'answer': 'inseparable', 'alternatives': ('gravity',)}),
        ('right', {'strain': 0.0, 'answer': 'none', 'effects': ()}),
        ('missed', {'answer': 'none', 'effects': ()}),
        ('too faint', {'answer': 'none', 'effects': (), 'visible': False}),
        ('false name', {'strain': 0.0}),
        ('false name', {'effects': ('camera_scale',)}),
        ('false name', {'effects': ('pressure_elongation', 'gravity')}),
        ('false name', {'effects': ('gravity', 'pressure_elongation')}),
        ('time', {'effects': ('pressure_elongation', 'creep')}),
        ('time', {'effects': ('camera_delay',)}),
        ('unknown', {'answer': 'unknown', 'effects': ()}),
        ('unobservable', {'answer': 'unobservable', 'effects': ()}),
    ],
)  # fmt: skip
def test_scores(score, changes):
    assert found(**changes).score == score


def test_the_summary_counts_by_what_was_hidden():
    some = [found(), found(), found(strain=0.0, uneven=0.1)]
    assert summary(some) == {
        'elongation, bends evenly': {'right': 2},
        'nothing, bends unevenly': {'false name': 1},
    }


def test_elongation_is_named_and_nothing_is_not():
    assert [diagnosed(which, 0).score for which in (1, 4)] == ['right', 'right']


def test_what_an_uneven_arm_does_as_well_is_not_observable():
    bench = made(18, 0)
    assert bench.uneven
    assert not bench.strain
    training, held_out = recorded(bench, 18)
    answer = diagnose(model(bench), training, held_out)
    assert answer.answer == 'unobservable'
    assert 'bends unevenly' in answer.sentence
    assert 'more targets' in answer.sentence
    assert not answer.effects
    assert not any(item.observable for item in answer.detectable.values())


def test_detection_limits_are_those_beside_an_arm_that_may_bend_unevenly(monkeypatch):
    bench = made(4, 0)
    training, _ = recorded(bench, 4)
    limits = []
    for settings in (TIP_FRAME, replace(TIP_FRAME, nonuniformity=1e-6)):
        monkeypatch.setattr('pneunet_ros.calibration.checks.nonuniformity.TIP_FRAME', settings)
        found = diagnose(model(bench), training, [])
        limits.append(found.detectable[WANTED].smallest)
    assert limits[0] > 1.2 * limits[1]
