"""The live lab: led through a protocol it repeats what `simulate` makes of it."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import load_model
from pneunet_ros.lab.live import Film, LiveLab, Load, SCENE, Valve
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.messages.builders import header, image
from pneunet_ros.messages.tracker import camera_info_message, decode_camera_info, decode_image
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.vision.camera.camera_settings import PosePlane
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
import pytest
from support.lab_pairs import NOISELESS, recorded
from support.refusals import refused

HEADING = ('camera', ROSBAGS_TYPES)
PAST = {
    'pressure_lag': {'time_constant': 0.2},
    'hysteresis': {'width': 3e3, 'richness': 1.0},
    'creep': {'amplitude': 0.1, 'time_constant': 5.0},
    'softening': {'loss': 0.1, 'richness': 1.0},
}
TIMED = {
    'periodic_disturbance': {'amplitude': 0.1, 'period': 3.0},
    'push': {'force': 0.02, 'begins': 7.0, 'ramp': 1.0, 'every': 8.0},
}
SENSING = {
    'pressure_offset': {'offset': 500.0},
    'force_misalignment': {'angle': 0.1},
    'camera_scale': {'factor': 1.01},
    'gravity': {'weight_y': -1.0},
    'clamp_compliance': {'compliance': 2.0},
}


def scenario(name='unloaded_ramp', effects=None, noise=NOISELESS):
    shipped = recorded(name).scenario.with_effects(effects or {})
    rates = dataclasses.replace(shipped.rates, pressure=10.0, wrench=10.0, frames=2.0)
    return dataclasses.replace(shipped, noise=noise, rates=rates)


def led(lab, events, times):
    """Lead a lab through the corners of a protocol; yields a state for every time."""
    state = lab.begin()
    for time in times:
        corners = events.time[(events.time > state.time) & (events.time < time)]
        for until in [*corners.tolist(), float(time)]:
            corner = np.searchsorted(events.time, until)
            (force,) = events.force_at(np.array([until])).tolist()
            load = Load(force_x=force[0], force_y=force[1])
            state = lab.step(state, until, float(events.pressure[corner]), load)
        yield state


def expect_the_recording(scenario):
    recording, events = simulate(scenario), scenario.protocol.timeline()
    # A valve that is as fast as the steepest leg follows legs of that steepness, and holds.
    slopes = np.abs(np.diff(events.pressure) / np.diff(events.time))
    assert len({round(float(slope), 6) for slope in slopes if slope > 0.0}) == 1
    lab = LiveLab(
        scenario=scenario, valve=Valve(time_constant=0.0, rate_limit=float(slopes.max()))
    )
    random = np.random.default_rng(0)
    for frame, state in enumerate(led(lab, events, recording.truth.time)):
        state, shape = lab.shape(state)
        assert state.pressure == pytest.approx(recording.truth.pressure[frame], abs=1e-6)
        assert shape.points(recording.truth.arclength)[1][0] == pytest.approx(
            recording.truth.y[frame], abs=1e-6
        )
        points = lab.tracked_points(shape, random)
        assert points[:, 0] == pytest.approx(recording.x[frame], abs=1e-6)
        assert points[:, 1] == pytest.approx(recording.y[frame], abs=1e-6)
    readings = (recording.reading_stamp_ns - recording.reading_stamp_ns[0]) * 1e-9
    for index, state in enumerate(led(lab, events, readings)):
        said = lab.reading(state, random)
        assert said.pressure == pytest.approx(recording.pressure[index], abs=1e-3)
        if recording.loaded:
            force = said.load.force_x, said.load.force_y
            assert force == pytest.approx(recording.wrench_force[index].tolist(), abs=1e-9)


def test_effects_with_a_past_or_a_time_are_as_in_a_recording():
    expect_the_recording(scenario(effects=PAST | TIMED))


def test_loads_and_sensors_are_as_in_a_recording():
    loaded = scenario('force_sweeps', SENSING)
    # One level, as all legs must be of one steepness.
    protocol = dataclasses.replace(loaded.protocol, pressures=(3e4,), duration=20.0)
    expect_the_recording(dataclasses.replace(loaded, protocol=protocol))


@cache
def lab(effects=()):
    return LiveLab(scenario=scenario(effects={name: PAST[name] for name in effects}))


def test_the_arm_rests_until_it_is_told_a_pressure():
    state = lab().begin(3.0)
    state, shape = lab().shape(lab().step(state, 4.0, 0.0))
    assert (state.time, state.pressure) == (4.0, 0.0)
    assert not shape.y.any()
    assert shape.x[0, -1] == pytest.approx(0.112)


def test_a_step_changes_nothing_that_was():
    before = lab(('creep',)).begin()
    first = lab(('creep',)).step(before, 1.0, 3e4)
    assert lab(('creep',)).step(before, 1.0, 3e4).past == first.past
    assert (before.time, before.pressure) == (0.0, 0.0)


def test_a_load_stays_until_it_is_taken_away():
    load = Load(force_x=0.05, force_y=0.02, moment=1e-4)
    state = lab().step(lab().begin(), 0.5, 2e4, load)
    state = lab().step(state, 1.0, 2e4)
    assert state.load == load
    assert lab().reading(state, np.random.default_rng(0)).load == load
    state = lab().step(state, 1.5, 2e4, Load())
    assert not state.load.is_loaded


def test_an_object_that_knows_how_far_a_tip_gives_is_at_rest_with_it_in_a_few_steps():
    """A spring of 60 N/m, 300 times as stiff as the tip, would swing by its own force alone."""
    live, stiffness, down = lab(), 60.0, np.array([0.0, -1.0])
    state, shape = live.shape(live.step(live.begin(), 1.0, 2e4))
    wall, force, forces = shape.y[0, -1] - 0.001, 0.0, []
    for step in range(8):
        load = Load(force_y=-force)
        state, shape = live.shape(live.step(state, 2.0 + step, 2e4, load))
        depth = shape.y[0, -1] - wall
        share = 1.0 / (1.0 + stiffness * live.tip_compliance(state, down))
        force += share * (stiffness * depth - force)
        forces.append(force)
    assert share < 0.02
    assert forces[-1] == pytest.approx(stiffness * depth, rel=1e-6)
    assert forces[2] == pytest.approx(forces[-1], rel=1e-3)


def test_a_moment_bends_the_arm():
    plain = lab().shape(lab().step(lab().begin(), 1.0, 0.0))[1]
    bent = lab().shape(lab().step(lab().begin(), 1.0, 0.0, Load(moment=1e-3)))[1]
    assert bent.angles[0, -1] > plain.angles[0, -1] + 0.1


def test_commands_go_as_far_as_the_arm_is_described():
    state = lab().step(lab().begin(), 100.0, 1e9)
    assert state.pressure == pytest.approx(66e3)
    assert lab().step(state, 200.0, -1e9).pressure == pytest.approx(0.0, abs=1e-6)


def test_effects_can_come_and_go_while_it_lives():
    held = lab(('creep', 'softening'))
    state = held.step(held.begin(), 2.0, 5e4)
    other = lab(('softening', 'hysteresis'))
    later = other.reconfigure(state)
    assert later.past['softening'] == pytest.approx(state.past['softening'])
    assert set(later.past) == {'softening', 'hysteresis'}
    assert (later.time, later.pressure, later.load) == (state.time, state.pressure, state.load)
    other.shape(later)


def test_frames_are_stamped_late_by_the_delay_of_the_camera():
    delayed = scenario(effects={'camera_delay': {'delay': 0.05, 'richness': 1.0}})
    assert LiveLab(scenario=delayed).frame_delay == pytest.approx(0.05, rel=1e-12)
    assert LiveLab(scenario=scenario()).frame_delay == 0.0


def test_noise_is_of_its_size_and_of_nothing_where_nothing_hangs():
    noisy = LiveLab(scenario=recorded('unloaded_ramp').scenario)
    state, shape = noisy.shape(noisy.step(noisy.begin(), 1.0, 2e4))
    random = np.random.default_rng(3)
    readings = [noisy.reading(state, random) for _ in range(500)]
    pressure = np.array([reading.pressure for reading in readings])
    assert pressure.std() == pytest.approx(60.0, rel=0.15)
    assert pressure.mean() == pytest.approx(state.pressure, abs=12.0)
    assert all(reading.load == Load() for reading in readings)
    seen = np.array([noisy.tracked_points(shape, random) for _ in range(500)])
    assert np.nanstd(seen - noisy.camera_points(shape)) == pytest.approx(5e-5, rel=0.1)
    assert 0.0 < np.isnan(seen).mean() < 0.01


@pytest.mark.parametrize(
    ('time', 'command'), [(-0.1, 0.0), (np.nan, 0.0), (np.inf, 0.0), (1.0, np.nan)]
)
def test_what_is_no_step_is_refused(time, command):
    with refused(RequestError, 'no_equilibrium'):
        lab().step(lab().begin(), time, command)


def test_a_load_that_is_no_number_is_refused():
    with refused(RequestError, 'not_finite'):
        Load(force_y=np.nan)


# ---- the valve ---------------------------------------------------------------------------------


@pytest.mark.parametrize(('start', 'command'), [(0.0, 3e4), (5e4, 1e4), (2e4, 2e4)])
@pytest.mark.parametrize(('time_constant', 'rate_limit'), [(0.1, 1e5), (0.3, 2e4), (0.05, 1e9)])
def test_the_pressure_follows_its_equation(start, command, time_constant, rate_limit):
    valve = Valve(time_constant=time_constant, rate_limit=rate_limit)
    seconds = np.linspace(0.0, 3.0, 30_001)
    pressure = valve.pressure(start, command, seconds)
    expected, now = [start], start
    for step in np.diff(seconds).tolist():
        now += step * min(max((command - now) / time_constant, -rate_limit), rate_limit)
        expected.append(now)
    assert pressure[0] == start
    assert pressure == pytest.approx(np.array(expected), abs=30.0)
    assert np.all(np.abs(pressure - command) <= abs(start - command))


def test_it_does_not_matter_in_how_many_steps():
    valve = Valve(time_constant=0.2, rate_limit=3e4)
    whole = valve.pressure(0.0, 4e4, np.array([1.7]))[-1]
    first = valve.pressure(0.0, 4e4, np.array([0.4]))[-1]
    assert valve.pressure(first, 4e4, np.array([1.3]))[-1] == pytest.approx(whole, abs=1e-9)


def test_without_a_time_constant_the_supply_alone_is_the_limit():
    valve = Valve(time_constant=0.0, rate_limit=1e4)
    pressure = valve.pressure(1e4, 0.0, np.array([0.0, 0.5, 1.0, 2.0]))
    assert pressure.tolist() == [1e4, 5e3, 0.0, 0.0]


def test_an_impossible_valve_is_refused():
    with refused(RequestError, 'out_of_bounds'):
        Valve(rate_limit=0.0)


# ---- its camera --------------------------------------------------------------------------------


def test_the_camera_file_says_where_the_camera_is():
    plane = load_camera(share_path('config/lab_camera.yaml')).plane
    assert isinstance(plane, PosePlane)
    assert plane.position == tuple(np.round(SCENE.camera.position, 12).tolist())
    assert tuple(plane.quaternion) == (1.0, 0.0, 0.0, 0.0)
    assert np.array_equal(SCENE.camera.rotation, np.diag([1.0, -1.0, -1.0]))


def test_the_tracker_finds_all_targets_where_they_are():
    lab = LiveLab(scenario=recorded('unloaded_ramp').scenario)
    film, random = Film(lab), np.random.default_rng(0)
    tracker = Tracker(
        load_model(share_path('config/lab_arm.yaml')),
        load_camera(share_path('config/lab_camera.yaml')),
    )
    lens = decode_camera_info(camera_info_message(SCENE.camera, 1, *HEADING))
    tracking, _ = tracker.step(TrackerState(), lens)
    state = lab.begin()
    load = Load(force_x=0.05, force_y=0.05)
    # Already bent when the first image comes: the camera knows where it is.
    for frame, command in enumerate((30e3, 31e3, 33e3, 32e3), start=1):
        state, shape = lab.shape(lab.step(state, 2.0 + 0.1 * frame, command, load))
        message = image(film.image(shape, random), header(frame, *HEADING), ROSBAGS_TYPES)
        tracking, outcome = tracker.step(tracking, decode_image(message))
        assert isinstance(outcome, Tracking)
        points = lab.camera_points(shape)
        for found, there in (
            (outcome.sightings.x, points[:, 0]),
            (outcome.sightings.y, points[:, 1]),
        ):
            assert np.abs(found - there).max() < 1e-4
