"""Shape estimation from readings, as a pure step used by live nodes and for recordings.

`Estimator.step(state, reading) -> state, outcome` uses no clock, topic or file. A pressure reading
gives a `ShapeEstimate` or a `Refusal`; a wrench reading gives nothing or a `Refusal`. Stamps are
those of the message headers.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.outcome import Refusal, refuse
from pneunet_ros.core.readings import BaseReading, PressureReading, Reading, WrenchReading
from pneunet_ros.core.units import seconds_between, seconds_since
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.estimation.base_gravity import Direction, GravitySource
from pneunet_ros.estimation.estimate import estimate_of, Outcome, ShapeEstimate
from pneunet_ros.estimation.out_of_plane import out_of_plane, OutOfPlane
from pneunet_ros.estimation.sensor_mapping import base_wrench, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import admit, EstimatorState
from pneunet_ros.measurement.errors.age_error import with_age_error
from pneunet_ros.measurement.errors.extrapolation_error import with_extrapolation_error
from pneunet_ros.measurement.errors.noise_jacobian import noise_jacobian, PRESSURE
from pneunet_ros.measurement.errors.propagated_errors import propagate_errors, PropagatedErrors
from pneunet_ros.measurement.meaning.wrench_judge import load_hint
from pneunet_ros.measurement.moving_arm import MovingArm, MovingState, Places, places_along
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain_position import DomainPosition, locate_load, OUT_OF_RANGE
from pneunet_ros.model.equilibrium import (
    jacobian_of,
    linearize_shape,
    solve_rod,
    station_arclength,
)
from pneunet_ros.model.perturbation import gravity_of, PerturbationTable
from pneunet_ros.model.shape import Shape
from pneunet_ros.model.vibration import links_at
from pneunet_ros.solver.rod import Rods


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmInputs:
    """Inputs of an arm at a pressure reading.

    sensed: load according to the readings; load: the true load, corrected for sensing effects;
    chamber pressure (Pa), and the history of the actuation.
    """

    sensed: Load
    load: Load
    chamber: float
    history: tuple[History, ...]

    def rods(self, arm: Arm, load: Load) -> Rods:
        """Return the rod under another end load and gravity, at the same chamber pressure."""
        gravity = gravity_of(load, count=1)
        return arm.rods(np.array([self.chamber]), self.history, load.row, gravity)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimator:
    """Estimates the shape with its covariance from each reading, for a calibrated arm.

    arm: with the noise of its sensors and the covariance of its model; settings: meaning and
    timeouts of the readings; arclength (stations,) m of the stations; table: derivatives of the
    rod's record by pressure and model; moving: the moving arm with stations and targets, None if
    the model has no `motion`; gravity: the source of the direction of gravity. Raises ModelError
    if a column of the model's covariance moves a parameter out of bounds.
    """

    arm: Arm
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    arclength: Array = field(init=False, repr=False)
    table: PerturbationTable = field(init=False, repr=False)
    moving: MovingArm | None = field(init=False, repr=False)
    places: Places | None = field(init=False, repr=False)
    target_places: Places | None = field(init=False, repr=False)
    gravity: GravitySource = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare stations and the table."""
        stations = station_arclength(self.arm.reach, self.settings.stations)
        object.__setattr__(self, 'arclength', stations)
        object.__setattr__(self, 'table', PerturbationTable(arm=self.arm))
        source = GravitySource(settings=self.settings, gravity=self.arm.gravity)
        object.__setattr__(self, 'gravity', source)
        moving = places = targets = None
        if self.arm.inertia is not None:
            moving = MovingArm(arm=self.arm, table=self.table)
            places = places_along(self.arm.reach, stations)
            targets = places_along(self.arm.reach, self.arm.target_arclength)
        object.__setattr__(self, 'moving', moving)
        object.__setattr__(self, 'places', places)
        object.__setattr__(self, 'target_places', targets)

    def step(
        self, state: EstimatorState, reading: Reading | BaseReading
    ) -> tuple[EstimatorState, Outcome]:
        """Process one reading: Eq 4 gives the shape, its linearization the covariance.

        Args:
            state: the state after all earlier readings; unchanged.
            reading: a pressure (Pa) or an end wrench (N, N m), with the stamp of its message
                header; or a reading of an accelerometer on the base, or of frames.

        Returns:
            The next state, and the result: a ShapeEstimate or a Refusal for a pressure, None or a
            Refusal for any other reading. Bad readings never raise.
        """
        if not isinstance(reading, PressureReading | WrenchReading):
            gravity, refusal = self.gravity.take(state.gravity, reading)
            state = replace(state, gravity=gravity)
            return (state if refusal is None else state.count_rejected(refusal.reason)), refusal
        state, refusal, note = admit(state, reading)
        if refusal is None:
            if isinstance(reading, WrenchReading):
                state, refusal = self.take_wrench(state, reading)
                if refusal is None:
                    return state, None
            else:
                state = state.watch_pressure(reading, self.arm, self.settings)
                state, outcome = self.take_pressure(state, reading, note)
                if not isinstance(outcome, Refusal):
                    return state, outcome
                refusal = outcome
        return state.count_rejected(refusal.reason), refusal

    def take_wrench(
        self, state: EstimatorState, reading: WrenchReading
    ) -> tuple[EstimatorState, Refusal | None]:
        """Store an end wrench in the base frame."""
        sentence = wrong_frame(self.settings, reading)
        if sentence:
            return state, refuse(reading.stamp_ns, 'wrong_frame', sentence)
        keep = bool(state.passed) and self.settings.wrench_required
        if keep and state.moving is not None:
            elapsed = seconds_between(state.moving.stamp_ns, reading.stamp_ns)
            keep = elapsed <= self.settings.input_timeout
        return state.with_wrench(base_wrench(self.settings, reading), keep), None

    def take_pressure(
        self, state: EstimatorState, reading: PressureReading, note: str
    ) -> tuple[EstimatorState, ShapeEstimate | Refusal]:
        """Estimate the shape at a pressure reading."""
        notes = [note] if note else []
        limit = self.settings.input_timeout
        if state.seconds_to(reading.stamp_ns) > limit:
            notes.append(f'first pressure after more than {limit:g} s (input_timeout)')
        wrench, age, refusal = self.wrench_at(state, reading.stamp_ns)
        gravity, unknown = self.gravity.at(state.gravity, reading.stamp_ns)
        inputs = self.inputs_at(state, reading, wrench, gravity)
        position = locate_load(self.arm, inputs.load, inputs.chamber, self.reading_std(reading))
        off_plane = out_of_plane(self.arm, self.settings, wrench)
        other = state.watch.refusal(reading.stamp_ns)
        refusal = other or refusal or unknown
        refusal = refusal or self.load_refusal(state, reading, position, off_plane)
        if refusal is not None and (other or position.reason == OUT_OF_RANGE):
            return state.with_impossible(reading.stamp_ns), refusal
        if refusal is not None:
            return state.with_reading(reading.stamp_ns, inputs.history), refusal
        rods, changes = self.table.at(inputs.chamber, inputs.history, inputs.load)
        shape = solve_rod(self.arm, rods, inputs.load, state.solution, self.arclength)
        solution = shape.solution
        if solution is None:
            refusal = refuse(reading.stamp_ns, 'no_equilibrium', shape.status)
            return state.with_reading(reading.stamp_ns, inputs.history), refusal
        sensitivity = linearize_shape(solution, rods, changes)
        noise = noise_jacobian(self.table, inputs.sensed, self.reading_std(reading))
        aged = self.with_age_error(state, noise, inputs.sensed, age)
        aged = with_extrapolation_error(aged, position)
        errors = propagate_errors(sensitivity, aged, self.arclength)
        if errors is None:
            sentence = (
                'no covariance: the arm is at a limit point (infinitely sensitive to its loads), '
                'or readings and model are too uncertain'
            )
            refusal = refuse(reading.stamp_ns, 'no_uncertainty', sentence)
            return state.with_reading(reading.stamp_ns, inputs.history), refusal
        change = self.gravity.change_since(state.gravity, reading.stamp_ns)
        errors = self.with_gravity_error(errors, shape, inputs, change)
        moving = motion = None
        if self.moving is not None and self.places is not None:
            by_reading = noise[: PRESSURE + 1] @ sensitivity.tip
            since_ns = None if state.moving is None else state.moving.stamp_ns
            base = self.gravity.motion_at(state.gravity, reading.stamp_ns, since_ns)
            passed, course = self.advance_past_loads(
                state, reading.stamp_ns, inputs, base.turn_rate
            )
            moving, motion, shape, errors = self.moving.step(
                passed, reading.stamp_ns, shape, errors, by_reading, self.places, course, base
            )
        estimate = estimate_of(
            stamp_ns=reading.stamp_ns,
            shape=shape,
            chamber_pressure=inputs.chamber,
            jacobian=jacobian_of(self.arm, sensitivity, inputs.history),
            noise=noise,
            errors=errors,
            motion=motion,
            position=position,
            wrench_age=age,
            gravity=gravity,
            notes=[*notes, *([off_plane.note] if off_plane.warns else [])],
        )
        return state.with_estimate(reading.stamp_ns, inputs.history, solution, moving), estimate

    def inputs_at(
        self,
        state: EstimatorState,
        reading: PressureReading,
        wrench: WrenchReading,
        gravity: Direction | None,
    ) -> ArmInputs:
        """Return the inputs of the arm at a pressure reading."""
        sensed = Load(
            pressure=self.settings.pressure.gauge(reading.pressure),
            force_x=wrench.force_x,
            force_y=wrench.force_y,
            moment=wrench.moment,
            gravity=gravity,
        )
        load = self.arm.sense(sensed)
        history, chamber = state.actuate(self.arm, reading.stamp_ns, load.pressure)
        return ArmInputs(sensed=sensed, load=load, chamber=chamber, history=history)

    def advance_past_loads(
        self, state: EstimatorState, stamp_ns: int, inputs: ArmInputs, turn_rate: float
    ) -> tuple[MovingState | None, Array | None]:
        """Return the motion after the end wrenches read since the last estimate.

        inputs, turn_rate (rad/s) of the base: at the stamp. Also returns the covariance of
        `MovingArm.advance_through_loads`; None if there are no such wrenches. A gap longer than
        input_timeout, or with a load without equilibrium, is bridged in one step.
        """
        moving, solution = state.moving, state.solution
        if self.moving is None or moving is None or not state.passed:
            return moving, None
        between = [one for one in state.passed[1:] if moving.stamp_ns < one.stamp_ns < stamp_ns]
        gap = seconds_between(moving.stamp_ns, stamp_ns)
        if not between or gap > self.settings.input_timeout:
            return moving, None
        loaded = []
        for wrench in (state.passed[0], *between):
            load = self.arm.sense(with_wrench(inputs.sensed, wrench))
            rods = inputs.rods(self.arm, load)
            shape = solve_rod(self.arm, rods, load, solution, self.arclength, quick=True)
            solution = shape.solution
            if solution is None:
                return moving, None
            links = links_at(solution)._replace(turn_rate=turn_rate)
            loaded.append((wrench.stamp_ns, links))
        return self.moving.advance_through_loads(moving, stamp_ns, loaded)

    def with_age_error(
        self, state: EstimatorState, noise: Array, sensed: Load, age: float | None
    ) -> Array:
        """Return the noise input matrix with the error of an end wrench of this age (s)."""
        last, earlier = state.wrench, state.earlier
        if not age or age < 0.0 or last is None or earlier is None:
            return noise
        between = seconds_since(earlier.stamp_ns, last.stamp_ns)
        if not between > 0.0:
            return noise
        now, before = (self.arm.sense(with_wrench(sensed, one)).row[0] for one in (last, earlier))
        return with_age_error(noise, now - before, age / between)

    def with_gravity_error(
        self, errors: PropagatedErrors, shape: Shape, inputs: ArmInputs, change: Direction | None
    ) -> PropagatedErrors:
        """Add the error of gravity (one sigma in g; None: known) to the errors of a shape."""
        if change is None:
            return errors
        gravity = inputs.load.gravity
        assert gravity is not None
        turned = replace(inputs.load, gravity=(gravity[0] + change[0], gravity[1] + change[1]))
        rods = inputs.rods(self.arm, turned)
        there = solve_rod(self.arm, rods, turned, shape.solution, self.arclength, quick=True)
        if there.solution is None:
            return errors
        x, y, curvature = there.x - shape.x, there.y - shape.y, there.curvature - shape.curvature
        tip = np.array([x[-1], y[-1], there.theta[-1] - shape.theta[-1]])
        return replace(
            errors,
            tip_covariance=freeze(errors.tip_covariance + np.outer(tip, tip)),
            std=freeze(np.hypot(errors.std, [x, y, curvature])),
        )

    def load_refusal(
        self,
        state: EstimatorState,
        reading: PressureReading,
        position: DomainPosition,
        off_plane: OutOfPlane,
    ) -> Refusal | None:
        """Return the reason for which a load rules out an estimate; None if it does not."""
        if off_plane.stops:
            return refuse(reading.stamp_ns, 'out_of_plane', off_plane.sentence)
        if not position.reason:
            return None
        hint = ''
        if position.reason == OUT_OF_RANGE:
            hint = state.watch.hint(reading, self.arm, self.settings)
        elif state.wrench is not None and self.settings.judge_readings:
            force = complex(state.wrench.force_x, state.wrench.force_y)
            pressure = self.settings.pressure.gauge(reading.pressure)
            hint = load_hint(self.arm, self.settings.wrench, force, pressure)
        return refuse(reading.stamp_ns, position.reason, position.sentence + hint)

    def reading_std(self, reading: PressureReading) -> tuple[float, float, float, float]:
        """Return one sigma of F1, F2 (N), M (N m) and pressure (Pa)."""
        sensors = self.arm.sensors
        pressure = sensors.pressure_std
        if reading.variance > 0.0:
            pressure = self.settings.pressure.size * math.sqrt(reading.variance)
        if not self.settings.wrench_required:
            return 0.0, 0.0, 0.0, pressure
        return sensors.force_std, sensors.force_std, sensors.moment_std, pressure

    def wrench_at(
        self, state: EstimatorState, stamp_ns: int
    ) -> tuple[WrenchReading, float | None, Refusal | None]:
        """Return the end wrench to use at a stamp and its age (s), or the reason for none."""
        if state.wrench is None or not self.settings.wrench_required:
            unloaded = WrenchReading(
                stamp_ns=stamp_ns,
                force_x=0.0,
                force_y=0.0,
                moment=0.0,
                frame_id=self.settings.frame_id,
            )
            if not self.settings.wrench_required:
                return unloaded, None, None
            sentence = (
                'no usable end wrench received; set wrench_required to false if there is no load'
            )
            refusal = refuse(stamp_ns, 'no_wrench', sentence, awaits_others=True)
            return unloaded, None, refusal
        age = seconds_since(state.wrench.stamp_ns, stamp_ns)
        if abs(age) <= self.settings.wrench_timeout:
            return state.wrench, age, None
        side = 'older' if age > 0.0 else 'newer'
        sentence = (
            f'the last usable end wrench is {abs(age):.3g} s {side} than the pressure, more than '
            f'wrench_timeout = {self.settings.wrench_timeout:.3g} s'
        )
        return state.wrench, age, refuse(stamp_ns, 'stale_wrench', sentence)


def with_wrench(load: Load, wrench: WrenchReading) -> Load:
    """Return a load with another end wrench."""
    return replace(load, force_x=wrench.force_x, force_y=wrench.force_y, moment=wrench.moment)
