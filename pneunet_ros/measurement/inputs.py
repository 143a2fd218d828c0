"""Inputs of the arm in the frames of recordings: readings, sensing effects and history."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array, pressure_rows
from pneunet_ros.core.units import seconds_since
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.rod import Rods


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """True inputs of the arm at the frames of a run.

    pressure (frames,) Pa in the chamber; loads (frames, 3): F1, F2 (N), M (N m); histories: per
    active effect one row per frame; None if no effect has a history. gravity (frames, 2): along x
    and y, in g; None: as in the model.
    """

    pressure: Array
    loads: Array
    histories: tuple[Array, ...] | None = None
    gravity: Array | None = None

    def __post_init__(self) -> None:
        """Make the loads read-only; kernels would be recompiled for writable arrays."""
        object.__setattr__(self, 'loads', frozen_array(self.loads))

    def subset(self, frames: npt.NDArray[np.int64]) -> Inputs:
        """Return the inputs of a subset of the frames."""
        histories = self.histories
        return Inputs(
            pressure=self.pressure[frames],
            loads=self.loads[frames],
            histories=None if histories is None else tuple(one[frames] for one in histories),
            gravity=None if self.gravity is None else self.gravity[frames],
        )

    def rods(self, arm: Arm) -> Rods:
        """Return the rod record of an arm in every frame."""
        return arm.rods(self.pressure, self.histories, self.loads, self.gravity)

    def with_loads(self, loads: Array) -> Inputs:
        """Return the inputs with other loads."""
        return replace(self, loads=loads)

    def row_weights(self, arm: Arm) -> Array:
        """Return the weights of the rows of the kappa_p0 table in every frame, (frames, rows)."""
        rows, frames = arm.intrinsic_curvature.pressure, np.arange(self.pressure.size)
        row, above = pressure_rows(rows, self.pressure)
        weights = np.zeros((self.pressure.size, rows.size))
        weights[frames, row] = 1.0 - above
        weights[frames, row + 1] = above
        for terms in arm.terms(self.pressure, self.histories, self.loads):
            if terms.row_weights is not None:
                weights = terms.mix_rows(weights, terms.row_weights)
        return weights


def inputs_of(arm: Arm, runs: Sequence[RecordingData]) -> tuple[Inputs, ...]:
    """Return the inputs of each run; the history carries over from run to run by stamps.

    The arm is assumed to have settled at the first pressure before the first run, and to be
    unchanged between runs. Static frames have no history: each is an independent equilibrium.
    """
    return inputs_at_instants(arm, [run.at_instants(arm.frame_delay) for run in runs])


def runs_in_order(runs: Sequence[RecordingData]) -> Iterator[tuple[int, bool]]:
    """Yield the index of each run in time (not the static ones) and whether its history goes on.

    The history starts anew, with a settled arm, in a run that begins before all earlier runs have
    ended, such as a table whose time starts at zero.
    """
    ends = {
        which: tuple(run.reading_stamp_ns[[0, -1]].tolist())
        for which, run in enumerate(runs)
        if not run.static
    }
    started_ns = ended_ns = 0
    for which, (first_ns, last_ns) in sorted(ends.items(), key=lambda item: item[1]):
        yield which, first_ns >= ended_ns and first_ns != started_ns
        started_ns, ended_ns = first_ns, max(ended_ns, last_ns)


def inputs_at_instants(arm: Arm, runs: Sequence[RecordingData]) -> tuple[Inputs, ...]:
    """Return `inputs_of` for runs with a reading at the instant of each frame."""
    if not arm.acting:
        return tuple(steady_inputs(arm, run) for run in runs)
    all_inputs = {which: equilibria(arm, run) for which, run in enumerate(runs) if run.static}
    history: tuple[History, ...] | None = None
    previous_ns = 0
    for which, goes_on in runs_in_order(runs):
        run, history = runs[which], history if goes_on else None
        chamber, histories = np.empty(len(run.pressure)), []
        for index, (stamp, pressure) in enumerate(
            zip(run.reading_stamp_ns.tolist(), run.pressure.tolist(), strict=True)
        ):
            sensed = arm.sense(Load(pressure=pressure)).pressure
            if history is None:
                history, previous_ns = arm.initial_history(sensed), stamp
            seconds = max(seconds_since(previous_ns, stamp), 0.0)
            history, chamber[index] = arm.actuate(history, seconds, sensed)
            histories.append(history)
            previous_ns = stamp
        steady = steady_inputs(arm, run)
        all_inputs[which] = Inputs(
            pressure=chamber[run.reading],
            loads=steady.loads,
            histories=tuple(
                np.array([histories[reading][index] for reading in run.reading.tolist()])
                for index in range(len(arm.acting))
            ),
            gravity=steady.gravity,
        )
    return tuple(all_inputs[which] for which in range(len(runs)))


def equilibria(arm: Arm, run: RecordingData) -> Inputs:
    """Return the inputs of every frame in a run of steady states."""
    steady = steady_inputs(arm, run)
    settled = []
    for pressure in steady.pressure.tolist():
        settled.append(arm.actuate(arm.initial_history(pressure), 0.0, pressure))
    return replace(
        steady,
        pressure=np.array([chamber for _, chamber in settled]),
        histories=tuple(
            np.array([history[index] for history, _ in settled])
            for index in range(len(arm.acting))
        ),
    )


def steady_inputs(arm: Arm, run: RecordingData) -> Inputs:
    """Return the inputs from readings and known loads alone, without history."""
    loads = run.load
    if not arm.sensing:
        return Inputs(pressure=run.frame_pressure, loads=loads, gravity=run.gravity)
    true = [
        arm.sense(Load(pressure=p, force_x=f1, force_y=f2, moment=m))
        for p, (f1, f2, m) in zip(run.frame_pressure.tolist(), loads.tolist(), strict=True)
    ]
    return Inputs(
        pressure=np.array([load.pressure for load in true]),
        loads=loads
        if run.load_known
        else np.array([[load.force_x, load.force_y, load.moment] for load in true]),
        gravity=run.gravity,
    )
