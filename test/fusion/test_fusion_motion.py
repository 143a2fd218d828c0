"""Fusion of an arm that swings: recordings by MuJoCo, a model that knows mass and damping."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.belief import FRAME_TIMES, MIRRORED, MOTION
from pneunet_ros.fusion.causes import MotionCause, TiltCause
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.frame_update import known_bending
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.hypothesis_update import problem_of, update_with_walk
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.fusion.weighing import evidence_comparable_with_swings, smoothness_of_loads
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.blocks.tilt import Tilt
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.lab_run import readings_at_frames, true_model

pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")

RATE, EVERY, LATE, SECONDS = 80.0, 3, 2, 5.0
TARGET_STD = 5e-5
IN_95 = 5.991
SHARE = (0.0, 0.1, 0.12, 0.45, 0.47, 0.75, 0.77, 1.0)
STEPS = (20e3, 20e3, 45e3, 45e3, 10e3, 10e3, 35e3, 35e3)
FREE = (0.0,) * len(SHARE)
LOADS = (0.0, 0.0, 0.06, 0.06, -0.03, -0.03, 0.05, 0.05)


@cache
def recorded(loaded: bool):
    """Return steps of pressure, and of a load if there is one, of an arm with mass."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    force = LOADS if loaded else FREE
    protocol = Corners(duration=SECONDS, share=SHARE, pressure=STEPS, force_x=FREE, force_y=force)
    scenario = dataclasses.replace(
        scenario,
        protocol=protocol,
        noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
        rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
        motion=LabMotion(damping_time=0.03),
    )
    return simulate(scenario), scenario


@cache
def fusion() -> Fusion:
    """Return the fusion by the true model, with mass and damping."""
    arm = true_model(dataclasses.replace(recorded(False)[1], motion=None))
    return Fusion(arm=dataclasses.replace(arm, motion=Motion(damping_time=0.03)))


def sightings(recording, frame) -> TargetSightings:
    """Return a frame of targets."""
    count = recording.x.shape[1]
    unknown = np.full(count, np.nan)
    rest = dict.fromkeys(('u', 'v', 'area', 'major', 'minor', 'angle'), unknown)
    return TargetSightings(
        stamp_ns=int(recording.stamp_ns[frame]),
        x=recording.x[frame],
        y=recording.y[frame],
        std=np.full(count, TARGET_STD),
        **rest,
    )


@cache
def fused(loaded: bool, wrench: bool, known: bool = True):
    """Return estimates and their truths: errors of tip (n, 2) m and force, NEES, and the state.

    known: the model knows how it swings.
    """
    recording, _ = recorded(loaded)
    by = fusion()
    if not known:
        by = Fusion(arm=dataclasses.replace(by.arm, motion=None))
    _, forces, _ = readings_at_frames(recording)
    truth, state, rows, estimates = recording.truth, FusionState(), [], []
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        events: list = []
        if instant >= LATE and not (instant - LATE) % EVERY:
            events.append(sightings(recording, instant - LATE))
        if wrench:
            force_x, force_y = forces[instant].tolist()
            events.append(
                WrenchReading(
                    stamp_ns=stamp,
                    force_x=force_x,
                    force_y=force_y,
                    moment=0.0,
                    frame_id='pneunet_base',
                )
            )
        pressure = float(recording.pressure[instant])
        events.append(PressureReading(stamp_ns=stamp, pressure=pressure))
        for event in events:
            state, estimate = by.step(state, event)
        if isinstance(estimate, FusedEstimate) and truth.time[instant] > 0.4:
            off = np.array([truth.x[instant, -1], truth.y[instant, -1]])
            off = off - np.array(estimate.estimate.shape.tip[:2])
            covariance = estimate.estimate.tip_covariance[:2, :2]
            rows.append([*off, off @ np.linalg.solve(covariance, off)])
            estimates.append((instant, estimate))
    return np.array(rows), estimates, state


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def test_steps_of_pressure_leave_tip_and_force_known_and_accuse_nothing():
    rows, estimates, state = fused(False, False)
    assert rms(rows[:, :2]) < 0.5e-3
    assert np.mean(rows[:, 2] < IN_95) > 0.9
    assert state.causes == frozenset()
    assert all(one.contact is None for _, one in estimates)
    known = [one.force for _, one in estimates if np.isfinite(one.force).all()]
    assert len(known) > 0.5 * len(estimates)
    assert rms(np.array(known)) < 0.02


