"""The virtual lab: from a scenario to a recording with known ground truth.

Pressure and load come from the protocol. Effects with a history are integrated in small time
steps; at every camera frame the shape is that of a chain in equilibrium, or of MuJoCo if the
scenario has a block `motion`; then the sensors are simulated.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.lab.chain import Chain, ChainShape, equilibrium_shape, middle_joints
from pneunet_ros.lab.lab_effect import Course, Past
from pneunet_ros.lab.lab_recording import LabMemory, LabRecording, LabTruth
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.moving_arm import MotionTruth, moving_shape, MovingShape
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import (
    draw_drift,
    draw_hidden,
    draw_placement,
    draw_stamps,
    random_stream,
    regular_times,
)
from pneunet_ros.lab.timeline import Timeline

STEP = 0.002  # s, of effects with a history
MOST_STEPS_BETWEEN = 5000  # between two recordings
# Limits of a recording, so that simulating it needs less than 1 GB.
MOST_NODES, MOST_READINGS, MOST_STEPS = 5e6, 1e6, 2e6
FRAME_OFFSET = 0.25  # frames by which the camera starts after the other sensors


def simulate(scenario: Scenario, memory: LabMemory | None = None) -> LabRecording:
    """Return the recording of a scenario; bit-reproducible.

    memory: of the arm from an earlier recording (`LabRecording.memory`); without it, the arm is
    unconditioned (no prior loading) and at rest. Raises RequestError if protocol and arm do not
    match, or if the arm finds no equilibrium.
    """
    check_size(scenario)
    events = scenario.protocol.timeline()
    check_pressures(scenario, events)
    course, memory = follow_arm(scenario, events, memory)
    times = regular_times(scenario.rates.frames, events.duration, FRAME_OFFSET)
    if times.size < 2:
        raise RequestError(
            'protocol.duration must be long enough for two frames', reason='too_short'
        )
    arm, weights = scenario.arm, sample(course, course.weights, times)
    chamber = sample(course, course.chamber[:, None], times)[:, 0]
    shape, motion, force = shape_of(scenario, course, events, times)
    arclength = np.linspace(0.0, arm.reach, int(scenario.detail.stations))
    x, y, theta = shape.points(arclength)
    placement = draw_placement(random_stream('placement', arm.seed), arm.targets, scenario.noise)
    target_x, target_y = painted_targets(shape, arm.targets, placement, scenario.noise.row_spacing)
    registration = scenario.noise.registration_std * random_of(
        scenario, 'registration'
    ).standard_normal(2)
    drift = draw_drift(random_of(scenario, 'drift'), times, events.duration, scenario.noise)
    truth = LabTruth(
        time=times,
        pressure=events.pressure_at(times),
        chamber_pressure=freeze(chamber),
        force=force,
        moment=freeze(np.zeros(times.size)),
        target_x=target_x,
        target_y=target_y,
        arclength=freeze(arclength),
        x=x,
        y=y,
        theta=theta,
        curvature=shape.curvature(arclength),
        intrinsic_curvature=freeze(weights @ arm.intrinsic_curvature(arclength)),
        registration=freeze(registration),
        placement=placement,
        drift=drift,
    )
    return measure(scenario, events, truth, memory, motion)


def check_size(scenario: Scenario) -> None:
    """Reject a recording that is too large for memory, before computing it."""
    motion, rates = scenario.effective_motion, scenario.rates
    seconds = scenario.protocol.duration
    frames = rates.frames * seconds
    moving = (
        ()
        if motion is None or not motion.inertia
        else (('steps of MuJoCo', seconds / motion.timestep, MOST_STEPS),)
    )
    for what, count, most in (
        *moving,
        ('frames by elements of the chain', frames * scenario.detail.elements, MOST_NODES),
        ('frames by stations', frames * scenario.detail.stations, MOST_NODES),
        ('frames by targets', frames * scenario.arm.targets.size, MOST_NODES),
        ('readings', max(rates.pressure, rates.wrench, rates.imu) * seconds, MOST_READINGS),
        ('steps of time', seconds / STEP, MOST_STEPS),
    ):
        if count > most:
            raise RequestError(
                f'a recording of {seconds:g} s would have {count:.3g} {what}, more than '
                f'{most:.3g}: make it shorter, and continue it with another recording (--after)',
                reason='too_large',
            )


def check_pressures(scenario: Scenario, events: Timeline) -> None:
    """Reject pressures outside the range of the arm."""
    low, high = scenario.arm.pressure_range
    lowest, highest = float(events.pressure.min()), float(events.pressure.max())
    if lowest < low or highest > high:
        raise RequestError(
            f'the protocol goes from {lowest:g} to {highest:g} Pa, but the arm is defined from '
            f'{low:g} to {high:g} Pa only',
            reason='out_of_bounds',
        )


def random_of(scenario: Scenario, name: str) -> np.random.Generator:
    """Return the random numbers for this name in this recording."""
    return random_stream(f'{scenario.name}/{name}', scenario.seed)


def follow_arm(
    scenario: Scenario, events: Timeline, memory: LabMemory | None
) -> tuple[Course, LabMemory]:
    """Return the course of the chamber pressure, and the final memory of the arm."""
    past: dict[str, Past] = {}
    if memory is not None:
        gap = scenario.start - memory.time
        if gap < 0.0:
            raise RequestError(
                f'{scenario.name} begins at {scenario.start:g} s, before the end of the previous '
                f'recording at {memory.time:g} s',
                reason='wrong_order',
            )
        past = dict(memory.past)
        count = min(math.ceil(gap / STEP), MOST_STEPS_BETWEEN) + 1
        between = np.linspace(memory.pressure, float(events.pressure[0]), count)
        _, past = apply_effects(scenario, np.linspace(0.0, gap, count), between, past)
        new = [name for name, state in past.items() if state and not memory.past.get(name)]
        if new:
            raise RequestError(
                f'the earlier recording has no history of {", ".join(new)}: record it with the '
                'same effects, or do not continue it',
                reason='other_arm',
            )
    time = np.linspace(0.0, events.duration, math.ceil(events.duration / STEP) + 1)
    course, past = apply_effects(scenario, time, events.pressure_at(time), past)
    end = scenario.start + events.duration
    return course, LabMemory(time=end, pressure=float(events.pressure[-1]), past=past)


def apply_effects(
    scenario: Scenario, time: Array, pressure: Array, past: dict[str, Past]
) -> tuple[Course, dict[str, Past]]:
    """Apply all effects in order, starting from their previous states."""
    pressure = freeze(pressure)
    course = Course(
        arm=scenario.arm,
        time=freeze(time),
        pressure=pressure,
        chamber=pressure,
        weights=scenario.arm.curvature_weights(pressure),
        rigidity_factor=freeze(np.ones(time.size)),
    )
    next_memory: dict[str, Past] = {}
    for effect in scenario.effects:
        course, next_memory[effect.name] = effect.unfold(course, past.get(effect.name, ()))
    return course, next_memory


def shape_of(
    scenario: Scenario, course: Course, events: Timeline, times: Array
) -> tuple[ChainShape | MovingShape, MotionTruth | None, Array]:
    """Return the shapes of the arm at times (n,) s, in equilibrium or simulated by MuJoCo.

    Also returns the end forces (n, 2) N including effects.
    """
    motion = scenario.effective_motion
    if motion is None or not motion.inertia:
        chain = chain_of(scenario, course, times, events.force_at(times))
        return equilibrium_shape(chain), None, chain.force
    fine = for_mujoco(scenario)

    def chain_at(at: Array) -> Chain:
        return chain_of(fine, course, at, events.force_at(at))

    moving = moving_shape(scenario.arm, motion, chain_at, times, events.duration)
    return *moving, chain_at(times).force


def for_mujoco(scenario: Scenario) -> Scenario:
    """Return a scenario whose chain has two elements per MuJoCo hinge."""
    motion = scenario.effective_motion
    assert motion is not None
    elements = 2.0 * motion.links
    return replace(scenario, detail=replace(scenario.detail, elements=elements))


def sample(course: Course, columns: Array, times: Array) -> Array:
    """Interpolate columns (n, k) of a time series at other times (s); returns (times, k)."""
    values = [np.interp(times, course.time, column) for column in columns.T]
    return freeze(np.column_stack(values))


def chain_of(
    scenario: Scenario, course: Course, times: Array, force: Array, of_base: Array | None = None
) -> Chain:
    """Return the arm as a chain at times (n,) s, under forces (n, 2) N, including its effects.

    of_base (n,) s: the times of the motion of the base, if different.
    """
    arm, motion = scenario.arm, scenario.effective_motion
    chamber = freeze(np.interp(times, course.time, course.chamber))
    factor = np.interp(times, course.time, course.rigidity_factor)
    rigidity, split = arm.stiffness(chamber)
    borders = middle_joints(arm.length, int(scenario.detail.elements))
    angles = sample(course, course.weights, times) @ arm.turning_angle(borders)
    chain = Chain(
        length=arm.length,
        clamp_angle=arm.clamp_angle,
        turning=freeze(np.diff(angles, axis=1)),
        rigidity=freeze(rigidity * factor[:, None]),
        split=split,
        force=force,
        moment=freeze(np.zeros(times.size)),
        end_offset_along=arm.tip_cap,
        time=times,
    )
    if motion is not None:
        of_base = times if of_base is None else of_base
        chain = replace(
            chain,
            mass=arm.weight / STANDARD_GRAVITY,
            tip_mass=motion.tip_mass,
            pulls=motion.apparent_gravity(of_base, scenario.protocol.duration)[:, :2],
        )
    for effect in scenario.effects:
        chain = effect.build(arm, chain, chamber)
    return chain


def painted_targets(
    shape: ChainShape | MovingShape, places: Array, placement: Array, spacing: float
) -> tuple[Array, Array]:
    """Return x, y (m) of misplaced targets, each (frames, targets).

    spacing: the part of the errors that is proportional to arclength, applied along the arm. The
    remaining errors are small, and applied along the tangent.
    """
    x, y, theta = shape.points(places * (1.0 + spacing))
    cosine, sine = np.cos(theta), np.sin(theta)
    along, across = placement.T
    along = along - spacing * places
    return freeze(x + along * cosine - across * sine), freeze(y + along * sine + across * cosine)


def measure(
    scenario: Scenario,
    events: Timeline,
    truth: LabTruth,
    memory: LabMemory,
    motion: MotionTruth | None,
) -> LabRecording:
    """Return noisy measurements of the truth."""
    arm, noise, rates = scenario.arm, scenario.noise, scenario.rates
    start, duration = scenario.start, events.duration
    share = freeze(truth.time / duration)
    delay = sum((effect.frame_delay(share) for effect in scenario.effects), 0.0 * share)
    times = (
        regular_times(rates.pressure, duration),
        regular_times(rates.wrench, duration),
        freeze(truth.time + delay),
        regular_times(rates.imu, duration),
    )
    stamp = [
        draw_stamps(random_of(scenario, f'stamps of {name}'), time, start, noise)
        for name, time in zip(('pressure', 'wrench', 'frames', 'imu'), times, strict=True)
    ]
    imu = (scenario.effective_motion or LabMotion()).imu(times[3], duration).copy()
    imu[:, :3] += noise.imu_std * random_of(scenario, 'imu').standard_normal((len(imu), 3))
    imu[:, 3] += noise.gyro_std * random_of(scenario, 'gyro').standard_normal(len(imu))
    pressure, _ = read_sensors(scenario, events.pressure_at(times[0]), events.force_at(times[0]))
    white = random_of(scenario, 'pressure').standard_normal(pressure.size)
    _, force = read_sensors(scenario, events.pressure_at(times[1]), events.force_at(times[1]))
    random = random_of(scenario, 'wrench')
    hanging = np.abs(events.force_at(times[1])).max(axis=1) > 0.0
    force = force + noise.force_std * random.standard_normal(force.shape)
    moment = noise.moment_std * random.standard_normal(len(force))
    force, moment = force * hanging[:, None], moment * hanging
    points = np.stack([truth.target_x, truth.target_y], axis=-1)
    for effect in scenario.effects:
        points = effect.see(arm, points, share)
    points = points + truth.registration + truth.drift[:, None]
    points += noise.target_std * random_of(scenario, 'targets').standard_normal(points.shape)
    targets = arm.targets.size
    points[draw_hidden(random_of(scenario, 'hidden'), truth.time, duration, targets, noise)] = (
        np.nan
    )
    kept = slice(None if events.loaded else 0)
    return LabRecording(
        scenario=scenario,
        loaded=events.loaded,
        reading_stamp_ns=stamp[0],
        pressure=freeze(pressure + noise.pressure_std * white),
        wrench_stamp_ns=stamp[1][kept],
        wrench_force=freeze(force[kept]),
        wrench_moment=freeze(moment[kept]),
        stamp_ns=stamp[2],
        x=freeze(np.ascontiguousarray(points[..., 0])),
        y=freeze(np.ascontiguousarray(points[..., 1])),
        truth=truth,
        memory=memory,
        motion=motion,
        imu_stamp_ns=stamp[3],
        imu=freeze(imu),
    )


def read_sensors(scenario: Scenario, pressure: Array, force: Array) -> tuple[Array, Array]:
    """Return noise-free readings of true pressures (n,) Pa and forces (n, 2) N."""
    for effect in scenario.effects:
        pressure, force = effect.read(scenario.arm, pressure, force)
    return pressure, force
