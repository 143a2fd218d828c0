"""State of an estimator between readings, and admission of readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from types import MappingProxyType

from pneunet_ros.core.arrays import LARGEST
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.readings import PressureReading, Reading, WrenchReading
from pneunet_ros.core.stamps import AHEAD, BACKWARD_JUMP, count_reason, RESTARTED, stamp_fault
from pneunet_ros.core.units import seconds_between
from pneunet_ros.effects.effect import History
from pneunet_ros.estimation.base_gravity import BaseGravity
from pneunet_ros.estimation.pressure_watch import PressureWatch
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.moving_arm import MovingState
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.solution import SolverNodes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatorState:
    """State of an estimator between readings.

    history_ns: stamp of the last pressure reading in the history, excluding impossible readings;
    earlier: the end wrench before the last one; moving: motion of the arm, if the model has
    `motion`; passed: the end wrench of the last estimate of a moving arm, and all later ones;
    before: the state before a pressure reading that follows a gap of more than a second, kept
    until the next reading shows whether the stamp was right; watch: check of the declared meaning
    of pressure readings; gravity: direction of gravity.
    """

    pressure_stamp_ns: int | None = None
    history_ns: int | None = None
    wrench: WrenchReading | None = None
    earlier: WrenchReading | None = None
    history: tuple[History, ...] | None = None
    solution: SolverNodes | None = None
    moving: MovingState | None = None
    passed: tuple[WrenchReading, ...] = ()
    estimates: int = 0
    resets: int = 0
    rejected: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    before: EstimatorState | None = None
    watch: PressureWatch = field(default_factory=PressureWatch)
    gravity: BaseGravity = field(default_factory=BaseGravity)

    def with_wrench(self, wrench: WrenchReading, keep: bool = False) -> EstimatorState:
        """Return the state after an end wrench in the base frame; keep: for the motion."""
        return replace(
            self,
            wrench=wrench,
            earlier=self.wrench,
            passed=(*self.passed, wrench) if keep else self.passed,
        )

    def seconds_to(self, stamp_ns: int) -> float:
        """Return the time (s) since the last pressure in the history; 0 before the first."""
        return 0.0 if self.history_ns is None else seconds_between(self.history_ns, stamp_ns)

    def actuate(
        self, arm: Arm, stamp_ns: int, pressure: float
    ) -> tuple[tuple[History, ...], float]:
        """Return history and chamber pressure (Pa) at a stamp with this true pressure (Pa)."""
        history = self.history
        if history is None:
            history = arm.initial_history(pressure)
        return arm.actuate(history, self.seconds_to(stamp_ns), pressure)

    def with_reading(self, stamp_ns: int, history: tuple[History, ...]) -> EstimatorState:
        """Return the state after a pressure reading without an estimate."""
        return replace(
            self, pressure_stamp_ns=stamp_ns, history_ns=stamp_ns, history=history, solution=None
        )

    def watch_pressure(
        self, reading: PressureReading, arm: Arm, settings: EstimatorSettings
    ) -> EstimatorState:
        """Return the state after checking unit, reference and sign of a pressure reading."""
        return replace(self, watch=self.watch.after(reading, arm, settings))

    def with_impossible(self, stamp_ns: int) -> EstimatorState:
        """Count an impossible pressure reading, which is otherwise ignored."""
        return replace(self, pressure_stamp_ns=stamp_ns, solution=None)

    def with_estimate(
        self,
        stamp_ns: int,
        history: tuple[History, ...],
        solution: SolverNodes,
        moving: MovingState | None = None,
    ) -> EstimatorState:
        """Return the state after an estimate; the next estimate follows its branch."""
        return replace(
            self,
            pressure_stamp_ns=stamp_ns,
            history_ns=stamp_ns,
            history=history,
            solution=solution,
            moving=moving,
            passed=() if moving is None or self.wrench is None else (self.wrench,),
            estimates=self.estimates + 1,
        )

    def fresh(self) -> EstimatorState:
        """Discard all readings; counters are kept."""
        return EstimatorState(
            estimates=self.estimates,
            resets=self.resets + 1,
            rejected=self.rejected,
            gravity=self.gravity.fresh(),
        )

    def count_rejected(self, reason: str) -> EstimatorState:
        """Count one more rejected reading."""
        return replace(self, rejected=count_reason(self.rejected, reason))


def admit(state: EstimatorState, reading: Reading) -> tuple[EstimatorState, Refusal | None, str]:
    """Whether a reading is admissible: finite, stamped, and later than the last one of its kind.

    A stamp that jumps back by more than a second (a looping bag, a restarted simulation) causes a
    restart, unless it only shows that the previous stamp was wrong; the third value distinguishes
    the two.
    """
    what = 'pressure' if isinstance(reading, PressureReading) else 'end wrench'
    last = state.pressure_stamp_ns
    if isinstance(reading, WrenchReading):
        last = None if state.wrench is None else state.wrench.stamp_ns
        off_plane = reading.force_z, reading.moment_x, reading.moment_y  # NaN: not measured
        known = (part for part in off_plane if not math.isnan(part))
        values: tuple[float, ...] = (reading.force_x, reading.force_y, reading.moment, *known)
    else:
        values = (reading.pressure, reading.variance)
    stamp_ns = reading.stamp_ns
    if not all(abs(value) <= LARGEST for value in values):
        sentence = f'{what} reading contains NaN, infinity or a number beyond {LARGEST:g}'
        reason = 'not_finite'
    else:
        reason, sentence = stamp_fault(f'{what} reading', last, stamp_ns)
    if reason == RESTARTED:
        resumed = resume(state, reading)
        if resumed is None:
            return state.fresh(), None, sentence
        return resumed, None, f'a {what} reading with a stamp in the future was dropped'
    if reason:
        refusal = drop(stamp_ns, reason, sentence)
        return state, refusal, ''
    if isinstance(reading, PressureReading):
        gap = last is not None and seconds_between(last, stamp_ns) > BACKWARD_JUMP
        if gap or state.before is not None:
            state = replace(state, before=replace(state, before=None) if gap else None)
    return state, None, ''


def resume(state: EstimatorState, reading: Reading) -> EstimatorState | None:
    """Remove the last reading of a kind if this one shows that its stamp was wrong.

    None if time itself has jumped back. The stamp was wrong if a pressure follows the reading
    before the last, or if a wrench is nearer to the pressure than the last wrench.
    """
    before, stamp_ns = state.before, reading.stamp_ns
    if isinstance(reading, WrenchReading):
        pressure_ns = (before or state).pressure_stamp_ns
        assert state.wrench is not None
        if pressure_ns is None or (
            abs(stamp_ns - pressure_ns) >= abs(state.wrench.stamp_ns - pressure_ns)
        ):
            return None
        return state.count_rejected(AHEAD)
    if before is None or before.pressure_stamp_ns is None or stamp_ns <= before.pressure_stamp_ns:
        return None
    return replace(
        state,
        pressure_stamp_ns=before.pressure_stamp_ns,
        history_ns=before.history_ns,
        history=before.history,
        solution=before.solution,
        moving=before.moving,
        passed=before.passed,
        before=None,
    ).count_rejected(AHEAD)
