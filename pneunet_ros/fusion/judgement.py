"""What a frame says: of the arm, of a contact, and of who is wrong where nothing explains it.

A frame is taken by what was believed, and then weighed against all else that it may be: a contact
along the arm (`contact`), targets painted elsewhere, a camera that was moved or turned, a force
sensor that is off (`force_sensor`), a pressure that is not what is read. Where one of them is
surely right, what had been learned without it is forgotten. If noise explains a frame as it was
taken, the comparison can wait until the estimate is out.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import (
    Belief,
    first_belief,
    told_by_frames,
    with_moved_camera,
    with_other_targets,
    without_lessons,
)
from pneunet_ros.fusion.bench import Bench
from pneunet_ros.fusion.contact import (
    evidence_cost,
    gain_without,
    weigh_hypotheses,
    WeighedFrame,
)
from pneunet_ros.fusion.force_sensor import doubt_after, sensor_score, Verdict, verdict_on
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.frame_update import excess, FrameUpdate, misfits, take_frame
from pneunet_ros.fusion.readings import ReadFrame, SeenFrame
from pneunet_ros.fusion.state import FusionState, TakenFrame
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.inference.gaussian import widen
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth


def is_copy(bench: Bench, seen: SeenFrame, frame: ReadFrame) -> bool:
    """Whether a frame, the same as one before to the last bit, should have been another."""
    pressed = abs(frame.instant.chamber - seen.chamber)
    return not frame.alone and pressed > bench.settings.frozen * frame.instant.std


def take(bench: Bench, state: FusionState, frame: ReadFrame, before: Belief) -> TakenFrame:
    """Return what a frame says by the hypothesis that led, to what was believed before it."""
    problem = problem_of(bench, frame, before)
    update = take_frame(
        problem,
        cold=frame.force_lost or not before.frames,
        found_better=state.search.found_better,
        force_read=frame.wrench is not None,
    )
    return TakenFrame(frame=frame, before=before, problem=problem, update=update)


def explains_all(taken: TakenFrame) -> bool:
    """Whether noise explains every target of a frame that was taken, so that doubts can wait."""
    fit = taken.update.fit
    return (
        taken.update.belief is not None
        and fit is not None
        and not taken.update.left_out
        and excess(fit) <= 1.0
    )


def weigh_and_judge(
    bench: Bench, state: FusionState, taken: TakenFrame
) -> tuple[FusionState, TakenFrame]:
    """Return what a frame says, once it has said whether camera and sensors are right.

    Beside it the state: without what a sensor that is not right has told so far.
    """
    state = replace(state, otherwise=None)
    frame, before = taken.frame, taken.before
    weighed = weigh_others(bench, state, taken)
    if state.sensor is not Verdict.OFF and shows_turn(bench, weighed.update.belief):
        before = without_lessons(bench.unknowns, before)
        before = with_moved_camera(bench.unknowns, before)
        state = replace(state.without_belief(), sensor=Verdict.OPEN)
        taken = take(bench, state, frame, before)
        weighed = weigh(bench, state, taken)
    after = state
    if frame.wrench is not None and not bench.settings.free_tip:
        after = judge_sensor(bench, state, frame, weighed)
    sensor_off = after.sensor is Verdict.OFF and frame.wrench is not None
    if sensor_off or doubts_pressure(bench, taken, weighed):
        unpressed = take_unpressed(bench, state, taken, weighed)
        if unpressed is not None:
            after, taken = state.without_pressure(), unpressed
            weighed = weigh(bench, after, taken)
        elif sensor_off:
            after = replace(state.without_belief(), sensor=Verdict.OFF)
            before = first_belief(bench.unknowns, frame.stamp_ns)
            taken = take(bench, after, frame.without_wrench(), before)
            weighed = weigh_others(bench, after, taken)
    after = replace(
        after, rival=weighed.rival, log_odds=weighed.log_odds, elsewhere=weighed.elsewhere
    )
    return after, replace(taken, update=weighed.update)


def doubts_pressure(bench: Bench, taken: TakenFrame, weighed: WeighedFrame) -> bool:
    """Whether a frame asks if the pressure is what is read.

    One whose pressure may hang; one that fits badly, or only with a contact, where no sensor tells
    the tip force; one with which the model seems to lack very much. Never one between readings
    that do not tell how the pressure went.
    """
    fit, belief = weighed.update.fit, weighed.update.belief
    if fit is None or taken.frame.force_lost:
        return False
    if taken.frame.instant.missed > bench.arm.sensors.pressure_std:
        return False
    touches = belief is not None and belief.touched and not taken.before.touched
    if taken.frame.pressure_still:
        return True
    if taken.frame.wrench is None and (misfits(fit) or touches):
        return True
    if belief is None:
        return False
    return bench.size_of(belief) > bench.settings.most_lacking


def take_unpressed(
    bench: Bench, state: FusionState, taken: TakenFrame, weighed: WeighedFrame
) -> TakenFrame | None:
    """Return a frame taken without its pressure, if that surely is not what is read.

    It fits better than the frame as it is, and than without the force sensor, by somebody to whom
    no frame has told anything, and better than with a contact. None where not, or where the error
    of the model is not known.
    """
    frame, settings = taken.frame, bench.settings
    if frame.alone or not bench.tells_camera:
        return None
    anew = replace(state.without_belief(), sensor=Verdict.OPEN)
    before = without_lessons(bench.unknowns, weighed.update.belief or taken.before)
    instant = bench.unread(frame.stamp_ns)
    unpressed = take(bench, anew, frame.without_pressure(instant), before)
    others = [take(bench, anew, frame, before)]
    if math.isinf(frame.instant.step):  # it may be coarse, and not off
        coarse = frame.with_pressure_std(bench.coarsest_pressure)
        others.append(take(bench, anew, coarse, before))
    if frame.wrench is not None and not settings.free_tip:
        others.append(take(bench, anew, frame.without_wrench(), before))
    least, fit = min(map(evidence_cost_of, others)), weighed.update.fit
    if fit is not None and (fit[0].prior.touched or misfits(fit)):
        least = min(least, evidence_cost(fit, frame.sightings.seen))
    return unpressed if evidence_cost_of(unpressed) < least - 2.0 * settings.pressure_off else None


def evidence_cost_of(taken: TakenFrame) -> float:
    """Return minus twice the log of the evidence of a frame; infinite where nothing fits."""
    fit = taken.update.fit
    return math.inf if fit is None else evidence_cost(fit, taken.frame.sightings.seen)


def shows_turn(bench: Bench, belief: Belief | None) -> bool:
    """Whether frames have surely said that the camera was turned, rather than the sensor off.

    Too little to leave a misfit: a tip force moves the arm much like that.
    """
    if belief is None or belief.camera_moved or not bench.tells_camera:
        return False
    if np.trace(bench.force_covariance(belief)) > bench.largest_force_std**2:
        return False  # what holds a force that is not determined tells of the rest as well
    turn, std = told_by_frames(
        bench.unknowns, belief, bench.unknowns.at(Camera, Camera.TURN).start
    )
    limit = bench.settings.turn_tolerance
    if std >= limit or abs(turn) <= max(limit, bench.settings.sure * std):
        return False
    return abs(turn) > std * sensor_score(bench.unknowns, belief)


def judge_sensor(
    bench: Bench, state: FusionState, frame: ReadFrame, weighed: WeighedFrame
) -> FusionState:
    """Return the state with the verdict on a force sensor that is used, after a frame.

    A contact confirms nothing. What fits better without sensor and contact is summed up, by
    how much; of a sensor that was never confirmed one frame is enough which nothing explains.
    """
    update, known = weighed.update, state.sensor
    verdict, without = known, None
    if update.belief is None:
        _, gain = bench.settings.sensor_gain
        if not fits_without(bench, state, frame, update):
            gain = 0.0
        elif known is Verdict.OPEN:
            verdict = Verdict.OFF
    else:
        said = verdict_on(bench.unknowns, bench.settings, update.belief)
        if said is Verdict.OFF or (said is Verdict.IN_ORDER and not update.belief.touched):
            verdict = said
        without = without_sensor(bench, state, frame, update)
        gain = gain_without(without, update, frame.sightings.seen)
    doubt = doubt_after(bench.settings, state.doubt, gain)
    if doubt >= bench.settings.sensor_doubt:
        verdict = Verdict.OFF
    otherwise = None if without is None or known is not Verdict.OPEN else without.belief
    return replace(state, sensor=verdict, doubt=doubt, otherwise=otherwise)


def without_sensor(
    bench: Bench, state: FusionState, frame: ReadFrame, update: FrameUpdate
) -> FrameUpdate | None:
    """Return what became of a frame with a contact if the sensor is off and nothing touches.

    None without a contact, and where it explains the frame and the sensor is confirmed.
    """
    belief, fit = update.belief, update.fit
    if belief is None or fit is None or not belief.touched:
        return None
    if state.sensor is Verdict.IN_ORDER and excess(fit) < bench.settings.sensor_misfit:
        return None
    before = without_lessons(bench.unknowns, belief)
    problem = problem_of(bench, frame.without_wrench(), before)
    return take_frame(problem, cold=False, found_better=False, force_read=False)


def fits_without(bench: Bench, state: FusionState, frame: ReadFrame, update: FrameUpdate) -> bool:
    """Whether a frame that was not used is explained if the sensor is off, and only then."""
    if frame.force_lost or update.reason not in ('inconsistent', 'no_equilibrium'):
        return False
    anew = state.without_belief()
    return explains(bench, anew, frame.without_wrench()) and not explains(bench, anew, frame)


def explains(bench: Bench, state: FusionState, frame: ReadFrame) -> bool:
    """Whether noise explains a frame to which nothing is known."""
    before = first_belief(bench.unknowns, frame.stamp_ns)
    fit = weigh(bench, state, take(bench, state, frame, before)).update.fit
    return fit is not None and excess(fit) <= 1.0


def confirmed(bench: Bench, state: FusionState) -> bool:
    """Whether a wrench surely tells the tip force: of a confirmed sensor, or nothing pulls."""
    return bench.settings.free_tip or state.sensor is Verdict.IN_ORDER


def weigh_others(bench: Bench, state: FusionState, taken: TakenFrame) -> WeighedFrame:
    """Return what a frame says, also if other targets are painted, or the camera was moved."""
    weighed, before = weigh(bench, state, taken), taken.before
    fit, belief = weighed.update.fit, weighed.update.belief
    if fit is None or taken.frame.force_lost:  # it was tried with the frames before
        return weighed
    settings, misfit = bench.settings, misfits(fit)
    if misfit and before.same_targets:
        other = with_other_targets(bench.unknowns, before)
        weighed = better_with(bench, state, taken.frame, other, weighed, settings.other_targets)
    touches = belief is not None and belief.touched and not before.touched
    if bench.tells_camera and (misfit or touches):
        other = with_moved_camera(bench.unknowns, before)
        weighed = better_with(bench, state, taken.frame, other, weighed, settings.camera_moved)
    return weighed


def weigh(bench: Bench, state: FusionState, taken: TakenFrame) -> WeighedFrame:
    """Return what a frame says, of a contact and of none."""
    frame = taken.frame
    rival = None if state.rival is None else problem_of(bench, frame, state.rival)
    odds = -bench.settings.contact_bound if state.log_odds is None else state.log_odds
    return weigh_hypotheses(
        taken.update,
        taken.problem,
        rival,
        odds,
        elsewhere=state.elsewhere,
        force_read=frame.wrench is not None and confirmed(bench, state),
    )


def better_with(
    bench: Bench,
    state: FusionState,
    frame: ReadFrame,
    other: Belief,
    weighed: WeighedFrame,
    log_odds: float,
) -> WeighedFrame:
    """Return what a frame says to another belief, if it surely says that this one is right.

    log_odds: against it, before the frame.
    """
    again = weigh(
        bench,
        replace(state, rival=None, log_odds=None),
        take(bench, state, frame, other),
    )
    seen = frame.sightings.seen
    if weighed.update.fit is None or again.update.fit is None:
        return weighed
    gain = evidence_cost(weighed.update.fit, seen) - evidence_cost(again.update.fit, seen)
    return again if gain > 2.0 * log_odds else weighed


def problem_of(bench: Bench, frame: ReadFrame, belief: Belief) -> FrameProblem:
    """Return a frame beside what was believed before it.

    From frame to frame the force is free: a frame must not inherit what the last one erred.
    But it is not drawn to zero either, frame after frame, which the unknowns that stay would
    take for evidence.
    """
    instant = replace(frame.instant, std=0.0) if frame.alone else frame.instant
    inputs = bench.inputs_at(instant, frame.wrench)
    pressed = abs(frame.instant.chamber - belief.chamber)
    pressed = 0.0 if frame.alone or not math.isfinite(pressed) else pressed
    unknowns, size = bench.unknowns, bench.size_of(belief)
    prior = bench.move(
        belief,
        frame.stamp_ns,
        pressed,
        noise=(inputs.moment_std, inputs.chamber_std),
        size=size,
        walk=unknowns.block(TipForce).free_walk,
    )
    growth = None
    if frame.alone:
        pressure = unknowns.block(PressureError)
        std = np.array([pressure.unread * pressure.range])
        prior = widen(prior, unknowns.at(PressureError), std)
    else:
        seconds = seconds_between(belief.stamp_ns, frame.stamp_ns) if belief.frames else math.inf
        growth = ErrorGrowth(size=size, grown=unknowns.growth(seconds, pressed), seconds=seconds)
        if frame.pressure_lost:
            prior = bench.without(prior, unknowns.at(PressureError))
    if frame.force_lost:
        prior = bench.without(prior, unknowns.at(TipForce))
    if frame.wrench is not None:
        prior = bench.with_wrench(prior, frame.wrench, frame.instant.gauge)
    sightings = frame.sightings
    return FrameProblem(
        table=bench.table,
        unknowns=bench.unknowns,
        settings=bench.settings,
        prior=prior,
        growth=growth,
        inputs=inputs,
        sightings=sightings,
        used=np.isfinite(sightings.x) & np.isfinite(sightings.y),
    )
