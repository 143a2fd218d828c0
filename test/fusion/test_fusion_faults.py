"""Faults of sensors: what is stale, unread or refuted is not used as if it were read."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import ImuReading, PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.fusion import weighing
from pneunet_ros.fusion.belief import CONTACT, FORCE_SENSOR, PRESSURE, reset_to_prior
from pneunet_ros.fusion.belief_estimate import other_shape
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion, PRESSURES_KEPT
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.inference.bank import Hypothesis
from pneunet_ros.model.gravity import gravity_of, IMU
import pytest

MILLISECOND = 1_000_000
GAUGE = 40e3  # Pa
NAMES = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')
RANDOM = np.random.default_rng(3)


@pytest.fixture(scope='module')
def fusion() -> Fusion:
    return Fusion(arm=load_model(share_path('config/lab_arm.yaml')))


def pressure(stamp_ms: float, gauge: float = GAUGE) -> PressureReading:
    """Return a reading of the pressure (Pa)."""
    return PressureReading(stamp_ns=round(stamp_ms * MILLISECOND), pressure=gauge)


def frame(fusion: Fusion, stamp_ms: float, gauge: float = GAUGE, noise: float = 1.0) -> Any:
    """Return the targets of the arm without a load; noise: of the stated one."""
    targets, shape = fusion.arm.target_arclength, solve(fusion.arm, pressure=gauge)
    std = noise * fusion.arm.sensors.target_std
    x, y = (
        np.interp(targets, shape.arclength, row) + std * RANDOM.standard_normal(targets.size)
        for row in (shape.x, shape.y)
    )
    nothing = dict.fromkeys(NAMES, np.full(targets.size, np.nan))
    return TargetSightings(stamp_ns=round(stamp_ms * MILLISECOND), x=x, y=y, **nothing)


def imu(stamp_ms: float) -> ImuReading:
    """Return a reading of an accelerometer at rest, gravity along -x."""
    return ImuReading(
        stamp_ns=round(stamp_ms * MILLISECOND),
        x=STANDARD_GRAVITY,
        y=0.0,
        z=0.0,
        frame_id='pneunet_base',
    )


def run(fusion: Fusion, *events: Any) -> tuple[FusionState, list[Any]]:
    """Return the state after events, and what each gave."""
    state, outcomes = FusionState(), []
    for event in events:
        state, outcome = fusion.step(state, event)
        outcomes.append(outcome)
    return state, outcomes


def watched(fusion: Fusion) -> Fusion:
    """Return the fusion of an arm whose direction of gravity is read."""
    return Fusion(
        arm=replace(fusion.arm, gravity=gravity_of(IMU)),
        sensors=EstimatorSettings(wrench_required=False),
    )


def test_a_frame_alone_needs_gravity_as_a_pressure_does(fusion):
    of = watched(fusion)
    upright = replace(of, arm=replace(of.arm, gravity=gravity_of([-1.0, 0.0])))
    frames = [frame(upright, stamp_ms) for stamp_ms in range(1000, 2000, 100)]
    state, outcomes = run(of, *frames)
    assert {one.reason for one in outcomes if one is not None} == {'no_imu'}
    assert state.counts.unused['no_imu'] and state.belief is None
    # An accelerometer that falls silent: what it said last is not what holds 2 s later.
    state, outcomes = run(of, imu(1000), pressure(1001), *frames)
    assert outcomes[1].reason == 'too_uncertain'  # before any frame
    said = [one.reason for one in outcomes[2:] if isinstance(one, Refusal)]
    assert said and set(said) == {'stale_imu'}
    # With it, the same frames are estimated alone.
    known = [event for one in frames for event in (imu(one.stamp_ns / MILLISECOND), one)]
    _, outcomes = run(of, *known)
    found = [one.estimate for one in outcomes if isinstance(one, FusedEstimate)]
    assert found and all(one.gravity == (-1.0, 0.0) for one in found)
    # After the last pressure, gravity is that of the frame and not of the pressure.
    upward = replace(imu(1000), x=-STANDARD_GRAVITY)
    _, outcomes = run(of, upward, pressure(1000), *known[2:])
    found = [one.estimate for one in outcomes if isinstance(one, FusedEstimate)]
    assert found and all(one.gravity == (-1.0, 0.0) for one in found)


def test_frames_that_fit_nothing_are_searched_for_causes_less_and_less(fusion, monkeypatch):
    """While none has fitted ever: the 1st, 2nd, 4th, 8th in a row, or each takes half a second."""
    tested = []
    looked = weighing.should_test_causes
    monkeypatch.setattr(
        weighing, 'should_test_causes', lambda *given: tested.append(1) or looked(*given)
    )
    state = FusionState()
    for stamp_ms in range(1000, 2200, 100):
        seen = frame(fusion, stamp_ms)
        wrong = replace(seen, x=1.02 * seen.x, y=1.02 * seen.y)
        for event in (wrong, pressure(stamp_ms)):
            state, _ = fusion.step(state, event)
            state = fusion.settle(state)
    assert (state.counts.frames, state.counts.lost) == (0, 12)
    assert len(tested) == 4


def test_without_gravity_the_history_of_the_arm_goes_on(fusion):
    of = watched(fusion)
    state, outcomes = run(of, pressure(1000), pressure(3000))
    assert [one.reason for one in outcomes] == ['no_imu', 'no_imu']
    assert state.readings.history_ns == 3000 * MILLISECOND
    assert [one.stamp_ns for one in state.pressures] == [1000 * MILLISECOND, 3000 * MILLISECOND]


def test_a_pressure_that_is_not_used_leaves_gravity_as_it_is_read(fusion):
    instant = replace(fusion.model.unread_at(0), gravity=(-1.0, 0.0), gauge=1.0)
    assert fusion.model.unread(instant).gravity == (-1.0, 0.0)
    assert fusion.model.unread(instant).gauge == fusion.model.unread_at(0).gauge


def test_a_rival_that_does_not_use_the_pressure_is_not_bent_by_it(fusion):
    events = [
        event
        for stamp_ms in range(1000, 1300, 33)
        for event in (pressure(stamp_ms), frame(fusion, stamp_ms))
    ]
    state, _ = run(fusion, *events)
    belief, model = state.belief, fusion.model
    mean = belief.mean.copy()
    mean[model.unknowns.at(PressureError).start] = GAUGE - 0.5 * sum(fusion.arm.pressure_range)
    rival = replace(belief, mean=mean, causes=belief.causes | {PRESSURE})
    shape = other_shape(model, rival, replace(state.pressures[-1], gauge=0.0, chamber=0.0))
    true = solve(fusion.arm, pressure=GAUGE)
    assert math.dist(shape.tip[:2], true.tip[:2]) < 1e-3


def test_a_belief_that_is_reset_keeps_only_causes_that_last(fusion):
    state, _ = run(fusion, pressure(1000), frame(fusion, 1000))
    both = replace(state.belief, causes=frozenset({CONTACT, FORCE_SENSOR}))
    assert reset_to_prior(fusion.model.unknowns, both).causes == {FORCE_SENSOR}


def test_a_rival_without_the_pressure_that_leads_after_a_wait_is_not_an_error(fusion):
    events = [
        event
        for stamp_ms in range(1000, 1300, 33)
        for event in (pressure(stamp_ms), frame(fusion, stamp_ms))
    ]
    state, _ = run(fusion, *events)
    lone = replace(state.bank[0].belief, chamber=math.nan)
    rival = replace(lone, causes=lone.causes | {PRESSURE})
    bank = (Hypothesis(belief=rival), Hypothesis(belief=lone, log_weight=-4.0))
    state = replace(state, pending=None).with_bank(bank)
    state, outcome = fusion.step(state, pressure(1400))
    assert isinstance(outcome, Refusal) and outcome.reason == 'pressure_off'
    state = replace(state, bank=bank[::-1], lasting=frozenset())
    state, outcome = fusion.step(state, pressure(1500))
    lonely = [one.belief for one in state.bank if PRESSURE in one.belief.causes]
    assert all(one.unpressed for one in lonely)


def test_the_first_frame_of_an_arm_of_negative_rigidity_is_used(fusion):
    law = fusion.arm.moment_law
    soft = replace(fusion.arm, moment_law=replace(law, rigidity=-np.array(law.rigidity)))
    of = Fusion(arm=soft)
    state, _ = run(of, pressure(1000), frame(of, 1000))
    assert (state.counts.frames, dict(state.counts.unused)) == (1, {})


def test_a_pressure_that_arrives_after_a_later_frame_is_not_the_pressure_of_that_frame(fusion):
    early = [pressure(stamp_ms) for stamp_ms in (980, 1000)]
    seen = [frame(fusion, stamp_ms) for stamp_ms in (1000, 1600, 1700)]  # two of them alone
    before, _ = run(fusion, *early, *seen)
    assert before.belief.unpressed
    state, late = before, []
    for stamp_ms in (1500, 1690, 1710):
        state, outcome = fusion.step(state, pressure(stamp_ms, gauge=0.8 * GAUGE))
        late.append(outcome)
    assert [one.reason for one in late[:2]] == ['too_uncertain', 'too_uncertain']
    assert isinstance(late[2], FusedEstimate) and not state.belief.unpressed
    assert len(state.pressures) == 5  # what came late is the past of what follows


def test_without_a_recent_frame_the_age_of_the_last_one_used_is_said(fusion):
    """Of a camera whose clock is behind, all frames are used, and none is recent."""
    strict = replace(fusion, settings=replace(fusion.settings, largest_tip_std=1e-5))
    pressures = [pressure(stamp_ms) for stamp_ms in range(1000, 2100, 100)]
    state, outcomes = run(strict, *pressures, *(frame(fusion, one) for one in (1000, 1200)))
    assert (outcomes[-3].reason, state.counts.frames) == ('too_uncertain', 2)
    assert ' s away' not in outcomes[-3].sentence
    _, late = strict.step(state, pressure(2100))
    assert late.reason == 'too_uncertain'
    assert ' 0.9 s away' in late.sentence


def test_a_frame_stamped_ahead_costs_none_that_follow(fusion):
    late = Fusion(arm=replace(fusion.arm, effects=(CameraDelay(delay=0.15),)))
    events = []
    for stamp_ms in range(1000, 2500, 50):  # a frame waits for its pressure when the odd one comes
        events += [] if stamp_ms % 400 else [pressure(stamp_ms)]
        events.append(frame(late, stamp_ms + 100_000 * (stamp_ms == 1550)))
    state, _ = run(late, *events)
    assert 'older' not in state.counts.unused


def test_a_reading_stamped_ahead_leaves_no_memory_of_its_pressure(fusion):
    rising = [pressure(stamp_ms, 5e3) for stamp_ms in range(1000, 1200, 20)]
    usual, _ = run(fusion, *rising, pressure(1200, 30e3), pressure(1220, 30e3))
    ahead = pressure(400_000, 30e3)
    odd, _ = run(fusion, *rising, ahead, pressure(1200, 30e3), pressure(1220, 30e3))
    assert odd.pressures[-1].stamp_ns == usual.pressures[-1].stamp_ns
    assert odd.pressures[-1].memory == pytest.approx(usual.pressures[-1].memory, rel=0.05)


def test_a_frame_from_before_all_kept_pressures_is_read_alone(fusion):
    readings = [pressure(1000 + stamp, 5e3 + 50.0 * stamp) for stamp in range(2 * PRESSURES_KEPT)]
    state, _ = run(fusion, *readings)
    for stamp_ms, alone in ((1100, True), (1400, False)):
        seen = frame(fusion, stamp_ms, 5e3 + 50.0 * (stamp_ms - 1000))
        instant, unknown = fusion.instant_shown(state, seen.stamp_ns)
        assert unknown is None
        assert fusion.read_frame(state, seen, instant).alone is alone


def test_frames_alike_to_the_bit_are_no_copies_of_one_that_had_no_pressure(fusion):
    still = [frame(fusion, stamp_ms, noise=0.0) for stamp_ms in range(1000, 2500, 50)]
    events = [
        *still[:12],
        *(e for one in still[12:] for e in (pressure(one.stamp_ns / MILLISECOND), one)),
    ]
    state, _ = run(fusion, *events)
    assert 'repeated' not in state.counts.unused
