"""Frames whose rows are read one after the other, or whose stamps are wrong."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.belief import first_belief, FRAME_TIMES, PRESSURE
from pneunet_ros.fusion.causes import FrameTimesCause, replace_causes, TargetsCause
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.hypothesis_update import problem_of, update_with_walk
from pneunet_ros.fusion.readings import NearWrench
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.protocols import Corners
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.rolling_shutter import (
    READOUT,
    row_errors,
    second_order_motion,
    STAMP_STD,
)
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.lab_run import true_model

RATE, EVERY, LATE = 80.0, 3, 2
SHARE = (0.0, 0.2, 0.22, 0.45, 0.47, 0.75, 0.77, 1.0)
STEPS = (15e3, 15e3, 45e3, 45e3, 10e3, 10e3, 35e3, 35e3)
FREE = (0.0,) * len(SHARE)
LOADS = (0.02, 0.02, 0.06, 0.06, -0.03, -0.03, 0.05, 0.05)
HEIGHT = 0.16  # m, of the picture


@cache
def recorded(loaded: bool):
    """Return steps of pressure within 0.1 s, and of a load if there is one."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    force = LOADS if loaded else FREE
    protocol = Corners(duration=5.0, share=SHARE, pressure=STEPS, force_x=FREE, force_y=force)
    scenario = dataclasses.replace(
        scenario,
        protocol=protocol,
        noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
        rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
    )
    covariance = ModelCovariance(quantities=('moment_law.rigidity.0.0',), factor=[[1e-6]])
    arm = dataclasses.replace(true_model(scenario), covariance=covariance)
    return simulate(scenario), Fusion(arm=arm)


def sightings(recording, frame, readout) -> TargetSightings:
    """Return a frame whose rows are read from the top down, within so many s."""
    truth, when = recording.truth, recording.truth.time
    late = readout * np.clip(0.5 - truth.target_y[frame] / HEIGHT, 0.0, 1.0)
    shown = [
        seen[frame]
        + np.array(
            [
                np.interp(when[frame] + one, when, true[:, dot]) - true[frame, dot]
                for dot, one in enumerate(late)
            ]
        )
        for seen, true in ((recording.x, truth.target_x), (recording.y, truth.target_y))
    ]
    unknown = np.full(late.size, np.nan)
    rest = dict.fromkeys(('std', 'u', 'v', 'area', 'major', 'minor', 'angle'), unknown)
    x, y = shown
    return TargetSightings(stamp_ns=int(recording.stamp_ns[frame]), x=x, y=y, **rest)


@cache
def fused(loaded: bool, readout: float):
    """Return the NEES of the tip, its errors (m), the causes after every frame, and the state."""
    recording, by = recorded(loaded)
    truth, state, missed, named = recording.truth, FusionState(), [], []
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        if instant >= LATE and not (instant - LATE) % EVERY:
            state, _ = by.step(state, sightings(recording, instant - LATE, readout))
            named.append(by.settle(state).certain_causes)
        reading = PressureReading(stamp_ns=stamp, pressure=float(recording.pressure[instant]))
        state, fused = by.step(state, reading)
        if isinstance(fused, FusedEstimate):
            off = np.array([truth.x[instant, -1], truth.y[instant, -1]])
            off = off - np.array(fused.estimate.shape.tip[:2])
            covariance = fused.estimate.tip_covariance[:2, :2]
            missed.append([off @ np.linalg.solve(covariance, off), np.hypot(*off)])
    nees, off = np.array(missed).T
    return nees, off, named, state


@pytest.mark.parametrize('loaded', [False, True])
def test_rows_that_are_read_one_after_the_other_are_the_only_cause(loaded):
    nees, off, named, state = fused(loaded, 33e-3)
    assert state.certain_causes == {FRAME_TIMES}
    assert set().union(*named) == {FRAME_TIMES}
    assert np.mean(nees < 5.991) > 0.93
    assert np.mean(off < 3e-3) > 0.9  # the others are of the steps
    assert state.counts.lost == 0


@pytest.mark.parametrize('loaded', [False, True])
def test_steps_that_are_seen_at_once_name_nothing(loaded):
    _, _, named, _ = fused(loaded, 0.0)
    assert not set().union(*named)


def test_a_frame_of_an_arm_at_rest_says_nothing_of_its_rows():
    recording, by = recorded(True)
    state, rows, odds, sizes = FusionState(), None, [], []
    for frame, stamp in enumerate(recording.stamp_ns.tolist()[:180]):
        pressure = float(recording.pressure[frame])
        state, _ = by.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
        seen = sightings(recording, frame, 0.0)
        if frame > 10:
            shown, _ = by.instant_shown(state, by.model.shown_ns(seen))
            read = by.read_frame(state, seen, shown)
            rows = rows or replace_causes(state.belief, FRAME_TIMES)
            sizes.append(np.abs(problem_of(by.model, read, rows).row_errors).max())
            at_once, in_rows = (
                update_with_walk(by.model, read, one) for one in (state.belief, rows)
            )
            odds.append(in_rows.log_evidence - at_once.log_evidence)
            rows = in_rows.after
        state, _ = by.step(state, seen)
    still, moving = slice(0, 60), slice(71, 77)  # the first step begins at frame 80
    assert np.abs(odds[still]).max() < 1.0
    assert np.median(sizes[still]) < 1e-4
    assert np.max(sizes[moving]) > 3e-3