def test_a_load_that_is_read_moves_the_arm_as_it_swings():
    rows, _, state = fused(True, True)
    assert rms(rows[:, :2]) < 1e-3
    assert np.mean(rows[:, 2] < IN_95) > 0.93
    assert state.causes == frozenset()


def test_a_load_that_steps_and_that_nobody_reads_is_told_in_time():
    rows, estimates, state = fused(True, False)
    assert np.mean(rows[:, 2] < IN_95) > 0.93
    assert state.causes == frozenset()
    assert np.mean([one.contact is not None for _, one in estimates]) < 0.2
    recording, _ = recorded(True)
    off = [one.force - recording.truth.force[at] for at, one in estimates]
    known = np.array([one for one in off if np.isfinite(one).all()])
    assert len(known) > 0.5 * len(off)
    assert rms(known) < 0.02


def test_a_load_that_is_read_accuses_no_force_sensor_by_a_model_without_motion():
    rows, estimates, state = fused(True, True, known=False)
    assert state.causes == {MOTION}
    assert all(one.force_sensor is None for _, one in estimates)
    assert np.mean(rows[:, 2] < IN_95) > 0.9


def test_the_force_on_an_arm_that_swings_at_unknown_times_is_withheld():
    """It follows from the acceleration, and that from the times of the frames."""
    (recording, _), (_, _, state) = recorded(False), fused(False, False, known=False)
    by = Fusion(arm=dataclasses.replace(fusion().arm, motion=None))
    last, pressure = int(recording.stamp_ns[-1]), float(recording.pressure[-1])
    reading = PressureReading(stamp_ns=last + 10_000_000, pressure=pressure)
    leading, *rest = state.bank
    causes = leading.belief.causes | {FRAME_TIMES}
    assert MOTION in causes
    leading = dataclasses.replace(
        leading, belief=dataclasses.replace(leading.belief, causes=causes)
    )
    _, with_times = by.step(state, reading)
    _, without = by.step(dataclasses.replace(state, bank=(leading, *rest)), reading)
    assert np.isfinite(with_times.force).any()
    assert np.isnan(without.force).all()


