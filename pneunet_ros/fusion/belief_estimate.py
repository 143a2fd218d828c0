"""Estimate from the belief propagated to the stamp of a pressure reading, with all errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.frames import rotate
from pneunet_ros.core.outcome import Refusal, refuse
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_since
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.estimate import estimate_of, ShapeEstimate
from pneunet_ros.estimation.out_of_plane import out_of_plane
from pneunet_ros.fusion.belief import (
    Belief,
    first_belief,
    FORCE_SENSOR,
    FRAME_TIMES,
    MOTION,
    PRESSURE,
)
from pneunet_ros.fusion.bent_arm import bend_arm, BentArm, causes_with_contact
from pneunet_ros.fusion.causes import CAMERA, CAUSES
from pneunet_ros.fusion.contact import Contact, CONTACT_APART
from pneunet_ros.fusion.estimate import ForceSensorFault, FusedEstimate, Mode
from pneunet_ros.fusion.frame_update import FRAME_GATE
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import load_read, NearWrench, path_of, PressureInstant
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.fusion.swinging import propagate_swing, swinging_estimate, SwingingEstimate
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.errors.extrapolation_error import with_extrapolation_error
from pneunet_ros.measurement.errors.noise_model import target_std
from pneunet_ros.measurement.errors.propagated_errors import (
    PlaceChanges,
    propagate_errors,
    SeenShape,
)
from pneunet_ros.measurement.inference.bank import Hypothesis, odds_relative_to_first
from pneunet_ros.measurement.inference.gaussian import compress, widen
from pneunet_ros.measurement.swinging_arm import EquilibriumBetween
from pneunet_ros.model.domain_position import DomainPosition, locate_load
from pneunet_ros.model.equilibrium import jacobian_of, Sensitivity
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.solution import SolverNodes

STIFFNESS_UNKNOWN = (
    'forces are neither used nor estimated, because no load has measured the stiffness of the '
    'model: calibrate with loads'
)
SETUP_PROBLEMS = (
    *(one.sentence for one in CAUSES if one.sentence),
    STIFFNESS_UNKNOWN,
)  # problems that the user can fix


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BelievedArm:
    """The arm at the stamp of a reading, according to the belief.

    belief: propagated to the stamp; unseen (unknowns, errors): changes since the last frame;
    inputs: the readings; causes: derivatives by the unknowns; bent: the rod; position: that of the
    load relative to the domain of the model. swinging: the swing about this rod, None if the model
    has no `motion`.
    """

    belief: Belief
    unseen: Array
    inputs: FrameInputs
    causes: Array
    bent: BentArm
    position: DomainPosition
    swinging: SwingingEstimate | None


def unknown_swing(state: FusionState, belief: Belief, mode: Mode) -> str:
    """Return a sentence if the swing of the arm is unknown, or else ''.

    A swing that the newest frame contradicts is not propagated; for an arm at rest, a single wrong
    frame does no harm.
    """
    if belief.reference is None:
        return ''
    if belief.reference.lost:
        return 'the motion of the arm is unknown: its equilibrium is far from the measured targets'
    if state.counts.contradicted and mode is not Mode.PREDICTION:
        return 'the motion of the arm is unknown: no hypothesis explains the last frame'
    return ''


def estimate_at(
    model: PreparedModel,
    state: FusionState,
    instant: PressureInstant,
    read: NearWrench | None,
    mode: Mode,
    notes: list[str],
) -> tuple[FusionState, FusedEstimate | Refusal]:
    """Estimate shape and force at a pressure, from the belief propagated to its stamp.

    read: the wrench nearest to that stamp, used unless the sensor is faulty; notes: further notes.
    """
    stamp_ns = instant.stamp_ns
    used = None if FORCE_SENSOR in state.causes else read
    if used is not None:
        off_plane = out_of_plane(model.arm, model.sensors, used.reading)
        if off_plane.stops:
            return state.answered(), refuse(stamp_ns, 'out_of_plane', off_plane.sentence)
        notes = [*notes, *([off_plane.note] if off_plane.warns else [])]
    start = state.solution if mode is Mode.PREDICTION else None
    every, model = model, model.of(state.causes)
    arm = arm_at(model, state, instant, used, start)
    if not arm.bent.shape.converged:
        return replace(state.answered(), solution=None), refuse(
            stamp_ns, 'no_equilibrium', arm.bent.shape.status
        )
    swings = unknown_swing(state, arm.belief, mode)
    if swings:
        return state.answered(), refuse(stamp_ns, 'too_uncertain', swings, awaits_others=True)
    if arm.position.reason:
        refusal = refuse(stamp_ns, arm.position.reason, arm.position.sentence)
        return state.answered(), refusal
    notes = [*notes, *setup_problems(model, state)]
    wrench_age = None if used is None else used.age
    age = state.target_age(stamp_ns)
    estimate = shape_estimate(model, arm, stamp_ns, mode, wrench_age, age, notes)
    if isinstance(estimate, Refusal):
        return state.answered(), estimate
    for odds, other in likely_alternatives(every, state, arm, instant):
        estimate = holding(estimate, other, odds)
    determinable = mode is not Mode.PREDICTION and not model.stiffness_unknown
    contact = contact_at(model, state, arm, used) if determinable else None
    ambiguous = state.search.ambiguous or (contact is not None and contact.ambiguous)
    # The force on a swinging arm follows from its acceleration, and that from the times of frames.
    timeless = used is None and arm.belief.causes >= {FRAME_TIMES, MOTION}
    unknown = ambiguous or timeless or model.stiffness_unknown
    fault = None
    if FORCE_SENSOR in state.certain_causes:
        fault = sensor_fault(model, arm.belief, instant, read, unknown=unknown)
    force, covariance = known_force(model, state, arm, fault, unknown=unknown)
    as_pressure = model.unknowns.as_pressure(arm.inputs)
    pressure_root = as_pressure @ arm.belief.root
    fused = FusedEstimate(
        estimate=estimate,
        mode=mode,
        force=force,
        force_covariance=covariance,
        contact=contact,
        pressure_bias=float(as_pressure @ arm.belief.mean),
        pressure_bias_std=math.sqrt(pressure_root @ pressure_root),
        force_sensor=fault,
        ambiguous=ambiguous,
        nis=math.nan if state.nis is None else state.nis.mean,
        nis_limit=math.nan if state.nis is None else state.nis.limit,
        target_age=age,
    )
    return replace(state.answered().count_estimate(), solution=arm.bent.solution), fused


def arm_at(
    model: PreparedModel,
    state: FusionState,
    instant: PressureInstant,
    wrench: NearWrench | None,
    start: SolverNodes | None,
) -> BelievedArm:
    """Return the arm at a reading, according to the belief.

    start: initial shape of the rod; None: that at the last frame.
    """
    stamp_ns = instant.stamp_ns
    belief = state.belief or first_belief(model.unknowns, stamp_ns, state.lasting)
    inputs = model.inputs_at(instant, wrench)
    unseen = np.zeros((belief.mean.size, 0))
    before, motion = belief, None
    causes = model.unknowns.causes_at(inputs)
    start = start or belief.solution
    if belief.stamp_ns != stamp_ns or not belief.frames:
        pressure_change = abs(instant.chamber - belief.chamber)
        pressure_change = pressure_change if math.isfinite(pressure_change) else 0.0
        columns = belief.root.shape[1]
        noise = (inputs.moment_std, inputs.chamber_std)
        walk = None if model.swinging is None else belief.walk.largest
        delay = model.certain_delay(belief)
        late_ns = stamp_ns + round(max(delay, 0.0) * NANOSECONDS_PER_SECOND)
        belief = model.move(belief, late_ns, pressure_change, noise, model.size_of(belief), walk)
        belief = replace(belief, stamp_ns=stamp_ns)
        belief = with_earlier_pressures(model, state.pressures, belief, abs(delay))
        unseen = belief.root[:, columns:].copy()
        unseen[model.unknowns.white] = 0.0
    if wrench is not None and wrench.reading.stamp_ns != state.wrench_used_ns:
        belief = model.with_wrench(belief, wrench, instant.gauge)
    bent = bent_at(model, belief, inputs, causes, start)
    if stamp_ns != before.stamp_ns:
        path: list[EquilibriumBetween] = []
        if model.swinging is not None:
            pulls = model.pulled(() if wrench is None else state.force.kept, instant.gauge)
            path = path_of(state.pressures, pulls, before.stamp_ns, before.chamber, instant)
        all_causes = None
        if model.swinging and bent.shape.converged and not model.force_is_known(belief):
            all_causes = causes_with_contact(model.unknowns, causes, bent.contact)
        belief, motion = propagate_swing(
            model.swinging, before, belief, bent, path, all_causes, instant.turn_rate
        )
    ratio = 1.0 if state.nis is None else state.nis.birge_ratio(FRAME_GATE)
    if ratio > 1.0:  # no hypothesis explains the last frames
        belief, unseen = replace(belief, root=freeze(ratio * belief.root)), ratio * unseen
    return BelievedArm(
        belief=belief,
        unseen=unseen,
        inputs=inputs,
        causes=causes,
        bent=bent,
        position=position_of(model, belief, bent, inputs),
        swinging=swinging_estimate(model.swinging, belief, bent, motion),
    )


def with_earlier_pressures(
    model: PreparedModel, known: tuple[PressureInstant, ...], belief: Belief, seconds: float
) -> Belief:
    """Return the belief if the pressure of the last seconds may still act on the arm.

    That camera and pressure are not of the same time does not tell which of them is wrong.
    """
    if seconds <= 0.0:
        return belief
    acting = [
        one.chamber for one in known if seconds_since(one.stamp_ns, belief.stamp_ns) <= seconds
    ]
    spread = np.array([max(acting) - min(acting)]) if acting else np.zeros(1)
    return widen(belief, model.unknowns.at(PressureError), spread)


def bent_at(
    model: PreparedModel,
    belief: Belief,
    inputs: FrameInputs,
    causes: Array,
    start: SolverNodes | None,
) -> BentArm:
    """Solve the rod at the mean of the belief; causes: derivatives by the unknowns."""
    return bend_arm(
        model.table,
        inputs,
        causes @ belief.mean,
        start,
        model.arclength,
        quick=False,
        contact=model.held_contact(belief),
    )


def likely_alternatives(
    model: PreparedModel, state: FusionState, arm: BelievedArm, instant: PressureInstant
) -> list[tuple[float, Shape]]:
    """Return the alternative shapes, with their odds against the best shape."""
    found = []
    for odds, other in zip(odds_relative_to_first(state.bank), state.bank[1:], strict=True):
        shape = other_shape(model, other.belief, instant)
        found += [] if shape is None else [(odds, shape)]
    if CAMERA in arm.belief.causes:  # a model error may look like that
        found.append((1.0, shape_in_place(model, arm.bent.shape, arm.belief)))
    return found


def setup_problems(model: PreparedModel, state: FusionState) -> list[str]:
    """Return sentences about problems of the setup that the user can fix."""
    causes = state.certain_causes
    sentences = [one.sentence for one in CAUSES if one.name in causes]
    return [*sentences, STIFFNESS_UNKNOWN] if model.stiffness_unknown else sentences


def contact_at(
    model: PreparedModel, state: FusionState, arm: BelievedArm, wrench: NearWrench | None
) -> Contact | None:
    """Return the likely contact; None if there is none.

    The contact is ambiguous if another hypothesis is about as likely, or if no sensor measures the
    tip force: both loads bend the arm in similar ways.
    """
    belief, bent = arm.belief, arm.bent
    if bent.contact is None or not state.bank:
        return None
    force, place = bent.contact.force, bent.contact.place
    if abs(force) < model.settings.contact_least * model.force_scale:
        return None
    push = model.unknowns.at(Push)
    shape = bent.shape
    free = [one.log_weight for one in state.bank if not one.belief.touched]
    force_unmeasured = wrench is None and not model.settings.free_tip
    return Contact(
        x=float(np.interp(place, shape.arclength, shape.x)),
        y=float(np.interp(place, shape.arclength, shape.y)),
        arclength=place,
        std_arclength=belief.std(push.stop - 1),
        force=force,
        std_force=belief.std(push.start),
        log_odds=state.bank[0].log_weight - max(free, default=-model.settings.bound),
        ambiguous=force_unmeasured or not all(is_there(model, place, one) for one in state.bank),
    )


def is_there(model: PreparedModel, place: float, other: Hypothesis[Belief]) -> bool:
    """Whether a hypothesis, if it is likely, also has a contact near a place (m)."""
    belief = other.belief
    distance = abs(float(belief.mean[model.unknowns.at(Push).stop - 1]) - place)
    at_place = distance <= CONTACT_APART * model.arm.length
    return not other.is_about_as_likely or (belief.touched and at_place)


def position_of(
    model: PreparedModel, belief: Belief, bent: BentArm, inputs: FrameInputs
) -> DomainPosition:
    """Return where the estimated load lies relative to the domain of the model."""
    shape = bent.shape
    load = Load(
        pressure=shape.pressure,
        force_x=shape.force[0],
        force_y=shape.force[1],
        moment=shape.end_moment,
    )
    force_x, force_y = np.sqrt(np.diagonal(model.force_covariance(belief))).tolist()
    std = (force_x, force_y, inputs.moment_std, inputs.chamber_std)
    return locate_load(model.arm, load, shape.pressure, std)


def shape_estimate(
    model: PreparedModel,
    arm: BelievedArm,
    stamp_ns: int,
    mode: Mode,
    wrench_age: float | None,
    target_age: float | None,
    notes: list[str],
) -> ShapeEstimate | Refusal:
    """Return the shape with its errors from the belief, to second order.

    wrench_age, target_age (s): age of the last wrench and of the last frame that were used.
    """
    bent, position = arm.bent, arm.position
    sensitivity = bent.linearize()
    causes = causes_with_contact(model.unknowns, arm.causes, bent.contact)
    noise = compress(causes @ arm.belief.root).T.copy()
    if mode is Mode.PREDICTION:
        widened = with_extrapolation_error(noise, position)
        errors = propagate_errors(sensitivity, widened, model.arclength)
    else:
        seen = seen_shape(model, causes @ arm.unseen, sensitivity)
        errors = propagate_errors(sensitivity, noise, model.arclength, seen)
    shape, motion = bent.shape, None
    if arm.swinging is not None and errors is not None:
        shape = arm.swinging.swing_deviation.shape(shape)
        errors = arm.swinging.errors(causes, sensitivity, errors)
        motion = arm.swinging.motion(errors)
    largest, within_limit = math.inf, mode is not Mode.PREDICTION
    if errors is not None and not within_limit:
        largest = math.sqrt(np.linalg.eigvalsh(errors.tip_covariance[:2, :2])[-1])
        within_limit = largest <= model.settings.largest_tip_std
    if errors is None or not within_limit:
        known, reason = f'{1e3 * largest:.3g} mm', ''
        if largest > model.arm.length:
            known = 'more than the length of the arm'
        if mode is Mode.PREDICTION:
            reason = ': no frame of targets has been used yet'
            if target_age is not None:
                reason = (
                    f': the last frame used is {target_age:.3g} s away from the pressure, '
                    f'more than target_timeout = {model.settings.target_timeout:.3g} s'
                )
        return refuse(
            stamp_ns,
            'too_uncertain',
            f'the tip uncertainty is {known}, but largest_tip_std allows only '
            f'{1000.0 * model.settings.largest_tip_std:.3g} mm{reason}',
            awaits_others=True,
        )
    return estimate_of(
        stamp_ns=stamp_ns,
        shape=shape,
        motion=motion,
        chamber_pressure=bent.shape.pressure,
        jacobian=jacobian_of(model.arm, sensitivity, arm.inputs.history or ()),
        noise=freeze(noise),
        errors=errors,
        position=position,
        wrench_age=wrench_age,
        notes=notes,
        gravity=arm.inputs.gravity,
    )


def other_shape(model: PreparedModel, other: Belief, instant: PressureInstant) -> Shape | None:
    """Return the shape for another belief at a pressure; None if there is none."""
    model = model.of(other.causes)
    if PRESSURE in other.causes:
        instant = model.unread(instant)
    inputs = model.inputs_at(instant, None)
    causes = model.unknowns.causes_at(inputs)
    bent = bent_at(model, other, inputs, causes, other.solution)
    if not bent.shape.converged:
        return None
    restamped = replace(other, stamp_ns=instant.stamp_ns)
    propagated, _ = propagate_swing(
        model.swinging, other, restamped, bent, turn_rate=instant.turn_rate
    )
    estimate = swinging_estimate(model.swinging, propagated, bent, None)
    return bent.shape if estimate is None else estimate.swing_deviation.shape(bent.shape)


def shape_in_place(model: PreparedModel, shape: Shape, belief: Belief) -> Shape:
    """Return the shape that follows if the camera, which seems to have moved, has not moved."""
    moved = belief.mean[model.unknowns.at(Camera)] - model.unknowns.block(Camera).prior.mean
    x, y, turn = moved[Camera.PLACE.start :].tolist()
    there = np.array([x, y])
    x, y = np.stack(rotate(turn, shape.x, shape.y)) + there[:, None]
    return replace(shape, x=freeze(x), y=freeze(y), theta=freeze(shape.theta + turn))


def holding(estimate: ShapeEstimate, other: Shape, odds: float) -> ShapeEstimate:
    """Return an estimate whose errors include another possible shape, weighted by its odds.

    The covariance is the second moment of the mixture about the published shape.
    """
    shape, root = estimate.shape, math.sqrt(odds)
    tip = root * (np.array(other.tip) - np.array(shape.tip))
    curvature = root * (other.curvature - shape.curvature)
    return replace(
        estimate,
        tip_covariance=freeze(estimate.tip_covariance + np.outer(tip, tip)),
        std_x=freeze(np.hypot(estimate.std_x, root * (other.x - shape.x))),
        std_y=freeze(np.hypot(estimate.std_y, root * (other.y - shape.y))),
        std_curvature=freeze(np.hypot(estimate.std_curvature, curvature)),
    )


def seen_shape(model: PreparedModel, unseen: Array, sensitivity: Sensitivity) -> SeenShape:
    """Return the arclengths at which the camera saw the shape, and their present accuracy.

    unseen (causes, errors): changes since then.
    """
    noise = model.arm.sensors
    variance = target_std(noise) ** 2 + noise.registration_std**2 + noise.drift_std**2
    changes = sensitivity.stations(model.places)
    by_cause = changes[:, :2].take(model.of_targets, axis=2).reshape(len(unseen), -1)
    moved = ((unseen.T @ by_cause) ** 2).sum(axis=0).reshape(2, -1)
    return SeenShape(
        at=PlaceChanges(arclength=model.places, changes=changes),
        stations=model.of_stations,
        seen=model.of_targets,
        std=np.sqrt(variance + moved),
    )


def sensor_fault(
    model: PreparedModel,
    belief: Belief,
    instant: PressureInstant,
    read: NearWrench | None,
    *,
    unknown: bool,
) -> ForceSensorFault:
    """Return the reading of a rejected force sensor and the estimate without it."""
    reading = np.full(2, np.nan)
    if read is not None:
        true = model.arm.sense(load_read(read.reading, instant.gauge))
        reading = np.array([true.force_x, true.force_y])
    std = np.sqrt(np.diagonal(model.force_covariance(belief)))
    undetermined = np.full(2, unknown) | (std > model.largest_force_std)
    return ForceSensorFault(
        reading=freeze(reading),
        targets=freeze(np.where(undetermined, np.nan, belief.mean[model.unknowns.at(TipForce)])),
        targets_std=freeze(np.where(undetermined, np.nan, std)),
    )


def known_force(
    model: PreparedModel,
    state: FusionState,
    arm: BelievedArm,
    fault: ForceSensorFault | None,
    *,
    unknown: bool,
) -> tuple[Array, Array]:
    """Return force (2,) N and covariance (2, 2) N^2, NaN where the force is not determined.

    The covariance includes the other hypotheses. If one component alone is determined, it covers
    every likely value of the other: along a straight arm, frames in which the force is held learn
    its variance, but leave its mean. fault: that of a force sensor that is not used.
    Because the sensor may be right and the model wrong, the covariance includes both while there
    are readings.
    """
    tip = model.unknowns.at(TipForce)
    force = arm.belief.mean[tip]
    covariance = model.force_covariance(arm.belief)
    for axis, error in enumerate(arm.position.error[:2]):
        covariance[axis, axis] += error**2
    for odds, other in zip(odds_relative_to_first(state.bank), state.bank[1:], strict=True):
        difference = other.belief.mean[tip] - state.bank[0].belief.mean[tip]
        covariance += odds * np.outer(difference, difference)
    if fault is not None and np.isfinite(fault.reading).all():
        difference = fault.reading - force
        covariance += np.outer(difference, difference)
    determined = np.sqrt(np.diagonal(covariance)) <= model.largest_force_std
    if unknown:
        determined = np.zeros(2, dtype=bool)
    if determined.all():
        return freeze(force.copy()), freeze(covariance)
    if determined.any():
        which, free = (0, 1) if determined[0] else (1, 0)
        variance = float(covariance[free, free])
        slope = float(covariance[which, free]) / variance
        covariance[which, which] += slope**2 * max(model.force_scale**2 - variance, 0.0)
        determined[which] = covariance[which, which] <= model.largest_force_std**2
    force = np.where(determined, force, np.nan)
    both = determined[:, None] & determined[None, :]
    return freeze(force), freeze(np.where(both, covariance, np.nan))