def test_no_frame_shows_its_times_where_another_cause_looks_like_it():
    """No pressure, a blow on an arm that swings, or a force sensor that may be wrong."""
    recorded_, by = recorded(False)
    stamp, pressure = int(recorded_.stamp_ns[0]), float(recorded_.pressure[0])
    state, _ = by.step(FusionState(), PressureReading(stamp_ns=stamp, pressure=pressure))
    seen = sightings(recorded_, 0, 0.0)
    shown, _ = by.instant_shown(state, by.model.shown_ns(seen))
    before = first_belief(by.model.unknowns, stamp)
    updated = update_with_walk(by.model, by.read_frame(state, seen, shown), before)
    swings = Fusion(arm=dataclasses.replace(by.arm, motion=Motion(damping_time=0.03)))
    assert FrameTimesCause().is_possible(by.model, updated)
    assert not FrameTimesCause().is_possible(swings.model, updated)
    ignoring = dataclasses.replace(updated, before=replace_causes(before, PRESSURE))
    assert not FrameTimesCause().is_possible(by.model, ignoring)
    pulled = WrenchReading(
        stamp_ns=stamp, force_x=0.0, force_y=0.0, moment=0.0, frame_id='pneunet_base'
    )
    read = dataclasses.replace(updated.frame, wrench=NearWrench(reading=pulled, age=0.0, std=1e-3))
    assert not FrameTimesCause().is_possible(by.model, dataclasses.replace(updated, frame=read))


def test_a_pressure_that_is_not_read_yet_may_change_as_before():
    """A frame of unknown times is taken for later than its stamp, and its rivals do not wait."""
    recorded_, by = recorded(False)
    state = FusionState()
    for frame in range(84):  # the first step begins at frame 80
        stamp, pressure = int(recorded_.stamp_ns[frame]), float(recorded_.pressure[frame])
        state, _ = by.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
    seen = sightings(recorded_, 83, 0.0)
    shown, _ = by.instant_shown(state, by.model.shown_ns(seen))
    frame = by.read_frame(state, seen, shown)
    late_ns = round(0.5e9 * READOUT)
    later, missed = frame.delayed(late_ns, 0.0).instant, abs(np.diff(recorded_.pressure[82:84])[0])
    assert later.std > 0.5 * missed * RATE * 1e-9 * late_ns
    assert frame.delayed(-late_ns, 0.0).instant.std < 0.1 * later.std


def test_that_targets_change_between_two_frames_is_rare():
    recorded_, by = recorded(False)
    state, odds = FusionState(), []
    for frame in range(2):
        stamp, pressure = int(recorded_.stamp_ns[frame]), float(recorded_.pressure[frame])
        state, _ = by.step(state, PressureReading(stamp_ns=stamp, pressure=pressure))
        seen = sightings(recorded_, frame, 0.0)
        shown, _ = by.instant_shown(state, by.model.shown_ns(seen))
        before = state.belief or first_belief(by.model.unknowns, stamp)
        updated = update_with_walk(by.model, by.read_frame(state, seen, shown), before)
        odds.append([earlier for _, earlier in TargetsCause().alternatives(by.model, updated)])
        state, _ = by.step(state, seen)
    assert odds == [[0.0] * 2, [-2.0 * by.settings.odds_against] * 2]


def test_row_errors_are_those_of_the_times_of_the_targets():
    """Targets that move evenly, seen at times that change linearly over the picture."""
    velocity = np.array([[0.0, 0.1, 0.4], [0.2, 0.3, 0.1]])
    places = np.array([[0.1, 0.5, 0.9], [0.0, 0.2, 0.4]])
    motion, at_once = READOUT * velocity[None], STAMP_STD * velocity[None]
    errors = row_errors(motion, at_once, np.zeros((2, 3)), places)
    for time, x, y in ((0.01, 0.0, 0.0), (0.0, 0.02, 0.0), (0.004, -0.01, 0.015)):
        seen = velocity * (time + x * places[0] + y * places[1])
        amounts = np.array([time / STAMP_STD, x / READOUT, y / READOUT])
        assert np.abs(np.tensordot(amounts, errors[:3], axes=1) - seen).max() < 1e-12


def test_second_order_motion_is_what_a_linear_one_leaves_out():
    joints = np.linspace(0.0, 0.12, 33)
    heading, turn = np.linspace(0.1, 1.0, 32), np.linspace(0.0, 0.2, 32)

    def ends(angles):
        links = np.diff(joints) * np.exp(1j * angles)
        return np.append(0.0, np.cumsum(links))

    linear = np.append(0.0, np.cumsum(np.diff(joints) * 1j * turn * np.exp(1j * heading)))
    left = ends(heading + turn) - ends(heading) - linear
    x, y = second_order_motion(turn, heading, joints, joints)
    assert np.abs(x + 1j * y - left).max() < 0.1 * np.abs(left).max()
