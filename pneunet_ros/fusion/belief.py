"""What is believed of all unknowns at the stamp of a frame, and how it moves.

Without a contact its force and place are known to be zero; a camera that nobody moved and a force
sensor in order are known to be right, to a hair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.blocks.block import Passage
from pneunet_ros.measurement.blocks.camera import Camera
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.force_sensor import ForceSensor
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.target_row import TargetRow
from pneunet_ros.measurement.blocks.tip_force import ForceChange, TipForce, Walk
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.inference.gaussian import forget, Gaussian
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief(Gaussian):
    """What is believed at a stamp: mean (n,), root (n, m) with root root^T the covariance.

    walk: of the forces; sizes (sizes,): log weights of the sizes of the model error; chamber: the
    pressure (Pa) as read, NaN where it was not; solution: the rod there, None before the first;
    frames: how many have been used. same_targets: they are taken for those of the calibration,
    which knows where they are painted; camera_moved: the camera is not where it was when the base
    frame was found; touched: a contact is believed.
    """

    stamp_ns: int
    walk: Walk
    sizes: Array
    chamber: float = math.nan
    solution: SolverNodes | None = None
    frames: int = 0
    same_targets: bool = False
    camera_moved: bool = False
    touched: bool = False


def first_belief(unknowns: Unknowns, stamp_ns: int) -> Belief:
    """Return what is believed before any frame."""
    grid = unknowns.block(ModelDiscrepancy).grid
    prior = unknowns.prior(grid.size_of(grid.first))
    return Belief(
        stamp_ns=stamp_ns,
        mean=prior.mean,
        root=prior.root,
        walk=unknowns.block(TipForce).first,
        sizes=grid.first,
        same_targets=unknowns.block(Placement).known is not None,
    )


def without_lessons(unknowns: Unknowns, belief: Belief) -> Belief:
    """Return what is believed before any frame, to be sought from where the arm is believed."""
    first, force = first_belief(unknowns, belief.stamp_ns), unknowns.at(TipForce)
    mean = first.mean.copy()
    mean[force] = belief.mean[force]
    return replace(
        first,
        mean=freeze(mean),
        chamber=belief.chamber,
        solution=belief.solution,
        frames=belief.frames,
    )


def with_other_targets(unknowns: Unknowns, belief: Belief) -> Belief:
    """Reset where dots are painted to the prior: targets were repainted."""
    where = slice(unknowns.at(Placement).start, unknowns.at(TargetRow).stop)
    return replace(forget(belief, where, unknowns.std[where]), same_targets=False)


def with_moved_camera(unknowns: Unknowns, belief: Belief) -> Belief:
    """Widen the prior of the camera's place and turn: it was moved.

    What frames have said of the force sensor may have come from that.
    """
    camera, sensor = unknowns.at(Camera), unknowns.at(ForceSensor)
    where = np.arange(camera.start + Camera.PLACE.start, sensor.stop)
    std = np.concatenate([unknowns.block(Camera).moved_std, unknowns.std[sensor]])
    return replace(forget(belief, where, std), camera_moved=True)


def told_by_frames(unknowns: Unknowns, belief: Belief, which: int) -> tuple[float, float]:
    """Return what frames say by themselves of an unknown that is known to a hair, and its std.

    By the score of the narrow prior; infinite where they say nothing.
    Source: Rao, Math. Proc. Cambridge Phil. Soc. 44 (1948).
    """
    prior = float(unknowns.std[which])
    share = 1.0 - (belief.std(which) / prior) ** 2 if prior > 0.0 else 0.0
    if share <= 0.0:
        return 0.0, math.inf
    return float(belief.mean[which]) / share, prior / math.sqrt(share)


def with_strange_targets(
    unknowns: Unknowns, settings: FusionSettings, belief: Belief, strange: npt.NDArray[np.intp]
) -> Belief:
    """Widen the places of targets that did not fit by their gate: they are not where they were."""
    where = unknowns.at(Placement).start + unknowns.block(Placement).of_dots(strange)
    return forget(belief, where, math.sqrt(settings.target_gate) * unknowns.std[where])


def move_belief(
    unknowns: Unknowns,
    belief: Belief,
    stamp_ns: int,
    size: float,
    pressed: float = 0.0,
    *,
    walk: float | None = None,
    noise: tuple[float, float] | None = None,
) -> Belief:
    """Return the belief at another stamp, before or after its own: it tells as little of both.

    size: of the model error; pressed (Pa): by how much the pressure has moved since; walk
    (N/sqrt(s)): of the forces from now on, None for as they moved lately; noise (N m, Pa): one
    sigma of readings of moment and pressure there, None where they are those of before.
    """
    seconds = seconds_between(belief.stamp_ns, stamp_ns)
    steady = belief.walk.steadiness(seconds) if walk is None else 1.0
    recent = belief.walk.recent if walk is None else walk
    passage = Passage(seconds=seconds, pressed=pressed, size=size, walk=recent, steady=steady)
    mean, root = unknowns.move(belief, passage, noise)
    return Belief(
        stamp_ns=stamp_ns,
        mean=mean,
        root=root,
        walk=Walk(recent=recent, usual=belief.walk.usual, interval=belief.walk.interval),
        sizes=belief.sizes,
        chamber=belief.chamber,
        solution=belief.solution,
        frames=belief.frames,
        same_targets=belief.same_targets,
        camera_moved=belief.camera_moved,
        touched=belief.touched,
    )


def with_walk(unknowns: Unknowns, before: Belief, after: Belief) -> Belief:
    """Return the belief after a frame, with the random walk of the forces that it tells.

    before, after: the beliefs at the last frame and at this one, which are all but independent in
    the forces. What their two variances leave of a change is walk.
    """
    seconds = seconds_between(before.stamp_ns, after.stamp_ns)
    if not before.frames or seconds <= 0.0:
        return replace(after, walk=before.walk)
    tip, push = unknowns.at(TipForce), unknowns.at(Push).start
    changes = []
    for force in (*range(tip.start, tip.stop), push):
        rows = before.root[force], after.root[force]
        changes.append(
            ForceChange(
                squared=float(after.mean[force] - before.mean[force]) ** 2,
                explained=sum(float(row @ row) for row in rows),
                of_tip=force != push,
            )
        )
    block = unknowns.block(TipForce)
    return replace(after, walk=block.walk_after(before.walk, changes, seconds, before.frames))
