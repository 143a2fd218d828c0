"""The belief about all unknowns at the stamp of a frame, and its propagation.

A belief is conditional on a hypothesis: a set of active causes (`fusion.causes`). The unknowns of
an inactive cause have a tiny prior variance around zero: no contact force, no shift of the camera,
no error of the force sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import seconds_between
from pneunet_ros.fusion.inertial_force import InertialForce
from pneunet_ros.fusion.readings import ReadFrame
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.blocks.block import Passage
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.placement import Placement
from pneunet_ros.measurement.blocks.tip_force import ForceChange, TipForce, Walk
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.inference.gaussian import forget, Gaussian
from pneunet_ros.measurement.swinging_arm import Reference
from pneunet_ros.solver.solution import SolverNodes

# Causes that change what the rod bears, or what is read: the others widen a prior, and no more.
CONTACT, FORCE_SENSOR, PRESSURE = 'contact', 'force_sensor', 'pressure'
FRAME_TIMES, MIRRORED, MOTION = 'frame_times', 'mirrored', 'motion'
# These remain when a belief is reset.
LASTING = frozenset({FORCE_SENSOR, FRAME_TIMES, PRESSURE, MIRRORED, MOTION})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief(Gaussian):
    """The belief at a stamp: mean (n,), root (n, m) with root root^T the covariance.

    walk: random walk of the forces; sizes (sizes,): log weights of the possible sizes of the model
    error; chamber: the pressure reading (Pa), NaN if there was none; solution: the rod at the
    frame, None before the first; frames: number used so far; causes: names of the active causes;
    reference: reference of a swing, None if the model has no `motion`, or before any frame;
    inertial: what the forces say of a mass that the model does not have; last: the last frame, and
    rest: the last one of an arm at rest, None if that is not known; delay_ns: how much later than
    its stamp the last frame shows the arm, by the pressure, beyond the delay of the model.
    """

    stamp_ns: int
    walk: Walk
    sizes: Array
    chamber: float = math.nan
    solution: SolverNodes | None = None
    frames: int = 0
    causes: frozenset[str] = frozenset()
    reference: Reference | None = None
    inertial: InertialForce | None = None
    last: TakenFrame | None = None
    rest: TakenFrame | None = None
    delay_ns: int = 0

    @property
    def unpressed(self) -> bool:
        """Whether the last frame had no pressure reading; the bias is then the whole pressure."""
        return self.frames > 0 and math.isnan(self.chamber)

    @property
    def touched(self) -> bool:
        """Whether something touches the arm."""
        return CONTACT in self.causes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TakenFrame:
    """A frame and the belief before it.

    is_steady: whether the pressure was the same in the frame before; swing (2,): one sigma of the
    deviation of the tip from equilibrium (m) and of its velocity (m/s), infinite if unknown.
    """

    before: Belief
    frame: ReadFrame
    is_steady: bool
    swing: tuple[float, float] = (math.inf, math.inf)


def first_belief(
    unknowns: Unknowns, stamp_ns: int, causes: frozenset[str] = frozenset()
) -> Belief:
    """Return the prior belief before any frame, given these causes."""
    grid = unknowns.block(ModelDiscrepancy).grid
    prior = unknowns.prior(grid.size_of(grid.first))
    return Belief(
        stamp_ns=stamp_ns,
        mean=prior.mean,
        root=prior.root,
        walk=unknowns.block(TipForce).first,
        sizes=grid.first,
        causes=causes,
    )


def reset_to_prior(unknowns: Unknowns, belief: Belief) -> Belief:
    """Reset to the prior, but keep the tip force and the shape as the start of the search.

    Causes that only widen a prior end with it.
    """
    causes, force = belief.causes & LASTING, unknowns.at(TipForce)
    first = first_belief(unknowns, belief.stamp_ns - belief.delay_ns, causes)
    mean = first.mean.copy()
    mean[force] = belief.mean[force]
    return replace(
        first,
        mean=freeze(mean),
        chamber=belief.chamber,
        solution=belief.solution,
        frames=belief.frames,
    )


def with_outlier_targets(
    unknowns: Unknowns, settings: FusionSettings, belief: Belief, outliers: npt.NDArray[np.intp]
) -> Belief:
    """Forget the positions of targets that their gate rejected, because they have moved."""
    where = unknowns.at(Placement).start + unknowns.block(Placement).of_dots(outliers)
    return forget(belief, where, math.sqrt(settings.target_gate) * unknowns.std[where])


def move_belief(
    unknowns: Unknowns,
    belief: Belief,
    stamp_ns: int,
    size: float,
    pressure_change: float = 0.0,
    *,
    walk: float | None = None,
    noise: tuple[float, float] | None = None,
) -> Belief:
    """Propagate the belief to another stamp, forward or backward.

    size of the model error; pressure_change (Pa) over the propagation; walk (N/sqrt(s)): random
    walk of the forces from now on, None: as recently; noise (N m, Pa): one sigma of the new
    readings of moment and pressure, None if there are no new ones.
    """
    seconds = seconds_between(belief.stamp_ns, stamp_ns)
    steady = belief.walk.steadiness(seconds) if walk is None else 1.0
    recent = belief.walk.recent if walk is None else walk
    passage = Passage(
        seconds=seconds, pressure_change=pressure_change, size=size, walk=recent, steady=steady
    )
    mean, root = unknowns.move(belief, passage, noise)
    walked = replace(belief.walk, recent=recent)
    return replace(belief, stamp_ns=stamp_ns, mean=mean, root=root, walk=walked)


def forces_of(unknowns: Unknowns) -> list[int]:
    """Return the indices of the forces that walk: F1, F2, and the force of a contact."""
    tip = unknowns.at(TipForce)
    return [*range(tip.start, tip.stop), unknowns.at(Push).start]


def with_walk(
    unknowns: Unknowns, before: Belief, after: Belief, kept: Array | None = None
) -> Belief:
    """Return the belief after a frame, with the random walk of the forces estimated from it.

    A change of force that is larger than the errors at both frames explain is attributed to the
    walk. An error that both have in common, as that of a direction of gravity, explains no change.

    before, after: the beliefs at the last frame and at this one. kept (forces, errors): what the
    errors before contribute to the forces after; None: nothing.
    """
    seconds = seconds_between(before.stamp_ns, after.stamp_ns)
    if not before.frames or seconds <= 0.0:
        return replace(after, walk=before.walk)
    forces, push = forces_of(unknowns), unknowns.at(Push).start
    first, last = before.root[forces], after.root[forces]
    kept = np.zeros(first.shape) if kept is None else kept
    new = np.square(last).sum(axis=1) - np.square(kept).sum(axis=1)
    explained = np.square(first - kept).sum(axis=1) + np.maximum(new, 0.0)
    changes = [
        ForceChange(
            squared=float(after.mean[force] - before.mean[force]) ** 2,
            explained=float(one),
            of_tip=force != push,
        )
        for force, one in zip(forces, explained, strict=True)
    ]
    block = unknowns.block(TipForce)
    return replace(after, walk=block.walk_after(before.walk, changes, seconds, before.frames))
