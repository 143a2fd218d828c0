"""The tip force: a random walk with a rate learned from recent frames."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block, Move, Passage, WrenchSeen
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth, SizeGrid

# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
LEAST_WALK = 0.0015  # of the force scale/sqrt(s): random walk of a force at rest
USUAL_TIME = 30.0  # s, over which the walk of the force is averaged
GUESS_COUNTS = 5.0  # s of frames, the weight of the initial walk


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """Random walk of the tip force (N/sqrt(s)): the recent rate, and the typical one.

    interval (s): time over which a force keeps changing as it does from frame to frame. weights
    (walks,): log weights of the candidate walks of a swinging arm, None before any frame;
    most_likely: the walk that made the last frame of a swinging arm most likely.
    """

    recent: float
    usual: float
    interval: float = math.inf
    weights: Array | None = None
    most_likely: float = 0.0

    @property
    def largest(self) -> float:
        """Upper limit of the random walk (N/sqrt(s)) of the load on a swinging arm."""
        return max(self.recent, self.usual, self.most_likely)

    def steadiness(self, seconds: float) -> float:
        """Return the variance growth relative to a random walk, for a load that may swing."""
        return max(seconds / self.interval, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceChange:
    """Changes of a force between frames, and the part explained by their variances.

    of_tip: whether the force is a component of the tip force, to which the typical walk refers.
    """

    squared: float
    explained: float
    of_tip: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class TipForce(Block):
    """F1 and F2 (N) at the free end; scale (N): the largest likely force.

    swings: whether the arm swings, so that a frame alone does not determine the force.
    """

    scale: float
    swings: bool = False
    first_walk: float = tuning(
        0.15,
        'random walk of the tip force before any frame',
        unit='of the force scale/sqrt(s)',
        source='sweep',
    )
    largest_walk: float = tuning(
        0.9, 'largest random walk of a force', unit='of the force scale/sqrt(s)', source='sweep'
    )
    steady_after: float = tuning(
        0.1,
        'time over which a force keeps changing as it did, if frames are at least this frequent',
        unit='s',
        source='tried on one rig: 0.05 s leaves the force almost unobservable, 9 s makes it '
        'overconfident',
    )
    walk_time: float = tuning(
        0.5, 'time after which a force counts as constant again', unit='s', source='sweep'
    )

    @property
    def std(self) -> Array:
        """The force scale, along both axes."""
        return np.full(2, self.scale)

    @property
    def times(self) -> Array:
        """Time constants: finite, since the force moves by `move`."""
        return np.ones(2)

    @property
    def free_walk(self) -> float:
        """Random walk (N/sqrt(s)) above which earlier frames carry no information on the force."""
        return self.largest_walk * self.scale

    @property
    def rates(self) -> Array:
        """Random walks (N/sqrt(s)) of any load, from one at rest on, half a decade apart."""
        return np.geomspace(LEAST_WALK, self.largest_walk, 6) * self.scale

    @property
    def first(self) -> Walk:
        """The random walk before any frame."""
        walk = self.first_walk * self.scale
        return Walk(recent=walk, usual=walk)

    def move(self, passage: Passage, by_times: Move) -> Move:
        """Increase the variance, up to the scale; keep the mean if frames determine the force."""
        time = 2.0 * (self.scale / passage.walk) ** 2 / passage.steady
        decay = np.exp(-passage.seconds / np.full(2, time))
        return Move(decay=decay, noise=np.sqrt(1.0 - decay**2) * self.scale, held=True)

    def on_rod(self, causes: Array, columns: slice) -> None:
        """Map the force to the loads F1 and F2 of the rod."""
        causes[:2] = np.eye(2)

    def on_wrench(self, seen: WrenchSeen) -> Array:
        """Return the derivatives of the force reading: the identity."""
        return np.eye(2)

    @property
    def walks(self) -> SizeGrid:
        """Candidate random walks (N/sqrt(s)) of the load on a swinging arm.

        Even the slowest is fast enough that a steadily growing load is not taken for a constant
        error.
        """
        walks = tuple(self.first_walk * 10.0 ** (0.5 * half) * self.scale for half in range(-1, 5))
        return SizeGrid(sizes=walks, fall=0.0, time=self.walk_time)

    def estimate_walk(
        self, walk: Walk, score: Array, precision: Array, size: float, seconds: float, frames: int
    ) -> Walk:
        """Return the walk after a frame of a swinging arm.

        score, precision: for a walk of 1 N/sqrt(s), as in `SizeGrid.after`; size: the assumed
        walk; frames: number of frames used before.
        """
        grid = self.walks
        growth = ErrorGrowth(size=size, grown=np.ones(2), seconds=seconds)
        known = grid.first if walk.weights is None else walk.weights
        weights = grid.after(known, growth, (score, precision))
        recent = grid.size_of(weights)
        share = -math.expm1(-seconds / min(GUESS_COUNTS + seconds * frames, USUAL_TIME))
        usual = math.sqrt(walk.usual**2 + share * (recent**2 - walk.usual**2))
        return Walk(recent=recent, usual=usual, weights=weights)

    def walk_after(
        self, walk: Walk, changes: list[ForceChange], seconds: float, frames: int
    ) -> Walk:
        """Return the random walk after a frame, from force changes beyond their variances.

        frames: number of frames used before. The walk rises immediately and falls within
        `walk_time`, but not below the mean walk of the tip force.
        """
        found = [(one.squared - one.explained) / seconds for one in changes]
        weights = [one.explained**-2.0 if one.of_tip else 0.0 for one in changes]
        average = sum(weight * one for weight, one in zip(weights, found, strict=True))
        average /= sum(weights)
        watched = GUESS_COUNTS + seconds * frames
        share = -math.expm1(-seconds / min(watched, USUAL_TIME))
        usual = walk.usual**2 + share * (average - walk.usual**2)
        least = (self.scale * LEAST_WALK) ** 2
        largest = (self.scale * self.largest_walk) ** 2
        usual = min(max(usual, least), largest)
        recent = min(max(*found, usual), largest)
        share = 1.0 if recent > walk.recent**2 else -math.expm1(-seconds / self.walk_time)
        return Walk(
            recent=math.sqrt(walk.recent**2 + share * (recent - walk.recent**2)),
            usual=math.sqrt(usual),
            interval=max(seconds, self.steady_after),
        )
