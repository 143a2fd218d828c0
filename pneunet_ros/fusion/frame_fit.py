"""The most likely unknowns behind one frame of targets: y = h(x) + e, with a prior on all of x.

With the prior's mean m and root S the unknowns are x = m + S xi, and what is minimized is |xi|^2 +
|e|^2 of the whitened residual e: its least value is the NIS of the frame. In xi nothing is
singular, whatever is known exactly. The search is the damped Gauss-Newton of `measurement`, among
stable shapes alone; of a linear h it is one Kalman update in square-root form.

Source: iterated extended Kalman filter as Gauss-Newton: Bell & Cathey, IEEE Trans. Automatic
Control 38 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.fusion.belief import (
    Belief,
    BIAS,
    CAMERA,
    CONTACT,
    DRIFT,
    FORCE,
    MOMENT_NOISE,
    PRESSURE_NOISE,
    Unknowns,
)
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.gauss_newton import gauss_newton
from pneunet_ros.measurement.noise_jacobian import PRESSURE
from pneunet_ros.measurement.predicted_targets import target_jacobian
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import linearize_shape, Sensitivity, solve_rod
from pneunet_ros.model.part_load import (
    heading_at,
    PartLoad,
    turning_with_arm,
    with_part_changes,
    with_part_load,
)
from pneunet_ros.model.perturbation import Perturbation, PerturbationTable
from pneunet_ros.model.shape import Shape
from pneunet_ros.solver.columns import END_LOAD_MOMENT
from pneunet_ros.solver.rod import Rods
from pneunet_ros.solver.solution import SolverNodes

TURNED = 1e-6  # rad, between the normal of the arm and where its contact points
MOST_TURNS = 4

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameInputs:
    """What acted on the arm at a frame, as read.

    chamber, chamber_std: pressure in it, and of its white noise (Pa); history: of the effects;
    moment, moment_std (N m): at the tip; by_column (columns,): what one sigma of each column of
    the model's covariance changes of the pressure, by effects of sensing.
    """

    chamber: float
    chamber_std: float
    history: tuple[History, ...] | None
    moment: float
    moment_std: float
    by_column: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BentArm:
    """The rod at some values of the unknowns, at places along it; rods without its contact."""

    rods: Rods
    changes: Perturbation
    shape: Shape
    contact: PartLoad | None

    @property
    def solution(self) -> SolverNodes:
        """The solved rod."""
        assert self.shape.solution is not None
        return self.shape.solution

    def linearize(self) -> Sensitivity:
        """Return how it answers to loads, pressure and columns of the covariance.

        With a contact also to its force, its place and where it points.
        """
        if self.contact is None:
            return linearize_shape(self.solution, self.rods, self.changes)
        changes = with_part_changes(self.rods, self.changes, self.contact)
        return linearize_shape(self.solution, self.rods, changes)


def bend_arm(
    table: PerturbationTable,
    inputs: FrameInputs,
    force: Array,
    pressure_error: float,
    moment: float,
    columns: Array,
    start: SolverNodes | None,
    arclength: Array,
    *,
    quick: bool,
    contact: PartLoad | None = None,
) -> BentArm:
    """Solve the rod at a force (2,) N and moment (N m), and a model off by columns (sigma).

    pressure_error (Pa): bias and noise. quick: give up soon where no solution is near. contact: it
    points along the normal of the arm, whatever its heading.
    """
    pressure = inputs.chamber + pressure_error + float(inputs.by_column @ columns)
    rods, changes = table.at(pressure, inputs.history)
    rods = changes.moved(rods, np.concatenate([[0.0], columns]))
    load = Load(pressure=pressure, force_x=float(force[0]), force_y=float(force[1]), moment=moment)
    shape: Shape | None = None
    if contact is not None and start is None:
        shape = solve_rod(table.arm, rods, load, None, arclength, quick=quick)
        start = shape.solution
    if contact is None or start is None:
        shape = shape or solve_rod(table.arm, rods, load, start, arclength, quick=quick)
        return BentArm(rods=rods, changes=changes, shape=shape, contact=contact)
    for _ in range(MOST_TURNS):
        contact = replace(contact, heading=heading_at(start, contact.place))
        pushed = with_part_load(rods, contact)
        shape = solve_rod(table.arm, pushed, load, start, arclength, quick=quick)
        start = shape.solution
        if start is None or abs(heading_at(start, contact.place) - contact.heading) < TURNED:
            break
    assert shape is not None
    return BentArm(rods=rods, changes=changes, shape=shape, contact=contact)


def contact_of(arm: Arm, settings: FusionSettings, x: Array) -> PartLoad | None:
    """Return the contact among the unknowns; None where it is off the arm."""
    force, place = x[CONTACT].tolist()
    low, high = settings.contact_places
    if not low * arm.length <= place <= high * arm.length:
        return None
    return PartLoad(force=force, place=place, heading=0.0, width=settings.contact_width)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """Unknowns that were tried: xi, the arm there, the whitened residual, and what it costs."""

    xi: Array
    bent: BentArm
    residual: Array
    cost: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameLinearization:
    """A trial with its Jacobian by xi, the gradient of half the cost, and the root of its Hessian.

    jacobian (coordinates, unknowns): of what is predicted, whitened.
    """

    trial: Trial
    jacobian: Array
    gradient: Array
    hessian_root: Array

    @property
    def cost(self) -> float:
        """The squared whitened residual, of the prior too."""
        return self.trial.cost

    @property
    def log_evidence_cost(self) -> float:
        """Minus twice the log of the evidence of this solution, by Laplace, but for a constant.

        A solution that must be met to a hair, as near buckling, is less likely than its cost.
        """
        return self.cost + 2.0 * float(np.sum(np.log(np.diagonal(self.hessian_root))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameProblem:
    """One frame beside a prior: what is minimized over the unknowns.

    prior: moved to the stamp of the frame, with the noise of its readings; used (targets,): which
    targets count.
    """

    table: PerturbationTable
    unknowns: Unknowns
    settings: FusionSettings
    prior: Belief
    inputs: FrameInputs
    sightings: TargetSightings
    used: Mask
    std: Array = field(init=False)

    def __post_init__(self) -> None:
        """Take the white noise of the targets that count."""
        white = np.fmax(self.sightings.std[self.used], self.table.arm.sensors.target_std)
        object.__setattr__(self, 'std', np.tile(white, 2))

    @property
    def mean(self) -> Array:
        """Mean of the prior."""
        return self.prior.mean

    @property
    def root(self) -> Array:
        """Root of the covariance of the prior."""
        return self.prior.root

    def start_at(self, force: Array) -> Array:
        """Return the likeliest xi with a force (2,) N."""
        root = self.root[FORCE]
        gain = np.linalg.lstsq(root @ root.T, force - self.mean[FORCE], rcond=None)[0]
        return np.asarray(root.T @ gain)

    def try_at(self, xi: Array, start: SolverNodes | None) -> Trial | None:
        """Predict the targets; None where there is no stable shape."""
        unknowns, targets = self.unknowns, self.table.arm.target_arclength
        x = self.mean + self.root @ xi
        contact = contact_of(self.table.arm, self.settings, x) if self.prior.touched else None
        if contact is None and self.prior.touched:
            return None
        bent = bend_arm(
            self.table,
            self.inputs,
            x[FORCE],
            float(x[BIAS] + x[PRESSURE_NOISE]),
            self.inputs.moment + float(x[MOMENT_NOISE]),
            x[unknowns.of_columns],
            start,
            targets,
            quick=True,
            contact=contact,
        )
        shape = bent.shape
        if not shape.converged or shape.stable is False:
            return None
        places = np.stack(self.table.arm.see(shape.x, shape.y))
        cosine, sine = np.cos(shape.theta), np.sin(shape.theta)
        along, across = x[unknowns.along], x[unknowns.across]
        places += np.stack([cosine * along - sine * across, sine * along + cosine * across])
        places += (x[CAMERA] + x[DRIFT])[:, None]
        measured = np.stack([self.sightings.x, self.sightings.y])
        residual = (measured - places)[:, self.used].ravel() / self.std
        cost = float(xi @ xi + residual @ residual)
        if not math.isfinite(cost):
            return None
        return Trial(xi=xi, bent=bent, residual=residual, cost=cost)

    def linearize(self, trial: Trial) -> FrameLinearization:
        """Linearize what is predicted around a trial."""
        unknowns, bent = self.unknowns, trial.bent
        sensitivity = bent.linearize()
        by_cause = target_jacobian(self.table, sensitivity)
        if bent.contact is not None:
            turning = turning_with_arm(sensitivity, bent.contact)
            by_cause = by_cause[:-1] + turning[:, None, None] * by_cause[-1]
        targets = unknowns.targets
        response = np.zeros((2, targets, self.mean.size))
        response[:, :, FORCE] = by_cause[FORCE].transpose(1, 2, 0)
        response[:, :, BIAS] = response[:, :, PRESSURE_NOISE] = by_cause[PRESSURE]
        response[:, :, MOMENT_NOISE] = by_cause[END_LOAD_MOMENT]
        if bent.contact is not None:
            response[:, :, CONTACT] = by_cause[-2:].transpose(1, 2, 0)
        by_column = by_cause[PRESSURE + 1 : PRESSURE + 1 + unknowns.columns]
        by_column = by_column + self.inputs.by_column[:, None, None] * by_cause[PRESSURE]
        response[:, :, unknowns.of_columns] = by_column.transpose(1, 2, 0)
        for axis in range(2):
            response[axis, :, DRIFT.start + axis] = 1.0
            response[axis, :, CAMERA.start + axis] = 1.0
        cosine, sine = np.cos(bent.shape.theta), np.sin(bent.shape.theta)
        which = np.arange(targets)
        along, across = unknowns.along.start + which, unknowns.across.start + which
        response[0, which, along], response[1, which, along] = cosine, sine
        response[0, which, across], response[1, which, across] = -sine, cosine
        seen = response[:, self.used].reshape(-1, self.mean.size)
        jacobian = seen @ self.root / self.std[:, None]
        hessian = np.eye(jacobian.shape[1]) + jacobian.T @ jacobian
        return FrameLinearization(
            trial=trial,
            jacobian=jacobian,
            gradient=jacobian.T @ trial.residual - trial.xi,
            hessian_root=np.asarray(np.linalg.cholesky(hessian), dtype=np.float64),
        )

    def search(self, xi: Array, start: SolverNodes | None) -> FrameLinearization | None:
        """Search from xi for the lowest cost; None where there is no shape to start from."""
        first = self.try_at(xi, start)
        if first is None:
            return None

        def newton_step(at: FrameLinearization) -> tuple[Array, float]:
            half = np.linalg.solve(at.hessian_root, at.gradient)
            return np.linalg.solve(at.hessian_root.T, half), float(half @ half)

        def lower(at: FrameLinearization, step: Array) -> Trial | None:
            trial = self.try_at(at.trial.xi + step, at.trial.bent.solution)
            return trial if trial is not None and trial.cost < at.cost else None

        return gauss_newton(
            self.linearize(first),
            newton_step,
            lower,
            self.linearize,
            small=self.settings.small_gain,
            most_steps=self.settings.most_steps,
            most_halvings=self.settings.most_halvings,
        ).last

    def at_targets(self, fit: FrameLinearization) -> Array:
        """Return the chi squared (targets,) of each target against all others; NaN: not used.

        Of the residual that is left, with the covariance that it has after the fit.
        """
        seen = np.linalg.solve(fit.hessian_root, fit.jacobian.T)
        count = self.std.size // 2
        pairs = seen.reshape(-1, 2, count).transpose(2, 0, 1)  # (targets, unknowns, 2)
        left = np.eye(2) - pairs.transpose(0, 2, 1) @ pairs
        residual = fit.trial.residual.reshape(2, count).T[:, :, None]
        solved = np.linalg.solve(left, residual)
        found = np.full(self.used.size, np.nan)
        found[self.used] = np.sum(residual * solved, axis=(1, 2))
        return found

    def posterior(self, fit: FrameLinearization) -> Belief:
        """Return what is believed after the frame."""
        root = np.linalg.solve(fit.hessian_root, self.root.T).T
        return Belief(
            stamp_ns=self.prior.stamp_ns,
            mean=freeze(self.mean + self.root @ fit.trial.xi),
            root=freeze(np.ascontiguousarray(root)),
            walk=self.prior.walk,
            solution=fit.trial.bent.solution,
            frames=self.prior.frames + 1,
        )
