"""A contact along the arm, pushed by the lab: found, sized, placed, gone; and none in vain."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.core.readings import PressureReading, TargetSightings, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.belief import first_belief
from pneunet_ros.fusion.contact import with_any_contact, without_contact
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.protocols import RandomMix
from pneunet_ros.lab.scenario import lab_effect
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.messages.fusion import contact_points
import pytest
from support.lab_run import true_model
from support.nees import squares

RATE = 10.0
BEGINS, ENDS = 3.0, 6.0  # s
FORCE, PLACE = -0.018, 0.6  # N, s / l


@cache
def recorded(place=PLACE, force=FORCE, pulled=True, begins=BEGINS) -> LabRecording:
    """Return eight seconds, with a push in the middle."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    tip = {} if pulled else {'force_x': (0.0, 0.0), 'force_y': (0.0, 0.0)}
    push = {'force': force, 'place': place, 'begins': begins, 'ends': ENDS, 'ramp': 0.1}
    changes = {
        'name': 'contact',
        'seed': 11,
        'arm': vary_arm(scenario.arm, 11),
        'effects': (lab_effect('push', push),),
        'noise': replace(scenario.noise, jitter_std=0.0, occlusions=0.0),
        'rates': Rates(pressure=RATE, wrench=RATE, frames=RATE),
        'protocol': RandomMix(duration=8.0, rest=0.4, seed=7.0, lowest=15e3, top=55e3, **tip),
    }
    return simulate(replace(scenario, **changes))


@cache
def arm():
    return true_model(recorded().scenario)


def fuse(recording, *, wrench=True, settings=FUSION) -> list[FusedEstimate]:
    """Return the estimates of a recording."""
    return fused(recording, wrench=wrench, settings=settings)[0]


def fused(recording, *, wrench=True, settings=FUSION) -> tuple[list[FusedEstimate], FusionState]:
    """Fuse a recording; readings without noise, frames as they are."""
    fusion, state, found = Fusion(arm=arm(), settings=settings), FusionState(), []
    nothing = np.full(recording.x.shape[1], np.nan)
    names = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')
    truth = recording.truth
    for frame, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        force_x, force_y = truth.force[frame].tolist()
        events = [
            TargetSightings(
                stamp_ns=stamp_ns,
                x=recording.x[frame],
                y=recording.y[frame],
                **dict.fromkeys(names, nothing),
            ),
            PressureReading(stamp_ns=stamp_ns, pressure=float(truth.pressure[frame])),
        ]
        if wrench:
            load = WrenchReading(
                stamp_ns=stamp_ns,
                force_x=force_x,
                force_y=force_y,
                moment=0.0,
                frame_id='pneunet_base',
            )
            events.insert(0, load)
        for event in events:
            state, outcome = fusion.step(state, event)
        assert isinstance(outcome, FusedEstimate)
        found.append(outcome)
    return found, state


@cache
def with_wrench():
    return fuse(recorded())


def test_a_push_is_found_at_once_sized_and_placed_and_gone_when_it_goes():
    found, time = with_wrench(), recorded().truth.time
    named = np.array([one.contact is not None for one in found])
    there = (time > BEGINS + 0.35) & (time < ENDS - 0.1)
    assert named[there].all()
    assert not named[(time < BEGINS) | (time > ENDS + 0.25)].any()
    contacts = [one.contact for one, yes in zip(found, there, strict=True) if yes]
    force = np.array([one.force for one in contacts]) - FORCE
    place = np.array([one.arclength for one in contacts]) - PLACE * arm().length
    assert np.median(np.abs(force)) < 0.04 * abs(FORCE)
    assert np.median(np.abs(place)) < 1.5e-3
    assert np.mean(np.abs(force) < 2.0 * np.array([one.std_force for one in contacts])) > 0.8
    assert np.mean(np.abs(place) < 2.0 * np.array([one.std_arclength for one in contacts])) > 0.8
    assert not any(one.ambiguous for one in contacts)


def test_a_contact_that_jumps_is_found_where_it_is():
    before, after = recorded(), recorded(place=0.35, force=0.04)
    jump = int(np.searchsorted(before.truth.time, 4.5))
    x, y = before.x.copy(), before.y.copy()
    x[jump:], y[jump:] = after.x[jump:], after.y[jump:]
    found = fuse(replace(before, x=x, y=y))[jump + 2 : jump + 12]
    contacts = [one.contact for one in found]
    assert all(one is not None for one in contacts)
    assert np.median([abs(one.arclength - 0.35 * arm().length) for one in contacts]) < 3e-3
    assert np.median([abs(one.force - 0.04) for one in contacts]) < 4e-3


