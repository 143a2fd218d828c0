"""A frame whose rows are read one after the other, while the arm moves.

When each target is seen is not learned from frame to frame, because between two readings the
motion of the arm is not known well enough: it is an error of every frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.prepared_model import PreparedModel
from pneunet_ros.fusion.readings import rate_around, ReadFrame
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.inference.gaussian import with_columns
from pneunet_ros.measurement.rolling_shutter import (
    READOUT,
    row_errors,
    second_order_motion,
    STAMP_STD,
)
from pneunet_ros.model.vibration import LINKS


class MotionMeanwhile(NamedTuple):
    """How an arm moves while its rows are read.

    motion (motions, 2, targets) m during READOUT, by each cause; at_once (n, 2, targets) m: that
    by a pressure, whose time is not that of the frame, during STAMP_STD; turn, heading (LINKS,)
    rad of the links, by all causes.
    """

    motion: Array
    at_once: Array
    turn: Array
    heading: Array


def read_row_by_row(
    model: PreparedModel, problem: FrameProblem, before: Belief, frame: ReadFrame
) -> FrameProblem:
    """Return the problem of a frame if its targets are seen row by row.

    before: the belief at the last frame. Unchanged if nothing is known of the motion of the arm.
    """
    if model.swinging is None:
        meanwhile = followed_motion(model, problem, before, frame)
    else:
        meanwhile = swing_motion(problem)
    if meanwhile is None:
        return problem
    seen, prior = frame.sightings, problem.prior
    joints = np.linspace(0.0, model.arm.reach, LINKS + 1)
    curved = second_order_motion(
        meanwhile.turn, meanwhile.heading, joints, model.arm.target_arclength
    )
    places = np.nan_to_num(np.stack([seen.x, seen.y])) / model.arm.length
    errors = row_errors(meanwhile.motion, meanwhile.at_once, curved, places)
    left_out = prior.root.shape[1] if problem.left_out is None else problem.left_out
    prior = replace(prior, root=with_columns(prior.root, len(errors)))
    return replace(problem, prior=prior, left_out=left_out, row_errors=errors)


def followed_motion(
    model: PreparedModel, problem: FrameProblem, before: Belief, frame: ReadFrame
) -> MotionMeanwhile | None:
    """Return how an arm without inertia follows pressure and force; None if it has no shape.

    The force moves it as since the last frame, as far as noise does not explain that.
    """
    prior, tip = problem.prior, problem.unknowns.at(TipForce)
    linear = problem.linearize_at(np.zeros(prior.root.shape[1]), prior.solution)
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
    sensitivity = linear.trial.bent.linearize()
    middles = model.arm.reach * (np.arange(LINKS) + 0.5) / LINKS
    by_cause, turns = (
        sensitivity.stations(where)[: PRESSURE + 1]
        for where in (model.arm.target_arclength, middles)
    )
    driven = np.array([[0.0, 0.0, 0.0, rate * READOUT], [*change, 0.0, 0.0]])
    return MotionMeanwhile(
        motion=np.tensordot(driven, by_cause[:, :2], axes=1),
        at_once=rate * STAMP_STD * by_cause[PRESSURE:, :2],
        turn=driven.sum(axis=0) @ turns[:, 2],
        heading=sensitivity.fields(middles)[2],
    )


def swing_motion(problem: FrameProblem) -> MotionMeanwhile | None:
    """Return how a swinging arm moves; None before its second frame."""
    prior, arm = problem.prior, problem.swinging
    reference, solution = prior.reference, prior.solution
    if arm is None or reference is None or reference.impulses is None or solution is None:
        return None
    momenta, mobility = arm.part(Motion.MOMENTUM), reference.impulses.mobility
    mean, root = mobility @ prior.mean[momenta], mobility @ prior.root[momenta]
    moved = READOUT * np.sqrt(mean**2 + np.square(root).sum(axis=1))
    deviation = arm.swing_deviation(solution, prior.mean, reference, arm.targets)
    motion = moved[:, None, None] * deviation.by_shape[:, :2]
    return MotionMeanwhile(
        motion=motion,
        at_once=motion[:0],
        turn=READOUT * mean @ reference.turns,
        heading=deviation.heading,
    )


def last_target_variance(problem: FrameProblem) -> float:
    """Return the variance (m^2) of the last target of a frame in each direction, by its rows."""
    if problem.row_errors is None:
        return 0.0
    return 0.5 * float(np.square(problem.row_errors[:, :, -1]).sum())
