"""Update of one hypothesis by one frame of targets: the problem, its fit, and its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import Belief, FRAME_TIMES, MOTION, TakenFrame
from pneunet_ros.fusion.bent_arm import bend_arm, causes_with_contact
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.frame_update import (
    evidence_cost,
    excess,
    FrameUpdate,
    is_inconsistent,
    left_out_cost,
    misfits,
    take_frame,
    with_belief,
)
from pneunet_ros.fusion.inertial_force import TipInFrame
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import path_of, ReadFrame
from pneunet_ros.fusion.rolling_shutter import last_target_variance, read_row_by_row
from pneunet_ros.fusion.swinging import propagate_swing, with_blow_on_contact
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.pressure_error import PressureError, UNREAD
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import LAW
from pneunet_ros.measurement.inference.adequacy import RARELY
from pneunet_ros.measurement.inference.gaussian import innovation_factor, widen, with_columns
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth
from pneunet_ros.measurement.swinging_arm import ERRORS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HypothesisUpdate:
    """The update of a hypothesis by a frame.

    frame: the targets, with the readings at their stamp; before: the belief before the frame;
    problem: the estimation problem of all targets seen; update: the result.
    """

    frame: ReadFrame
    before: Belief
    problem: FrameProblem
    update: FrameUpdate

    @property
    def after(self) -> Belief:
        """The belief after the frame; unchanged if the frame was not used."""
        return self.before if self.update.belief is None else self.update.belief

    @property
    def misfits(self) -> bool:
        """Whether the frame deviates from the fit by more than noise."""
        fit = self.update.fit
        return fit is None or misfits(fit)

    @property
    def explained(self) -> bool:
        """Whether the fit agrees with all targets of the frame within noise."""
        update = self.update
        fit = None if update.belief is None or update.left_out else update.fit
        return fit is not None and excess(fit) <= 1.0

    @property
    def log_evidence(self) -> float:
        """Log likelihood of the frame, up to a constant; -inf if nothing fits."""
        fit, seen = self.update.evident, int(np.count_nonzero(self.problem.used))
        return -math.inf if fit is None else -0.5 * evidence_cost(fit, seen)

    @property
    def log_sharpness(self) -> float:
        """Log density of the prediction at its center, up to a constant; -inf if nothing fits."""
        fit = self.update.evident
        return -math.inf if fit is None else log_sharpness_of(fit[1].factor)

    @property
    def log_sharpness_given_loads(self) -> float:
        """The same if tip force, end moment and pressure of the frame had been known."""
        free, used = self.update.fit, self.update.evident
        if free is None or used is None:
            return -math.inf
        loads, jacobian = free[0].cause_root[:LAW], used[1].jacobian
        size = np.linalg.norm(loads, axis=1, keepdims=True)
        loads = np.divide(loads, size, out=np.zeros_like(loads), where=size > 0.0)
        known = innovation_factor(jacobian - (jacobian @ np.linalg.pinv(loads)) @ loads)
        return log_sharpness_of(known)

    @property
    def cost(self) -> float:
        """The lowest cost of the frame, in chi squared; a left-out target costs its gate."""
        fit, seen = self.update.fit, int(np.count_nonzero(self.problem.used))
        return math.inf if fit is None else fit[1].cost + left_out_cost(fit, seen)

    @property
    def cost_per_coordinate(self) -> float:
        """Residual chi squared per target coordinate; infinite without a fit."""
        fit = self.update.fit
        return math.inf if fit is None else fit[1].cost / fit[1].trial.residual.size


def log_sharpness_of(factor: Array) -> float:
    """Return the log density of an innovation of zero from the factor of its covariance."""
    return -float(np.log(np.diagonal(factor)).sum())


def update_with_likeliest_walk(
    model: PreparedModel,
    frame: ReadFrame,
    before: Belief,
    *,
    found_better: bool = False,
    widely: bool | None = None,
) -> HypothesisUpdate:
    """Return the update of a belief by a frame.

    On a swinging arm an unmeasured load may change faster or slower than it did recently. If the
    recent random walk does not fit the frame, or the frame alone indicates another, the most
    likely of the candidate walks is used. The fastest walk fits everything that a slower one fits.
    If it has no consistent fit, the slower ones are not tried, and neither if no wide search is
    due.
    """
    update = partial(
        update_with_walk, model, frame, before, found_better=found_better, widely=widely
    )
    updated = update()
    own = model.of(before.causes)
    read = model.used(frame, before.causes).wrench is not None
    if own.swinging is None or read or not before.frames:
        return updated
    if updated.explained and not indicates_other_walk(updated):
        return updated
    *slower, fastest = own.unknowns.block(TipForce).walks.sizes
    with_fastest = update(fastest, believed=False)
    fit = with_fastest.update.fit
    if widely is False or fit is None or is_inconsistent(fit):
        slower = []
    with_slower = (update(size, believed=False) for size in slower)
    best = max([updated, *with_slower, with_fastest], key=lambda one: one.log_evidence)
    if best is updated:
        return updated
    return replace(best, update=with_belief(best.problem, best.update))


def indicates_other_walk(updated: HypothesisUpdate) -> bool:
    """Whether a frame alone makes another random walk more likely than the recent one."""
    fit = updated.update.fit
    information = None if fit is None else fit[0].walk_information(fit[1])
    if information is None or not updated.before.frames:
        return False
    walks = updated.problem.unknowns.block(TipForce).walks
    growth = ErrorGrowth(size=information[2], grown=np.ones(2), seconds=0.0)
    likeliest = int(walks.after(walks.first, growth, information[:2]).argmax())
    recent = np.abs(np.log(walks.sizes) - math.log(updated.before.walk.recent)).argmin()
    return likeliest != int(recent)


def update_with_walk(
    model: PreparedModel,
    frame: ReadFrame,
    before: Belief,
    walk: float | None = None,
    *,
    found_better: bool = False,
    widely: bool | None = None,
    believed: bool = True,
) -> HypothesisUpdate:
    """Return the update of a belief by a frame; the search starts at the last shape.

    walk (N/sqrt(s)): random walk of the tip force, see `problem_of`; found_better, widely,
    believed: see `take_frame`. widely=None searches widely only for the first frame of a belief.
    """
    problem, cold = problem_of(model, frame, before, walk), not before.frames
    update = take_frame(
        problem,
        cold=cold,
        found_better=found_better,
        force_read=model.used(frame, before.causes).wrench is not None,
        widely=cold if widely is None else widely,
        believed=believed,
    )
    updated = HypothesisUpdate(frame=frame, before=before, problem=problem, update=update)
    return updated if update.belief is None else with_inertial_force(model, updated)


def with_inertial_force(model: PreparedModel, updated: HypothesisUpdate) -> HypothesisUpdate:
    """Return the update of an arm at rest with what its force says of a mass.

    A force that is read says nothing: it stays as it is while the arm swings. Neither does a frame
    in which the last target is hidden.
    """
    before, after, fit = updated.before, updated.after, updated.update.fit
    if model.inertial is None or fit is None or MOTION in before.causes:
        return updated
    if not fit[0].used[-1]:
        return updated
    shape, tip = fit[1].trial.bent.shape, updated.problem.unknowns.at(TipForce)
    seen = TipInFrame(
        stamp_ns=after.stamp_ns,
        place=np.array([shape.x[-1], shape.y[-1]]),
        place_variance=float(fit[0].std[-1]) ** 2 + last_target_variance(fit[0]),
        force=after.mean[tip],
        force_variance=np.diag(after.covariance_of(tip)),
    )
    frame = model.used(updated.frame, before.causes)
    inertial = (before.inertial or model.inertial).after(seen, is_free=frame.wrench is None)
    change = math.inf if frame.alone else abs(frame.instant.chamber - before.chamber)
    taken = TakenFrame(
        before=replace(before, last=None, rest=None),
        frame=updated.frame,
        is_steady=change <= RARELY * math.sqrt(2.0) * frame.instant.std,
    )
    rest, swing = before.rest, inertial.swing_at_rest()
    if before.last is not None and before.last.is_steady and swing is not None:
        rest = replace(before.last, swing=swing)
    after = replace(after, inertial=inertial, last=taken, rest=rest)
    return replace(updated, update=replace(updated.update, belief=after))


def problem_of(
    model: PreparedModel, frame: ReadFrame, belief: Belief, walk: float | None = None
) -> FrameProblem:
    """Return the estimation problem of a frame: its measurements and the propagated prior.

    The force may change freely from frame to frame, so that a frame does not inherit the error of
    the last one. Its prior is not zero either, because the constant unknowns would take that as
    evidence. A single frame does not determine the force on a swinging arm. There the force is a
    random walk of strength `walk` (N/sqrt(s)); None: the recent strength.
    """
    model = model.of(belief.causes)
    frame = model.used(frame, belief.causes)
    frame = frame.delayed(model.delay_ns(belief), model.delay_std(belief))
    instant = replace(frame.instant, std=0.0) if frame.alone else frame.instant
    inputs = model.inputs_at(instant, frame.wrench)
    pressure_change = abs(instant.chamber - belief.chamber)
    pressure_change = 0.0 if frame.alone or not math.isfinite(pressure_change) else pressure_change
    unknowns, size = model.unknowns, model.size_of(belief)
    prior = model.move(
        belief,
        frame.stamp_ns,
        pressure_change,
        noise=(inputs.moment_std, inputs.chamber_std),
        size=size,
        walk=unknowns.block(TipForce).free_walk
        if walk is None and model.swinging is None
        else walk,
    )
    if model.swinging is not None:
        if frame.wrench is not None:  # a swing follows the force that is read
            prior = model.with_wrench(prior, frame.wrench, instant.gauge)
        prior = propagate_to_frame(model, belief, prior, frame, inputs)
    growth = None
    seconds = seconds_between(belief.stamp_ns, frame.stamp_ns) if belief.frames else math.inf
    if frame.alone:
        std = np.array([UNREAD * unknowns.block(PressureError).range])
        prior = widen(prior, unknowns.at(PressureError), std)
    else:
        growth = ErrorGrowth(
            size=size, grown=unknowns.growth(seconds, pressure_change), seconds=seconds
        )
        if belief.unpressed:
            prior = model.without(prior, unknowns.at(PressureError))
    if frame.wrench is not None and model.swinging is None:
        prior = model.with_wrench(prior, frame.wrench, instant.gauge)
    left_out = None
    if prior.reference is not None:  # of this frame alone
        left_out = prior.root.shape[1]
        prior = replace(prior, root=with_columns(prior.root, ERRORS))
    sightings = frame.sightings
    problem = FrameProblem(
        table=model.table,
        unknowns=unknowns,
        settings=model.settings,
        prior=prior,
        growth=growth,
        inputs=inputs,
        sightings=sightings,
        used=np.isfinite(sightings.x) & np.isfinite(sightings.y),
        swinging=model.swinging,
        late=None if model.swinging is None or frame.wrench else belief.root.shape[1],
        response_share=1.0 if model.swinging is None else model.swinging.response(seconds).share,
        left_out=left_out,
    )
    rows = FRAME_TIMES in belief.causes
    return read_row_by_row(model, problem, belief, frame) if rows else problem


def propagate_to_frame(
    model: PreparedModel, before: Belief, propagated: Belief, frame: ReadFrame, inputs: FrameInputs
) -> Belief:
    """Return a belief propagated to a frame, with the swing of the arm."""
    causes = model.unknowns.causes_at(inputs)
    contact = model.held_contact(propagated)
    bent = bend_arm(
        model.table,
        inputs,
        causes @ propagated.mean,
        before.solution,
        model.arm.target_arclength,
        quick=True,
        contact=contact,
    )
    pulls = model.pulled(frame.pulls, frame.instant.gauge)
    path = path_of(frame.before, pulls, before.stamp_ns, before.chamber, frame.instant)
    all_causes = None
    if bent.shape.converged and not model.force_is_known(propagated):
        all_causes = causes_with_contact(model.unknowns, causes, contact)
    advanced, _ = propagate_swing(
        model.swinging, before, propagated, bent, path, all_causes, frame.instant.turn_rate
    )
    if model.swinging is not None:
        advanced = with_blow_on_contact(model.swinging, advanced, bent)
    return replace(advanced, solution=bent.solution if bent.shape.converged else before.solution)
