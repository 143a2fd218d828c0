"""What the model says of a recording: where the targets are in every frame, and its Jacobian.

The Jacobian is by every input of the rod (loads, knots of the curvature's table, rigidities,
split, ...); that by a parameter is the chain rule over them. The solver is the same as live;
frames start from their own last solution.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem, panels_needed
from pneunet_ros.solver.collocation import unloaded_nodes
from pneunet_ros.solver.columns import (
    CURVATURE as CURVATURE,
)
from pneunet_ros.solver.columns import (
    INTRINSIC_CURVATURE as INTRINSIC_CURVATURE,
)
from pneunet_ros.solver.columns import (
    LOADS,
    NODE_WIDTH,
    RIGIDITY,
    ROTATION_WIDTH,
)
from pneunet_ros.solver.columns import (
    MOMENT as MOMENT,
)
from pneunet_ros.solver.columns import (
    THETA as THETA,
)
from pneunet_ros.solver.columns import (
    X as X,
)
from pneunet_ros.solver.columns import (
    Y as Y,
)
from pneunet_ros.solver.frame_series import FrameSolutions, linearize_frames, solve_frames
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import SOLVER
from scipy.interpolate import CubicSpline

Columns = npt.NDArray[np.int64]  # (k, 2): section and column of its record


class ForwardModel:
    """The shapes of an arm in the frames of a run, kept as starts for the next, changed arm."""

    __slots__ = (
        'arclength',
        'counts',
        'detail',
        'fields',
        'known',
        'nodes',
        'points',
        'solved',
        'stable',
    )

    def __init__(self, arclength: Array) -> None:
        self.arclength = arclength
        self.counts = np.zeros(0, dtype=np.int64)

    def solve(self, arm: Arm, inputs: Inputs) -> npt.NDArray[np.bool_]:
        """Solve all frames; return which have a shape.

        Fills `fields` (frames, 6, stations) and `points` (frames, 2, stations), where the stations
        are measured by a camera of which only the effects of the arm are known.
        """
        rods = arm.rods(inputs.pressure, inputs.histories)
        counts = mesh_counts(rods, inputs.loads)
        if self.counts.size != counts.size or np.any(counts > self.counts):
            self.remesh(counts, len(inputs.pressure))
        self.solve_on_mesh(arm, rods, inputs.loads)
        self.points = np.stack(arm.see(self.fields[:, X], self.fields[:, Y]), axis=1)
        return self.solved

    def solve_on_mesh(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve on a mesh that carries the solutions; what is too fine for any is not solved."""
        while True:
            self.solve_frames(arm, rods, loads)
            if not np.any(self.detail[self.solved] > SOLVER.finest_detail * arm.length):
                return
            if 2 * int(self.counts.sum()) > SOLVER.most_panels:
                self.solved &= self.detail <= SOLVER.finest_detail * arm.length
                return
            self.remesh(2 * self.counts, len(loads))

    def remesh(self, counts: npt.NDArray[np.int64], frames: int) -> None:
        """Take another mesh."""
        self.counts = counts
        self.nodes = np.zeros((frames, int(counts.sum()) + 1, NODE_WIDTH))
        self.known = np.zeros(frames, dtype=np.bool_)
        self.fields = np.empty((frames, 6, self.arclength.size))
        self.detail = np.zeros(frames)
        self.stable = np.zeros(frames, dtype=np.bool_)

    def solve_frames(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve the frames one after the other; one that Newton's method misses is solved cold."""
        frames = len(loads)
        beyond = np.array([arm.beyond_range(value) for value in rods.pressure.tolist()])
        self.solved = beyond <= EXTRAPOLATION
        first = 0
        while first < frames:
            first = solve_frames(
                rods, loads, self.solutions(), first, SOLVER.frame_iterations, SOLVER.tolerance
            )
            if first == frames:
                return
            attempt = BoundaryValueProblem(
                rods.record(first),
                (float(loads[first, 0]), float(loads[first, 1])),
                float(loads[first, 2]),
            )
            attempt.mesh(self.counts)
            if attempt.solve_cold():
                self.nodes[first] = attempt.nodes
                self.known[first] = True
                continue
            self.solved[first] = False
            self.fields[first] = np.nan
            self.detail[first] = 0.0
            self.known[first] = False
            if first + 1 < frames and not self.known[first + 1]:
                unloaded_nodes(attempt.panels, attempt.ends, self.nodes[first])
            first += 1

    def solutions(self) -> FrameSolutions:
        """Return what the kernels fill."""
        return FrameSolutions(
            counts=self.counts,
            arclength=self.arclength,
            nodes=self.nodes,
            known=self.known,
            fields=self.fields,
            detail=self.detail,
            stable=self.stable,
        )

    def subset(self, frames: npt.NDArray[np.int64]) -> ForwardModel:
        """Return the forward model of a subset of the frames, with their solutions."""
        part = ForwardModel(self.arclength)
        part.remesh(self.counts, frames.size)
        part.nodes[:], part.known[:] = self.nodes[frames], self.known[frames]
        return part

    def load_jacobian(self, arm: Arm, inputs: Inputs) -> Array:
        """Return how points move per F1, F2 and M, (frames, 2 stations, 3)."""
        none = np.zeros((0, 2), dtype=np.int64)
        return as_points(self.rod_jacobian(arm, inputs, none, knot_rotation(arm)[:0]))

    def point_jacobian(self, arm: Arm, inputs: Inputs, columns: Columns) -> Array:
        """Return how points move per input of `jacobian`, (frames, 2 stations, inputs)."""
        return as_points(self.jacobian(arm, inputs, columns))

    def jacobian(self, arm: Arm, inputs: Inputs, columns: Columns) -> Array:
        """Return how fields of the solved frames move per input, (frames, inputs, 6, stations).

        x and y as measured; inputs: F1, F2, M, the knots of the curvature's table, then these
        columns of sections.
        """
        return self.rod_jacobian(arm, inputs, columns, knot_rotation(arm))

    def rod_jacobian(self, arm: Arm, inputs: Inputs, columns: Columns, rotation: Array) -> Array:
        """Return `jacobian` with knots of this rotation (knots, pieces, 5)."""
        rods, loads = arm.rods(inputs.pressure, inputs.histories), inputs.loads
        size = np.abs(rods.sections[:, columns[:, 0], columns[:, 1]]).mean(axis=0)
        steps = 1e-4 * np.where(size > 0.0, size, 1.0)
        moved_inputs = LOADS + rotation.shape[0] + len(columns)
        out = np.empty((len(loads), moved_inputs, 6, self.arclength.size))
        linearize_frames(rods, loads, self.solutions(), rotation, columns, steps, out)
        # Stability is defined for positive rigidity alone.
        self.stable |= np.any(rods.sections[:, :, RIGIDITY] < 0.0, axis=1)
        out[:, :, X], out[:, :, Y] = arm.see(out[:, :, X], out[:, :, Y])  # it is linear
        return out


def as_points(jacobian: Array) -> Array:
    """Return the Jacobian of points (frames, 2 stations, inputs) of that of all fields."""
    return jacobian[:, :, :2].reshape(*jacobian.shape[:2], -1).transpose(0, 2, 1)


def mesh_counts(rods: Rods, loads: Array) -> npt.NDArray[np.int64]:
    """Return the panels per section that every one of the rods needs."""
    ends = np.column_stack([rods.clamp, loads])
    counts: npt.NDArray[np.int64] = np.max(
        [panels_needed(rods.record(rod), ends[rod]) for rod in range(len(loads))], axis=0
    )
    return counts


def knot_rotation(arm: Arm) -> Array:
    """Return the rotation (knots, pieces, 5) of a curvature of 1/m at one knot and 0 at others."""
    shares = arm.intrinsic_curvature.arclength
    spline = CubicSpline(shares, np.eye(shares.size), axis=1)
    powers = np.moveaxis(spline.antiderivative().c[::-1], (0, 1, 2), (2, 1, 0))
    powers = powers * arm.length ** (1.0 - np.arange(float(ROTATION_WIDTH)))
    return np.ascontiguousarray(arm.with_cap(powers))
