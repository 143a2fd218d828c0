"""Fusion of readings and targets into one estimate of shape and tip force, as a pure step.

`Fusion.step(state, event) -> state, outcome` uses no clock, topic or file, like `Estimator.step`.
The belief refers to the stamp of the last frame, because frames arrive late; every pressure
reading gives a `FusedEstimate`, the belief propagated to its stamp with the pressures read since.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from functools import partial
import math

import numpy as np
from pneunet_ros.core.arrays import median
from pneunet_ros.core.notes import Note
from pneunet_ros.core.outcome import drop, Refusal, refuse
from pneunet_ros.core.readings import (
    BaseReading,
    PressureReading,
    Reading,
    TargetSightings,
    WrenchReading,
)
from pneunet_ros.core.stamps import AHEAD, RESTARTED
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between, seconds_since
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.base_gravity import GravitySource
from pneunet_ros.estimation.sensor_mapping import base_wrench, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import admit
from pneunet_ros.fusion.belief import (
    Belief,
    first_belief,
    FORCE_SENSOR,
    PRESSURE,
    reset_to_prior,
    with_outlier_targets,
    with_walk,
)
from pneunet_ros.fusion.belief_estimate import estimate_at
from pneunet_ros.fusion.causes import PressureCause, TARGETS
from pneunet_ros.fusion.estimate import FusedEstimate, FusionOutcome, Mode
from pneunet_ros.fusion.frame_update import ColdSearch
from pneunet_ros.fusion.hypothesis_update import HypothesisUpdate
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import (
    followed_by,
    nearest_to,
    NearWrench,
    pressure_at,
    PressureInstant,
    ReadFrame,
    SeenFrame,
    stamp_of,
)
from pneunet_ros.fusion.settings import FUSION, FusionSettings
from pneunet_ros.fusion.state import FusionState, PendingFrame, RunningNis
from pneunet_ros.fusion.weighing import estimate_walk, is_copy, kept_force_errors, take, weigh
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.errors.rounding_error import smallest_change, with_rounding
from pneunet_ros.measurement.errors.white_noise import white_std
from pneunet_ros.measurement.inference.adequacy import chi_square_limit
from pneunet_ros.measurement.inference.bank import Hypothesis
from pneunet_ros.measurement.inference.gaussian import take_measurement
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain_position import locate_load, OUT_OF_RANGE

PRESSURES_KEPT = 256  # readings that wait for frames, which arrive later: limits memory
WRENCHES_KEPT = 256  # end wrenches that wait for frames: limits memory
MOST_WAITING = 128  # frames that wait for their pressure reading: limits memory
NIS_TIME = 2.0  # s, averaging time of the NIS in the diagnostics

Event = Reading | BaseReading | TargetSightings
USUAL_GAP = 1.5  # times the gap before: longer ones are not interpolated across
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
MOST_AHEAD = 0.1  # s, of a frame before its pressure: more is a note
NOISE_READINGS = 60  # latest ones of the force, for its noise
STILL_READINGS = 5  # identical ones of the pressure: its sensor may hang
STILL_FRAMES = 5  # for one such test: an idle sensor may clip at zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fusion:
    """Fusion of pressure, end wrench and targets into one estimate of a calibrated arm.

    arm: with the noise of its sensors and the covariance of its model; sensors: meaning and
    timeouts of the readings (a fresh wrench is used regardless of `wrench_required`); settings of
    the filter; unknowns: the errors to estimate, None for `unknowns_of` the arm. Raises ModelError
    if the arm has no targets.
    """

    arm: Arm
    sensors: EstimatorSettings = field(default_factory=EstimatorSettings)
    settings: FusionSettings = FUSION
    unknowns: Unknowns | None = None
    model: PreparedModel = field(init=False, repr=False)
    gravity: GravitySource = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare the model."""
        source = GravitySource(settings=self.sensors, gravity=self.arm.gravity)
        object.__setattr__(self, 'gravity', source)
        model = PreparedModel(
            arm=self.arm, sensors=self.sensors, settings=self.settings, given=self.unknowns
        )
        object.__setattr__(self, 'model', model)

    def step(self, state: FusionState, event: Event) -> tuple[FusionState, FusionOutcome]:
        """Take one reading or one frame of targets.

        Args:
            state: the state after all earlier events; unchanged.
            event: a pressure (Pa), an end wrench (N, N m) or the targets seen in a frame (m, base
                frame), with the stamp of its message header; or a reading of the gravity
                direction.

        Returns:
            The next state, and the result. A pressure gives a FusedEstimate or a Refusal. A frame
            gives None or a Refusal, or a FusedEstimate if the pressure is out of date, so that
            only the camera is used. A wrench gives None or a Refusal. Bad readings never raise.
        """
        state = self.settle(state)
        if isinstance(event, TargetSightings):
            return self.take_targets(state, event)
        if not isinstance(event, PressureReading | WrenchReading):
            gravity, refusal = self.gravity.take(state.readings.gravity, event)
            state = replace(state, readings=replace(state.readings, gravity=gravity))
            return (state if refusal is None else state.count_rejected(refusal.reason)), refusal
        resets = state.readings.resets
        readings, refusal, note = admit(state.readings, event)
        if readings is not state.readings:
            state = replace(state, readings=readings)
        if refusal is not None:
            return state.count_rejected(refusal.reason), refusal
        if readings.resets > resets:
            state = state.fresh()
        if isinstance(event, WrenchReading):
            return self.take_wrench(state, event)
        return self.take_pressure(state, event, [note] if note else [])

    def settle(self, state: FusionState) -> FusionState:
        """Compare the hypotheses for the last frame, after its estimate was published.

        A node calls this after publishing an estimate. If it is not called, the next step does the
        same work first.
        """
        pending = state.pending
        return self.weigh_pending(state) if pending and pending.answered else state

    def take_wrench(
        self, state: FusionState, reading: WrenchReading
    ) -> tuple[FusionState, Refusal | None]:
        """Store an end wrench in the base frame."""
        sentence = wrong_frame(self.sensors, reading)
        if sentence:
            refusal = drop(reading.stamp_ns, 'wrong_frame', sentence)
            return state.count_rejected(refusal.reason), refusal
        wrench = base_wrench(self.sensors, reading)
        step, before = state.force.step, state.force.kept
        if before:
            last = before[-1]
            change = math.hypot(wrench.force_x - last.force_x, wrench.force_y - last.force_y)
            step = smallest_change(step, change)
        kept = followed_by(before, wrench, WRENCHES_KEPT)
        force = replace(state.force, kept=kept, step=step)
        return replace(state, readings=state.readings.with_wrench(wrench), force=force), None

    def take_pressure(
        self, state: FusionState, reading: PressureReading, notes: list[str]
    ) -> tuple[FusionState, FusedEstimate | Refusal]:
        """Process the frames that wait for a pressure reading, and estimate at its stamp."""
        if PRESSURE in state.causes:
            return self.refuse_pressure(state, reading)
        readings = state.readings.watch_pressure(reading, self.arm, self.sensors)
        state = replace(state, readings=readings)
        gravity, unknown = self.gravity.at(readings.gravity, reading.stamp_ns)
        refusal = readings.watch.refusal(reading.stamp_ns)
        if refusal is not None:
            readings = readings.with_impossible(reading.stamp_ns)
            return replace(state, readings=readings).count_rejected(refusal.reason), refusal
        turn_rate = self.gravity.turn_rate_at(readings.gravity, reading.stamp_ns)
        instant = self.instant_at(state, reading)
        instant = replace(instant, gravity=gravity, turn_rate=turn_rate)
        position = locate_load(self.arm, Load(pressure=instant.gauge), instant.chamber)
        if position.reason == OUT_OF_RANGE:
            # The reading is not kept: without a possible pressure, only the camera is used.
            hint = readings.watch.hint(reading, self.arm, self.sensors)
            refusal = refuse(reading.stamp_ns, position.reason, position.sentence + hint)
            readings = state.readings.with_impossible(reading.stamp_ns)
            return replace(state, readings=readings).count_rejected(refusal.reason), refusal
        state = replace(
            state,
            readings=state.readings.with_reading(reading.stamp_ns, instant.history),
            pressures=followed_by(state.pressures, instant, PRESSURES_KEPT),
        )
        state = self.with_pressure(self.use_waiting(state))
        if PRESSURE in state.causes:
            return self.refuse_pressure(state, reading)
        belief = state.belief
        if belief is not None and self.is_ahead_of_pressure(state, belief):
            seconds = seconds_between(instant.stamp_ns, belief.stamp_ns)
            sentence = (
                f'the last frame is {seconds:.3g} s newer than this pressure, which came late'
            )
            sentences = '; '.join([sentence, *self.ahead_notes(state)])
            refusal = refuse(reading.stamp_ns, 'too_uncertain', sentences, awaits_others=True)
            return state.count_rejected(refusal.reason), refusal
        if unknown is not None:
            return state.count_rejected(unknown.reason), unknown
        age = state.target_age(instant.stamp_ns)
        late = age is None or age > self.settings.target_timeout
        clock_notes = self.ahead_notes(state)
        mode = Mode.PREDICTION if late else Mode.FUSED
        state, outcome = self.publish(state, instant, mode, [*notes, *clock_notes])
        if isinstance(outcome, Refusal):
            state = state.count_rejected(outcome.reason)
            outcome = replace(outcome, sentence='; '.join([outcome.sentence, *clock_notes]))
        return state, outcome

    def use_waiting(self, state: FusionState) -> FusionState:
        """Use the frames that wait and whose pressure has arrived, one after the other.

        Each of them may change the delay that is known, and so whether the next one is ready; or
        the pressure is not used any more.
        """
        while state.waiting:
            state = self.weigh_pending(state)
            last_ns = state.pressures[-1].stamp_ns if state.pressures else -math.inf
            ready_ns = partial(self.ready_ns, state)
            ready = next((one for one in state.waiting if ready_ns(one) <= last_ns), None)
            if ready is None:
                break
            waiting = tuple(one for one in state.waiting if one is not ready)
            state = self.use_frame(replace(state, waiting=waiting), ready)
        return state

    def is_ahead_of_pressure(self, state: FusionState, belief: Belief) -> bool:
        """Whether no pressure reading has reached the last frame, so that it is unknown there."""
        return belief.unpressed and state.pressures[-1].stamp_ns < belief.stamp_ns

    def refuse_pressure(
        self, state: FusionState, reading: PressureReading
    ) -> tuple[FusionState, Refusal]:
        """Reject the reading of a faulty sensor."""
        refusal = drop(reading.stamp_ns, 'pressure_off', PressureCause.sentence)
        state = replace(state, readings=state.readings.with_impossible(reading.stamp_ns))
        return state.count_rejected(refusal.reason), refusal

    def ahead_notes(self, state: FusionState) -> list[str]:
        """Report that frames are stamped long before their pressure."""
        last_ns = state.pressures[-1].stamp_ns
        before_ns = state.pressures[max(len(state.pressures) - 2, 0)].stamp_ns
        shown = [self.model.shown_ns(sightings) for sightings in state.waiting]
        if state.belief is not None and state.belief.frames:
            shown.append(state.belief.stamp_ns - self.delay_ns(state))
        seconds = max((seconds_since(last_ns, ns) for ns in shown), default=0.0)
        if seconds <= MOST_AHEAD + 1.5 * seconds_between(before_ns, last_ns):
            return []
        return [
            f'the last frame of targets is stamped {seconds:.3g} s later than the pressure: '
            'are the clocks of camera and pressure sensor synchronized?'
        ]

    def instant_at(self, state: FusionState, reading: PressureReading) -> PressureInstant:
        """Return the state of the chamber that follows from a pressure reading."""
        before = state.readings
        gauge = self.sensors.pressure.gauge(reading.pressure)
        sensed = self.arm.sense(Load(pressure=gauge)).pressure
        history, chamber = before.actuate(self.arm, reading.stamp_ns, sensed)
        earlier = bisect_left(state.pressures, reading.stamp_ns, key=stamp_of)
        last = state.pressures[earlier - 1] if earlier else None  # not one stamped ahead
        step = math.inf if last is None else smallest_change(last.step, gauge - last.gauge)
        if reading.variance > 0.0:
            std = self.sensors.pressure.size * math.sqrt(reading.variance)
        else:
            rounding = self.model.pressure_rounding(step)
            std = with_rounding(self.arm.sensors.pressure_std, rounding)
        memory = () if last is None else last.memory
        elapsed = before.seconds_to(reading.stamp_ns)
        return PressureInstant(
            stamp_ns=reading.stamp_ns,
            gauge=gauge,
            chamber=chamber,
            std=std,
            history=history,
            memory=self.model.discrepancy.remember(memory, chamber, elapsed),
            step=step,
        )

    def take_targets(
        self, state: FusionState, sightings: TargetSightings
    ) -> tuple[FusionState, FusionOutcome]:
        """Process a frame, or keep it until its pressure arrives, or estimate from it alone."""
        stamp_ns, targets = sightings.stamp_ns, self.arm.target_arclength.size
        reason, sentence = state.frame_stamps.fault('frame of targets', stamp_ns)
        if len(sightings.x) != targets:
            reason = 'wrong_targets'
            sentence = f'the frame has {len(sightings.x)} targets, but the model has {targets}'
        if reason == RESTARTED:
            state = state.without_frames()
        elif reason == AHEAD:
            state = state.without_frames_after(stamp_ns, self.shown_ns(state, sightings))
        elif reason:
            refusal = drop(stamp_ns, reason, sentence)
            return state.count_unused(reason), refusal
        state = replace(state, frame_stamps=state.frame_stamps.after(stamp_ns))
        if state.pressures:
            state = self.use_waiting(state)
        if state.pressures and self.ready_ns(state, sightings) <= state.pressures[-1].stamp_ns:
            return self.use_frame(state, sightings), None
        if state.pressures:
            since_ns = state.pressures[-1].stamp_ns
        else:
            since_ns = self.model.shown_ns(state.waiting[0] if state.waiting else sightings)
        alone = state.unpressed and not state.pressures
        gap = state.frame_stamps.before_ns is not None  # the next frame shows if this one is ahead
        stale = self.is_stale(since_ns, self.model.shown_ns(sightings))
        if not alone and (not stale or (gap and not state.waiting)):
            if len(state.waiting) == MOST_WAITING:
                state = replace(state, waiting=state.waiting[1:]).count_unused('no_pressure')
            return replace(state, waiting=(*state.waiting, sightings)), None
        return self.see_alone(state, sightings)

    def see_alone(
        self, state: FusionState, sightings: TargetSightings
    ) -> tuple[FusionState, FusionOutcome]:
        """Process a frame without a pressure reading, and estimate at the stamp of the frame."""
        waiting, state = state.waiting, replace(state, waiting=())
        for earlier in (*waiting, sightings):
            state = self.use_frame(state, earlier)
        belief, shown_ns = state.belief, self.shown_ns(state, sightings)
        instant, unknown = self.instant_shown(state, shown_ns)
        if unknown is not None or belief is None or belief.stamp_ns != shown_ns:
            return state, unknown
        return self.publish(state, replace(instant, std=0.0), Mode.CAMERA_ONLY, [])

    def instant_shown(
        self, state: FusionState, shown_ns: int
    ) -> tuple[PressureInstant, Refusal | None]:
        """Return pressure and gravity when a frame was taken, or why gravity is unknown."""
        instant = self.pressure_at(state, shown_ns)
        stamped_ns = shown_ns - (0 if state.belief is None else state.belief.delay_ns)
        gravity, unknown = self.gravity.at(state.readings.gravity, stamped_ns)
        after_all = not state.pressures or shown_ns > state.pressures[-1].stamp_ns
        if after_all or instant.gravity is None:  # gravity turns without a pressure too
            turn_rate = self.gravity.turn_rate_at(state.readings.gravity, shown_ns)
            instant = replace(instant, gravity=gravity, turn_rate=turn_rate)
        return instant, unknown

    def shown_ns(self, state: FusionState, sightings: TargetSightings) -> int:
        """Return when a frame was taken, by the pressure: its stamp and the delay known so far."""
        return self.model.shown_ns(sightings) + self.delay_ns(state)

    def delay_ns(self, state: FusionState) -> int:
        """Return how much later than its stamp a frame shows the arm, as far as is known."""
        return 0 if state.belief is None else self.model.delay_ns(state.belief)

    def ready_ns(self, state: FusionState, sightings: TargetSightings) -> int:
        """Return the stamp (ns) up to which a frame needs the pressure.

        If it is certain to show the arm later than its stamp, it may also be one sigma later.
        Otherwise it does not wait.
        """
        shown_ns, belief = self.shown_ns(state, sightings), state.belief
        if belief is None or self.model.certain_delay(belief) <= 0.0:
            return shown_ns if belief is None else shown_ns - max(belief.delay_ns, 0)
        return shown_ns + round(self.model.delay_std(belief) * NANOSECONDS_PER_SECOND)

    def is_stale(self, last_ns: int, stamp_ns: int) -> bool:
        """Whether the last pressure reading is too old at a stamp."""
        return seconds_between(last_ns, stamp_ns) > self.sensors.input_timeout

    def pressure_at(self, state: FusionState, stamp_ns: int) -> PressureInstant:
        """Return the pressure at a stamp, interpolated or from the nearest reading.

        Before any reading it is the middle of the range.
        """
        known = state.pressures
        return pressure_at(known, stamp_ns) if known else self.model.unread_at(stamp_ns)

    def wrench_at(
        self, state: FusionState, stamp_ns: int, *, with_targets: bool
    ) -> NearWrench | None:
        """Return the wrench nearest to a stamp; None if none is near or the stiffness is unknown.

        If there are targets, they suffice, so the result is also None until the noise of the
        readings is known.
        """
        if self.settings.free_tip:
            zero = WrenchReading(
                stamp_ns=stamp_ns,
                force_x=0.0,
                force_y=0.0,
                moment=0.0,
                frame_id=self.sensors.frame_id,
            )
            return NearWrench(reading=zero, age=0.0, std=0.0)
        if not state.force.kept or self.model.stiffness_unknown:
            return None
        if with_targets and not self.force_noise_is_known(state):
            return None
        wrench = nearest_to(state.force.kept, stamp_ns)
        age = seconds_since(wrench.stamp_ns, stamp_ns)
        if abs(age) > self.sensors.wrench_timeout:
            return None
        return NearWrench(reading=wrench, age=age, std=self.force_std(state))

    def force_is_read_often(self, state: FusionState) -> bool:
        """Whether the force is read so often that changes between readings are noise."""
        stamps = [one.stamp_ns for one in state.force.kept[-NOISE_READINGS:]]
        period = median(np.diff(stamps).astype(np.float64)) if len(stamps) > 1 else 0.0
        return period <= self.settings.noise_period * NANOSECONDS_PER_SECOND

    def force_noise_is_known(self, state: FusionState) -> bool:
        """Whether the force noise is known, or the readings are too rare to estimate it."""
        has_enough = len(state.force.kept) >= self.settings.fewest_readings
        return has_enough or not self.force_is_read_often(state)

    def force_std(self, state: FusionState) -> float:
        """Return one sigma (N) of the force sensor: that of the model, or a larger estimate."""
        known, rounding = (self.arm.sensors.force_std, self.model.force_rounding(state.force.step))
        return with_rounding(state.force.noise or known, rounding)

    def estimate_force_noise(self, state: FusionState) -> float:
        """Return the noise (N) of the last force readings; 0 if the noise of the model is used.

        An estimate above that of the model stays in use until it is clearly smaller. Noise is not
        estimated from rare readings, because the load itself changes between them.
        """
        if not self.force_is_read_often(state):
            return 0.0
        wrenches = state.force.kept[-NOISE_READINGS:]
        noise = white_std(np.reshape([(one.force_x, one.force_y) for one in wrenches], (-1, 2)))
        most = self.settings.noise_ratio * self.arm.sensors.force_std
        return noise if noise > (0.5 * most if state.force.noise else most) else 0.0

    def with_force_noise(self, before: Belief, state: FusionState) -> tuple[Belief, FusionState]:
        """Return the predicted belief and the state with the estimated force noise.

        Estimates from frames that assumed a much smaller noise are discarded.
        """
        noise, force = self.estimate_force_noise(state), state.force
        known = max(force.largest_noise, self.arm.sensors.force_std)
        if noise > self.settings.noise_ratio * known and FORCE_SENSOR not in state.causes:
            before = reset_to_prior(self.model.of(before.causes).unknowns, before)
            state = replace(state, bank=(Hypothesis(belief=before),))
        force = replace(force, noise=noise, largest_noise=max(force.largest_noise, noise))
        return before, replace(state, force=force)

    def other_sensors(self, state: FusionState) -> dict[str, Note]:
        """Return a note per sensor that is noisier or coarser than the model states."""
        sentences = self.coarse_sensors(state)
        if state.force.noise:
            sentences['force'] = Note(
                f'the force readings have {state.force.noise:.3g} N of noise, but the model '
                f'states {self.arm.sensors.force_std:.3g} N: using the measured noise. Calibrate '
                'with this sensor',
                reason='other_noise',
            )
        return sentences

    def coarse_sensors(self, state: FusionState) -> dict[str, Note]:
        """Return a sentence per sensor whose steps are coarser than the noise of the model."""
        noise, model, sentences = self.arm.sensors, self.model, {}
        pressure_step = state.pressures[-1].step if state.pressures else math.inf
        for name, unit, step, std, rounding_of in (
            ('pressure', 'Pa', pressure_step, noise.pressure_std, model.pressure_rounding),
            ('force', 'N', state.force.step, noise.force_std, model.force_rounding),
        ):
            rounding = rounding_of(step)
            if rounding > std:
                sentences[name] = Note(
                    f'the {name} readings have steps of {step:.4g} {unit}, but the model states '
                    f'{std:.3g} {unit} of noise: using {with_rounding(std, rounding):.3g} {unit} '
                    'if a message has no variance. Calibrate with this sensor',
                    reason='coarse_steps',
                )
        return sentences

    def publish(
        self, state: FusionState, instant: PressureInstant, mode: Mode, notes: list[str]
    ) -> tuple[FusionState, FusedEstimate | Refusal]:
        """Estimate shape and force; with targets, only a wrench that a frame confirmed is used."""
        seen = mode is not Mode.PREDICTION and state.belief is not None and state.belief.frames > 0
        wrench = self.wrench_at(state, instant.stamp_ns, with_targets=seen)
        checked = state.wrench_used_ns is not None or self.model.force_sensor_is_confirmed(
            state.belief
        )
        if seen and not checked and not self.settings.free_tip:
            wrench = None
        return estimate_at(self.model, state, instant, wrench, mode, notes)

    def with_pressure(self, state: FusionState) -> FusionState:
        """Return the state after the pressure is available again."""
        if state.belief is None or not state.belief.unpressed or PRESSURE in state.causes:
            return state
        if self.is_ahead_of_pressure(state, state.belief):
            return state
        state = self.weigh_pending(state)  # if the pressure of a frame had not been read
        if PRESSURE in state.causes:
            return state
        bank = tuple(
            one
            if PRESSURE in one.belief.causes
            else replace(one, belief=self.with_pressure_read(state, one.belief))
            for one in state.bank
        )
        return replace(state, bank=bank)

    def with_pressure_read(self, state: FusionState, belief: Belief) -> Belief:
        """Update the belief of a frame without pressure, now that a reading has arrived."""
        belief = self.condition_on_pressure(state, belief)
        belief = self.model.without(belief, self.model.unknowns.at(PressureError))
        return replace(belief, chamber=self.pressure_at(state, belief.stamp_ns).chamber)

    def condition_on_pressure(self, state: FusionState, belief: Belief) -> Belief:
        """Condition the belief of a frame on its pressure, interpolated between both readings.

        The bias of the belief contains the change of the pressure since the last reading before
        the frame. An undetermined force is kept, because along a straight arm it would move to
        buckling. After an unusually long gap between readings, the pressure in between is unknown.
        """
        known = state.pressures
        after = bisect_left(known, belief.stamp_ns, key=stamp_of)
        if not 1 < after < len(known):
            return belief
        earlier, before, behind = known[after - 2 : after + 1]
        usual = before.stamp_ns - earlier.stamp_ns
        if behind.stamp_ns - before.stamp_ns > USUAL_GAP * usual:
            return belief
        instant = self.pressure_at(state, belief.stamp_ns)
        response = np.zeros((1, belief.mean.size))
        bias = self.model.unknowns.at(PressureError).start
        response[0, bias] = 1.0
        value = np.array([instant.chamber - before.chamber])
        size = self.model.size_of(belief)
        model_error_std = float(self.model.unknowns.scaled_std(size)[bias])
        std = math.hypot(instant.std, model_error_std)
        innovation = float(value[0] - belief.mean[bias]) / math.hypot(std, belief.std(bias))
        if innovation**2 > self.settings.target_gate:
            return belief
        conditioned = take_measurement(belief, response, value, np.array([std]))
        determined = (
            np.trace(self.model.force_covariance(conditioned)) <= self.model.largest_force_std**2
        )
        return conditioned if determined else belief

    def use_frame(self, state: FusionState, sightings: TargetSightings) -> FusionState:
        """Update the bank of hypotheses by a frame."""
        state = self.weigh_pending(state)
        if not sightings.seen:
            return state.count_unused('not_seen')
        shown_ns = self.shown_ns(state, sightings)
        unknowns = self.model.of(state.lasting).unknowns
        before = state.belief or first_belief(unknowns, shown_ns, state.lasting)
        if before.frames and shown_ns < before.stamp_ns:
            return state.count_unused('older')
        instant, unknown = self.instant_shown(state, shown_ns)
        if unknown is not None:
            return state.count_unused(unknown.reason)
        before, state = self.with_force_noise(before, state)
        frame = self.read_frame(state, sightings, instant)
        seen, chamber = state.seen, math.nan if frame.alone else instant.chamber
        if seen is None or not seen.is_same(sightings) or math.isnan(seen.chamber):
            seen = SeenFrame(x=sightings.x, y=sightings.y, chamber=chamber)
        elif is_copy(self.model, seen, frame):
            return state.count_unused('repeated')
        state = replace(state, seen=seen)
        updated = take(self.model, state, frame, before)
        if updated.explained:
            rest = state.bank[1:]
            weight = state.bank[0].log_weight if state.bank else 0.0
            bank = (Hypothesis(belief=self.belief_after_frame(updated), log_weight=weight), *rest)
            return self.after_frame(replace(state, bank=bank), updated, pending=updated)
        bank, updated = weigh(self.model, state, updated)
        if updated.update.belief is None:
            return self.with_nis(state, updated).count_unused(updated.update.reason, lost=1)
        return self.after_frame(self.with_updated_hypotheses(state, bank, updated), updated)

    def read_frame(
        self, state: FusionState, sightings: TargetSightings, instant: PressureInstant
    ) -> ReadFrame:
        """Return a frame with the sensor readings at the time when it was taken, an instant."""
        shown_ns = self.shown_ns(state, sightings)
        wrench = self.wrench_at(state, shown_ns, with_targets=True)
        turn = not state.counts.frames % STILL_FRAMES
        return ReadFrame(
            stamp_ns=shown_ns,
            sightings=sightings,
            instant=instant,
            alone=not state.pressures
            or state.pressures[-1].stamp_ns < self.ready_ns(state, sightings)  # none in time
            # Earlier readings are no longer kept, so the pressure of then is unknown.
            or (len(state.pressures) == PRESSURES_KEPT and shown_ns < state.pressures[0].stamp_ns)
            or self.is_stale(nearest_to(state.pressures, shown_ns).stamp_ns, shown_ns),
            pressure_still=self.is_still(state) and turn,
            wrench=wrench,
            before=state.pressures,
            pulls=() if wrench is None or self.settings.free_tip else state.force.kept,
            delay_ns=self.delay_ns(state),
        )

    def is_still(self, state: FusionState) -> bool:
        """Whether the last pressure readings are bit-identical.

        False for a coarsely quantized sensor, whose readings repeat anyway.
        """
        if 'pressure' in self.coarse_sensors(state):
            return False
        last = {instant.gauge for instant in state.pressures[-STILL_READINGS:]}
        return len(last) == 1 and len(state.pressures) >= STILL_READINGS

    def with_nis(self, state: FusionState, updated: HypothesisUpdate) -> FusionState:
        """Return the state with the running NIS after a frame."""
        update, shown_ns = updated.update, updated.frame.stamp_ns
        if not update.coordinates:
            return state
        limit = chi_square_limit(update.coordinates)
        value = update.nis / update.coordinates
        if state.nis is None:
            nis = RunningNis(stamp_ns=shown_ns, weight=1.0, last=value, mean=value, limit=limit)
        else:
            nis = state.nis.followed_by(shown_ns, value, limit, NIS_TIME)
        return replace(state, nis=nis)

    def after_frame(
        self,
        state: FusionState,
        updated: HypothesisUpdate,
        pending: HypothesisUpdate | None = None,
    ) -> FusionState:
        """Count a used frame; pending: its hypotheses still have to be compared."""
        frame, update = updated.frame, updated.update
        wrench_ns = None if frame.wrench is None else frame.wrench.reading.stamp_ns
        return replace(
            self.with_nis(state, updated).count_frame(),
            wrench_used_ns=wrench_ns,
            pending=PendingFrame(updated=pending, unchecked=update.unchecked),
            search=ColdSearch(ambiguous=update.ambiguous) if update.settled else state.search,
        )

    def belief_after_frame(self, updated: HypothesisUpdate) -> Belief:
        """Return the belief after a frame, with the estimated force walk and moved targets."""
        update, unknowns = updated.update, self.model.unknowns
        if self.model.of(updated.after.causes).swinging is None:
            kept = kept_force_errors(self.model, updated)
            belief = with_walk(unknowns, updated.before, updated.after, kept)
        else:
            belief = replace(updated.after, walk=estimate_walk(updated))
        known = unknowns.block(Placement).known is not None and TARGETS not in belief.causes
        if known and update.left_out and update.fit:
            outliers = np.flatnonzero(updated.problem.used & ~update.fit[0].used)
            belief = with_outlier_targets(unknowns, self.settings, belief, outliers)
        return belief

    def with_updated_hypotheses(
        self, state: FusionState, bank: tuple[Hypothesis[Belief], ...], best: HypothesisUpdate
    ) -> FusionState:
        """Return the state with the hypotheses updated by a frame, the best one first."""
        first = replace(bank[0], belief=self.belief_after_frame(best))
        return state.with_bank((first, *bank[1:]))

    def weigh_pending(self, state: FusionState) -> FusionState:
        """Compare all hypotheses for the last frame, then search for another tip force.

        If another force fits the frame better, the force is ambiguous, and the next frame gets a
        full search.
        """
        pending = state.pending
        if pending is None:
            return state
        unchecked = pending.unchecked
        state = replace(state, pending=None)
        if pending.updated is not None:
            bank, updated = weigh(self.model, state, pending.updated)
            if updated is not pending.updated:
                unchecked = updated.update.unchecked
            state = self.with_updated_hypotheses(state, bank, updated)
        if unchecked is not None:
            state = replace(state, search=state.search.looked(unchecked))
        return state.compressed()
