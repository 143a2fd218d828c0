"""Running comparison of measured targets with the estimate.

As in the estimator, a step maps a state to the next one, without clock, topic or file.
`take_estimate` processes every pressure reading with its outcome, `take_targets` every frame of
targets, and `ConsistencyState.disagreement` gives the current result. A frame is compared with the
prediction from the neighboring estimates (`frame_prediction`), one of which must be at most a
period of the readings away. `agreement_of` gives the verdict on a whole recording, for single
frames and, with `persistent_errors`, for all frames together.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
import math
from statistics import median
from types import MappingProxyType

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.stamps import AHEAD, count_reason, match_stamps, RESTARTED, StampGate
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.estimation.estimate import Outcome, ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.frame_prediction import NEIGHBORS, predict_frame
from pneunet_ros.estimation.persistent_errors import FrameEvidence, PersistentErrors
from pneunet_ros.measurement.inference.adequacy import ADEQUACY, chi_square_limit, LARGEST_95, RARE
from pneunet_ros.measurement.innovation import innovation
from pneunet_ros.measurement.predicted_targets import PredictedTargets
import scipy

ESTIMATES_KEPT = 256  # readings that wait for later frames: memory
MOST_WAITING = 128  # frames that wait for their readings: memory
PERIODS = 32  # latest ones, for the median
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FEWEST_FRAMES = 10  # for a verdict
MANY = 0.25  # share of recent frames beyond the limit from which it is a disagreement


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencySettings:
    """Tuning constants of the comparison of measured targets with estimates."""

    most_tips: float = tuning(
        0.2,
        'largest share of tips outside their ellipses for an adequate model; a systematic '
        'error causes a larger one',
        source='sweep',
    )


DEFAULTS = ConsistencySettings()
FORCE_NOT_JUDGED = (
    'without an end wrench the force is not checked: a force on the arm would look the same'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """The recent disagreement between measured targets and estimate.

    rms of the whitened difference, 1 for pure noise; limit: noise limit of rms; target, arclength
    (m) of the largest difference relative to its noise; beyond: whether rms exceeds the limit, not
    only because of a few frames; force_read: whether the end load was measured; stamp_ns: of the
    last frame.
    """

    stamp_ns: int
    rms: float
    limit: float
    target: int
    arclength: float
    beyond: bool
    force_read: bool

    def exceeds(self, other: Disagreement) -> bool:
        """Whether this disagreement exceeds another one: first by significance, then by size."""
        return (self.beyond, self.rms / self.limit) > (other.beyond, other.rms / other.limit)

    @property
    def sentence(self) -> str:
        """Describe the disagreement for users."""
        return (
            f'measured targets are {self.rms:.3g} x their noise away from the estimate (noise '
            f'alone: less than {self.limit:.3g}), worst at {self.arclength:.4g} m, target '
            f'{self.target}: run pneunet diagnose'
            + ('' if self.force_read else f' ({FORCE_NOT_JUDGED})')
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameInnovation:
    """Deviation of the targets of one frame from their estimate.

    rms of the whitened difference, 1 for pure noise; limit: noise limit of rms; at_tip: chi
    squared of the tip alone, two coordinates, NaN if the tip is not seen; force_read: whether the
    end load was measured; evidence: for persistent errors, None outside the domain of the model.
    """

    stamp_ns: int
    rms: float
    limit: float
    force_read: bool
    at_tip: float = math.nan
    evidence: FrameEvidence | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Whether a model fits a recording: measured versus predicted targets, in units of the noise.

    median of the whitened rms of a frame, 1 for pure noise; limit: noise limit of the rms of a
    frame; beyond: share of frames beyond this limit; most: largest such share of an adequate
    model. tips_outside: share of frames with the tip outside its 95 % ellipse, NaN if no tip was
    seen; tips_chance: p-value of this share; sure: significance level. fewest: frames needed for a
    verdict. force_read: whether the end load was measured in all frames. persistent: the joint
    test of all frames, None if there are too few.
    """

    frames: int
    median: float
    limit: float
    beyond: float
    most: float
    tips_outside: float
    tips_chance: float
    sure: float
    fewest: int
    force_read: bool
    persistent: PersistentErrors | None = None

    @property
    def tips_hold(self) -> bool:
        """Whether the tips lie in their confidence ellipses, apart from chance outliers."""
        return self.tips_chance >= self.sure

    @property
    def holds(self) -> bool | None:
        """Whether frames and tips are consistent with noise; None if there are too few frames."""
        if self.frames < self.fewest:
            return None
        return self.frames_hold and (self.persistent is None or self.persistent.holds)

    @property
    def frames_hold(self) -> bool:
        """Whether single frames are consistent with the model."""
        return self.median <= self.limit and self.beyond <= self.most and self.tips_hold

    @property
    def sentence(self) -> str:
        """Describe the agreement for users."""
        verdict, advice = 'the model holds on this recording', ''
        if self.holds is None:
            verdict = (
                f'too few frames to decide whether the model holds (fewer than {self.fewest})'
            )
        elif not self.holds:
            verdict, advice = 'the model does not hold on this recording', '; run pneunet diagnose'
        persistent_part = ''
        if self.persistent is not None and not self.persistent.holds:
            persistent_part = f'; {self.persistent.sentence}'
            advice = f'; {self.persistent.advice}'
        tips = ''
        if not self.tips_hold:
            tips = (
                f'; the tip is outside its 95 % ellipse in {100.0 * self.tips_outside:.0f} %: '
                'the uncertainty of the model is too small'
            )
        return (
            f'{verdict}: {100.0 * self.beyond:.0f} % of {self.frames} frames exceed the noise '
            f'limit (pass: at most {100.0 * self.most:.0f} %), and the median frame is '
            f'{self.median:.2f} x the noise{tips}{persistent_part}{advice}'
            + ('' if self.force_read else f'; {FORCE_NOT_JUDGED}')
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunningInnovation:
    """Exponentially weighted means over the last frames.

    weight: effective number of frames; frames: actual number; chi_square: per coordinate;
    coordinates: per frame; beyond: share of frames beyond the limit; at_targets (targets,): chi
    square of each target per coordinate, NaN if it was never seen; arclength (targets,) m: of the
    targets; force_read: whether the end load was measured at the last frame.
    """

    stamp_ns: int
    arclength: Array
    at_targets: Array
    weight: float = 0.0
    frames: int = 0
    chi_square: float = 0.0
    coordinates: float = 0.0
    beyond: float = 0.0
    force_read: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsistencyState:
    """State of the comparison between readings and frames.

    compared: the frames compared in the last step.
    """

    estimates: tuple[ShapeEstimate, ...] = ()
    frame_stamps: StampGate = field(default_factory=StampGate)
    waiting: tuple[TargetSightings, ...] = ()
    running: RunningInnovation | None = None
    compared: tuple[FrameInnovation, ...] = ()
    matched: int = 0
    unmatched: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def fresh(self) -> ConsistencyState:
        """Return the state without readings and frames; counters are kept."""
        return ConsistencyState(matched=self.matched, unmatched=self.unmatched)

    def without_frames_after(self, stamp_ns: int) -> ConsistencyState:
        """Drop a waiting frame whose stamp turned out to be in the future."""
        waiting = tuple(one for one in self.waiting if one.stamp_ns <= stamp_ns)
        return replace(self, waiting=waiting).count_unmatched(AHEAD)

    def count_unmatched(self, reason: str) -> ConsistencyState:
        """Count one more frame that cannot be compared."""
        return replace(self, unmatched=count_reason(self.unmatched, reason))

    def disagreement(self) -> Disagreement | None:
        """Return the recent disagreement of measured and estimated targets; None for few frames.

        Errors of registration, placement and model are common to many frames and do not average
        out, so the limit of the mean is that of a single frame.
        """
        running = self.running
        if running is None or running.frames < FEWEST_FRAMES:
            return None
        most = chi_square_limit(running.coordinates)
        target = int(np.fmax(running.at_targets, 0.0).argmax())
        return Disagreement(
            stamp_ns=running.stamp_ns,
            rms=math.sqrt(running.chi_square),
            limit=math.sqrt(most),
            target=target,
            arclength=float(running.arclength[target]),
            beyond=running.chi_square > most and running.beyond >= MANY,
            force_read=running.force_read,
        )


def agreement_of(
    compared: Sequence[FrameInnovation], persistent: PersistentErrors | None = None
) -> Agreement:
    """Return the agreement of measured and predicted targets over these frames, at least one.

    persistent: the joint test.
    """
    rms, limit, at_tip = np.array([(one.rms, one.limit, one.at_tip) for one in compared]).T
    tips = at_tip[np.isfinite(at_tip)]
    outside = int(np.count_nonzero(tips > LARGEST_95))
    return Agreement(
        frames=len(compared),
        median=float(np.median(rms)),
        limit=float(np.median(limit)),
        beyond=float(np.mean(rms > limit)),
        most=ADEQUACY.outside,
        tips_outside=outside / tips.size if tips.size else math.nan,
        tips_chance=float(scipy.special.bdtrc(outside - 1, tips.size, DEFAULTS.most_tips)),
        sure=RARE,
        fewest=FEWEST_FRAMES,
        force_read=all(frame.force_read for frame in compared),
        persistent=persistent,
    )


def take_estimate(
    state: ConsistencyState, estimator: Estimator, outcome: Outcome
) -> ConsistencyState:
    """Process the outcome of a pressure reading, and compare the frames waiting for it."""
    state = replace(state, compared=())
    if not isinstance(outcome, ShapeEstimate):
        return state
    if state.estimates and outcome.stamp_ns <= state.estimates[-1].stamp_ns:
        state = state.fresh()  # the estimator has restarted
    kept = state.estimates[1 - ESTIMATES_KEPT :]
    state = replace(state, estimates=(*kept, outcome))
    return compare_waiting(state, estimator) if state.waiting else state


def take_targets(
    state: ConsistencyState, estimator: Estimator, sightings: TargetSightings
) -> tuple[ConsistencyState, Refusal | None]:
    """Process a frame; return an error if it is out of sequence, else None."""
    state = replace(state, compared=())
    reason, sentence = state.frame_stamps.fault('frame of targets', sightings.stamp_ns)
    if reason == RESTARTED:
        state = state.fresh()
    elif reason == AHEAD:
        state = state.without_frames_after(sightings.stamp_ns)
    elif reason:
        refusal = drop(sightings.stamp_ns, reason, sentence)
        return state.count_unmatched(reason), refusal
    state = replace(state, frame_stamps=state.frame_stamps.after(sightings.stamp_ns))
    if not sightings.seen:
        return state.count_unmatched('not_seen'), None
    if len(state.waiting) == MOST_WAITING:
        state = replace(state, waiting=state.waiting[1:]).count_unmatched('no_estimate')
    state = replace(state, waiting=(*state.waiting, sightings))
    return compare_waiting(state, estimator), None


def compare_waiting(state: ConsistencyState, estimator: Estimator) -> ConsistencyState:
    """Compare the waiting frames whose nearest estimate is now known."""
    if not state.estimates:
        return state
    delay_ns = round(estimator.arm.frame_delay * NANOSECONDS_PER_SECOND)
    last = state.estimates[-NEIGHBORS:]
    if all(
        one.stamp_ns - delay_ns > last[0].stamp_ns
        and not any(is_at(estimate, one.stamp_ns - delay_ns) for estimate in last)
        for one in state.waiting
    ):
        return state  # not decided yet
    stamps = [estimate.stamp_ns for estimate in state.estimates]
    periods = [after - before for before, after in pairwise(stamps[-PERIODS - 1 :])]
    period = median(periods) if periods else 0.0
    waiting, state = state.waiting, replace(state, waiting=())
    shown = np.array([sightings.stamp_ns - delay_ns for sightings in waiting])
    matches = (part.tolist() for part in (shown, *match_stamps(shown, np.array(stamps), period)))
    for sightings, shown_ns, nearest, is_matched in zip(waiting, *matches, strict=True):
        behind = len(stamps) - bisect_left(stamps, shown_ns)
        estimate = state.estimates[nearest]
        at_reading = is_matched and is_at(estimate, shown_ns)
        if is_matched and (at_reading or behind >= NEIGHBORS):
            neighbors = slice(max(nearest - NEIGHBORS, 0), nearest + NEIGHBORS + 1)
            known = (estimate,) if at_reading else state.estimates[neighbors]
            predicted = predict_frame(estimator, known, shown_ns)
            if predicted is None:
                state = state.count_unmatched('unsteady')
                continue
            running, frame = add_frame(state.running, sightings, estimate, predicted, estimator)
            compared = (*state.compared, frame)
            state = replace(state, running=running, compared=compared, matched=state.matched + 1)
        elif behind < NEIGHBORS and (is_matched or not behind):
            state = replace(state, waiting=(*state.waiting, sightings))
        else:
            state = state.count_unmatched('no_estimate')
    return state


def is_at(estimate: ShapeEstimate, shown_ns: int) -> bool:
    """Whether a frame coincides with an estimate, so that no later reading is needed."""
    return estimate.stamp_ns == shown_ns and not estimate.wrench_age


def add_frame(
    before: RunningInnovation | None,
    sightings: TargetSightings,
    estimate: ShapeEstimate,
    predicted: PredictedTargets,
    estimator: Estimator,
) -> tuple[RunningInnovation, FrameInnovation]:
    """Add a frame to the running means, which restart after a gap of `watch_time`."""
    frame = innovation(predicted, sightings, estimator.arm.sensors)
    assert frame is not None
    stamp_ns, time = sightings.stamp_ns, estimator.settings.watch_time
    chi_square = frame.chi_square / frame.coordinates
    most = chi_square_limit(frame.coordinates)
    force_read = estimate.wrench_age is not None
    frame_innovation = FrameInnovation(
        stamp_ns=stamp_ns,
        rms=math.sqrt(chi_square),
        limit=math.sqrt(most),
        force_read=force_read,
        at_tip=frame.at_tip,
        evidence=evidence_of(sightings, estimate, predicted, beyond=chi_square > most),
    )
    beyond = float(chi_square > most)
    if before is None or seconds_between(before.stamp_ns, stamp_ns) > time:
        places = estimator.arm.target_arclength
        before = RunningInnovation(
            stamp_ns=stamp_ns, arclength=places, at_targets=np.full(places.size, math.nan)
        )
    since = seconds_between(before.stamp_ns, stamp_ns)
    weight = before.weight * math.exp(-since / time) + 1.0
    share = 1.0 / weight
    known = np.where(np.isnan(before.at_targets), frame.at_targets, before.at_targets)
    news = np.where(np.isnan(frame.at_targets), known, frame.at_targets)
    running = RunningInnovation(
        stamp_ns=stamp_ns,
        weight=weight,
        frames=before.frames + 1,
        chi_square=before.chi_square + share * (chi_square - before.chi_square),
        coordinates=before.coordinates + share * (frame.coordinates - before.coordinates),
        beyond=before.beyond + share * (beyond - before.beyond),
        at_targets=freeze(known + share * (news - known)),
        arclength=before.arclength,
        force_read=force_read,
    )
    return running, frame_innovation


def evidence_of(
    sightings: TargetSightings,
    estimate: ShapeEstimate,
    predicted: PredictedTargets,
    *,
    beyond: bool,
) -> FrameEvidence | None:
    """Return the evidence of a frame for persistent errors; None outside the domain of the model.

    beyond: whether the frame deviates by more than noise.
    """
    position = estimate.position
    if estimate.curved is None or (position is not None and any(position.error)):
        return None
    assert estimate.noise is not None
    return FrameEvidence(
        stamp_ns=sightings.stamp_ns,
        residual=np.stack([sightings.x - predicted.x, sightings.y - predicted.y]),
        std=sightings.std,
        predicted=predicted,
        tip_errors=estimate.noise @ estimate.curved.sensitivity.tip[:, :2],
        tip_covariance=estimate.tip_covariance[:2, :2],
        beyond=beyond,
    )
