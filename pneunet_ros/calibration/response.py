"""What the model says of a recording: where the targets are in every frame, and how that answers.

The answer is taken for every column of the record of the rod (loads, knots of the curvature's
table, rigidities, split, ...); the answer to a parameter is the chain rule over them. The solver
is the same as live; frames start from their own last solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.arm import Arm, EXTRAPOLATION
from pneunet_ros.attempt import (
    Attempt,
    DECAY_PER_PANEL,
    FINEST_DETAIL,
    MOST_PANELS,
    TURN_PER_PANEL,
)
from pneunet_ros.effects.effect import Load
from pneunet_ros.rod import Rods
from pneunet_ros.run import Run
from pneunet_ros.shape import Array
from pneunet_ros.solver import collocation
from pneunet_ros.solver.series import answers, follow
from pneunet_ros.units import seconds_between
from scipy.interpolate import CubicSpline

Columns = npt.NDArray[np.int64]  # (k, 2): section and column of its record

X, Y, THETA, CURVATURE, INTRINSIC_CURVATURE, MOMENT = range(6)  # fields at stations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """What really acted on the arm at the frames of a run, by its sensing and its history.

    pressure (frames,) Pa in the chamber; loads (frames, 3): F1, F2 (N), M (N m).
    """

    pressure: Array
    loads: Array

    def at(self, frames: npt.NDArray[np.int64]) -> Drive:
        """Return the same for some of the frames."""
        return Drive(pressure=self.pressure[frames], loads=self.loads[frames])


def drive_of(arm: Arm, run: Run) -> Drive:
    """Return what acted at the frames: sensing effects, then history over all readings."""
    pressures = run.frame_pressure
    loads = np.column_stack([run.force, run.moment])
    if not arm.sensing and not arm.acting:
        return Drive(pressure=pressures, loads=loads)
    true = [
        arm.sense(Load(pressure=p, force_x=f1, force_y=f2, moment=m))
        for p, (f1, f2, m) in zip(pressures.tolist(), loads.tolist(), strict=True)
    ]
    loads = np.array([[load.force_x, load.force_y, load.moment] for load in true])
    chamber = np.empty(len(run.pressure))
    history, before = None, 0
    for place, (stamp, pressure) in enumerate(
        zip(run.reading_stamp_ns.tolist(), run.pressure.tolist(), strict=True)
    ):
        sensed = arm.sense(Load(pressure=pressure)).pressure
        if history is None:
            history, before = arm.initial_history(sensed), stamp
        history, chamber[place] = arm.actuate(history, seconds_between(before, stamp), sensed)
        before = stamp
    return Drive(pressure=chamber[run.reading], loads=loads)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Linear answer of the shapes at stations to the columns of the record.

    values (frames, causes, 6, stations); causes: F1, F2, M, knots of the curvature, then the
    `columns` (k, 2) of sections.
    """

    values: Array
    columns: Columns
    knots: int


class Series:
    """The shapes of an arm in the frames of a run, kept as starts for the next, changed arm."""

    __slots__ = ('arclength', 'counts', 'detail', 'fields', 'known', 'nodes', 'solved')

    def __init__(self, arclength: Array) -> None:
        self.arclength = arclength
        self.counts = np.zeros(0, dtype=np.int64)

    def solve(self, arm: Arm, pressure: Array, loads: Array) -> npt.NDArray[np.bool_]:
        """Solve all frames; `fields` (frames, 6, stations) is filled. Return which have a shape."""
        rods = arm.rods(pressure)
        counts = mesh_counts(rods, loads)
        if self.counts.size != counts.size or np.any(counts > self.counts):
            self.start_anew(counts, len(pressure))
        while True:
            self.sweep(arm, rods, loads)
            if not np.any(self.detail[self.solved] > FINEST_DETAIL * arm.length):
                return self.solved
            if 2 * int(self.counts.sum()) > MOST_PANELS:
                self.solved &= self.detail <= FINEST_DETAIL * arm.length
                return self.solved
            self.start_anew(2 * self.counts, len(pressure))

    def start_anew(self, counts: npt.NDArray[np.int64], frames: int) -> None:
        """Take another mesh."""
        self.counts = counts
        self.nodes = np.zeros((frames, int(counts.sum()) + 1, collocation.NODE_WIDTH))
        self.known = np.zeros(frames, dtype=np.bool_)
        self.fields = np.empty((frames, 6, self.arclength.size))
        self.detail = np.zeros(frames)

    def sweep(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve the frames one after the other; one that Newton's method misses is solved cold."""
        frames = len(loads)
        beyond = np.array([arm.beyond_range(value) for value in rods.pressure.tolist()])
        self.solved = beyond <= EXTRAPOLATION
        first = 0
        while first < frames:
            first = follow(
                rods.length,
                rods.sections,
                rods.clamp,
                rods.knots,
                rods.turning,
                loads,
                self.counts,
                self.known,
                collocation.TOLERANCE,
                first,
                self.nodes,
                self.arclength,
                self.fields,
                self.detail,
            )
            if first == frames:
                return
            attempt = Attempt(
                rods.one(first),
                (float(loads[first, 0]), float(loads[first, 1])),
                float(loads[first, 2]),
                collocation.TOLERANCE,
            )
            attempt.mesh(self.counts)
            if attempt.cold():
                self.nodes[first] = attempt.nodes
                self.known[first] = True
                continue
            self.solved[first] = False
            self.fields[first] = np.nan
            self.detail[first] = 0.0
            self.known[first] = False
            if first + 1 < frames and not self.known[first + 1]:
                collocation.unloaded_nodes(attempt.panels, attempt.ends, self.nodes[first])
            first += 1

    def answer(self, arm: Arm, pressure: Array, loads: Array, columns: Columns) -> Answer:
        """Return the linear answer of the solved frames to these columns of sections."""
        rods = arm.rods(pressure)
        unit = knot_turning(arm)
        size = np.abs(rods.sections[:, columns[:, 0], columns[:, 1]]).mean(axis=0)
        steps = 1e-4 * np.where(size > 0.0, size, 1.0)
        causes = 3 + unit.shape[0] + len(columns)
        out = np.empty((len(loads), causes, 6, self.arclength.size))
        answers(
            rods.length,
            rods.sections,
            rods.clamp,
            rods.knots,
            rods.turning,
            loads,
            self.counts,
            self.nodes,
            unit,
            columns,
            steps,
            np.zeros(0, dtype=np.int64),
            self.arclength,
            out,
        )
        return Answer(values=out, columns=columns, knots=unit.shape[0])


def mesh_counts(rods: Rods, loads: Array) -> npt.NDArray[np.int64]:
    """Return the panels per section that every one of the rods needs."""
    ends = np.column_stack([rods.clamp, loads])
    return np.max(
        [
            collocation.panel_counts(
                rods.length,
                rods.sections[rod],
                rods.turning[rod],
                ends[rod],
                DECAY_PER_PANEL,
                TURN_PER_PANEL,
                MOST_PANELS,
            )
            for rod in range(len(loads))
        ],
        axis=0,
    )


def knot_turning(arm: Arm) -> Array:
    """Return the turning (knots, pieces, 5) of a curvature of 1/m at one knot and 0 at others."""
    shares = arm.intrinsic_curvature.arclength
    spline = CubicSpline(shares, np.eye(shares.size), axis=1)
    powers = np.moveaxis(spline.antiderivative().c[::-1], (0, 1, 2), (2, 1, 0))
    return np.ascontiguousarray(powers * arm.length ** (1.0 - np.arange(5.0)))
