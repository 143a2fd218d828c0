"""Prediction of a recording: target positions in every frame, and the Jacobian.

The Jacobian is with respect to every input of the rod (loads, knots of the curvature table,
rigidities, split, ...); the chain rule gives that of a parameter. The solver is the same as in the
live estimator. The search in a frame starts from its last solution, or initially from the measured
shape, because a soft arm may have several equilibria under a load, and the observed equilibrium is
needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.model.intrinsic_curvature import over_meters, rotation_pieces
from pneunet_ros.model.record import section_owners
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.solver.collocation import unloaded_nodes
from pneunet_ros.solver.columns import (
    LOAD_X,
    LOAD_Y,
    LOADS,
    NODE_WIDTH,
    RIGIDITY,
    START,
    THETA,
    X,
    Y,
)
from pneunet_ros.solver.frame_series import (
    FrameSolutions,
    linearize_frames,
    most_panels,
    solve_frames,
    start_at_points,
)
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.settings import FRAME_ITERATIONS, MOST_PANELS, SOLVER, TURNED

LEAST_SHARE = 2.0**-6  # of a Newton step, before the search ends
LOAD_STEP = 1e-4  # of weight and length: difference step where effects depend on the end load
Columns = npt.NDArray[np.int64]  # (k, 2): section and column of its record


class ForwardModel:
    """Shapes of an arm in the frames of a run, reused as starting points for a changed arm.

    arclength (targets,) m of the stations; measured (frames, 2, targets) m, NaN where not seen:
    points in the base frame, from which the first search for equilibria starts; None: start from
    the unloaded shape.
    """

    __slots__ = (
        'arclength',
        'counts',
        'detail',
        'every_field',
        'heading',
        'known',
        'measured',
        'nodes',
        'points',
        'push_place',
        'solved',
        'stable',
        'stations',
    )

    def __init__(self, arclength: Array, measured: Array | None = None) -> None:
        self.arclength, self.measured = frozen_array(arclength), measured
        self.push_place = np.zeros(0)
        self.heading = np.zeros((0, 0))
        self.stations = self.arclength
        self.counts = np.zeros(0, dtype=np.int64)

    @property
    def fields(self) -> Array:
        """Fields (frames, 6, stations) at the stations, NaN where a frame has no shape."""
        if not self.push_place.size:
            return self.every_field
        return self.every_field[:, :, np.searchsorted(self.stations, self.arclength)]

    def solve(self, arm: Arm, inputs: Inputs) -> npt.NDArray[np.bool_]:
        """Solve all frames; return a mask of those with a shape.

        Fills `fields` (frames, 6, stations) and `points` (frames, 2, stations): the stations as
        measured by the camera, given the camera effects of the arm.
        """
        rods = inputs.rods(arm)
        counts = most_panels(
            rods, inputs.loads, SOLVER.decay_per_panel, SOLVER.turn_per_panel, MOST_PANELS
        )
        if not np.array_equal(rods.push_place, self.push_place):
            self.push_place = rods.push_place
            self.stations = freeze(np.union1d(self.arclength, rods.push_place))
            self.counts = counts[:0]
        if self.counts.size != counts.size or np.any(counts > self.counts):
            self.remesh(counts, len(inputs.pressure))
        if rods.push.any():
            self.solve_pushed(arm, rods, inputs.loads)
        else:
            self.solve_on_mesh(arm, rods, inputs.loads)
        fields = self.fields
        self.points = np.stack(arm.see(fields[:, X], fields[:, Y]), axis=1)
        return self.solved

    def solve_pushed(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve all frames with pushes along the normals of the deformed arm."""
        if not np.isfinite(self.heading).all():
            self.solve_on_mesh(arm, rods, loads)
            self.heading = np.nan_to_num(self.headings)
        none = np.zeros((0, 2), dtype=np.int64)
        best, turn = self.heading.copy(), np.zeros_like(self.heading)
        least, share = np.full(len(loads), np.inf), np.ones(len(loads))
        while True:
            self.solve_on_mesh(arm, rods.pointed(self.heading), loads)
            missed = np.where(self.solved[:, None], self.headings - self.heading, np.inf)
            most = np.abs(missed).max(axis=1)
            better = most < least
            best[better], least[better], share[better] = self.heading[better], most[better], 1.0
            searched = better & (most > TURNED)
            back = ~better & (least > TURNED) & (least < np.inf) & (share > LEAST_SHARE)
            if not (searched | back).any():
                break
            if searched.any():
                _, by_heading = self.linearized(rods, loads, none, rods.rotation[:0])
                implicit = self.implicit(by_heading)[searched]
                turn[searched] = np.linalg.solve(implicit, missed[searched][..., None])[..., 0]
            share[back] *= 0.5
            moved = searched | back
            self.heading[moved] = best[moved] + share[moved, None] * turn[moved]
        self.solved &= most <= TURNED
        self.every_field[~self.solved] = np.nan

    @property
    def headings(self) -> Array:
        """Return the tangent angle (frames, pushes) rad at the pushes."""
        return self.every_field[:, THETA][:, np.searchsorted(self.stations, self.push_place)]

    def solve_on_mesh(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve on a mesh that resolves the solutions, except frames that need a finer one."""
        while True:
            self.solve_frames(arm, rods, loads)
            if not np.any(self.detail[self.solved] > SOLVER.finest_detail * arm.length):
                return
            if 2 * int(self.counts.sum()) > MOST_PANELS:
                self.solved &= self.detail <= SOLVER.finest_detail * arm.length
                return
            self.remesh(2 * self.counts, len(loads))

    def remesh(self, counts: npt.NDArray[np.int64], frames: int) -> None:
        """Reallocate for a mesh with this many panels per piece, discarding all solutions."""
        self.counts = counts
        self.nodes = np.zeros((frames, int(counts.sum()) + 1, NODE_WIDTH))
        self.known = np.zeros(frames, dtype=np.bool_)
        self.every_field = np.empty((frames, 6, self.stations.size))
        self.heading = np.full((frames, self.push_place.size), np.nan)
        self.detail = np.zeros(frames)
        self.stable = np.zeros(frames, dtype=np.bool_)

    def solve_frames(self, arm: Arm, rods: Rods, loads: Array) -> None:
        """Solve the frames in order; where Newton's method fails, solve from a cold start."""
        frames = len(loads)
        beyond = np.array([arm.beyond_range(value) for value in rods.pressure.tolist()])
        self.solved = beyond <= EXTRAPOLATION
        if self.measured is not None and not self.known.any():
            start_at_points(rods, loads, self.solutions(), self.arclength, self.measured)
        first = 0
        while first < frames:
            first = solve_frames(
                rods, loads, self.solutions(), first, FRAME_ITERATIONS, SOLVER.tolerance
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
            self.every_field[first] = np.nan
            self.detail[first] = 0.0
            self.known[first] = False
            if first + 1 < frames and not self.known[first + 1]:
                unloaded_nodes(attempt.panels, attempt.ends, self.nodes[first])
            first += 1

    def start_from(self, other: ForwardModel, frames: npt.NDArray[np.int64]) -> None:
        """Start from the solutions of another model of these frames, if its mesh is the same."""
        if np.array_equal(other.counts, self.counts):
            self.nodes[frames], self.known[frames] = other.nodes, other.known
            self.heading[frames] = other.heading

    def solutions(self) -> FrameSolutions:
        """Return the arrays that the kernels start from and fill, without copying."""
        return FrameSolutions(
            counts=self.counts,
            arclength=self.stations,
            nodes=self.nodes,
            known=self.known,
            fields=self.every_field,
            detail=self.detail,
            stable=self.stable,
        )

    def subset(self, frames: npt.NDArray[np.int64]) -> ForwardModel:
        """Return the forward model of a subset of the frames, with their solutions."""
        part = ForwardModel(
            self.arclength, None if self.measured is None else self.measured[frames]
        )
        part.push_place, part.stations = self.push_place, self.stations
        part.remesh(self.counts, frames.size)
        part.nodes[:], part.known[:] = self.nodes[frames], self.known[frames]
        part.heading[:] = self.heading[frames]
        return part

    def load_jacobian(self, arm: Arm, inputs: Inputs) -> Array:
        """Return derivatives of the points by F1, F2 and M, (frames, 2 stations, 3)."""
        none = np.zeros((0, 2), dtype=np.int64)
        return as_points(self.rod_jacobian(arm, inputs, none, knot_rotation(arm)[:0]))

    def point_jacobian(self, arm: Arm, inputs: Inputs, columns: Columns) -> Array:
        """Return derivatives of points by the `jacobian` inputs, (frames, 2 stations, inputs)."""
        return as_points(self.jacobian(arm, inputs, columns))

    def jacobian(self, arm: Arm, inputs: Inputs, columns: Columns) -> Array:
        """Return derivatives of the fields by the inputs, (frames, inputs, 6, stations).

        x and y as measured; inputs: F1, F2, M, the knots of the curvature table, then these
        columns of the sections of the moment law, before effects.
        """
        return self.rod_jacobian(arm, inputs, columns, knot_rotation(arm))

    def rod_jacobian(self, arm: Arm, inputs: Inputs, columns: Columns, rotation: Array) -> Array:
        """Return `jacobian` for a given rotation (knots, pieces, 5) of the knots."""
        rods = inputs.rods(arm)
        pieces = pieces_of(arm, rods, columns)
        jacobian = self.single_jacobian(rods, inputs.loads, pieces.columns, rotation)
        jacobian = pieces.joined(jacobian, LOADS + rotation.shape[0])
        if arm.by_load:
            jacobian[:, :LOADS] = self.load_differences(arm, inputs)
        # Stability is defined for positive rigidity alone.
        self.stable |= np.any(rods.sections[:, :, RIGIDITY] < 0.0, axis=1)
        fields = self.fields[:, None]
        seen = arm.see_moves(
            fields[:, :, X], fields[:, :, Y], jacobian[:, :, X], jacobian[:, :, Y]
        )
        jacobian[:, :, X], jacobian[:, :, Y] = seen
        return jacobian

    def single_jacobian(
        self, rods: Rods, loads: Array, columns: Columns, rotation: Array
    ) -> Array:
        """Return derivatives of true fields by inputs of the records, with pushes that rotate."""
        jacobian, by_heading = self.linearized(rods, loads, columns, rotation)
        if by_heading.size:
            direct = self.at_pushes(jacobian)
            turns = np.linalg.solve(self.implicit(by_heading), direct.transpose(0, 2, 1))
            jacobian = jacobian + np.einsum('npi,npfk->nifk', turns, by_heading)
        return np.asarray(jacobian[..., np.searchsorted(self.stations, self.arclength)])

    def linearized(
        self, rods: Rods, loads: Array, columns: Columns, rotation: Array
    ) -> tuple[Array, Array]:
        """Return derivatives of true fields at the stations, with the headings of pushes fixed.

        The second array (frames, pushes, 6, stations) is by these headings.
        """
        pushed = np.flatnonzero(rods.push.any(axis=(0, 1)))
        push_columns = [
            [section, column] for column in (LOAD_X, LOAD_Y) for section in pushed.tolist()
        ]
        every = np.concatenate([columns, np.array(push_columns, dtype=np.int64).reshape(-1, 2)])
        pointed = rods.pointed(self.heading) if pushed.size else rods
        size = np.abs(pointed.sections[:, every[:, 0], every[:, 1]]).mean(axis=0)
        steps = 1e-4 * np.where(size > 0.0, size, 1.0)
        inputs = LOADS + rotation.shape[0] + len(columns)
        jacobian = np.empty((len(loads), inputs + len(push_columns), 6, self.stations.size))
        linearize_frames(pointed, loads, self.solutions(), rotation, every, steps, jacobian)
        if not pushed.size:
            return jacobian, jacobian[:, :0]
        # Per heading: the line loads of its push turn, (frames, pushes, 2 pushed sections).
        turning = np.concatenate(
            [
                -np.cos(self.heading)[:, :, None] * rods.push[:, :, pushed],
                -np.sin(self.heading)[:, :, None] * rods.push[:, :, pushed],
            ],
            axis=2,
        )
        return jacobian[:, :inputs], np.einsum('nps,nsfk->npfk', turning, jacobian[:, inputs:])

    def at_pushes(self, jacobian: Array) -> Array:
        """Return the derivatives (frames, inputs, pushes) of the headings at the pushes."""
        places = np.searchsorted(self.stations, self.push_place)
        return np.asarray(jacobian[:, :, THETA][:, :, places])

    def implicit(self, by_heading: Array) -> Array:
        """Return the matrices (frames, pushes, pushes) of the implicit equation for the headings.

        Each is the transposed derivative of a heading minus the heading that it causes.
        """
        turned = np.eye(self.push_place.size) - self.at_pushes(by_heading)
        return turned.transpose(0, 2, 1)

    def difference(self, arm: Arm, low: Inputs, high: Inputs) -> Array:
        """Return the displacement of the points and the last heading, (frames, 2 stations + 1).

        Displacement between the shapes at two inputs, both near those of the solutions; NaN if
        either has no shape.
        """
        sides = []
        for inputs in (low, high):
            stepped = self.subset(np.arange(len(inputs.loads)))
            solved = stepped.solve(arm, inputs)
            points = stepped.points.reshape(len(solved), -1)
            side = np.column_stack([points, stepped.fields[:, THETA, -1]])
            sides.append(np.where(solved[:, None], side, np.nan))
        return sides[1] - sides[0]

    def load_differences(self, arm: Arm, inputs: Inputs) -> Array:
        """Return derivatives of true fields by F1, F2, M, by finite differences with effects."""
        frames, by_load = np.arange(len(inputs.loads)), []
        for step in np.diag(LOAD_STEP * arm.weight * np.array([1.0, 1.0, arm.length])):
            sides = []
            for sign in (-1.0, 1.0):
                stepped = self.subset(frames)
                stepped.solve(arm, inputs.with_loads(inputs.loads + sign * step))
                sides.append(stepped.fields)
            by_load.append((sides[1] - sides[0]) / (2.0 * step.sum()))
        return np.stack(by_load, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pieces:
    """Map from columns of the law's sections to columns of records, which effects may have split.

    columns (k, 2): those of the records; shares (frames, columns of the law, k): derivative of
    each by a column of the law.
    """

    columns: Columns
    shares: Array

    def joined(self, jacobian: Array, first: int) -> Array:
        """Return a Jacobian (frames, inputs, ...) with the columns of the law as inputs."""
        by_law = np.einsum('nlk,nkfs->nlfs', self.shares, jacobian[:, first:])
        return np.concatenate([jacobian[:, :first], by_law], axis=1)


def pieces_of(arm: Arm, rods: Rods, columns: Columns) -> Pieces:
    """Return the map from columns of the law's sections to columns of the records."""
    base, _ = arm.table.at(rods.pressure)
    owner = section_owners(base, rods.sections)
    first = np.diff(owner, axis=1, prepend=-1) != 0
    places = sorted(
        {
            (int(piece), int(column))
            for section, column in columns
            for piece in np.flatnonzero((owner == section).any(axis=0))
        }
    )
    every = np.array(places, dtype=np.int64).reshape(-1, 2)
    shares = np.zeros((len(owner), len(columns), len(every)))
    for index, (section, column) in enumerate(columns.tolist()):
        for which, (piece, of) in enumerate(places):
            if of != column:
                continue
            share = (owner[:, piece] == section).astype(np.float64)
            if column == START:
                share *= first[:, piece]
            elif column == RIGIDITY:
                share *= rods.sections[:, piece, RIGIDITY] / base[:, section, RIGIDITY]
            shares[:, index, which] = share
    return Pieces(columns=every, shares=shares)


def as_points(jacobian: Array) -> Array:
    """Return the Jacobian of points (frames, 2 stations, inputs), given that of all fields."""
    return jacobian[:, :, :2].reshape(*jacobian.shape[:2], -1).transpose(0, 2, 1)


def knot_rotation(arm: Arm) -> Array:
    """Return the rotation (knots, pieces, 5) due to a curvature of 1/m at one knot."""
    shares = arm.intrinsic_curvature.arclength
    powers = over_meters(rotation_pieces(shares, np.eye(shares.size)), arm.length)
    return np.ascontiguousarray(arm.on_knots(powers))
