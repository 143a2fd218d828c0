"""From readings to shape estimates: one pure step, the same for live nodes and for recordings.

`Estimator.step(state, reading) -> state, outcome` knows no clock, no topic and no file. A pressure
reading gives a `ShapeEstimate` or a `Refusal`; a wrench reading gives nothing or a `Refusal`.
Stamps are those of the message headers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, Reading, WrenchReading
from pneunet_ros.core.units import kilopascals, seconds_between
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.estimation.estimate import Outcome, ShapeEstimate
from pneunet_ros.estimation.sensor_mapping import base_wrench, gauge_pressure, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import admitted, EstimatorState
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.model.equilibrium import (
    jacobian_of,
    linearize,
    out_of_range,
    Perturbation,
    solve_rod,
    station_arclength,
    with_pressure_change,
)
from pneunet_ros.model.neighbors import neighbors
from pneunet_ros.solver.columns import LOADS
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.sensitivity import propagate_covariance

PRESSURE = LOADS  # index of the chamber pressure among the causes of a response


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimator:
    """A calibrated arm with the settings of its sensors."""

    arm: Arm
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    arclength: Array = field(init=False, repr=False)
    model_columns: tuple[tuple[Arm, Arm, float], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare stations and the neighbors of the arm along each column of its covariance."""
        stations = station_arclength(self.arm.length, self.settings.stations)
        columns = () if self.arm.covariance is None else self.arm.covariance.columns()
        object.__setattr__(self, 'arclength', stations)
        object.__setattr__(
            self, 'model_columns', tuple(neighbors(self.arm, column) for column in columns)
        )

    def step(self, state: EstimatorState, reading: Reading) -> tuple[EstimatorState, Outcome]:
        """Take one reading; see the module."""
        state, refusal, note = admitted(state, reading)
        if refusal is None:
            if isinstance(reading, WrenchReading):
                state, refusal = self.take_wrench(state, reading)
                if refusal is None:
                    return state, None
            else:
                state, outcome = self.take_pressure(state, reading, note)
                if not isinstance(outcome, Refusal):
                    return state, outcome
                refusal = outcome
        return state.counting(refusal.reason), refusal

    def take_wrench(
        self, state: EstimatorState, reading: WrenchReading
    ) -> tuple[EstimatorState, Refusal | None]:
        """Remember an end wrench in the base frame."""
        sentence = wrong_frame(self.settings, reading)
        if sentence:
            return state, refused(reading.stamp_ns, 'wrong_frame', sentence)
        return state.with_wrench(base_wrench(self.settings, reading)), None

    def take_pressure(
        self, state: EstimatorState, reading: PressureReading, note: str
    ) -> tuple[EstimatorState, ShapeEstimate | Refusal]:
        """Estimate the shape at a pressure reading."""
        elapsed = 0.0
        if state.pressure_stamp_ns is not None:
            elapsed = seconds_between(state.pressure_stamp_ns, reading.stamp_ns)
        notes = [note] if note else []
        if elapsed > self.settings.input_timeout:
            notes.append(f'first pressure after {elapsed:.3g} s')
        gauge = gauge_pressure(self.settings, reading.pressure)
        wrench, age, refusal = self.wrench_at(state, reading.stamp_ns)
        load = self.arm.sense(
            Load(
                pressure=gauge,
                force_x=wrench.force_x,
                force_y=wrench.force_y,
                moment=wrench.moment,
            )
        )
        history = state.history
        if history is None:
            history = self.arm.initial_history(load.pressure)
        history, chamber = self.arm.actuate(history, elapsed, load.pressure)
        if refusal is None and self.arm.beyond_range(chamber) > EXTRAPOLATION:
            sentence = out_of_range(self.arm, chamber) + self.reference_hint(reading.pressure)
            refusal = refused(reading.stamp_ns, 'out_of_range', sentence)
        if refusal is not None:
            return state.with_reading(reading.stamp_ns, history), refusal
        rods, change = with_pressure_change(self.arm, chamber, history)
        shape = solve_rod(self.arm, rods, load, state.solution, self.arclength)
        state = state.with_reading(reading.stamp_ns, history)
        if shape.solution is None:
            return state, refused(reading.stamp_ns, 'no_equilibrium', shape.status)
        if shape.extrapolated:
            notes.append('pressure beyond the calibrated range: extrapolated')
        if shape.stable is False:
            notes.append('the equilibrium is unstable under dead load')
        changes = self.changes(rods, change, history)
        response = linearize(shape.solution, rods, changes, self.arclength)
        mixing = self.noise_columns(reading, gauge, wrench)
        covariance, std = np.empty((3, 3)), np.empty((3, self.arclength.size))
        if not propagate_covariance(mixing, response.tip, response.stations, covariance, std):
            refusal = refused(
                reading.stamp_ns,
                'no_uncertainty',
                'the shape answers to its loads without bound (limit point)',
            )
            return state, refusal
        estimate = ShapeEstimate(
            stamp_ns=reading.stamp_ns,
            shape=shape,
            chamber_pressure=chamber,
            jacobian=jacobian_of(self.arm, response, history),
            tip_covariance=freeze(covariance),
            std_x=freeze(std[0]),
            std_y=freeze(std[1]),
            std_curvature=freeze(std[2]),
            wrench_age=age,
            warnings=tuple(notes),
        )
        return state.with_estimate(reading.stamp_ns, history, shape.solution), estimate

    def changes(
        self, rods: Rods, change: Perturbation, history: tuple[History, ...]
    ) -> tuple[Perturbation, ...]:
        """Return the change of a record with pressure, then with each column of the covariance."""
        changes = [change]
        for before, after, distance in self.model_columns:
            # With the arm's own history: what other parameters would have made of it is left out.
            less, more = (side.rods(rods.pressure, history) for side in (before, after))
            changes.append(Perturbation(before=less, after=more, distance=distance))
        return tuple(changes)

    def wrench_at(
        self, state: EstimatorState, stamp_ns: int
    ) -> tuple[WrenchReading, float | None, Refusal | None]:
        """Return the end wrench to use at a stamp, its age (s), or why there is none to use."""
        unloaded = WrenchReading(
            stamp_ns=stamp_ns,
            force_x=0.0,
            force_y=0.0,
            moment=0.0,
            frame_id=self.settings.frame_id,
        )
        if not self.settings.wrench_required:
            return unloaded, None, None
        if state.wrench is None:
            reason, sentence = (
                'no_wrench',
                ('no end wrench received; set wrench_required to false if there is no load'),
            )
            return unloaded, None, refused(stamp_ns, reason, sentence)
        age = seconds_between(state.wrench.stamp_ns, stamp_ns)
        if abs(age) <= self.settings.wrench_timeout:
            return state.wrench, age, None
        side = 'older' if age > 0.0 else 'newer'
        sentence = (
            f'the end wrench is {abs(age):.3g} s {side} than the pressure, more than '
            f'wrench_timeout = {self.settings.wrench_timeout:.3g} s'
        )
        return state.wrench, age, refused(stamp_ns, 'stale_wrench', sentence)

    def reference_hint(self, raw: float) -> str:
        """Say what to do where a reading fits the range as the other kind of pressure."""
        ambient = self.settings.ambient_pressure
        if self.settings.pressure_reference == 'gauge':
            other, gauge = 'absolute', raw - ambient
        else:
            other, gauge = 'gauge', raw
        if self.arm.beyond_range(gauge + self.settings.pressure_offset) > EXTRAPOLATION:
            return ''
        return (
            f'; as {other} pressure it would be {kilopascals(gauge):.4g} kPa gauge: '
            f'set pressure_reference to {other} if the sensor reports that'
        )

    def noise_columns(
        self, reading: PressureReading, gauge: float, wrench: WrenchReading
    ) -> Array:
        """One row per independent source of error: what one sigma of it does to every cause.

        (sources, causes): F1, F2, M, pressure, then the columns of the model's covariance; the
        causes are those of the response, in the same order.
        """
        sensors = self.arm.sensors
        pressure_std = (
            math.sqrt(reading.variance) if reading.variance > 0.0 else sensors.pressure_std
        )
        loaded = 1.0 if self.settings.wrench_required else 0.0
        sigmas = (
            loaded * sensors.force_std,
            loaded * sensors.force_std,
            loaded * sensors.moment_std,
            pressure_std,
        )
        columns = len(self.model_columns)
        mixing = np.zeros((LOADS + 1 + columns, LOADS + 1 + columns))
        for source, sigma in enumerate(sigmas):
            mixing[source, source] = sigma
        if self.arm.sensing:  # an effect changes what an error of a reading means
            base = (wrench.force_x, wrench.force_y, wrench.moment, gauge)
            correction = sensed(self.arm, base) - base  # exactly 0 where no effect is sensed
            for source, sigma in enumerate(sigmas):
                moved = tuple(
                    value + sigma if place == source else value for place, value in enumerate(base)
                )
                mixing[source, : LOADS + 1] += sensed(self.arm, moved) - moved - correction
            for column, (before, after, distance) in enumerate(self.model_columns):
                change = sensed(after, base) - sensed(before, base)
                mixing[PRESSURE + 1 + column, : LOADS + 1] = change / distance
        for column in range(columns):
            mixing[PRESSURE + 1 + column, PRESSURE + 1 + column] = 1.0
        return mixing


def sensed(arm: Arm, load: tuple[float, ...]) -> Array:
    """Return true F1, F2, M and pressure behind readings of them, in this order."""
    true = arm.sense(Load(force_x=load[0], force_y=load[1], moment=load[2], pressure=load[3]))
    return np.array([true.force_x, true.force_y, true.moment, true.pressure])


def refused(stamp_ns: int, reason: str, sentence: str) -> Refusal:
    """Return a refusal that stops the estimates."""
    return Refusal(stamp_ns=stamp_ns, reason=reason, sentence=sentence, error=True)