def test_a_push_beyond_the_last_place_keeps_no_frame_out():
    recording = recorded(place=0.97)
    _, state = fused(recording)
    assert state.counts.frames == len(recording.stamp_ns)


def test_begun_in_contact_it_is_found_where_it_is_and_the_sensor_is_not_accused():
    recording = recorded(begins=0.0)
    found, _ = fused(recording)
    time = recording.truth.time
    there = (time > 1.5) & (time < ENDS)  # the first eight readings do not tell its noise
    contacts = [one.contact for one, yes in zip(found, there, strict=True) if yes]
    assert np.mean([one is not None and not one.ambiguous for one in contacts]) > 0.9
    force = np.array([one.force for one in contacts]) - FORCE
    place = np.array([one.arclength for one in contacts]) - PLACE * arm().length
    assert np.median(np.abs(force)) < 0.15 * abs(FORCE)
    assert np.median(np.abs(place)) < 5e-3
    assert not any(one.force_sensor for one in found)
    error, covariance = tip_errors(recording, found)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1.2e-4
    assert np.mean(squares(error, covariance) < 5.991) > 0.85


def tip_errors(recording, found) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (n, 2) m of the tip and their covariances."""
    truth = recording.truth
    tip = np.array([one.estimate.shape.tip[:2] for one in found])
    covariance = np.array([one.estimate.tip_covariance[:2, :2] for one in found])
    return np.stack([truth.x[:, -1], truth.y[:, -1]], axis=1) - tip, covariance


def test_the_tip_is_right_in_spite_of_the_push():
    found, time = with_wrench(), recorded().truth.time
    settled = (time > BEGINS + 0.35) & (time < ENDS - 0.1)
    error, covariance = (values[settled] for values in tip_errors(recorded(), found))
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1.5e-4
    assert np.mean(squares(error, covariance) < 5.991) > 0.85


def test_without_a_force_sensor_it_may_be_the_tip_force_and_says_so():
    recording = recorded(place=0.9)
    found, time = fuse(recording, wrench=False), recording.truth.time
    there = (time > BEGINS + 0.5) & (time < ENDS - 0.1)
    for one in (one for one, yes in zip(found, there, strict=True) if yes):
        assert contact_points(one).size == 0
        if one.contact is not None:
            assert one.contact.ambiguous
            assert one.ambiguous
            assert np.isnan(one.force).all()


def test_a_tip_that_is_free_by_setting_needs_no_force_sensor():
    recording = recorded(place=0.9, pulled=False)
    found = fuse(recording, wrench=False, settings=replace(FUSION, free_tip=True))
    time = recording.truth.time
    there = (time > BEGINS + 0.35) & (time < ENDS - 0.1)
    contacts = [one.contact for one, yes in zip(found, there, strict=True) if yes]
    assert all(one is not None and not one.ambiguous for one in contacts)
    assert np.median([abs(one.force - FORCE) for one in contacts]) < 0.04 * abs(FORCE)
    assert np.median([abs(one.arclength - 0.9 * arm().length) for one in contacts]) < 1.5e-3
    assert all(np.abs(one.force).max() < 1e-5 for one in found)  # N: it has no force at all


def test_the_point_says_what_was_found_and_there_is_none_without_a_contact():
    found, time = with_wrench(), recorded().truth.time
    before = found[int(np.searchsorted(time, 2.0))]
    assert before.contact is None
    assert contact_points(before).size == 0
    one = found[int(np.searchsorted(time, 5.0))]
    (point,) = contact_points(one)
    assert one.contact is not None
    assert (point['s'], point['std_s']) == (one.contact.arclength, one.contact.std_arclength)
    assert (point['force'], point['std_force']) == (one.contact.force, one.contact.std_force)
    assert point['log_odds'] == one.contact.log_odds > 0.0
    shape = one.estimate.shape
    assert point['x'] == pytest.approx(np.interp(point['s'], shape.arclength, shape.x))
    assert point['y'] == pytest.approx(np.interp(point['s'], shape.arclength, shape.y))


def test_without_its_contact_a_belief_keeps_its_tip_force():
    unknowns = Fusion(arm=arm()).model.unknowns
    belief = with_any_contact(unknowns, first_belief(unknowns, 0))
    root = belief.root.copy()
    std = belief.root[unknowns.at(Push).start, -2]
    root[0, -2], root[0, 0] = 0.6 * std, 0.8 * std
    alike = replace(belief, root=root)
    assert alike.touched
    free = without_contact(unknowns, alike)
    assert not free.touched
    assert not free.root[unknowns.at(Push)].any()
    assert np.array_equal(free.root[:2], alike.root[:2])
