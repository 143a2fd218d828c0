"""The running disagreement of measured targets with the estimate: the trigger for a diagnosis.

As the estimator: state in, state out; no clock, no topic, no file. `take_estimate` is given every
pressure reading with what became of it, `take_targets` every frame of targets, and
`ConsistencyState.disagreement` says where things stand. A frame is compared with the estimate at
the pressure reading that is nearest by the stamps, within half a period of the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
import math
from statistics import median
from types import MappingProxyType

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.core.stamps import count_reason, match_stamps, stamp_fault, STARTS_ANEW
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.estimate import Outcome, ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.predicted_targets import (
    Innovation,
    innovation,
    predict_targets,
    Snapshot,
)
from pneunet_ros.estimation.state import EstimatorState

KEPT = 256  # estimates; frames come later than readings, as images are looked at first
PERIODS = 32  # of the last readings, whose median is their period
MOST_WAITING = 32  # frames whose reading has not come
FEWEST = 10  # frames, before anything is claimed
# A single bad frame is no disagreement: this share of the recent ones must be beyond the limit.
SHARE = 0.25
# One-sided normal quantile of 1e-4: how rarely the targets of one frame go beyond the limit.
QUANTILE = 3.719


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """How far measured targets have been from the estimate lately.

    rms: of the whitened difference, 1 where it is all noise; limit: what noise does not exceed;
    target, arclength (m): where it is largest, against its own noise; beyond: rms is beyond the
    limit, and not by a few frames. stamp_ns: of the last frame.
    """

    stamp_ns: int
    rms: float
    limit: float
    target: int
    arclength: float
    beyond: bool

    def exceeds(self, other: Disagreement) -> bool:
        """Whether it is worse than another: first whether it is beyond noise, then how much."""
        return (self.beyond, self.rms / self.limit) > (other.beyond, other.rms / other.limit)

    @property
    def sentence(self) -> str:
        """Say it to a person."""
        return (
            f'measured targets are {self.rms:.3g} x their noise from the estimate (noise alone: '
            f'less than {self.limit:.3g}), worst at {self.arclength:.4g} m, target {self.target}: '
            'run pneunet diagnose'
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunningInnovation:
    """Means over the frames of the last while, older ones counting less and less.

    weight: how many frames they are worth; frames: how many there were; chi_square: per
    coordinate; coordinates: in a frame; beyond: share of frames beyond the limit; at_targets
    (targets,): chi square of each target per coordinate, NaN where it was never seen; arclength
    (targets,) m: of the targets.
    """

    stamp_ns: int
    weight: float
    frames: int
    chi_square: float
    coordinates: float
    beyond: float
    at_targets: Array
    arclength: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsistencyState:
    """All that is remembered from one reading or frame to the next."""

    moments: tuple[Snapshot, ...] = ()
    frame_stamp_ns: int | None = None
    waiting: tuple[TargetSightings, ...] = ()
    running: RunningInnovation | None = None
    matched: int = 0
    unmatched: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def fresh(self) -> ConsistencyState:
        """Forget readings and frames; only the counts go on."""
        return ConsistencyState(matched=self.matched, unmatched=self.unmatched)

    def missing(self, reason: str) -> ConsistencyState:
        """Count one more frame that cannot be compared."""
        return replace(self, unmatched=count_reason(self.unmatched, reason))

    def disagreement(self) -> Disagreement | None:
        """Return how far measured and estimated targets have been apart; None: too few frames.

        Errors of registration, placement and model are the same in many frames and do not average
        out, so the limit of the mean is that of a single frame.
        """
        running = self.running
        if running is None or running.frames < FEWEST:
            return None
        most = limit(running.coordinates)
        target = int(np.nanargmax(running.at_targets))
        return Disagreement(
            stamp_ns=running.stamp_ns,
            rms=math.sqrt(running.chi_square),
            limit=math.sqrt(most),
            target=target,
            arclength=float(running.arclength[target]),
            beyond=running.chi_square > most and running.beyond >= SHARE,
        )


def take_estimate(
    state: ConsistencyState,
    estimator: Estimator,
    reading: PressureReading,
    after: EstimatorState,
    outcome: Outcome,
) -> ConsistencyState:
    """Take what became of a pressure reading, and compare the frames that have waited for it.

    after: the state of the estimator after the reading.
    """
    if not isinstance(outcome, ShapeEstimate):
        return state
    if state.moments and reading.stamp_ns <= state.moments[-1].reading.stamp_ns:
        state = state.fresh()  # the estimator has started anew
    moment = Snapshot(reading=reading, state=after, estimate=outcome)
    state = replace(state, moments=(*state.moments[1 - KEPT :], moment))
    return compared(state, estimator) if state.waiting else state


def take_targets(
    state: ConsistencyState, estimator: Estimator, sightings: TargetSightings
) -> tuple[ConsistencyState, Refusal | None]:
    """Take a frame; returns why it cannot follow the one before, or None."""
    reason, sentence = stamp_fault('frame of targets', state.frame_stamp_ns, sightings.stamp_ns)
    if reason == STARTS_ANEW:
        state = state.fresh()
    elif reason:
        refusal = Refusal(
            stamp_ns=sightings.stamp_ns, reason=reason, sentence=sentence, error=False
        )
        return state.missing(reason), refusal
    state = replace(state, frame_stamp_ns=sightings.stamp_ns)
    if not sightings.seen:
        return state.missing('not_seen'), None
    if len(state.waiting) == MOST_WAITING:
        state = replace(state, waiting=state.waiting[1:]).missing('no_estimate')
    return compared(replace(state, waiting=(*state.waiting, sightings)), estimator), None


def compared(state: ConsistencyState, estimator: Estimator) -> ConsistencyState:
    """Compare the waiting frames whose nearest estimate is known by now."""
    if not state.moments:
        return state
    stamps = [moment.reading.stamp_ns for moment in state.moments]
    recent = stamps[-PERIODS - 1 :]
    periods = [after - before for before, after in pairwise(recent)]
    reach = 0.5 * median(periods) if periods else 0.0
    waiting, state = state.waiting, replace(state, waiting=())
    for sightings in waiting:
        nearest, near = match_stamps(np.array([sightings.stamp_ns]), np.array(stamps), reach)
        if near[0]:
            moment = state.moments[nearest[0]]
            found = innovation(
                predict_targets(estimator, moment), sightings, estimator.arm.sensors
            )
            assert found is not None
            running = followed(state.running, found, sightings.stamp_ns, estimator)
            state = replace(state, running=running, matched=state.matched + 1)
        elif sightings.stamp_ns > stamps[-1]:
            state = replace(state, waiting=(*state.waiting, sightings))
        else:
            state = state.missing('no_estimate')
    return state


def followed(
    before: RunningInnovation | None, found: Innovation, stamp_ns: int, estimator: Estimator
) -> RunningInnovation:
    """Take a frame into the running means; after a gap of `watch_time` they start anew."""
    time = estimator.settings.watch_time
    chi_square = found.chi_square / found.coordinates
    beyond = float(chi_square > limit(found.coordinates))
    since = math.inf if before is None else seconds_between(before.stamp_ns, stamp_ns)
    if before is None or since > time:
        return RunningInnovation(
            stamp_ns=stamp_ns,
            weight=1.0,
            frames=1,
            chi_square=chi_square,
            coordinates=found.coordinates,
            beyond=beyond,
            at_targets=freeze(found.at_targets),
            arclength=estimator.arm.target_arclength,
        )
    weight = before.weight * math.exp(-since / time) + 1.0
    share = 1.0 / weight
    known = np.where(np.isnan(before.at_targets), found.at_targets, before.at_targets)
    news = np.where(np.isnan(found.at_targets), known, found.at_targets)
    return RunningInnovation(
        stamp_ns=stamp_ns,
        weight=weight,
        frames=before.frames + 1,
        chi_square=before.chi_square + share * (chi_square - before.chi_square),
        coordinates=before.coordinates + share * (found.coordinates - before.coordinates),
        beyond=before.beyond + share * (beyond - before.beyond),
        at_targets=freeze(known + share * (news - known)),
        arclength=before.arclength,
    )


def limit(coordinates: float) -> float:
    """Return what chi square per coordinate of one frame rarely exceeds (Wilson and Hilferty)."""
    spread = 2.0 / (9.0 * coordinates)
    return (1.0 - spread + QUANTILE * math.sqrt(spread)) ** 3
