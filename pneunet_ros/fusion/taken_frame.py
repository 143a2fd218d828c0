"""One frame of targets beside one hypothesis: its problem, its fit, and how likely it makes it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
import math

import numpy as np
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.bench import Bench
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
from pneunet_ros.fusion.readings import path_of, ReadFrame
from pneunet_ros.fusion.swinging import swung_on
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.inference.gaussian import widen, with_columns
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth
from pneunet_ros.measurement.swinging_arm import ERRORS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TakenFrame:
    """A frame as a hypothesis takes it.

    frame: with all that was read at its stamp; before: what was believed before it; problem: of
    all targets that were seen; update: what came of it.
    """

    frame: ReadFrame
    before: Belief
    problem: FrameProblem
    update: FrameUpdate

    @property
    def after(self) -> Belief:
        """The belief after it; unchanged if it was not used."""
        return self.before if self.update.belief is None else self.update.belief

    @property
    def misfits(self) -> bool:
        """Whether noise does not explain it."""
        fit = self.update.fit
        return fit is None or misfits(fit)

    @property
    def explained(self) -> bool:
        """Whether noise explains all of its targets."""
        update = self.update
        fit = None if update.belief is None or update.left_out else update.fit
        return fit is not None and excess(fit) <= 1.0

    @property
    def log_evidence(self) -> float:
        """Log of the likelihood of the frame, but for a constant; -inf where nothing fits."""
        fit, seen = self.update.fit, int(np.count_nonzero(self.problem.used))
        return -math.inf if fit is None else -0.5 * evidence_cost(fit, seen)

    @property
    def cost(self) -> float:
        """Its least cost, in chi squared, where a target left out costs its gate."""
        fit, seen = self.update.fit, int(np.count_nonzero(self.problem.used))
        return math.inf if fit is None else fit[1].cost + left_out_cost(fit, seen)

    @property
    def cost_per_coordinate(self) -> float:
        """Residual chi squared per coordinate of its targets; infinite without a fit."""
        fit = self.update.fit
        return math.inf if fit is None else fit[1].cost / fit[1].trial.residual.size


def taken_by(
    bench: Bench,
    frame: ReadFrame,
    before: Belief,
    *,
    found_better: bool = False,
    widely: bool | None = None,
) -> TakenFrame:
    """Return a frame taken by a belief.

    Of an arm that swings an unread load may walk faster or slower than it did recently: a frame
    that this does not explain, or that alone speaks for another walk, is taken by the most likely
    of all walks. A slower walk explains nothing that the fastest does not: where that fits no
    shape to the frame, or no wide search is due, the others are not tried.
    """
    once = partial(taken_once, bench, frame, before, found_better=found_better, widely=widely)
    taken = once()
    own = bench.of(before.causes)
    read = bench.used(frame, before.causes).wrench is not None
    if own.swinging is None or read or not before.frames:
        return taken
    if taken.explained and not tells_another_walk(taken):
        return taken
    *slower, fastest = own.unknowns.block(TipForce).walks.sizes
    freest = once(fastest, believed=False)
    fit = freest.update.fit
    if widely is False or fit is None or is_inconsistent(fit):
        slower = []
    others = (once(size, believed=False) for size in slower)
    best = max([taken, *others, freest], key=lambda one: one.log_evidence)
    if best is taken:
        return taken
    return replace(best, update=with_belief(best.problem, best.update))


def tells_another_walk(taken: TakenFrame) -> bool:
    """Whether a frame alone makes another walk of the load more likely than the recent one."""
    fit = taken.update.fit
    told = None if fit is None else fit[0].walk_information(fit[1])
    if told is None or not taken.before.frames:
        return False
    walks = taken.problem.unknowns.block(TipForce).walks
    growth = ErrorGrowth(size=told[2], grown=np.ones(2), seconds=0.0)
    likeliest = int(walks.after(walks.first, growth, told[:2]).argmax())
    recent = np.abs(np.log(walks.sizes) - math.log(taken.before.walk.recent)).argmin()
    return likeliest != int(recent)


def taken_once(
    bench: Bench,
    frame: ReadFrame,
    before: Belief,
    walk: float | None = None,
    *,
    found_better: bool = False,
    widely: bool | None = None,
    believed: bool = True,
) -> TakenFrame:
    """Return a frame taken by a belief, near the last shape where there is one.

    walk (N/sqrt(s)): of the tip force, as `problem_of` takes it; found_better, widely, believed:
    as of `take_frame`; widely None: only if the belief has seen no frame yet.
    """
    problem, cold = problem_of(bench, frame, before, walk), not before.frames
    update = take_frame(
        problem,
        cold=cold,
        found_better=found_better,
        force_read=bench.used(frame, before.causes).wrench is not None,
        widely=cold if widely is None else widely,
        believed=believed,
    )
    return TakenFrame(frame=frame, before=before, problem=problem, update=update)


def problem_of(
    bench: Bench, frame: ReadFrame, belief: Belief, walk: float | None = None
) -> FrameProblem:
    """Return a frame beside what was believed before it.

    From frame to frame the force is free: a frame must not inherit what the last one erred.
    But it is not drawn to zero either, frame after frame, which the unknowns that stay would
    take for evidence. A frame alone does not determine the force on a swinging arm: there it is a
    random walk of strength `walk` (N/sqrt(s)), None for as it moved recently.
    """
    bench = bench.of(belief.causes)
    frame = bench.used(frame, belief.causes)
    instant = replace(frame.instant, std=0.0) if frame.alone else frame.instant
    inputs = bench.inputs_at(instant, frame.wrench)
    pressed = abs(instant.chamber - belief.chamber)
    pressed = 0.0 if frame.alone or not math.isfinite(pressed) else pressed
    unknowns, size = bench.unknowns, bench.size_of(belief)
    prior = bench.move(
        belief,
        frame.stamp_ns,
        pressed,
        noise=(inputs.moment_std, inputs.chamber_std),
        size=size,
        walk=unknowns.block(TipForce).free_walk
        if walk is None and bench.swinging is None
        else walk,
    )
    if bench.swinging is not None:
        if frame.wrench is not None:  # a swing follows the force that is read
            prior = bench.with_wrench(prior, frame.wrench, instant.gauge)
        prior = swung_to(bench, belief, prior, frame, inputs)
    growth = None
    seconds = seconds_between(belief.stamp_ns, frame.stamp_ns) if belief.frames else math.inf
    if frame.alone:
        pressure = unknowns.block(PressureError)
        std = np.array([pressure.unread * pressure.range])
        prior = widen(prior, unknowns.at(PressureError), std)
    else:
        growth = ErrorGrowth(size=size, grown=unknowns.growth(seconds, pressed), seconds=seconds)
        if belief.unpressed:
            prior = bench.without(prior, unknowns.at(PressureError))
    if frame.wrench is not None and bench.swinging is None:
        prior = bench.with_wrench(prior, frame.wrench, instant.gauge)
    left_out = None
    if prior.reference is not None:  # of this frame alone
        left_out = prior.root.shape[1]
        prior = replace(prior, root=with_columns(prior.root, ERRORS))
    sightings = frame.sightings
    return FrameProblem(
        table=bench.table,
        unknowns=unknowns,
        settings=bench.settings,
        prior=prior,
        growth=growth,
        inputs=inputs,
        sightings=sightings,
        used=np.isfinite(sightings.x) & np.isfinite(sightings.y),
        swinging=bench.swinging,
        late=None if bench.swinging is None or frame.wrench else belief.root.shape[1],
        answered=1.0 if bench.swinging is None else bench.swinging.answered(seconds),
        left_out=left_out,
    )


def swung_to(
    bench: Bench, before: Belief, moved: Belief, frame: ReadFrame, inputs: FrameInputs
) -> Belief:
    """Return a belief that has moved to a frame with the swing of the arm there."""
    causes = bench.unknowns.causes_at(inputs)
    contact = bench.held_contact(moved)
    bent = bend_arm(
        bench.table,
        inputs,
        causes @ moved.mean,
        before.solution,
        bench.arm.target_arclength,
        quick=True,
        contact=contact,
    )
    pulls = bench.pulled(frame.pulls, frame.instant.gauge)
    path = path_of(frame.before, pulls, before.stamp_ns, before.chamber, frame.instant)
    every = None
    if bent.shape.converged and not bench.knows_force(moved):
        every = causes_with_contact(bench.unknowns, causes, contact)
    swung, _ = swung_on(bench.swinging, before, moved, bent, path, every)
    return replace(swung, solution=bent.solution if bent.shape.converged else before.solution)
