"""Protocols of the lab: they last as long as they should, in ramps and holds, as a lab would."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.protocols import (
    DeadWeights,
    ForceSweeps,
    PROTOCOLS,
    RandomMix,
    SlowRamp,
    Staircase,
    Strings,
)
import pytest
from support.refusals import refused


def held(timeline):
    """Yield seconds, pressure and force of every hold."""
    for i, seconds in enumerate(np.diff(timeline.time)):
        still = np.array_equal(timeline.force[i], timeline.force[i + 1])
        if still and timeline.pressure[i] == timeline.pressure[i + 1]:
            yield seconds, timeline.pressure[i], tuple(timeline.force[i])


@pytest.mark.parametrize('kind', PROTOCOLS)
@pytest.mark.parametrize('duration', [40.0, 93.7])
def test_it_lasts_its_duration_and_nothing_jumps(kind, duration):
    timeline = PROTOCOLS[kind](duration=duration).timeline()
    assert timeline.duration == pytest.approx(duration, abs=1e-9)
    steps = np.diff(timeline.time)
    assert steps.min() > 0.0
    assert np.abs(np.diff(timeline.pressure) / steps).max() < 110e3  # Pa/s
    assert np.abs(np.diff(timeline.force, axis=0) / steps[:, None]).max() < 0.6  # N/s


@pytest.mark.parametrize('kind', PROTOCOLS)
def test_it_begins_at_rest_or_with_its_load(kind):
    timeline = PROTOCOLS[kind]().timeline()
    seconds, pressure, force = next(held(timeline))
    assert pressure == 0.0
    assert seconds >= 1.5
    assert force == ((0.25, 0.0) if kind == 'strings' else (0.0, 0.0))
    assert timeline.loaded == (kind not in ('slow_ramp', 'staircase'))
    assert timeline.loaded == bool(timeline.force.any())


def test_the_slow_ramp_has_one_top():
    timeline = SlowRamp(top=66e3).timeline()
    assert timeline.pressure.tolist() == [0.0, 0.0, 66e3, 66e3, 0.0, 0.0]


def test_the_staircase_holds_every_level_on_the_way_up_and_down():
    holds = list(held(Staircase(pressures=(20e3, 40e3, 60e3)).timeline()))
    assert [pressure for _, pressure, _ in holds] == [0.0, 20e3, 40e3, 60e3, 40e3, 20e3, 0.0]
    assert min(seconds for seconds, _, _ in holds[1:]) > 1.5


def test_dead_weights_meet_every_pressure():
    protocol = DeadWeights(pressures=(0.0, 20e3), weights=(0.1, 0.2), angle=math.pi / 6)
    holds = [(p, force) for _, p, force in held(protocol.timeline())]
    light, heavy = (
        (w * math.cos(math.pi / 6), w * math.sin(math.pi / 6)) for w in protocol.weights
    )
    assert [p for p, _ in holds[-4:]] == [0.0, 20e3, 20e3, 0.0]
    assert [force for _, force in holds[-4:]] == [light, light, heavy, heavy]


def test_force_sweeps_turn_at_the_largest_pull():
    timeline = ForceSweeps(pressures=(2e4, 5e4), angles=(0.0, 0.5 * math.pi)).timeline()
    information_vector = np.hypot(*timeline.force.T)
    assert np.count_nonzero(np.isclose(information_vector, 0.3)) == 4
    assert set(timeline.pressure[np.isclose(information_vector, 0.3)].tolist()) == {2e4, 5e4}
    assert information_vector[3:].min() == pytest.approx(0.04)


def test_strings_are_resolved_to_the_base_frame():
    a, b = 0.3, -0.8
    protocol = Strings(
        pressures=(1e3, 2e3), pull_a=(0.2, 0.1), pull_b=(0.0, 0.3), angle_a=a, angle_b=b
    )
    holds = list(held(protocol.timeline()))
    first, second = (force for _, _, force in holds)
    assert first == pytest.approx((0.2 * math.cos(a), 0.2 * math.sin(a)))
    assert second == pytest.approx(
        (0.1 * math.cos(a) + 0.3 * math.cos(b), 0.1 * math.sin(a) + 0.3 * math.sin(b))
    )


def test_a_random_mix_stays_in_its_limits_and_has_its_own_seed():
    first, same, other = (RandomMix(seed=seed).timeline() for seed in (1.0, 1.0, 2.0))
    assert first.pressure.tolist() == same.pressure.tolist()
    assert first.pressure.tolist() != other.pressure.tolist()
    assert 2e3 <= first.pressure[2:].min() < first.pressure.max() <= 60e3
    assert 0.1 <= first.force[2:, 0].min() < first.force[:, 0].max() <= 0.28
    assert len(list(held(first))) >= 4
    assert not RandomMix(force_x=(0.0, 0.0), force_y=(0.0, 0.0)).timeline().loaded


@pytest.mark.parametrize(
    ('make', 'reason'),
    [
        (lambda: SlowRamp(top=-1.0), 'out_of_bounds'),
        (lambda: SlowRamp(duration=4.9).timeline(), 'too_short'),
        (lambda: Staircase(duration=8.0).timeline(), 'too_short'),
        (lambda: Staircase(pressures=()), 'not_a_table'),
        (lambda: Strings(pull_a=(0.1,)).timeline(), 'wrong_shape'),
    ],
)
def test_what_does_not_fit_is_said(make, reason):
    with refused(RequestError, reason):
        make()
