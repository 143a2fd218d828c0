"""State of a fusion between readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from types import MappingProxyType

from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.stamps import AHEAD, count_reason, StampGate
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.fusion.belief import Belief, LASTING, PRESSURE
from pneunet_ros.fusion.frame_update import ColdSearch, Fit
from pneunet_ros.fusion.readings import PressureInstant, SeenFrame
from pneunet_ros.fusion.taken_frame import TakenFrame
from pneunet_ros.measurement.inference.bank import Hypothesis
from pneunet_ros.measurement.inference.gaussian import compressed
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningNis:
    """Mean NIS per coordinate of the frames of the last while, and what noise rarely exceeds.

    last: that of the last frame alone.
    """

    stamp_ns: int
    weight: float
    last: float
    mean: float
    limit: float

    @property
    def beyond(self) -> bool:
        """Whether targets have recently been further from the fused shape than noise explains."""
        return self.mean > self.limit

    def birge_ratio(self, most: float) -> float:
        """Return by how much all errors are larger than stated, 1 where noise explains the frames.

        The root of chi squared per coordinate (Birge, Physical Review 40 (1932)), whatever the
        cause. most: limits of the NIS of a frame that is used; one that is not counts as that.
        """
        return math.sqrt(min(self.mean, most * self.limit)) if self.beyond else 1.0

    @property
    def sentence(self) -> str:
        """Warning to a user: the deviation and its limit."""
        return (
            'targets deviate from the fused shape by more than noise (running NIS '
            f'{self.mean:.3g}, limit {self.limit:.3g}): run pneunet diagnose'
        )

    def followed_by(self, stamp_ns: int, nis: float, limit: float, time: float) -> RunningNis:
        """Return the mean with one more frame; older ones count less and less."""
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
    """The last end wrenches, for frames that come late, and what they tell of their sensor.

    step (N): the smallest change from wrench to wrench so far, see `rounding_error`; noise (N): of
    the last ones, 0 where it is that of the model; largest_noise (N): with which the belief has
    taken a frame.
    """

    kept: tuple[WrenchReading, ...] = ()
    step: float = math.inf
    noise: float = 0.0
    largest_noise: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PendingFrame:
    """The last frame that was used, and what of it is still to be looked at.

    taken: to be weighed against all else that it may be; unchecked: its fit, beside which other
    forces are to be looked for; answered: an estimate since then is out.
    """

    taken: TakenFrame | None = None
    unchecked: Fit | None = None
    answered: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Estimates so far, frames used, others by reason; lost: frames in a row that were not.

    contradicted: a frame since the last one used shows the arm where no hypothesis has it.
    """

    estimates: int = 0
    frames: int = 0
    lost: int = 0
    contradicted: bool = False
    unused: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionState:
    """All that a fusion remembers from one reading or frame to the next.

    readings: as of an estimator, which admits pressures and wrenches; pressures: the last ones,
    for frames that come late; force: the last wrenches. waiting: frames whose pressure has not
    come yet; seen: the last one that was no copy.
    bank: what may be true, each hypothesis with what is believed at the last frame, the most
    likely first; lasting: causes that stay when a belief is reset: sensors that are off, a
    mirror. wrench_used_ns: of the wrench in the belief; solution: of the last estimate; pending:
    the last frame; search: for other forces that explain it.
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
        """Causes that are taken to be at work."""
        return self.bank[0].belief.causes if self.bank else self.lasting

    @property
    def sure_causes(self) -> frozenset[str]:
        """Causes that all likely hypotheses share; the lasting ones if none is likely."""
        alike = [one.belief.causes for one in self.bank if one.is_alike]
        return frozenset.intersection(*alike) if alike else self.lasting

    @property
    def unpressed(self) -> bool:
        """Whether the last frame was taken without a pressure."""
        belief = self.belief
        return PRESSURE in self.causes or (belief is not None and belief.unpressed)

    def target_age(self, stamp_ns: int) -> float | None:
        """Return the age (s) of the last frame that was used; None before the first."""
        if self.belief is None or not self.belief.frames:
            return None
        return seconds_between(self.belief.stamp_ns, stamp_ns)

    def fresh(self) -> FusionState:
        """Forget all readings and frames; only the counts go on."""
        return FusionState(
            readings=self.readings, counts=replace(self.counts, lost=0, contradicted=False)
        )

    def restarted(self) -> FusionState:
        """Forget also that there were readings, and with them the history of the arm."""
        return replace(self.fresh(), readings=self.readings.fresh())

    def without_frames(self) -> FusionState:
        """Forget the frames; readings, sensors that are off and counts go on."""
        return replace(
            self.fresh(),
            pressures=self.pressures,
            force=self.force,
            solution=self.solution,
            lasting=self.lasting,
        )

    def without_frames_after(self, stamp_ns: int) -> FusionState:
        """Forget the frame whose stamp was ahead of its time, or that stamp where it was used."""
        waiting = tuple(one for one in self.waiting if one.stamp_ns <= stamp_ns)
        bank = tuple(
            replace(one, belief=replace(one.belief, stamp_ns=min(one.belief.stamp_ns, stamp_ns)))
            for one in self.bank
        )
        return replace(self, waiting=waiting, bank=bank).count_unused(AHEAD)

    def with_bank(self, bank: tuple[Hypothesis[Belief], ...]) -> FusionState:
        """Return it with other hypotheses; without a pressure that is not what is read."""
        lasting = bank[0].belief.causes & LASTING
        pressures = () if PRESSURE in lasting else self.pressures
        return replace(self, bank=bank, lasting=lasting, pressures=pressures)

    def compressed(self) -> FusionState:
        """Return it with compacted square roots of the beliefs, which grow with every frame."""
        bank = tuple(replace(one, belief=compressed(one.belief)) for one in self.bank)
        return replace(self, bank=bank)

    def answered(self) -> FusionState:
        """Return it after publication: pending work can be done."""
        if self.pending is None:
            return self
        return replace(self, pending=replace(self.pending, answered=True))

    def count_estimate(self) -> FusionState:
        """Count one more estimate."""
        return replace(self, counts=replace(self.counts, estimates=self.counts.estimates + 1))

    def count_unused(self, reason: str, *, lost: int = 0) -> FusionState:
        """Count one more frame that was not used; lost: 1 where nothing explains it."""
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
