"""State of a fusion between readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from types import MappingProxyType

from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.stamps import AHEAD, count_reason, StampGate
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.fusion.belief import Belief, LASTING, PRESSURE
from pneunet_ros.fusion.frame_update import ColdSearch, Fit
from pneunet_ros.fusion.hypothesis_update import HypothesisUpdate
from pneunet_ros.fusion.readings import PressureInstant, SeenFrame
from pneunet_ros.measurement.inference.bank import Hypothesis
from pneunet_ros.measurement.inference.gaussian import compressed
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningNis:
    """Running mean of the NIS per coordinate of frames, and the limit for noise.

    last: NIS of the last frame alone.
    """

    stamp_ns: int
    weight: float
    last: float
    mean: float
    limit: float

    @property
    def beyond(self) -> bool:
        """Whether targets recently deviated from the fused shape by more than noise."""
        return self.mean > self.limit

    def birge_ratio(self, most: float) -> float:
        """Return the factor by which errors exceed the stated ones; 1 if the frames fit.

        It is the root of chi squared per coordinate (Birge, Physical Review 40 (1932)), whatever
        the cause. most: limit of the NIS of used frames; an unused frame counts as this limit.
        """
        return math.sqrt(min(self.mean, most * self.limit)) if self.beyond else 1.0

    @property
    def sentence(self) -> str:
        """Warning for users: the deviation and its limit."""
        return (
            'targets deviate from the fused shape by more than noise (running NIS '
            f'{self.mean:.3g}, limit {self.limit:.3g}): run pneunet diagnose'
        )

    def followed_by(self, stamp_ns: int, nis: float, limit: float, time: float) -> RunningNis:
        """Return the mean with one more frame; older frames are forgotten exponentially."""
        since = seconds_between(self.stamp_ns, stamp_ns)
        weight = self.weight * math.exp(-since / time) + 1.0
        return RunningNis(
            stamp_ns=stamp_ns,
            weight=weight,
            last=nis,
            mean=self.mean + (nis - self.mean) / weight,
            limit=limit,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceReadings:
    """The last end wrenches, kept for late frames, and the estimated noise of the sensor.

    step (N): smallest change between successive wrenches so far, see `rounding_error`; noise (N):
    estimated from the last wrenches, 0 if the noise of the model is used; largest_noise (N): the
    largest that was used in an update by a frame.
    """

    kept: tuple[WrenchReading, ...] = ()
    step: float = math.inf
    noise: float = 0.0
    largest_noise: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PendingFrame:
    """The last frame that was used, and the work still to be done on it.

    updated: the update, not yet compared with alternative hypotheses; unchecked: its fit, if the
    search for other tip forces is still to be made; answered: whether an estimate has been
    published since.
    """

    updated: HypothesisUpdate | None = None
    unchecked: Fit | None = None
    answered: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Counts of estimates, of frames used, and of frames rejected, by reason.

    lost: consecutive frames that were not used; contradicted: whether a frame since the last used
    one contradicted every hypothesis.
    """

    estimates: int = 0
    frames: int = 0
    lost: int = 0
    contradicted: bool = False
    unused: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionState:
    """State of a fusion between readings and frames.

    readings: state of the estimator that admits pressures and wrenches; pressures: the last
    pressures, kept for late frames; force: the last wrenches; waiting: frames whose pressure has
    not arrived; seen: the last frame that is not a copy of an earlier one.
    bank: the hypotheses, most likely first, each with its belief at the last frame; lasting:
    causes that survive a reset of the belief (faulty sensors, a mirrored image). wrench_used_ns:
    stamp of the last wrench in the belief; solution of the last estimate; pending: the last
    frame; search: the search for other tip forces that fit it.
    """

    readings: EstimatorState = field(default_factory=EstimatorState)
    pressures: tuple[PressureInstant, ...] = ()
    force: ForceReadings = field(default_factory=ForceReadings)
    waiting: tuple[TargetSightings, ...] = ()
    frame_stamps: StampGate = field(default_factory=StampGate)
    seen: SeenFrame | None = None
    bank: tuple[Hypothesis[Belief], ...] = ()
    lasting: frozenset[str] = frozenset()
    wrench_used_ns: int | None = None
    solution: SolverNodes | None = None
    pending: PendingFrame | None = None
    search: ColdSearch = field(default_factory=ColdSearch)
    nis: RunningNis | None = None
    counts: Counts = field(default_factory=Counts)

    @property
    def belief(self) -> Belief | None:
        """The belief of the most likely hypothesis; None before the first frame."""
        return self.bank[0].belief if self.bank else None

    @property
    def causes(self) -> frozenset[str]:
        """Active causes of the most likely hypothesis."""
        return self.bank[0].belief.causes if self.bank else self.lasting

    @property
    def certain_causes(self) -> frozenset[str]:
        """Causes that all likely hypotheses share; the lasting ones if none is likely."""
        likely = [one.belief.causes for one in self.bank if one.is_about_as_likely]
        return frozenset.intersection(*likely) if likely else self.lasting

    @property
    def frame_delay(self) -> float | None:
        """Delay (s) of the last frame behind its stamp, by the pressure; None if it is none."""
        if self.belief is None or not self.belief.delay_ns:
            return None
        return self.belief.delay_ns / NANOSECONDS_PER_SECOND

    @property
    def unpressed(self) -> bool:
        """Whether the last frame was taken without a pressure reading."""
        belief = self.belief
        return PRESSURE in self.causes or (belief is not None and belief.unpressed)

    def target_age(self, stamp_ns: int) -> float | None:
        """Return the age (s) of the last frame that was used; None before the first."""
        if self.belief is None or not self.belief.frames:
            return None
        return seconds_between(self.belief.stamp_ns, stamp_ns)

    def fresh(self) -> FusionState:
        """Forget all readings and frames, but keep the counts."""
        return FusionState(
            readings=self.readings, counts=replace(self.counts, lost=0, contradicted=False)
        )

    def restarted(self) -> FusionState:
        """Forget all readings, including the history of the arm."""
        return replace(self.fresh(), readings=self.readings.fresh())

    def without_frames(self) -> FusionState:
        """Forget the frames, but keep readings, faulty sensors and counts."""
        return replace(
            self.fresh(),
            pressures=self.pressures,
            force=self.force,
            solution=self.solution,
            lasting=self.lasting,
        )

    def without_frames_after(self, stamp_ns: int, shown_ns: int) -> FusionState:
        """Forget a frame stamped ahead of its time, or its stamp if it was used.

        stamp_ns, shown_ns: of the frame that shows this, and when it was taken.
        """
        waiting = tuple(one for one in self.waiting if one.stamp_ns <= stamp_ns)
        bank = tuple(
            replace(one, belief=replace(one.belief, stamp_ns=min(one.belief.stamp_ns, shown_ns)))
            for one in self.bank
        )
        return replace(self, waiting=waiting, bank=bank).count_unused(AHEAD)

    def with_bank(self, bank: tuple[Hypothesis[Belief], ...]) -> FusionState:
        """Return the state with these hypotheses; drops the pressures of a faulty sensor."""
        lasting = bank[0].belief.causes & LASTING
        pressures = () if PRESSURE in lasting else self.pressures
        return replace(self, bank=bank, lasting=lasting, pressures=pressures)

    def compressed(self) -> FusionState:
        """Return the state with compact square roots of the beliefs (they grow every frame)."""
        bank = tuple(replace(one, belief=compressed(one.belief)) for one in self.bank)
        return replace(self, bank=bank)

    def answered(self) -> FusionState:
        """Return the state after publication, when pending work can be done."""
        if self.pending is None:
            return self
        return replace(self, pending=replace(self.pending, answered=True))

    def count_estimate(self) -> FusionState:
        """Count one more estimate."""
        return replace(self, counts=replace(self.counts, estimates=self.counts.estimates + 1))

    def count_unused(self, reason: str, *, lost: int = 0) -> FusionState:
        """Count one more frame that was not used; lost: 1 if no hypothesis fits it, else 0."""
        counts = self.counts
        unused = count_reason(counts.unused, reason)
        counts = replace(
            counts,
            unused=unused,
            lost=counts.lost + lost,
            contradicted=counts.contradicted or reason == 'inconsistent',
        )
        return replace(self, counts=counts)

    def count_frame(self) -> FusionState:
        """Count one more frame that was used."""
        counts = replace(self.counts, frames=self.counts.frames + 1, lost=0, contradicted=False)
        return replace(self, counts=counts)

    def count_rejected(self, reason: str) -> FusionState:
        """Count one more rejected reading."""
        return replace(self, readings=self.readings.count_rejected(reason))
