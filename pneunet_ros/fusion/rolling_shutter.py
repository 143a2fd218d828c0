"""A frame whose rows are read one after the other, while the arm moves.

When each target is seen is not learned from frame to frame, because between two readings the
motion of the arm is not known well enough: it is an error of every frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.bent_arm import bend_arm
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import rate_around, ReadFrame
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.inference.gaussian import with_columns
from pneunet_ros.measurement.rolling_shutter import READOUT, row_errors, second_order_motion
from pneunet_ros.model.vibration import LINKS


def read_row_by_row(
    model: PreparedModel, problem: FrameProblem, before: Belief, frame: ReadFrame
) -> FrameProblem:
    """Return the problem of a frame if its targets are seen row by row.

    before: the belief at the last frame. Unchanged if nothing is known of the motion of the arm.
    """
    if model.swinging is None:
        moving = followed_motion(model, problem, before, frame)
    else:
        moving = swing_motion(problem)
    if moving is None:
        return problem
    motion, turn, heading = moving
    together = motion[:1] if model.swinging is None else motion[:0]
    arclength, seen = model.arm.target_arclength, frame.sightings
    joints = np.linspace(0.0, model.arm.reach, LINKS + 1)
    curved = second_order_motion(turn, heading, joints, arclength)
    places = np.nan_to_num(np.stack([seen.x, seen.y])) / model.arm.length
    errors, prior = row_errors(motion, together, curved, places), problem.prior
    left_out = prior.root.shape[1] if problem.left_out is None else problem.left_out
    prior = replace(prior, root=with_columns(prior.root, len(errors)))
    return replace(problem, prior=prior, left_out=left_out, row_errors=errors)


def followed_motion(
    model: PreparedModel, problem: FrameProblem, before: Belief, frame: ReadFrame
) -> tuple[Array, Array, Array] | None:
    """Return how an arm without inertia follows pressure and force; None if it has no shape.

    (motions, 2, targets) m during READOUT; (LINKS,) rad of its links, and their heading. The force
    moves it as since the last frame, as far as noise does not explain that.
    """
    prior, tip = problem.prior, problem.unknowns.at(TipForce)
    arclength = model.arm.target_arclength
    bent = bend_arm(
        model.table,
        problem.inputs,
        problem.causes @ prior.mean,
        prior.solution,
        arclength,
        quick=True,
        contact=model.held_contact(prior),
    )
    if not bent.shape.converged or bent.shape.stable is False:
        return None
    trial = problem.trial_of(np.zeros(prior.root.shape[1]), bent)
    linear = None if trial is None else problem.linearize(trial)
    if linear is None:
        return None
    rate = 0.0 if frame.alone else rate_around(frame.before, frame.stamp_ns, READOUT)
    change, seconds = np.zeros(2), seconds_between(before.stamp_ns, frame.stamp_ns)
    if before.frames and seconds > 0.0:
        root = prior.root[tip]
        change = prior.mean[tip] + root @ linear.step - before.mean[tip]
        after = linear.errors_after(root)
        noise = before.covariance_of(tip) + after @ after.T
        squared = max(float(change @ np.linalg.solve(noise, change)), change.size)
        change = (1.0 - change.size / squared) * change * READOUT / seconds
    sensitivity = bent.linearize()
    middles = model.arm.reach * (np.arange(LINKS) + 0.5) / LINKS
    by_cause, turns = (
        sensitivity.stations(where)[: PRESSURE + 1] for where in (arclength, middles)
    )
    driven = np.array([[0.0, 0.0, 0.0, rate * READOUT], [*change, 0.0, 0.0]])
    motion = np.tensordot(driven, by_cause[:, :2], axes=1)
    return motion, driven.sum(axis=0) @ turns[:, 2], sensitivity.fields(middles)[2]


def swing_motion(problem: FrameProblem) -> tuple[Array, Array, Array] | None:
    """Return how a swinging arm moves, as `followed_motion` does; None before its second frame."""
    prior, arm = problem.prior, problem.swinging
    reference, solution = prior.reference, prior.solution
    if arm is None or reference is None or reference.impulses is None or solution is None:
        return None
    momenta, mobility = arm.part(Motion.MOMENTUM), reference.impulses.mobility
    mean, root = mobility @ prior.mean[momenta], mobility @ prior.root[momenta]
    moved = READOUT * np.sqrt(mean**2 + np.square(root).sum(axis=1))
    deviation = arm.swing_deviation(solution, prior.mean, reference, arm.targets)
    motion = moved[:, None, None] * deviation.by_shape[:, :2]
    return motion, READOUT * mean @ reference.turns, deviation.heading
