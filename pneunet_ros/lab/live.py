"""The virtual lab in steps: commands in, readings out.

The live lab uses the arm, effects and sensors of `simulate`, and reproduces the same recordings
under the same pressures and loads. It has no clock; the time is an argument of every step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import functools
import math
from typing import Final

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.image import Bytes
from pneunet_ros.core.units import check_quantities, quantity
from pneunet_ros.lab.chain import Chain, ChainShape, equilibrium_shape
from pneunet_ros.lab.lab_effect import Course, Past
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.moving_arm import MovingShape, Run, Swing
from pneunet_ros.lab.pictures.lens import overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Body, Dots, FrameState, Light, Scene
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import draw_placement, random_stream
from pneunet_ros.lab.simulation import (
    apply_effects,
    chain_of,
    for_mujoco,
    MOST_STEPS_BETWEEN,
    painted_targets,
    random_of,
    read_sensors,
    STEP,
)

OUTLINE = 57  # stations of the outline of the arm
# The camera is perpendicular to the working plane; its pose is in config/lab_camera.yaml.
SCENE: Final = Scene(
    camera=overhead_camera(
        width=640,
        height=480,
        focal_px=610.0,
        scale=0.00027,
        middle=(0.058, 0.032),
        distortion=(-0.25, 0.09, 0.0006, -0.0004, 0.0),
    ),
    light=Light(level=0.97, gradient_u=-0.2, gradient_v=0.1, vignette=0.25),
    background=96.0,
    texture=1.5,
    blur=0.75,
    noise=0.85,
)
SMALL_FORCE = 1e-3  # of the weight of an arm: small enough for a linear response
MIDDLE = 0.5  # share of the recording time at which a rich camera effect is evaluated live


@dataclass(frozen=True, slots=True, kw_only=True)
class Valve:
    """A first-order pressure regulator, limited by its supply.

    p' = (command - p) / time_constant, at most rate_limit; all numbers are invented.
    """

    time_constant: float = quantity(
        0.1,
        unit='s',
        meaning=('time constant of the valve; 0.0: none'),
        bounds=(0.0, 100.0),
        source='invented',
    )
    rate_limit: float = quantity(
        4e4,
        unit='Pa/s',
        meaning='largest rate at which the valve fills or vents',
        bounds=(1.0, 1e9),
        source='invented',
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'valve', RequestError)

    def pressure(self, start: float, command: float, seconds: Array) -> Array:
        """Return the exact pressures (n,) Pa at times (n,) s after the pressure `start`."""
        distance = abs(command - start)
        # A ramp at the rate limit, then an exponential once the remaining change is slow enough.
        exponential_part = min(distance, self.rate_limit * self.time_constant)
        ramp_time = (distance - exponential_part) / self.rate_limit
        after = np.maximum(seconds - ramp_time, 0.0)
        share = np.exp(-after / self.time_constant) if self.time_constant > 0.0 else 1.0
        remaining = np.where(
            seconds < ramp_time, distance - self.rate_limit * seconds, exponential_part * share
        )
        return freeze(command - math.copysign(1.0, command - start) * remaining)


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """End load from the environment, in the base frame: force (N), moment (N m)."""

    force_x: float = 0.0
    force_y: float = 0.0
    moment: float = 0.0

    def __post_init__(self) -> None:
        """Reject values that are not finite."""
        if not all(map(math.isfinite, (self.force_x, self.force_y, self.moment))):
            raise RequestError('the load must not contain NaN or infinity', reason='not_finite')

    @property
    def is_loaded(self) -> bool:
        """Whether there is any load."""
        return any((self.force_x, self.force_y, self.moment))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveState:
    """State of a live arm: time (s), true pressure (Pa) at the sensor, load.

    course: the course since the previous state; past: memory of every effect; angles (rad) of the
    chain at its last computed shape, from which the next shape starts. swing: of an arm with mass,
    which is `lag` (s) behind.
    """

    time: float
    pressure: float
    load: Load
    course: Course
    past: dict[str, Past]
    angles: Array | None = None
    swing: Swing | None = None
    lag: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveReading:
    """Readings of the pressure sensor (Pa) and force sensor (N, N m); 0 without a load.

    imu (4,): as in `LabRecording`; None if there is no IMU.
    """

    pressure: float
    load: Load
    imu: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveLab:
    """The arm of a scenario, with valve and sensors, in real time; the protocol is not used.

    Drift, jitter and occlusions are omitted, because they belong to whole recordings. With a block
    `motion`, the base repeats its motion from the recording of the scenario forever, and MuJoCo
    simulates an arm with mass.
    """

    scenario: Scenario
    valve: Valve = field(default_factory=Valve)
    placement: Array = field(init=False)
    registration: Array = field(init=False)
    run: Run | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Paint the targets and place the camera, as for a recording of the same scenario."""
        arm, noise = self.scenario.arm, self.scenario.noise
        placement = draw_placement(random_stream('placement', arm.seed), arm.targets, noise)
        shift = random_of(self.scenario, 'registration').standard_normal(2)
        object.__setattr__(self, 'placement', placement)
        object.__setattr__(self, 'registration', freeze(noise.registration_std * shift))
        motion, run = self.scenario.effective_motion, None
        if motion is not None and motion.inertia:
            rested = self._at(0.0, self.lowest, Load(), {})
            chain_at = functools.partial(self.chain_at, rested.course, rested.load)
            run = Run(arm, motion, chain_at, self.period)
        object.__setattr__(self, 'run', run)

    def begin(self, time: float = 0.0) -> LiveState:
        """Return an unconditioned arm at rest at its lowest pressure."""
        rested = self._at(time, self.lowest, Load(), {})
        return rested if self.run is None else replace(rested, swing=self.run.resting)

    @property
    def lowest(self) -> float:
        """The pressure (Pa) of a vented arm."""
        return max(0.0, float(self.scenario.arm.pressure_range[0]))

    @property
    def period(self) -> float:
        """Period (s) after which the base repeats its motion."""
        return float(self.scenario.protocol.duration)

    def reconfigure(self, state: LiveState) -> LiveState:
        """Return the state with other effects; new effects start at rest."""
        names = {effect.name for effect in self.scenario.effects}
        past = {name: values for name, values in state.past.items() if name in names}
        rested = self._at(state.time, state.pressure, state.load, past)
        if self.run is None:
            return rested
        swing, resting = state.swing, self.run.resting
        # A compliant clamp is one more joint.
        if swing is None or swing[0].size != resting[0].size:
            swing = resting
        return replace(rested, swing=swing, lag=state.lag)

    def _at(self, time: float, pressure: float, load: Load, past: dict[str, Past]) -> LiveState:
        course, past = apply_effects(self.scenario, np.full(1, time), np.full(1, pressure), past)
        return LiveState(time=time, pressure=pressure, load=load, course=course, past=past)

    def step(
        self, state: LiveState, time: float, command: float, load: Load | None = None
    ) -> LiveState:
        """Advance the arm to a later time (s) with a valve command (Pa), under a load.

        The command is limited to the pressure range of the arm. RequestError for a time before
        that of the state, or for a non-finite value.
        """
        elapsed = time - state.time
        if not (elapsed >= 0.0 and math.isfinite(elapsed) and math.isfinite(command)):
            raise RequestError(
                f'the arm cannot be advanced from {state.time:.6g} to {time:.6g} s at {command} '
                'Pa',
                reason='no_equilibrium',
            )
        low, high = self.scenario.arm.pressure_range
        command = min(max(command, low), high)
        count = min(math.ceil(elapsed / STEP), MOST_STEPS_BETWEEN) + 1
        seconds = np.linspace(0.0, elapsed, count)
        pressure = self.valve.pressure(state.pressure, command, seconds)
        course, past = apply_effects(self.scenario, state.time + seconds, pressure, state.past)
        load = state.load if load is None else load
        next_state = replace(
            state, time=time, pressure=float(pressure[-1]), load=load, course=course, past=past
        )
        return next_state if self.run is None else self.with_swing(self.run, state, next_state)

    def with_swing(self, run: Run, state: LiveState, next_state: LiveState) -> LiveState:
        """Return a later state of the swinging arm; skip the time after the decay of a swing."""
        step, elapsed = run.motion.timestep, next_state.time - state.time
        count = int((elapsed + state.lag) / step)
        behind = elapsed + state.lag - count * step
        count = min(count, MOST_STEPS_BETWEEN)
        begins = freeze(next_state.time - behind - step * np.arange(count, 0.0, -1.0))
        chain_at = functools.partial(self.chain_at, next_state.course, next_state.load)
        swing = run.follow(state.swing or run.resting, chain_at, begins)
        return replace(next_state, swing=swing, lag=behind)

    def chain_at(self, course: Course, load: Load, times: Array) -> Chain:
        """Return the chain under a load at times (n,) s of a course."""
        scenario, motion = self.scenario, self.scenario.effective_motion
        if motion is not None and motion.inertia:
            scenario = for_mujoco(scenario)
        force = freeze(np.tile([load.force_x, load.force_y], (times.size, 1)))
        chain = chain_of(scenario, course, times, force, freeze(np.mod(times, self.period)))
        return replace(chain, moment=freeze(np.full(times.size, load.moment)))

    def shape(self, state: LiveState) -> tuple[LiveState, ChainShape | MovingShape]:
        """Return the current shape (quasi-static without mass); RequestError if none is found.

        The returned state keeps the shape, from which the next shape starts.
        """
        if self.run is not None:
            return state, self.run.shape(state.swing or self.run.resting)
        shape = self.shape_at_rest(state)
        return replace(state, angles=shape.angles[0]), shape

    def shape_at_rest(self, state: LiveState) -> ChainShape:
        """Return the shape in equilibrium, near the last one; RequestError if none is found."""
        chain = self.chain_at(state.course, state.load, state.course.time[-1:])
        return equilibrium_shape(chain, state.angles)

    def tip_compliance(self, state: LiveState, direction: Array) -> float:
        """Return the compliance (m/N) of the tip along a direction (2,), in equilibrium.

        RequestError if none is found.
        """
        arm, load = self.scenario.arm, state.load
        small = SMALL_FORCE * arm.weight
        force = np.array([load.force_x, load.force_y]) + small * direction
        pulled = replace(load, force_x=float(force[0]), force_y=float(force[1]))
        tips = [
            np.array(self.shape_at_rest(one).points([arm.reach])[:2])[:, 0, 0]
            for one in (state, replace(state, load=pulled))
        ]
        return float((tips[1] - tips[0]) @ direction) / small

    def reading(self, state: LiveState, random: np.random.Generator) -> LiveReading:
        """Return noisy sensor readings."""
        noise, load = self.scenario.noise, state.load
        force = np.array([[load.force_x, load.force_y]])
        pressure, force = read_sensors(self.scenario, np.array([state.pressure]), freeze(force))
        white = random.standard_normal(4)
        measured = Load()
        if load.is_loaded:
            measured = Load(
                force_x=float(force[0, 0] + noise.force_std * white[1]),
                force_y=float(force[0, 1] + noise.force_std * white[2]),
                moment=load.moment + noise.moment_std * float(white[3]),
            )
        imu = None
        if self.scenario.rates.imu > 0.0:
            std = np.array([*3 * [noise.imu_std], noise.gyro_std])
            motion = self.scenario.effective_motion or LabMotion()
            time = np.mod(np.array([state.time]), self.period)
            imu = freeze(motion.imu(time, self.period)[0] + std * random.standard_normal(4))
        pressure = pressure + noise.pressure_std * white[0]
        return LiveReading(pressure=float(pressure[0]), load=measured, imu=imu)

    @property
    def frame_delay(self) -> float:
        """Delay (s) of frame stamps."""
        middle = np.full(1, MIDDLE)
        return float(sum(effect.frame_delay(middle)[0] for effect in self.scenario.effects))

    def camera_points(self, shape: ChainShape | MovingShape) -> Array:
        """Return the targets in the image (targets, 2) m, before noise."""
        arm = self.scenario.arm
        spacing = self.scenario.noise.row_spacing
        targets = painted_targets(shape, arm.targets, self.placement, spacing)
        points = np.stack(targets, axis=-1)
        for effect in self.scenario.effects:
            points = effect.see(arm, points, np.full(1, MIDDLE))
        return freeze(points[0] + self.registration)

    def tracked_points(
        self, shape: ChainShape | MovingShape, random: np.random.Generator
    ) -> Array:
        """Return the targets as a tracker measures them, (targets, 2) m, NaN where not seen."""
        noise, points = self.scenario.noise, self.camera_points(shape)
        measured = points + noise.target_std * random.standard_normal(points.shape)
        measured[random.uniform(size=len(points)) < noise.dropout] = np.nan
        return freeze(measured)


class Film:
    """Renders the arm of a live lab."""

    __slots__ = ('_lab', '_outline', '_renderer')

    def __init__(self, lab: LiveLab) -> None:
        """Draw the static part of the image."""
        self._lab = lab
        self._outline = np.linspace(0.0, lab.scenario.arm.reach, OUTLINE)
        self._renderer = Renderer(SCENE)

    def image(self, shape: ChainShape | MovingShape, random: np.random.Generator) -> Bytes:
        """Return a grey-level image (height, width) of the arm, without motion blur."""
        points = self._lab.camera_points(shape)
        x, y, theta = (rows[0] for rows in shape.points(self._outline))
        moment = FrameState(
            dots=Dots(x=points[:, 0], y=points[:, 1]), body=Body(x=x, y=y, theta=theta)
        )
        picture, _ = self._renderer.render(moment, random)
        return picture
