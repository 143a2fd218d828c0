"""From readings and targets to one estimate of shape and tip force: one pure step.

`Fusion.step(state, event) -> state, outcome` knows no clock, no topic and no file, as
`Estimator.step`. The belief lives at the stamps of frames, which come late; every pressure reading
gives a `FusedEstimate`, which is the belief moved to its stamp with the pressure read since.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
import math
from typing import TypeVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, Reading, TargetSightings, WrenchReading
from pneunet_ros.core.stamps import stamp_fault, STARTS_ANEW
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.consistency import chi_square_limit
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import reference_hint, refuse
from pneunet_ros.estimation.out_of_plane import out_of_plane
from pneunet_ros.estimation.sensor_mapping import base_wrench, gauge_pressure, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import admit
from pneunet_ros.fusion.belief import (
    Belief,
    compress,
    CONTACT,
    first_belief,
    FORCE,
    forget,
    GAIN,
    lack_grown,
    move_belief,
    OF_BIAS,
    OFFSET,
    scaled_std,
    take_measurement,
    told_by_frames,
    TURN,
    Unknowns,
    unknowns_of,
    widen,
    with_moved_camera,
    with_noise,
    with_other_targets,
    with_strange_targets,
    with_walk,
    without_lessons,
)
from pneunet_ros.fusion.contact import (
    Contact,
    correlation_with_tip,
    evidence_cost,
    gain_without,
    weigh_hypotheses,
    WeighedFrame,
    without_contact,
)
from pneunet_ros.fusion.estimate import FusedEstimate, FusionOutcome, Mode
from pneunet_ros.fusion.force_sensor import (
    DISAGREES,
    doubt_after,
    ForceSensorFault,
    sensor_score,
    Verdict,
    verdict_on,
)
from pneunet_ros.fusion.frame_fit import (
    bend_arm,
    BentArm,
    causes_of,
    causes_with_contact,
    contact_of,
    FrameInputs,
    FrameProblem,
    pressure_like,
)
from pneunet_ros.fusion.frame_update import (
    ColdRound,
    excess,
    FrameUpdate,
    look_elsewhere,
    take_frame,
)
from pneunet_ros.fusion.lack import lack_columns, LackGrowth, remember, scale_of
from pneunet_ros.fusion.propagated_errors import propagate_errors, SeenShape
from pneunet_ros.fusion.settings import FUSION, FusionSettings
from pneunet_ros.fusion.state import FusionState, PressureInstant, RunningNis, SeenFrame
from pneunet_ros.measurement.extrapolation_error import with_extrapolation_error
from pneunet_ros.measurement.noise_jacobian import noise_jacobian, PRESSURE
from pneunet_ros.measurement.noise_model import target_std
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain_position import DomainPosition, locate_load, OUT_OF_RANGE
from pneunet_ros.model.equilibrium import jacobian_of, Sensitivity, station_arclength
from pneunet_ros.model.part_load import PartLoad
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.solver.columns import LOADS

Event = Reading | TargetSightings
OTHER_TARGETS = (
    'the targets are not painted where the calibration found them: what it knows of their places '
    'is not used; calibrate anew, or take covariance.placement out of the model file'
)
CAMERA_MOVED = (
    'the camera is not where it was when its place was found: the arm tells where it is; find '
    'base_from_camera anew and reset'
)
OF_THE_BENCH = (OTHER_TARGETS, CAMERA_MOVED, DISAGREES)  # what somebody has to mend there

Stamped = TypeVar('Stamped', bound=PressureInstant | WrenchReading)


def stamp_of(reading: Stamped) -> int:
    """Return the stamp (ns) of a reading."""
    return reading.stamp_ns


def followed_by(known: tuple[Stamped, ...], reading: Stamped, most: int) -> tuple[Stamped, ...]:
    """Return readings in the order of their stamps and one that makes later ones void."""
    earlier = bisect_left(known, reading.stamp_ns, key=stamp_of)
    return (*known[max(earlier + 1 - most, 0) : earlier], reading)


def nearest_to(known: tuple[Stamped, ...], stamp_ns: int) -> Stamped:
    """Return the reading nearest to a stamp, of two the earlier one."""
    after = bisect_left(known, stamp_ns, key=stamp_of)
    beside = known[max(after - 1, 0) : after + 1]
    return min(beside, key=lambda one: abs(one.stamp_ns - stamp_ns))


def load_read(wrench: WrenchReading, gauge: float) -> Load:
    """Return what sensors read of the load: an end wrench and a pressure (Pa)."""
    return Load(
        pressure=gauge, force_x=wrench.force_x, force_y=wrench.force_y, moment=wrench.moment
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadFrame:
    """A frame with what was read at the stamp of what it shows.

    alone: no pressure is known there; pressure_lost: it was not at the frame before; force_lost:
    nothing is known of the force; wrench_age (s): of the wrench nearest to it, if any.
    """

    stamp_ns: int
    sightings: TargetSightings
    instant: PressureInstant
    alone: bool
    pressure_lost: bool
    force_lost: bool
    wrench: WrenchReading | None
    wrench_age: float

    def without_wrench(self) -> ReadFrame:
        """Return it as if nobody had read the force."""
        return replace(self, wrench=None, wrench_age=math.nan)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fusion:
    """A calibrated arm with its sensors and painted targets: one estimate from what is there.

    arm: with the noise of its sensors and the covariance of its model; sensors: what they report
    and when a reading is too old (a wrench is used while it is fresh, whatever `wrench_required`);
    settings: the numbers by which readings and targets are fused. Raises ModelError where the arm
    has no targets.
    """

    arm: Arm
    sensors: EstimatorSettings = field(default_factory=EstimatorSettings)
    settings: FusionSettings = FUSION
    arclength: Array = field(init=False, repr=False)
    table: PerturbationTable = field(init=False, repr=False)
    unknowns: Unknowns = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare stations, the table of the model's neighbors, and the unknowns."""
        if not self.arm.target_arclength.size:
            raise ModelError('arm.target_arclength is empty: without targets nothing can be fused')
        stations = station_arclength(self.arm.reach, self.sensors.stations)
        object.__setattr__(self, 'arclength', stations)
        object.__setattr__(
            self,
            'table',
            PerturbationTable(arm=self.arm, further=lack_columns(self.settings, self.arm)),
        )
        object.__setattr__(self, 'unknowns', unknowns_of(self.arm, self.settings))

    def step(self, state: FusionState, event: Event) -> tuple[FusionState, FusionOutcome]:
        """Take one reading or one frame of targets.

        Args:
            state: what is remembered of earlier ones; it is not changed.
            event: a pressure (Pa), an end wrench (N, N m) or the targets seen in a frame (m, base
                frame), stamped by its message's header.

        Returns:
            The state for the next one, and what came of this one: of a pressure a FusedEstimate or
            a Refusal; of a frame nothing or a Refusal, or a FusedEstimate where the pressure is
            too old and the camera is alone; of a wrench nothing or a Refusal. Nothing is raised
            for what a reading holds.

        """
        state = self.settle(state)
        if isinstance(event, TargetSightings):
            return self.take_targets(state, event)
        resets = state.readings.resets
        readings, refusal, note = admit(state.readings, event)
        state = replace(state, readings=readings)
        if refusal is not None:
            return state.count_rejected(refusal.reason), refusal
        if readings.resets > resets:
            state = state.fresh()
        if isinstance(event, WrenchReading):
            return self.take_wrench(state, event)
        return self.take_pressure(state, event, [note] if note else [])

    def settle(self, state: FusionState) -> FusionState:
        """Do what no estimate has to wait for: look for another force that explains the frame.

        A node does it when an estimate is out; where nobody did, the next step does. What comes of
        all steps is the same.
        """
        return self.check_frame(state) if state.told else state

    def take_wrench(
        self, state: FusionState, reading: WrenchReading
    ) -> tuple[FusionState, Refusal | None]:
        """Remember an end wrench in the base frame."""
        sentence = wrong_frame(self.sensors, reading)
        if sentence:
            refusal = Refusal(
                stamp_ns=reading.stamp_ns, reason='wrong_frame', sentence=sentence, error=False
            )
            return state.count_rejected(refusal.reason), refusal
        wrench = base_wrench(self.sensors, reading)
        kept = followed_by(state.wrenches, wrench, self.settings.wrenches_kept)
        return replace(state, readings=state.readings.with_wrench(wrench), wrenches=kept), None

    def take_pressure(
        self, state: FusionState, reading: PressureReading, notes: list[str]
    ) -> tuple[FusionState, FusedEstimate | Refusal]:
        """Take the frames that have waited for a pressure reading, and estimate at its stamp."""
        instant = self.instant_at(state, reading)
        position = locate_load(self.arm, Load(pressure=instant.gauge), instant.chamber)
        if position.reason == OUT_OF_RANGE:
            # It is not kept: without a pressure that can be, the camera is alone.
            hint = reference_hint(self.arm, self.sensors, reading.pressure)
            refusal = refuse(reading.stamp_ns, position.reason, position.sentence + hint)
            readings = state.readings.with_reading(reading.stamp_ns, instant.history)
            return replace(state, readings=readings).count_rejected(refusal.reason), refusal
        ready = [item for item in state.waiting if self.shown_ns(item) <= instant.stamp_ns]
        state = replace(
            state,
            readings=state.readings.with_reading(reading.stamp_ns, instant.history),
            pressures=followed_by(state.pressures, instant, self.settings.pressure_kept),
            waiting=tuple(
                item for item in state.waiting if self.shown_ns(item) > instant.stamp_ns
            ),
        )
        for sightings in ready:
            state = self.use_frame(state, sightings)
        state = self.with_pressure(state)
        age = self.target_age(state, instant.stamp_ns)
        late = age is None or abs(age) > self.settings.target_timeout
        ahead = self.ahead_notes(state)
        mode = Mode.PREDICTION if late else Mode.FUSED
        state, outcome = self.publish(state, instant, mode, [*notes, *ahead])
        if isinstance(outcome, Refusal):
            state = state.count_rejected(outcome.reason)
            outcome = replace(outcome, sentence='; '.join([outcome.sentence, *ahead]))
        return state, outcome

    def ahead_notes(self, state: FusionState) -> list[str]:
        """Say that frames come long before the pressure that they were taken at, by the stamps."""
        last_ns = state.pressures[-1].stamp_ns
        before_ns = state.pressures[max(len(state.pressures) - 2, 0)].stamp_ns
        shown = [self.shown_ns(sightings) for sightings in state.waiting]
        if state.belief is not None and state.belief.frames:
            shown.append(state.belief.stamp_ns)
        ahead = max((seconds_between(last_ns, ns) for ns in shown), default=0.0)
        if ahead <= self.settings.most_ahead + 1.5 * seconds_between(before_ns, last_ns):
            return []
        return [
            f'the last frame of targets is stamped {ahead:.3g} s later than the pressure: are the '
            'clocks of camera and pressure sensor apart?'
        ]

    def instant_at(self, state: FusionState, reading: PressureReading) -> PressureInstant:
        """Return what a pressure reading says of the chamber."""
        before = state.readings
        elapsed = 0.0
        if before.pressure_stamp_ns is not None:
            elapsed = seconds_between(before.pressure_stamp_ns, reading.stamp_ns)
        gauge = gauge_pressure(self.sensors, reading.pressure)
        sensed = self.arm.sense(Load(pressure=gauge)).pressure
        history = before.history
        if history is None:
            history = self.arm.initial_history(sensed)
        history, chamber = self.arm.actuate(history, elapsed, sensed)
        known = reading.variance > 0.0
        std = math.sqrt(reading.variance) if known else self.arm.sensors.pressure_std
        memory = state.pressures[-1].memory if state.pressures else ()
        play = self.settings.play * self.unknowns.range
        return PressureInstant(
            stamp_ns=reading.stamp_ns,
            gauge=gauge,
            chamber=chamber,
            std=std,
            history=history,
            memory=remember(self.settings, memory, chamber, elapsed, play),
        )

    def take_targets(
        self, state: FusionState, sightings: TargetSightings
    ) -> tuple[FusionState, FusionOutcome]:
        """Take a frame, or let it wait for its pressure; alone it gives an estimate itself."""
        stamp_ns = sightings.stamp_ns
        reason, sentence = stamp_fault('frame of targets', state.frame_stamp_ns, stamp_ns)
        if len(sightings.x) != self.unknowns.targets:
            reason = 'wrong_targets'
            sentence = (
                f'a frame of {len(sightings.x)} targets: the model has {self.unknowns.targets}'
            )
        if reason == STARTS_ANEW:
            state = state.without_frames()
        elif reason:
            refusal = Refusal(stamp_ns=stamp_ns, reason=reason, sentence=sentence, error=False)
            return state.count_unused(reason), refusal
        state = replace(state, frame_stamp_ns=stamp_ns)
        shown_ns = self.shown_ns(sightings)
        if state.pressures and shown_ns <= state.pressures[-1].stamp_ns:
            return self.use_frame(state, sightings), None
        if state.pressures:
            since_ns = state.pressures[-1].stamp_ns
        else:
            since_ns = self.shown_ns(state.waiting[0] if state.waiting else sightings)
        alone = state.pressure_lost and not state.pressures
        if not alone and not self.is_stale(since_ns, shown_ns):
            if len(state.waiting) == self.settings.most_waiting:
                state = replace(state, waiting=state.waiting[1:]).count_unused('no_pressure')
            return replace(state, waiting=(*state.waiting, sightings)), None
        return self.see_alone(state, sightings)

    def see_alone(
        self, state: FusionState, sightings: TargetSightings
    ) -> tuple[FusionState, FusionOutcome]:
        """Take a frame whose pressure nobody has read, and estimate at its stamp."""
        waiting, state = state.waiting, replace(state, waiting=())
        for earlier in (*waiting, sightings):
            state = self.use_frame(state, earlier)
        belief, shown_ns = state.belief, self.shown_ns(sightings)
        if belief is None or belief.stamp_ns != shown_ns:
            return state, None
        instant = replace(self.pressure_at(state, shown_ns), std=0.0)
        state, outcome = self.publish(state, instant, Mode.CAMERA_ONLY, [])
        return state, outcome

    def shown_ns(self, sightings: TargetSightings) -> int:
        """Return the stamp of what a frame shows."""
        return sightings.stamp_ns - round(self.arm.frame_delay * NANOSECONDS_PER_SECOND)

    def is_stale(self, last_ns: int, stamp_ns: int) -> bool:
        """Whether a pressure reading is too old at a stamp."""
        return abs(seconds_between(last_ns, stamp_ns)) > self.sensors.input_timeout

    def target_age(self, state: FusionState, stamp_ns: int) -> float | None:
        """Return the age (s) of the last frame that was used; None before the first."""
        if state.belief is None or not state.belief.frames:
            return None
        return seconds_between(state.belief.stamp_ns, stamp_ns)

    def pressure_at(self, state: FusionState, stamp_ns: int) -> PressureInstant:
        """Return the pressure at a stamp: on the line between readings, else the nearest one.

        Before any reading it is in the middle of the range.
        """
        known = state.pressures
        if not known:
            middle = 0.5 * sum(self.arm.pressure_range)
            return PressureInstant(
                stamp_ns=stamp_ns,
                gauge=middle,
                chamber=middle,
                std=0.0,
                history=self.arm.initial_history(middle),
                memory=remember(self.settings, (), middle, 0.0, 0.0),
            )
        after = bisect_left(known, stamp_ns, key=stamp_of)
        if after in (0, len(known)):
            return replace(known[min(after, len(known) - 1)], stamp_ns=stamp_ns)
        first, second = known[after - 1], known[after]
        share = (stamp_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
        nearest = first if share < 0.5 else second
        return replace(
            nearest,
            stamp_ns=stamp_ns,
            gauge=first.gauge + share * (second.gauge - first.gauge),
            chamber=first.chamber + share * (second.chamber - first.chamber),
        )

    def wrench_at(self, state: FusionState, stamp_ns: int) -> tuple[WrenchReading | None, float]:
        """Return the wrench nearest to a stamp and its age (s); None where none is near."""
        if self.settings.free_tip:
            nothing = WrenchReading(
                stamp_ns=stamp_ns,
                force_x=0.0,
                force_y=0.0,
                moment=0.0,
                frame_id=self.sensors.frame_id,
            )
            return nothing, 0.0
        if not state.wrenches:
            return None, math.nan
        wrench = nearest_to(state.wrenches, stamp_ns)
        age = seconds_between(wrench.stamp_ns, stamp_ns)
        return (wrench, age) if abs(age) <= self.sensors.wrench_timeout else (None, math.nan)

    def used_wrench_at(
        self, state: FusionState, stamp_ns: int
    ) -> tuple[WrenchReading | None, float]:
        """Return the wrench nearest to a stamp and its age (s), if the sensor is not off."""
        return (None, math.nan) if state.sensor is Verdict.OFF else self.wrench_at(state, stamp_ns)

    def with_pressure(self, state: FusionState) -> FusionState:
        """Return the state where the pressure is read again."""
        if not state.pressure_lost or state.belief is None:
            return state
        belief = self.without(state.belief, OF_BIAS)
        return replace(state, belief=belief, pressure_lost=False)

    def without(self, belief: Belief, where: slice) -> Belief:
        """Return a belief that knows of some unknowns what was known before any frame."""
        scale = scale_of(self.settings, belief.lack_weights)
        return forget(belief, where, scaled_std(self.unknowns, scale)[where])

    def inputs_at(self, instant: PressureInstant, wrench: WrenchReading | None) -> FrameInputs:
        """Return what acted on the arm, and what columns of the covariance change of it."""
        std = 0.0 if wrench is None else self.arm.sensors.moment_std
        columns = self.unknowns.columns
        by_column = np.zeros(columns)
        if self.arm.sensing:
            by_column = self.by_columns(Load(pressure=instant.gauge))[:, PRESSURE]
        return FrameInputs(
            chamber=instant.chamber,
            chamber_std=instant.std,
            history=instant.history,
            moment=0.0 if wrench is None else wrench.moment,
            moment_std=std,
            by_column=by_column,
            late=np.array(instant.memory) - instant.chamber,
        )

    def by_columns(self, reading: Load) -> Array:
        """Return what one sigma of each column changes of F1, F2, M, pressure: (columns, 4)."""
        return noise_jacobian(self.table, reading, (0.0,) * 4)[LOADS + 1 :, : PRESSURE + 1]

    def with_wrench(
        self, belief: Belief, wrench: WrenchReading, age: float, gauge: float
    ) -> Belief:
        """Return the belief after an end wrench (base frame), a linear measurement of the force.

        By its age (s) the force may have walked. One that is not where it was believed makes its
        past forgotten.
        """
        reading = load_read(wrench, gauge)
        true = self.arm.sense(reading)
        response = np.zeros((2, belief.mean.size))
        response[:, FORCE] = np.eye(2)
        if not self.settings.free_tip:  # then nobody reads it
            response[:, OFFSET] = np.eye(2)
            response[:, GAIN] = true.force_x, true.force_y
        if self.arm.sensing:
            response[:, self.unknowns.of_columns] = -self.by_columns(reading)[:, FORCE].T
        std = math.hypot(self.arm.sensors.force_std, belief.walk * math.sqrt(abs(age)))
        value = np.array([true.force_x, true.force_y])
        innovation = value - response @ belief.mean
        spread = response @ belief.root
        covariance = spread @ spread.T + std**2 * np.eye(2)
        if innovation @ np.linalg.solve(covariance, innovation) > self.settings.force_gate:
            belief = self.without(belief, FORCE)
        return take_measurement(belief, response, value, np.full(2, std))

    def use_frame(self, state: FusionState, sightings: TargetSightings) -> FusionState:
        """Take a frame into the belief."""
        state = self.check_frame(state)
        if not sightings.seen:
            return state.count_unused('not_seen')
        shown_ns = self.shown_ns(sightings)
        if state.lost >= self.settings.most_lost:  # what is believed keeps all frames out
            state = replace(state.without_belief(), lost=0)
        before = state.belief or first_belief(self.unknowns, self.settings, shown_ns)
        if before.frames and shown_ns < before.stamp_ns:
            return state.count_unused('older')
        lost = state.lost >= self.settings.frames_lost
        frame = self.read_frame(state, sightings, force_lost=lost)
        if state.seen is None or not state.seen.is_same(sightings):
            chamber = frame.instant.chamber
            state = replace(state, seen=SeenFrame(x=sightings.x, y=sightings.y, chamber=chamber))
        elif self.is_copy(state.seen, frame):
            return state.count_unused('repeated')
        if lost:
            before = without_contact(before)
            state = replace(state, rival=None, log_odds=None)
        state, frame, before, weighed = self.weigh_and_judge(state, frame, before)
        update = weighed.update
        if update.belief is not None:
            belief = with_walk(self.settings, before, update.belief)
            if belief.same_targets and update.left_out and update.fit:
                seen = np.isfinite(sightings.x) & np.isfinite(sightings.y)
                strange = np.flatnonzero(seen & ~update.fit[0].used)
                belief = with_strange_targets(self.unknowns, self.settings, belief, strange)
            update = replace(update, belief=belief)
        state = replace(
            state,
            rival=weighed.rival,
            log_odds=weighed.log_odds,
            elsewhere=weighed.elsewhere,
            pressure_lost=frame.alone,
        )
        return self.after_frame(state, shown_ns, update, frame.wrench)

    def read_frame(
        self, state: FusionState, sightings: TargetSightings, *, force_lost: bool
    ) -> ReadFrame:
        """Return a frame with what was read at the stamp of what it shows."""
        shown_ns = self.shown_ns(sightings)
        wrench, age = self.used_wrench_at(state, shown_ns)
        return ReadFrame(
            stamp_ns=shown_ns,
            sightings=sightings,
            instant=self.pressure_at(state, shown_ns),
            alone=not state.pressures
            or self.is_stale(nearest_to(state.pressures, shown_ns).stamp_ns, shown_ns),
            pressure_lost=state.pressure_lost,
            force_lost=force_lost,
            wrench=wrench,
            wrench_age=age,
        )

    def is_copy(self, seen: SeenFrame, frame: ReadFrame) -> bool:
        """Whether a frame, the same as one before to the last bit, should have been another."""
        pressed = abs(frame.instant.chamber - seen.chamber)
        return not frame.alone and pressed > self.settings.frozen * frame.instant.std

    def weigh_and_judge(
        self, state: FusionState, frame: ReadFrame, before: Belief
    ) -> tuple[FusionState, ReadFrame, Belief, WeighedFrame]:
        """Return what a frame says, once it has said whether camera and force sensor are right.

        Beside it the state, the frame and what was believed before it: without what a sensor that
        is not right has told so far.
        """
        state = replace(state, otherwise=None)
        weighed = self.weigh_with_targets(state, frame, before)
        if state.sensor is not Verdict.OFF and self.shows_turn(weighed.update.belief):
            before = without_lessons(self.unknowns, self.settings, before)
            before = with_moved_camera(self.unknowns, self.settings, before)
            state = replace(state.without_belief(), sensor=Verdict.OPEN)
            weighed = self.weigh(state, frame, before)
        if frame.wrench is None or self.settings.free_tip:
            return state, frame, before, weighed
        state = self.judge_sensor(state, frame, weighed)
        if state.sensor is Verdict.OFF:
            state, frame = state.without_belief(), frame.without_wrench()
            before = first_belief(self.unknowns, self.settings, frame.stamp_ns)
            weighed = self.weigh_with_targets(state, frame, before)
        return state, frame, before, weighed

    @property
    def tells_camera(self) -> bool:
        """Whether the error of the model is known, which else looks like a moved camera."""
        return self.arm.covariance is not None

    def shows_turn(self, belief: Belief | None) -> bool:
        """Whether frames have surely said that the camera was turned, rather than the sensor off.

        Too little to leave a misfit: a tip force moves the arm much like that.
        """
        if belief is None or belief.camera_moved or not self.tells_camera:
            return False
        if np.trace(belief.force_covariance) > self.largest_force_std**2:
            return False  # what holds a force that is not determined tells of the rest as well
        turn, std = told_by_frames(self.unknowns, belief, TURN)
        limit = self.settings.turn_tolerance
        if std >= limit or abs(turn) <= max(limit, self.settings.sure * std):
            return False
        return abs(turn) > std * sensor_score(self.unknowns, belief)

    def judge_sensor(
        self, state: FusionState, frame: ReadFrame, weighed: WeighedFrame
    ) -> FusionState:
        """Return the state with the verdict on a force sensor that is used, after a frame.

        A contact confirms nothing. What fits better without sensor and contact is summed up, by
        how much; of a sensor that was never confirmed one frame is enough which nothing explains.
        """
        update, known = weighed.update, state.sensor
        verdict, without = known, None
        if update.belief is None:
            _, gain = self.settings.sensor_gain
            if not self.fits_without(state, frame, update):
                gain = 0.0
            elif known is Verdict.OPEN:
                verdict = Verdict.OFF
        else:
            said = verdict_on(self.unknowns, self.settings, update.belief)
            if said is Verdict.OFF or (said is Verdict.IN_ORDER and not update.belief.touched):
                verdict = said
            without = self.without_sensor(state, frame, update)
            gain = gain_without(without, update, frame.sightings.seen)
        doubt = doubt_after(self.settings, state.doubt, gain)
        if doubt >= self.settings.sensor_doubt:
            verdict = Verdict.OFF
        otherwise = None if without is None or known is not Verdict.OPEN else without.belief
        return replace(state, sensor=verdict, doubt=doubt, otherwise=otherwise)

    def without_sensor(
        self, state: FusionState, frame: ReadFrame, update: FrameUpdate
    ) -> FrameUpdate | None:
        """Return what became of a frame with a contact if the sensor is off and nothing touches.

        None without a contact, and where it explains the frame and the sensor is confirmed.
        """
        belief, fit = update.belief, update.fit
        if belief is None or fit is None or not belief.touched:
            return None
        if state.sensor is Verdict.IN_ORDER and excess(fit) < self.settings.sensor_misfit:
            return None
        before = without_lessons(self.unknowns, self.settings, belief)
        problem = self.problem_of(frame.without_wrench(), before)
        return take_frame(problem, cold=False, found_better=False, force_read=False)

    def fits_without(self, state: FusionState, frame: ReadFrame, update: FrameUpdate) -> bool:
        """Whether a frame that was not used is explained if the sensor is off, and only then."""
        if frame.force_lost or update.reason not in ('inconsistent', 'no_equilibrium'):
            return False
        anew = state.without_belief()
        return self.explains(anew, frame.without_wrench()) and not self.explains(anew, frame)

    def explains(self, state: FusionState, frame: ReadFrame) -> bool:
        """Whether noise explains a frame to which nothing is known."""
        before = first_belief(self.unknowns, self.settings, frame.stamp_ns)
        fit = self.weigh(state, frame, before).update.fit
        return fit is not None and excess(fit) <= 1.0

    def reads_force(self, state: FusionState, wrench: WrenchReading | None) -> bool:
        """Whether a confirmed sensor tells the tip force, or nothing pulls there."""
        confirmed = self.settings.free_tip or state.sensor is Verdict.IN_ORDER
        return wrench is not None and confirmed

    def weigh_with_targets(
        self, state: FusionState, frame: ReadFrame, before: Belief
    ) -> WeighedFrame:
        """Return what a frame says, also if other targets are painted, or the camera was moved."""
        weighed = self.weigh(state, frame, before)
        fit, belief = weighed.update.fit, weighed.update.belief
        if fit is None or frame.force_lost:  # it was tried with the frames before
            return weighed
        settings, misfit = self.settings, excess(fit) > 1.0
        if misfit and before.same_targets:
            other = with_other_targets(self.unknowns, before)
            weighed = self.better_with(state, frame, other, weighed, settings.other_targets)
        touches = belief is not None and belief.touched and not before.touched
        if self.tells_camera and (misfit or touches):
            other = with_moved_camera(self.unknowns, settings, before)
            weighed = self.better_with(state, frame, other, weighed, settings.camera_moved)
        return weighed

    def weigh(self, state: FusionState, frame: ReadFrame, before: Belief) -> WeighedFrame:
        """Return what a frame says, of a contact and of none, to what was believed before it."""
        problem = self.problem_of(frame, before)
        update = take_frame(
            problem,
            cold=frame.force_lost or not before.frames,
            found_better=state.found_better,
            force_read=frame.wrench is not None,
        )
        rival = None if state.rival is None else self.problem_of(frame, state.rival)
        odds = -self.settings.contact_bound if state.log_odds is None else state.log_odds
        return weigh_hypotheses(
            update,
            problem,
            rival,
            odds,
            elsewhere=state.elsewhere,
            force_read=self.reads_force(state, frame.wrench),
        )

    def better_with(
        self,
        state: FusionState,
        frame: ReadFrame,
        other: Belief,
        weighed: WeighedFrame,
        log_odds: float,
    ) -> WeighedFrame:
        """Return what a frame says to another belief, if it surely says that this one is right.

        log_odds: against it, before the frame.
        """
        again = self.weigh(replace(state, rival=None, log_odds=None), frame, other)
        seen = frame.sightings.seen
        if weighed.update.fit is None or again.update.fit is None:
            return weighed
        gain = evidence_cost(weighed.update.fit, seen) - evidence_cost(again.update.fit, seen)
        return again if gain > 2.0 * log_odds else weighed

    def problem_of(self, frame: ReadFrame, belief: Belief) -> FrameProblem:
        """Return a frame beside what was believed before it.

        From frame to frame the force is free: a frame must not inherit what the last one erred.
        But it is not drawn to zero either, frame after frame, which the unknowns that stay would
        take for evidence.
        """
        free = replace(belief, walk=self.settings.largest_walk)
        pressed = abs(frame.instant.chamber - belief.chamber)
        pressed = 0.0 if frame.alone or not math.isfinite(pressed) else pressed
        moved, growth = self.move(free, frame.stamp_ns, pressed), None
        prior = replace(moved, root=compress(moved.root))
        if frame.alone:
            std = self.settings.unknown_pressure * self.unknowns.range
            prior = widen(prior, OF_BIAS, np.array([std]))
        else:
            seconds = seconds_between(free.stamp_ns, frame.stamp_ns) if free.frames else math.inf
            growth = LackGrowth(
                scale=scale_of(self.settings, belief.lack_weights),
                grown=lack_grown(self.unknowns, seconds, pressed),
                seconds=seconds,
            )
            if frame.pressure_lost:
                prior = self.without(prior, OF_BIAS)
        if frame.force_lost:
            prior = self.without(prior, FORCE)
        if frame.wrench is not None:
            prior = self.with_wrench(prior, frame.wrench, frame.wrench_age, frame.instant.gauge)
        instant = replace(frame.instant, std=0.0) if frame.alone else frame.instant
        inputs = self.inputs_at(instant, frame.wrench)
        sightings = frame.sightings
        return FrameProblem(
            table=self.table,
            unknowns=self.unknowns,
            settings=self.settings,
            prior=with_noise(prior, inputs.moment_std, inputs.chamber_std),
            growth=growth,
            inputs=inputs,
            sightings=sightings,
            used=np.isfinite(sightings.x) & np.isfinite(sightings.y),
        )

    def move(self, belief: Belief, stamp_ns: int, pressed: float) -> Belief:
        """Return the belief at a later stamp, with a contact that may have walked.

        pressed (Pa): by how much the pressure has moved since.
        """
        scale = scale_of(self.settings, belief.lack_weights)
        moved = move_belief(self.unknowns, belief, stamp_ns, scale, pressed)
        if not belief.touched:
            return moved
        seconds = abs(seconds_between(belief.stamp_ns, stamp_ns))
        force_walk = min(belief.walk, self.settings.contact_walk)
        walk = np.array([force_walk, self.settings.place_walk])
        return widen(moved, CONTACT, walk * math.sqrt(seconds))

    def after_frame(
        self, state: FusionState, shown_ns: int, update: FrameUpdate, wrench: WrenchReading | None
    ) -> FusionState:
        """Remember what became of a frame."""
        nis = state.nis
        if update.coordinates:
            limit = chi_square_limit(update.coordinates, self.settings.quantile)
            value = update.nis / update.coordinates
            first = RunningNis(stamp_ns=shown_ns, weight=1.0, last=value, mean=value, limit=limit)
            nis = (
                first
                if nis is None
                else nis.followed_by(shown_ns, value, limit, self.settings.nis_time)
            )
        if update.belief is None:
            return replace(state, nis=nis, lost=state.lost + 1).count_unused(update.reason)
        state = replace(
            state,
            belief=update.belief,
            wrench_used_ns=None if wrench is None else wrench.stamp_ns,
            nis=nis,
            unchecked=update.unchecked,
            told=False,
            lost=0,
            frames=state.frames + 1,
        )
        if not update.settled:
            return state
        return replace(
            state,
            ambiguous=update.ambiguous,
            found_better=False,
            since_restart=0,
            cold_round=ColdRound(),
        )

    def check_frame(self, state: FusionState) -> FusionState:
        """Look for another force that explains the last frame, where nobody did.

        One that explains it better leaves the force ambiguous, and the search in the next frame
        begins everywhere.
        """
        if state.unchecked is None:
            return state
        gain, round_ = look_elsewhere(state.unchecked, state.cold_round)
        rival = self.settings.rival
        clear = 0 if gain > -rival else state.since_restart + 1
        whole = self.settings.restart_frames + self.settings.starts_followed
        return replace(
            state,
            unchecked=None,
            ambiguous=gain > -rival or (state.ambiguous and clear < whole),
            found_better=gain > rival,
            since_restart=clear,
            cold_round=round_,
        )

    def publish(
        self, state: FusionState, instant: PressureInstant, mode: Mode, notes: list[str]
    ) -> tuple[FusionState, FusedEstimate | Refusal]:
        """Estimate shape and force at a pressure: the belief moved to its stamp."""
        stamp_ns, state = instant.stamp_ns, replace(state, told=True)
        belief = state.belief or first_belief(self.unknowns, self.settings, stamp_ns)
        unseen = np.zeros((belief.mean.size, 0))
        wrench, age = self.used_wrench_at(state, stamp_ns)
        inputs = self.inputs_at(instant, wrench)
        if belief.stamp_ns != stamp_ns or not belief.frames:
            pressed = abs(instant.chamber - belief.chamber)
            columns = belief.root.shape[1]
            belief = self.move(belief, stamp_ns, pressed if math.isfinite(pressed) else 0.0)
            unseen = belief.root[:, columns:]
            belief = with_noise(belief, inputs.moment_std, inputs.chamber_std)
        if wrench is not None and wrench.stamp_ns != state.wrench_used_ns:
            belief = self.with_wrench(belief, wrench, age, instant.gauge)
        if wrench is not None:
            beside = out_of_plane(self.arm, self.sensors, wrench)
            if beside.stops:
                return state, refuse(stamp_ns, 'out_of_plane', beside.sentence)
            notes = [*notes, *([beside.note] if beside.warns else [])]
        causes = causes_of(self.unknowns, inputs)
        bent = bend_arm(
            self.table,
            inputs,
            causes @ belief.mean,
            belief.solution if mode is not Mode.PREDICTION else state.solution,
            self.arclength,
            quick=False,
            contact=self.held_contact(belief),
        )
        if not bent.shape.converged:
            state = replace(state, solution=None)
            return state, refuse(stamp_ns, 'no_equilibrium', bent.shape.status)
        position = self.position_of(belief, bent, inputs)
        if position.reason:
            return state, refuse(stamp_ns, position.reason, position.sentence)
        estimate = self.shape_estimate(
            belief, unseen, bent, inputs, causes, position, stamp_ns, mode
        )
        if isinstance(estimate, Refusal):
            return state, estimate
        estimate = replace(
            estimate,
            wrench_age=None if wrench is None else age,
            warnings=(*notes, *position.notes, *estimate.warnings),
        )
        if state.otherwise is not None and mode is not Mode.PREDICTION:
            estimate = self.holding(estimate, state.otherwise, instant)
        state = replace(state, solution=bent.solution, estimates=state.estimates + 1)
        contact = self.contact_at(state, belief, bent, mode, wrench)
        ambiguous = state.ambiguous or (contact is not None and contact.ambiguous)
        fault = self.sensor_fault(state, belief, instant, ambiguous=ambiguous)
        if fault is not None:
            estimate = replace(estimate, warnings=(*estimate.warnings, DISAGREES))
        force, covariance = self.known_force(belief, position, fault, ambiguous=ambiguous)
        if self.unknowns.placement is not None and not belief.same_targets:
            estimate = replace(estimate, warnings=(*estimate.warnings, OTHER_TARGETS))
        if belief.camera_moved:
            estimate = replace(estimate, warnings=(*estimate.warnings, CAMERA_MOVED))
        lacking = pressure_like(self.unknowns, inputs)
        return state, FusedEstimate(
            estimate=estimate,
            mode=mode,
            force=force,
            force_covariance=covariance,
            contact=contact,
            pressure_bias=float(lacking @ belief.mean),
            pressure_bias_std=float(np.linalg.norm(lacking @ belief.root)),
            force_sensor=fault,
            ambiguous=ambiguous,
            nis=math.nan if state.nis is None else state.nis.mean,
            nis_limit=math.nan if state.nis is None else state.nis.limit,
            target_age=self.target_age(state, stamp_ns),
        )

    def held_contact(self, belief: Belief) -> PartLoad | None:
        """Return the contact that is believed, on the arm; None without one."""
        if not belief.touched:
            return None
        low, high = self.settings.contact_places
        mean = belief.mean.copy()
        place = CONTACT.stop - 1
        mean[place] = min(max(mean[place], low * self.arm.length), high * self.arm.length)
        return contact_of(self.arm, self.settings, mean)

    def contact_at(
        self,
        state: FusionState,
        belief: Belief,
        bent: BentArm,
        mode: Mode,
        wrench: WrenchReading | None,
    ) -> Contact | None:
        """Return the contact that is seen, None without one."""
        if bent.contact is None or state.log_odds is None or mode is Mode.PREDICTION:
            return None
        force, place = bent.contact.force, bent.contact.place
        if abs(force) < self.settings.contact_least * self.unknowns.force_scale:
            return None
        shape, correlation = bent.shape, correlation_with_tip(belief)
        unconfirmed = wrench is not None and state.sensor is Verdict.OPEN  # it may be the sensor
        alike = unconfirmed or state.elsewhere or correlation > self.settings.contact_alike
        return Contact(
            x=float(np.interp(place, shape.arclength, shape.x)),
            y=float(np.interp(place, shape.arclength, shape.y)),
            arclength=place,
            std_arclength=belief.std(CONTACT.stop - 1),
            force=force,
            std_force=belief.std(CONTACT.start),
            log_odds=state.log_odds,
            correlation=correlation,
            ambiguous=alike and not self.reads_force(state, wrench),
        )

    def position_of(self, belief: Belief, bent: BentArm, inputs: FrameInputs) -> DomainPosition:
        """Return where the load believed stands to the domain of the model."""
        shape = bent.shape
        load = Load(
            pressure=shape.pressure,
            force_x=shape.force[0],
            force_y=shape.force[1],
            moment=shape.end_moment,
        )
        force_x, force_y = np.sqrt(np.diagonal(belief.force_covariance)).tolist()
        std = (force_x, force_y, inputs.moment_std, inputs.chamber_std)
        return locate_load(self.arm, load, shape.pressure, std)

    def shape_estimate(
        self,
        belief: Belief,
        unseen: Array,
        bent: BentArm,
        inputs: FrameInputs,
        causes: Array,
        position: DomainPosition,
        stamp_ns: int,
        mode: Mode,
    ) -> ShapeEstimate | Refusal:
        """Return the shape with the errors that the belief carries into it, to second order.

        unseen (unknowns, errors): what has moved since the last frame; causes: of the unknowns.
        """
        sensitivity = bent.linearize()
        causes = causes_with_contact(causes, bent.contact)
        noise = np.ascontiguousarray(compress(causes @ belief.root).T)
        seen: SeenShape | None = None
        if mode is Mode.PREDICTION:
            noise = with_extrapolation_error(noise, position)
        else:
            seen = self.seen_shape(causes @ unseen, sensitivity)
        errors = propagate_errors(sensitivity, noise, self.arclength, seen)
        largest = math.inf
        if errors is not None:
            largest = math.sqrt(np.linalg.eigvalsh(errors.tip_covariance[:2, :2])[-1])
        held = mode is not Mode.PREDICTION or largest <= self.settings.largest_tip_std
        if errors is None or not held:
            return refuse(
                stamp_ns,
                'too_uncertain',
                f'the tip is known to {1e3 * largest:.3g} mm only, more than largest_tip_std = '
                f'{1e3 * self.settings.largest_tip_std:.3g} mm'
                + (': no target was seen lately' if mode is Mode.PREDICTION else ''),
            )
        notes = []
        if bent.shape.stable is False:
            notes.append('the equilibrium is unstable under dead load')
        if errors.second_order is None or errors.second_order.step < 1.0:
            notes.append('an error of one sigma leads to no equilibrium, or to another one')
        std_x, std_y, std_curvature = errors.std
        return ShapeEstimate(
            stamp_ns=stamp_ns,
            shape=replace(bent.shape, extrapolated=position.extrapolated),
            chamber_pressure=bent.shape.pressure,
            jacobian=jacobian_of(self.arm, sensitivity, inputs.history or ()),
            tip_covariance=errors.tip_covariance,
            std_x=std_x,
            std_y=std_y,
            std_curvature=std_curvature,
            wrench_age=None,
            warnings=tuple(notes),
            position=position,
            noise=freeze(noise),
            curved=errors.second_order,
        )

    def holding(
        self, estimate: ShapeEstimate, other: Belief, instant: PressureInstant
    ) -> ShapeEstimate:
        """Return an estimate whose errors hold another shape too, of which nobody can know."""
        inputs = self.inputs_at(instant, None)
        changes = causes_of(self.unknowns, inputs) @ other.mean
        bent = bend_arm(self.table, inputs, changes, other.solution, self.arclength, quick=False)
        here, there = estimate.shape, bent.shape
        if not there.converged:
            return estimate
        tip = np.array(there.tip) - np.array(here.tip)
        return replace(
            estimate,
            tip_covariance=freeze(estimate.tip_covariance + np.outer(tip, tip)),
            std_x=freeze(np.hypot(estimate.std_x, there.x - here.x)),
            std_y=freeze(np.hypot(estimate.std_y, there.y - here.y)),
            std_curvature=freeze(
                np.hypot(estimate.std_curvature, there.curvature - here.curvature)
            ),
        )

    def seen_shape(self, unseen: Array, sensitivity: Sensitivity) -> SeenShape:
        """Return where the camera saw the shape, and how well it still says where it is.

        unseen (causes, errors): what has moved since.
        """
        noise, places = self.arm.sensors, self.arm.target_arclength
        std = math.hypot(target_std(noise), noise.registration_std, noise.drift_std)
        moved = np.tensordot(unseen.T, sensitivity.stations(places)[:, :2], axes=1)
        return SeenShape(arclength=places, std=np.sqrt(std**2 + np.sum(moved**2, axis=0)))

    def sensor_fault(
        self, state: FusionState, belief: Belief, instant: PressureInstant, *, ambiguous: bool
    ) -> ForceSensorFault | None:
        """Return what a force sensor that is off reads, beside what is believed without it."""
        if state.sensor is not Verdict.OFF:
            return None
        reading = np.full(2, np.nan)
        wrench, _ = self.wrench_at(state, instant.stamp_ns)
        if wrench is not None:
            true = self.arm.sense(load_read(wrench, instant.gauge))
            reading = np.array([true.force_x, true.force_y])
        std = np.sqrt(np.diagonal(belief.force_covariance))
        unknown = np.full(2, ambiguous) | (std > self.largest_force_std)
        return ForceSensorFault(
            reading=freeze(reading),
            targets=freeze(np.where(unknown, np.nan, belief.mean[FORCE])),
            targets_std=freeze(np.where(unknown, np.nan, std)),
        )

    @property
    def largest_force_std(self) -> float:
        """The standard deviation (N) beyond which a component of the force is not determined."""
        return self.settings.determined * self.unknowns.force_scale

    def known_force(
        self,
        belief: Belief,
        position: DomainPosition,
        fault: ForceSensorFault | None,
        *,
        ambiguous: bool,
    ) -> tuple[Array, Array]:
        """Return force (2,) N and covariance (2, 2) N^2, NaN where not determined or ambiguous.

        fault: of a force sensor that is off. It may be right, and the model wrong: while it reads,
        the covariance holds both.
        """
        covariance = belief.force_covariance + np.diag(np.square(position.error[:2]))
        if fault is not None and np.isfinite(fault.reading).all():
            error = fault.reading - belief.mean[FORCE]
            covariance += np.outer(error, error)
        determined = np.sqrt(np.diagonal(covariance)) <= self.largest_force_std
        if ambiguous:
            determined = np.zeros(2, dtype=bool)
        force = np.where(determined, belief.mean[FORCE], np.nan)
        both = determined[:, None] & determined[None, :]
        return freeze(force), freeze(np.where(both, covariance, np.nan))
