"""Constants of a fusion: the arm, its sensors, and the effect of the unknowns."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.fusion.belief import (
    Belief,
    FORCE_SENSOR,
    FRAME_TIMES,
    MIRRORED,
    MOTION,
    move_belief,
    PRESSURE,
)
from pneunet_ros.fusion.frame_update import EXACT
from pneunet_ros.fusion.inertial_force import InertialForce
from pneunet_ros.fusion.readings import load_read, NearWrench, PressureInstant, ReadFrame
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.fusion.unknowns import unknowns_of
from pneunet_ros.measurement.blocks.block import FrameInputs, WrenchSeen
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.force_sensor import ForceSensor
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.timing import Timing
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.errors.noise_jacobian import noise_jacobian
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE as PRESSURE_ROW
from pneunet_ros.measurement.errors.propagated_errors import Indices
from pneunet_ros.measurement.errors.rounding_error import rounding_std
from pneunet_ros.measurement.inference.gaussian import (
    forget,
    take_measurement,
    widen,
    without_prior,
)
from pneunet_ros.measurement.moving_arm import likely_motion, MovingArm, places_along
from pneunet_ros.measurement.rolling_shutter import READOUT
from pneunet_ros.measurement.swinging_arm import SwingingArm
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import station_arclength
from pneunet_ros.model.part_load import PartLoad
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.model.starting_arm import has_invented_stiffness
from pneunet_ros.solver.columns import LOADS

FAR = 1e3  # force scales: a larger reading has no more information
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FORCE_GATE = 6.0  # chi squared: the innovation of a wrench that resets the tip force
COARSEST = 0.05  # step of readings, of the range or force scale: coarser ones are commands


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedModel:
    """A calibrated arm with its sensors and painted targets, prepared for the fusion.

    arclength (stations,) m: stations of an estimate; places (n,) m: stations and targets in order
    along the arm, of_stations and of_targets: their indices. given: the unknowns, None for
    `unknowns_of` the arm; moving: this model for a swinging arm if the arm has no `motion`;
    inertial: no evidence for this mass yet. Raises ModelError if the arm has no targets.
    """

    arm: Arm
    sensors: EstimatorSettings
    settings: FusionSettings
    given: Unknowns | None = None
    arclength: Array = field(init=False, repr=False)
    places: Array = field(init=False, repr=False)
    of_stations: Indices = field(init=False, repr=False)
    of_targets: Indices = field(init=False, repr=False)
    table: PerturbationTable = field(init=False, repr=False)
    unknowns: Unknowns = field(init=False, repr=False)
    swinging: SwingingArm | None = field(init=False, repr=False)
    moving: PreparedModel | None = field(init=False, repr=False)
    inertial: InertialForce | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare stations, the table of the model's neighbors, and the unknowns."""
        if not self.arm.target_arclength.size:
            raise ModelError(
                'arm.target_arclength is empty: the fusion needs targets', reason='too_few_targets'
            )
        stations = station_arclength(self.arm.reach, self.sensors.stations)
        places, which = np.unique(
            np.concatenate([stations, self.arm.target_arclength]), return_inverse=True
        )
        object.__setattr__(self, 'arclength', stations)
        object.__setattr__(self, 'places', places)
        object.__setattr__(self, 'of_stations', which[: stations.size])
        object.__setattr__(self, 'of_targets', which[stations.size :])
        settings = self.settings
        unknowns = self.given or unknowns_of(
            self.arm, free_tip=settings.free_tip, delay_std=settings.delay_std
        )
        table = PerturbationTable(arm=self.arm, further=unknowns.law_errors)
        object.__setattr__(self, 'table', table)
        object.__setattr__(self, 'unknowns', unknowns)
        swinging = None
        if self.arm.inertia is not None:
            moving = MovingArm(arm=self.arm, table=table)
            where = unknowns.at(Motion)
            swinging = SwingingArm(
                moving=moving,
                where=where,
                tip=unknowns.at(TipForce),
                pressure=unknowns.at(PressureError).start,
                start=unknowns.std[where][Motion.SWING],
                stations=places_along(self.arm.reach, stations),
                targets=places_along(self.arm.reach, self.arm.target_arclength),
            )
        object.__setattr__(self, 'swinging', swinging)
        object.__setattr__(self, 'moving', self._moving())
        object.__setattr__(self, 'inertial', self._inertial())

    def _moving(self) -> PreparedModel | None:
        """Return the model with a likely inertia; None if it is known, or the stiffness is not."""
        if self.arm.inertia is not None or self.given is not None:
            return None
        if has_invented_stiffness(self.arm):
            return None
        motion = likely_motion(self.arm)
        return None if motion is None else replace(self, arm=replace(self.arm, motion=motion))

    def _inertial(self) -> InertialForce | None:
        """Return no evidence yet for the likely inertia; None if there is no such."""
        if self.moving is None or self.moving.swinging is None:
            return None
        swinging, rates = self.moving.swinging, self.unknowns.block(TipForce).rates
        frequency = float(swinging.moving.modes.frequency[0])
        return InertialForce(
            mass=swinging.mass_at_tip,
            frequency=frequency,
            rates=rates,
            evidence=np.zeros((2, rates.size)),
        )

    @property
    def swings(self) -> bool:
        """Whether the arm may swing."""
        return self.swinging is not None or self.moving is not None

    def of(self, causes: frozenset[str]) -> PreparedModel:
        """Return the model for some active causes, one of which may be that the arm swings."""
        return self.moving if self.moving is not None and MOTION in causes else self

    def without(self, belief: Belief, where: slice) -> Belief:
        """Reset some unknowns to their prior."""
        return forget(belief, where, self.unknowns.scaled_std(self.size_of(belief))[where])

    def size_of(self, belief: Belief) -> float:
        """Return the likely size of the model error, relative to the range of pressure."""
        return self.discrepancy.grid.size_of(belief.sizes)

    @property
    def discrepancy(self) -> ModelDiscrepancy:
        """The block of the model error."""
        return self.unknowns.block(ModelDiscrepancy)

    @property
    def force_scale(self) -> float:
        """The largest likely force (N)."""
        return self.unknowns.block(TipForce).scale

    def inputs_at(self, instant: PressureInstant, wrench: NearWrench | None) -> FrameInputs:
        """Return the inputs of the arm and their derivatives by the columns of the covariance."""
        std = 0.0 if wrench is None or self.settings.free_tip else self.arm.sensors.moment_std
        columns = self.unknowns.law_columns
        by_column = np.zeros(columns)
        if self.arm.sensing:
            by_column = self.by_columns(Load(pressure=instant.gauge))[:, PRESSURE_ROW]
        return FrameInputs(
            chamber=instant.chamber,
            chamber_std=instant.std,
            history=instant.history,
            moment=0.0 if wrench is None else wrench.reading.moment,
            moment_std=std,
            by_column=by_column,
            lag_offsets=np.array(instant.memory) - instant.chamber,
            gravity=instant.gravity,
            pressure_rate=instant.rate,
        )

    def by_columns(self, reading: Load) -> Array:
        """Return the change of F1, F2, M, pressure by one sigma of each column, (columns, 4)."""
        return noise_jacobian(self.table, reading, (0.0,) * 4)[LOADS + 1 :, : PRESSURE_ROW + 1]

    def unread(self, instant: PressureInstant) -> PressureInstant:
        """Return an instant as if its pressure had not been read: in the middle of the range."""
        unread = self.unread_at(instant.stamp_ns)
        return replace(unread, gravity=instant.gravity, turn_rate=instant.turn_rate)

    def unread_at(self, stamp_ns: int) -> PressureInstant:
        """Return the default for an unread pressure: the middle of the range."""
        middle = 0.5 * sum(self.arm.pressure_range)
        return PressureInstant(
            stamp_ns=stamp_ns,
            gauge=middle,
            chamber=middle,
            std=0.0,
            history=self.arm.initial_history(middle),
            memory=self.discrepancy.remember((), middle, 0.0),
        )

    def used(self, frame: ReadFrame, causes: frozenset[str]) -> ReadFrame:
        """Return a frame with its readings restricted by the active causes."""
        if FORCE_SENSOR in causes:
            frame = frame.without_wrench()
        if PRESSURE in causes and not frame.alone:
            frame = frame.without_pressure(self.unread(frame.instant))
        if MIRRORED in causes:
            frame = frame.mirrored()
        return frame

    def pulled(self, kept: tuple[WrenchReading, ...], gauge: float) -> tuple[WrenchReading, ...]:
        """Return the true forces for force readings at a pressure (Pa); none for a free tip."""
        if self.settings.free_tip:
            return ()
        if not self.arm.sensing:
            return kept
        true = [self.arm.sense(load_read(one, gauge)) for one in kept]
        return tuple(
            replace(one, force_x=load.force_x, force_y=load.force_y)
            for one, load in zip(kept, true, strict=True)
        )

    def with_wrench(self, belief: Belief, wrench: NearWrench, gauge: float) -> Belief:
        """Return the belief after an end wrench (base frame), a linear measurement of the force.

        The force may have changed since the reading, by its random walk. A reading that deviates
        from the belief by more than `force_gate` resets the force first.
        """
        reading = load_read(wrench.reading, gauge)
        true = self.arm.sense(reading)
        tip = self.unknowns.at(TipForce)
        by_column = np.zeros((self.unknowns.law_columns, 2))
        if self.arm.sensing:
            by_column = self.by_columns(reading)[:, :2]
        seen = WrenchSeen(force=belief.mean[tip], by_column=by_column)
        response = self.unknowns.wrench_response(seen)
        force_walk = belief.walk.recent * math.sqrt(abs(wrench.age))
        std = math.hypot(wrench.std, force_walk, EXACT * self.force_scale)
        most = FAR * self.force_scale
        value = np.clip([true.force_x, true.force_y], -most, most)
        innovation = value - response @ belief.mean
        spread = response @ belief.root
        covariance = spread @ spread.T
        if misfit_of(innovation, covariance, std**2) > FORCE_GATE:
            belief = self.without(belief, tip)
        return take_measurement(belief, response, value, np.full(2, std))

    def move(
        self,
        belief: Belief,
        stamp_ns: int,
        pressure_change: float,
        noise: tuple[float, float],
        size: float,
        walk: float | None = None,
    ) -> Belief:
        """Return the belief at a later stamp; a contact may have moved.

        pressure_change, noise, size, walk: as in `move_belief`.
        """
        moved = move_belief(
            self.unknowns, belief, stamp_ns, size, pressure_change, noise=noise, walk=walk
        )
        if not belief.touched:
            return moved
        seconds = seconds_between(belief.stamp_ns, stamp_ns)
        walks = self.unknowns.block(Push).random_walks(moved.walk.recent, seconds)
        return widen(moved, self.unknowns.at(Push), walks)

    def force_covariance(self, belief: Belief) -> Array:
        """Return the covariance (2, 2) N^2 of the tip force."""
        return belief.covariance_of(self.unknowns.at(TipForce))

    def force_is_known(self, belief: Belief) -> bool:
        """Whether the tip force is determined."""
        return bool(np.trace(self.force_covariance(belief)) <= self.largest_force_std**2)

    def force_sensor_is_confirmed(self, belief: Belief | None) -> bool:
        """Whether frames have confirmed offset and gain of the force sensor, to a tolerance."""
        if belief is None or FORCE_SENSOR in belief.causes:
            return False
        where, sensor = self.unknowns.at(ForceSensor), self.unknowns.block(ForceSensor)
        for which, before, limit in zip(
            range(where.start, where.stop),
            sensor.std.tolist(),
            sensor.innocent_std.tolist(),
            strict=True,
        ):
            value, std = without_prior(belief, which, before)
            if std >= limit or abs(value) > limit:
                return False  # a straight arm barely determines it, and not linearly
        return True

    @property
    def largest_force_std(self) -> float:
        """Standard deviation (N) beyond which a component of the force counts as undetermined."""
        return self.settings.determined * self.force_scale

    @property
    def coarsest_pressure(self) -> float:
        """The step (Pa) beyond which readings are taken for commands, not measurements."""
        return COARSEST * self.discrepancy.range

    def pressure_rounding(self, step: float) -> float:
        """Return one sigma (Pa) of the rounding of a pressure sensor; 0 if unknown."""
        return rounding_std(step) if step <= self.coarsest_pressure else 0.0

    def force_rounding(self, step: float) -> float:
        """Return one sigma (N) of the quantization error of each force component."""
        coarsest = COARSEST * self.force_scale
        return rounding_std(step) if step <= coarsest else 0.0

    def shown_ns(self, sightings: TargetSightings) -> int:
        """Return the time (ns) at which a frame was taken: its stamp minus the camera delay."""
        return sightings.stamp_ns - round(self.arm.frame_delay * NANOSECONDS_PER_SECOND)

    def delay_ns(self, belief: Belief) -> int:
        """Return how much later (ns) than its stamp a frame shows the arm, by the pressure.

        Beyond the delay of the camera. Rows of a rolling shutter are seen after the stamp.
        """
        rows = round(0.5 * READOUT * NANOSECONDS_PER_SECOND)
        return belief.delay_ns + (rows if FRAME_TIMES in belief.causes else 0)

    def delay_std(self, belief: Belief) -> float:
        """Return one sigma (s) of the delay of frames; 0 if it is kept."""
        if self.swinging is not None or Timing not in self.unknowns.places:
            return 0.0
        return belief.std(self.unknowns.at(Timing).start)

    def certain_delay(self, belief: Belief) -> float:
        """Return what of the delay (s) of frames is certain: all but one sigma."""
        delay = belief.delay_ns / NANOSECONDS_PER_SECOND
        return math.copysign(max(abs(delay) - self.delay_std(belief), 0.0), delay)

    def held_contact(self, belief: Belief) -> PartLoad | None:
        """Return the estimated contact as a load on the arm; None if the belief has none."""
        if not belief.touched:
            return None
        return self.unknowns.block(Push).limited_load(belief.mean[self.unknowns.at(Push)])

    @property
    def stiffness_unknown(self) -> bool:
        """Whether no load has measured the stiffness of the model, so that it is unknown."""
        domain = self.arm.domain
        unloaded = domain is not None and domain.largest_force == domain.largest_end_moment == 0.0
        return unloaded or has_invented_stiffness(self.arm)

    @property
    def camera_is_observable(self) -> bool:
        """Whether the model error is known; an unknown model error looks like a moved camera."""
        return self.arm.covariance is not None


def misfit_of(innovation: Array, covariance: Array, variance: float) -> float:
    """Return the chi squared of an innovation (2,) with noise of this additional variance."""
    x, y = innovation.tolist()
    (both_x, both), (_, both_y) = covariance.tolist()
    both_x, both_y = both_x + variance, both_y + variance
    squared = both_y * x * x - 2.0 * both * x * y + both_x * y * y
    return float(squared / (both_x * both_y - both * both))