def test_frames_of_an_arm_at_rest_leave_a_swing_as_likely_as_it_was():
    """A swing makes the motion smooth, as a load and a pressure that move slowly do."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    scenario = dataclasses.replace(
        scenario,
        protocol=dataclasses.replace(
            scenario.protocol, duration=3.2, force_x=(0.0, 0.08), force_y=(-0.04, 0.04)
        ),
        rates=Rates(frames=50.0),
    )
    recording, by = simulate(scenario), Fusion(arm=true_model(scenario))
    reading, forces, _ = readings_at_frames(recording)
    model, state, swing, odds = by.model, FusionState(), None, []
    for frame, stamp in enumerate(recording.stamp_ns.tolist()):
        pressure = float(recording.pressure[reading[frame]])
        force_x, force_y = forces[frame].tolist()
        wrench = WrenchReading(
            stamp_ns=stamp, force_x=force_x, force_y=force_y, moment=0.0, frame_id='pneunet_base'
        )
        seen = sightings(recording, frame)
        for event in (wrench, PressureReading(stamp_ns=stamp, pressure=pressure)):
            state, _ = by.step(state, event)
        if frame > 40:
            shown, _ = by.instant_shown(state, model.shown_ns(seen))
            read = by.read_frame(state, seen, shown)
            rest = update_with_walk(model, read, state.belief)
            if swing is None:
                (swing, _), *_ = MotionCause().alternatives(model, rest)
            else:
                swing = update_with_walk(model, read, swing.after)
            evidence = evidence_comparable_with_swings(model, rest, [swing])
            evidence += smoothness_of_loads(model, rest, evidence, [swing])
            odds.append(evidence - swing.log_evidence)
        state, _ = by.step(state, seen)
    assert len(odds) > 100
    assert 0.0 < np.median(odds) < 2.0  # nats; where a load begins to move it refutes a swing
    assert state.causes == frozenset()


def test_velocity_is_that_of_the_tip():
    recording, _ = recorded(False)
    _, estimates, _ = fused(False, False)
    tip = np.column_stack([recording.truth.x[:, -1], recording.truth.y[:, -1]])
    true = np.gradient(tip, recording.truth.time, axis=0)
    found = [(instant, one.estimate.motion) for instant, one in estimates]
    off = [motion.velocity[:2] - true[at] for at, motion in found if motion is not None]
    assert len(off) > 0.9 * len(estimates)
    assert rms(np.array(off)) < 0.1 * rms(true)


def test_an_arm_that_swings_by_a_model_without_motion_accuses_nothing_else():
    rows, estimates, state = fused(False, False, known=False)
    assert state.causes == {MOTION}
    assert np.mean(rows[:, 2] < IN_95) > 0.9
    later = [(instant, one) for instant, one in estimates if instant > 0.3 * RATE * SECONDS]
    assert all(one.contact is None for _, one in later)
    assert any(MotionCause.sentence in one.estimate.warnings for _, one in later)
    known = [one.force for _, one in later if np.isfinite(one.force).all()]
    assert len(known) > 0.2 * len(later)
    assert rms(np.array(known)) < 0.02


def test_without_motion_in_the_model_nothing_swings():
    arm = dataclasses.replace(fusion().arm, motion=None)
    bench = Fusion(arm=arm).model
    assert bench.swinging is None
    assert bench.unknowns.std.size == fusion().model.unknowns.std.size - 6


@pytest.mark.parametrize(
    ('share', 'pressure_kpa', 'least'),
    [
        ((0.0, 0.2, 0.5, 1.0), (15, 15, 55, 55), 0.9),
        ((0.0, 0.2, 0.225, 1.0), (15, 15, 55, 55), 0.8),
        (
            (0.0, 0.1, 0.125, 0.35, 0.375, 0.6, 0.625, 0.8, 0.825, 1.0),
            (15, 15, 55, 55, 10, 10, 60, 60, 30, 30),
            0.9,
        ),
    ],
    ids=['ramp', 'step', 'steps'],
)
def test_a_peg_in_the_way_of_a_moving_arm_is_found_where_it_is(share, pressure_kpa, least):
    scenario = recorded(False)[1]
    peg = LabMotion(damping_time=0.03, peg_x=0.08, peg_y=0.04, peg_radius=0.006)
    none = (0.0,) * len(share)
    protocol = Corners(
        duration=4.0,
        share=share,
        pressure=tuple(1e3 * one for one in pressure_kpa),
        force_x=none,
        force_y=none,
    )
    recording = simulate(dataclasses.replace(scenario, protocol=protocol, motion=peg))
    settings = dataclasses.replace(FUSION, free_tip=True)
    state, found, touching, places = FusionState(), [], [], []
    filter_ = Fusion(arm=fusion().arm, settings=settings)
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        events: list = []
        if instant >= LATE and not (instant - LATE) % EVERY:
            events.append(sightings(recording, instant - LATE))
        pressure = float(recording.pressure[instant])
        events.append(PressureReading(stamp_ns=stamp, pressure=pressure))
        for event in events:
            state, estimate = filter_.step(state, event)
        contact = getattr(estimate, 'contact', None)
        found.append(contact is not None)
        touching.append(np.hypot(*recording.motion.contact_force[instant]) > 0.01)
        if contact is not None and touching[-1]:
            places.append(contact.arclength - recording.motion.contact_place[instant])
    found, touching = np.array(found), np.array(touching)
    assert 0.2 < touching.mean() < 0.9
    assert found[touching].mean() > least
    assert not found[: np.argmax(touching)].any()  # later it bounces, and is seen late
    assert np.median(np.abs(places)) < 3e-3
    assert state.causes <= {'contact'}


def answers_beside(change):
    """Return answers (instants) where a frame is changed, and the instant at which it comes."""
    recording, _ = recorded(False)
    state, answers, wrong = FusionState(), [], LATE + 13 * EVERY
    for instant, stamp in enumerate(recording.stamp_ns[: wrong + 2 * EVERY].tolist()):
        if instant >= LATE and not (instant - LATE) % EVERY:
            frame = sightings(recording, instant - LATE)
            state, _ = fusion().step(state, change(frame) if instant == wrong else frame)
        reading = PressureReading(stamp_ns=stamp, pressure=float(recording.pressure[instant]))
        state, answer = fusion().step(state, reading)
        answers.append(answer)
    return answers, wrong


def test_a_swing_that_the_last_frame_contradicts_is_not_told():
    answers, wrong = answers_beside(
        lambda frame: dataclasses.replace(frame, x=frame.x[::-1].copy(), y=0.05 + frame.y)
    )
    assert isinstance(answers[wrong - 1], FusedEstimate)
    assert {refusal.reason for refusal in answers[wrong : wrong + EVERY]} == {'too_uncertain'}
    assert isinstance(answers[wrong + EVERY], FusedEstimate)


@pytest.mark.parametrize('seen', [0, 2])
def test_a_swing_goes_on_where_a_frame_shows_too_little(seen):
    answers, wrong = answers_beside(
        lambda frame: dataclasses.replace(
            frame, x=np.where(np.arange(frame.x.size) < seen, frame.x, np.nan)
        )
    )
    assert all(isinstance(one, FusedEstimate) for one in answers[wrong - 1 :])


def test_a_straight_arm_tells_nothing_of_a_force_along_it():
    scenario = recorded(False)[1]
    share, pressure = (0.0, 0.8, 0.84, 1.0), (0.0, 0.0, 30e3, 30e3)
    none = (0.0,) * len(share)
    protocol = Corners(duration=2.0, share=share, pressure=pressure, force_x=none, force_y=none)
    recording = simulate(dataclasses.replace(scenario, protocol=protocol))
    by, truth, state, known, missed = fusion(), recording.truth, FusionState(), [], []
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        if instant >= LATE and not (instant - LATE) % EVERY:
            frame = sightings(recording, instant - LATE)
            if state.belief is not None and truth.time[instant - LATE] > 0.4:
                shown, _ = by.instant_shown(state, by.model.shown_ns(frame))
                read = by.read_frame(state, frame, shown)
                problem = problem_of(by.model, read, state.belief)
                bending = known_bending(problem)
                assert bending is not None
                axis, told = bending
                known.append([truth.time[instant - LATE], abs(float(axis[0, 0])), told])
            state, _ = by.step(state, frame)
        reading = PressureReading(stamp_ns=stamp, pressure=float(recording.pressure[instant]))
        state, estimate = by.step(state, reading)
        if truth.time[instant] > 0.4 and isinstance(estimate, FusedEstimate):
            tip = np.array([truth.x[instant, -1], truth.y[instant, -1]])
            missed.append(np.hypot(*(tip - np.array(estimate.estimate.shape.tip[:2]))))
    time, along, told = np.array(known).T
    straight = time < 1.5
    assert along[straight].min() > 0.99
    assert np.median(told[straight]) == 0.0
    assert told[~straight].max() > 0.9
    assert max(missed) < 1e-3


def test_a_swing_by_a_model_of_unknown_error_has_no_rival_in_a_mirror():
    """Far from its predicted shape, such an arm may be on either side."""
    recording, by = recorded(False)[0], fusion()
    assert by.arm.covariance is None
    seen = sightings(recording, 0)
    straight = dataclasses.replace(seen, x=by.arm.target_arclength, y=np.zeros(seen.x.size))
    state, _ = by.step(FusionState(), PressureReading(stamp_ns=seen.stamp_ns, pressure=0.0))
    state, _ = by.step(state, straight)
    assert state.counts.frames == 1
    bank = by.weigh_pending(state).bank
    assert not any('mirrored' in one.belief.causes for one in bank)


@pytest.mark.parametrize('known', [True, False])
def test_a_mirror_begins_while_an_arm_swings_only_if_its_motion_is_known(known):
    """A swing of a guessed mass is often far from its prediction, where any side may fit."""
    recording, arm = recorded(False)[0], fusion().arm
    covariance = ModelCovariance(quantities=('moment_law.rigidity.0.0',), factor=[[1e-6]])
    motion = arm.motion if known else None
    by = Fusion(arm=dataclasses.replace(arm, covariance=covariance, motion=motion))
    state, rivals = FusionState(), 0
    turned, end = recording.stamp_ns.size // 2, recording.stamp_ns.size * 5 // 8
    for instant, stamp in enumerate(recording.stamp_ns.tolist()[:end]):
        if instant >= LATE and not (instant - LATE) % EVERY:
            seen = sightings(recording, instant - LATE)
            if instant > turned:
                seen = dataclasses.replace(seen, y=-seen.y)
            state = by.settle(by.step(state, seen)[0])
            rivals += any({MIRRORED, MOTION} <= one.belief.causes for one in state.bank)
        pressure = float(recording.pressure[instant])
        state, _ = by.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
    assert rivals == 0
    assert (MIRRORED in state.certain_causes) == known
    assert (MOTION in state.certain_causes) != known


def test_an_arm_that_begins_to_swing_is_named_and_nothing_else():
    """A free force explains the first frames of a step; the swing is tried from before them."""
    scenario, arm = recorded(False)[1], fusion().arm
    share, pressure = (0.0, 0.5, 0.55, 1.0), (0.0, 0.0, 40e3, 40e3)
    none = (0.0,) * len(share)
    protocol = Corners(duration=2.0, share=share, pressure=pressure, force_x=none, force_y=none)
    recording = simulate(dataclasses.replace(scenario, protocol=protocol))
    covariance = ModelCovariance(quantities=('moment_law.rigidity.0.0',), factor=[[1e-6]])
    by = Fusion(arm=dataclasses.replace(arm, covariance=covariance, motion=None))
    state, named, missed = FusionState(), [], []
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        if instant >= LATE and not (instant - LATE) % EVERY:
            state = by.settle(by.step(state, sightings(recording, instant - LATE))[0])
            named.append((recording.truth.time[instant], state.certain_causes))
        reading = PressureReading(stamp_ns=stamp, pressure=float(recording.pressure[instant]))
        state, estimate = by.step(state, reading)
        if recording.truth.time[instant] > 1.3 and isinstance(estimate, FusedEstimate):
            tip = np.array([recording.truth.x[instant, -1], recording.truth.y[instant, -1]])
            missed.append(np.hypot(*(tip - np.array(estimate.estimate.shape.tip[:2]))))
    assert all(causes <= {MOTION} for _, causes in named)
    assert next(time for time, causes in named if causes) < 1.5  # the step begins at 1.0 s
    assert state.certain_causes == {MOTION}
    assert np.median(missed) < 1e-3


def test_an_arm_that_something_hits_costs_its_swing_alone():
    """From a hit on, the frames are those of another phase of the same swing."""
    recording, _ = recorded(False)
    by = Fusion(arm=fusion().arm, settings=dataclasses.replace(FUSION, free_tip=True))
    hit, half_period, state, known = int(4.2 * RATE), int(0.4 * RATE), FusionState(), []
    tilt = by.model.unknowns.at(Tilt).stop - 1
    for instant, stamp in enumerate(recording.stamp_ns[: hit + half_period].tolist()):
        if instant >= LATE and not (instant - LATE) % EVERY:
            frame = sightings(recording, instant - LATE)
            if instant >= hit:
                later = sightings(recording, instant - LATE + half_period)
                frame = dataclasses.replace(later, stamp_ns=frame.stamp_ns)
            state = by.settle(by.step(state, frame)[0])
            known.append((state.belief.std(tilt), state.certain_causes, instant >= hit))
        reading = PressureReading(stamp_ns=stamp, pressure=float(recording.pressure[instant]))
        state, _ = by.step(state, reading)
    before = [std for std, _, is_hit in known if not is_hit][-1]
    assert before < 0.1 * by.model.unknowns.std[tilt]
    assert all(std < 2.0 * before and not causes for std, causes, is_hit in known if is_hit)


@pytest.mark.parametrize(('motion', 'count'), [(Motion(damping_time=0.03), 0), (None, 1)])
def test_gravity_that_has_just_turned_has_not_moved_an_arm_with_mass(motion, count):
    recording, _ = recorded(False)
    by, state = Fusion(arm=dataclasses.replace(fusion().arm, motion=motion)), FusionState()
    for instant in (0, EVERY, 2 * EVERY):
        stamp, pressure = int(recording.stamp_ns[instant]), float(recording.pressure[instant])
        state, _ = by.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
        state, _ = by.step(state, sightings(recording, instant))
    tilted = list(TiltCause().alternatives(by.model, state.pending.updated))
    assert len(tilted) == count
