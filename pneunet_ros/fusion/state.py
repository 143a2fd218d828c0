"""What a fusion remembers from one reading to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from types import MappingProxyType

from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.stamps import AHEAD, count_reason, StampGate
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.force_sensor import Verdict
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.frame_update import ColdSearch, Fit, FrameUpdate
from pneunet_ros.fusion.readings import PressureInstant, ReadFrame, SeenFrame
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
        """Whether targets have lately been further from the fused shape than noise explains."""
        return self.mean > self.limit

    @property
    def sentence(self) -> str:
        """Say it to a person."""
        return (
            'targets are further from the fused shape than noise explains (running NIS '
            f'{self.mean:.3g}, noise alone: less than {self.limit:.3g}): run pneunet diagnose'
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TakenFrame:
    """A frame as it was taken.

    before: what was believed before it; problem: of all targets that were seen; update: what came
    of it.
    """

    frame: ReadFrame
    before: Belief
    problem: FrameProblem
    update: FrameUpdate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionState:
    """All that a fusion remembers from one reading or frame to the next.

    readings: as of an estimator, which admits pressures and wrenches; pressures, wrenches: the
    last ones, for frames that come late; force_step (N): the smallest change from wrench to wrench
    so far, see `rounding_error`; force_noise (N): of its last readings, 0 where it is that of the
    model; largest_force_noise (N): with which the belief has taken a frame; waiting:
    frames whose pressure has not come yet; seen: the last one that was no copy.
    belief: at the last frame that was used, by the likelier of two hypotheses, no contact and
    contact; rival: by the other one, None where that is as good as excluded; log_odds: of a
    contact, None before the first frame; elsewhere: one at another place may be it.
    wrench_used_ns: of the wrench in it; sensor: what frames have said of the force sensor;
    doubt: by how much (chi squared) frames have lately fitted better without it; otherwise: what
    would be believed without it and without the contact, where that may be so.
    solution: of the last estimate. pressure_lost: the belief's bias stands for the whole pressure;
    pressure_off: targets say that it is not what is read.
    unweighed: the last frame, which is still to be weighed against all else that it may be;
    unchecked: its fit, beside which other forces are still to be looked for; answered: an estimate
    since then is out; search: for such forces; lost: frames in a row not used. frames: used so
    far; unused: others by reason.
    """

    readings: EstimatorState = field(default_factory=EstimatorState)
    pressures: tuple[PressureInstant, ...] = ()
    wrenches: tuple[WrenchReading, ...] = ()
    force_step: float = math.inf
    force_noise: float = 0.0
    largest_force_noise: float = 0.0
    waiting: tuple[TargetSightings, ...] = ()
    frame_stamps: StampGate = field(default_factory=StampGate)
    seen: SeenFrame | None = None
    belief: Belief | None = None
    rival: Belief | None = None
    log_odds: float | None = None
    elsewhere: bool = False
    wrench_used_ns: int | None = None
    sensor: Verdict = Verdict.OPEN
    doubt: float = 0.0
    otherwise: Belief | None = None
    solution: SolverNodes | None = None
    pressure_lost: bool = False
    pressure_off: bool = False
    unweighed: TakenFrame | None = None
    unchecked: Fit | None = None
    answered: bool = False
    search: ColdSearch = field(default_factory=ColdSearch)
    lost: int = 0
    nis: RunningNis | None = None
    estimates: int = 0
    frames: int = 0
    unused: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def target_age(self, stamp_ns: int) -> float | None:
        """Return the age (s) of the last frame that was used; None before the first."""
        if self.belief is None or not self.belief.frames:
            return None
        return seconds_between(self.belief.stamp_ns, stamp_ns)

    def fresh(self) -> FusionState:
        """Forget all readings and frames; only the counts go on."""
        return FusionState(
            readings=self.readings,
            estimates=self.estimates,
            frames=self.frames,
            unused=self.unused,
        )

    def restarted(self) -> FusionState:
        """Forget also that there were readings, and with them the history of the arm."""
        return replace(self.fresh(), readings=self.readings.fresh())

    def without_belief(self) -> FusionState:
        """Forget what frames have told, but for the verdict on the force sensor."""
        return replace(
            self,
            belief=None,
            rival=None,
            log_odds=None,
            elsewhere=False,
            doubt=0.0,
            otherwise=None,
            largest_force_noise=0.0,
        )

    def without_pressure(self) -> FusionState:
        """Forget the pressure, which is not what is read, and what frames have told beside it."""
        return replace(
            self.without_belief(),
            pressures=(),
            pressure_lost=True,
            pressure_off=True,
            sensor=Verdict.OPEN,
        )

    def compressed(self) -> FusionState:
        """Return it with square roots of what is believed, which grow with every frame."""
        belief = None if self.belief is None else compressed(self.belief)
        rival = None if self.rival is None else compressed(self.rival)
        if belief is self.belief and rival is self.rival:
            return self
        return replace(self, belief=belief, rival=rival)

    def without_frames_after(self, stamp_ns: int) -> FusionState:
        """Forget the frame whose stamp was ahead of its time, or that stamp where it was used."""
        waiting = tuple(one for one in self.waiting if one.stamp_ns <= stamp_ns)
        belief = self.belief
        if belief is not None and belief.stamp_ns > stamp_ns:
            belief = replace(belief, stamp_ns=stamp_ns)
        return replace(self, waiting=waiting, belief=belief).count_unused(AHEAD)

    def without_frames(self) -> FusionState:
        """Forget the frames; readings and counts go on."""
        return replace(
            self.fresh(),
            pressures=self.pressures,
            wrenches=self.wrenches,
            force_step=self.force_step,
            force_noise=self.force_noise,
            solution=self.solution,
            sensor=self.sensor,
            pressure_lost=self.pressure_off,
            pressure_off=self.pressure_off,
        )

    def count_unused(self, reason: str) -> FusionState:
        """Count one more frame that was not used."""
        return replace(self, unused=count_reason(self.unused, reason))

    def count_rejected(self, reason: str) -> FusionState:
        """Count one more rejected reading."""
        return replace(self, readings=self.readings.count_rejected(reason))
