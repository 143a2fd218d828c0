"""Most likely unknowns of one frame of targets: y = h(x) + e, with a prior on all of x.

With the prior's mean m and root S, the unknowns are x = m + S xi, and the fit minimizes |xi|^2 +
|e|^2 with the whitened residual e; the minimum is the NIS of the frame. The problem in xi is never
singular, even with exactly known unknowns. The search is the damped Gauss-Newton method of
`measurement`, restricted to stable shapes; for a linear h it is one Kalman update in square-root
form.

Source: iterated extended Kalman filter as Gauss-Newton: Bell & Cathey, IEEE Trans. Automatic
Control 38 (1993).
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass, field, replace
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.pauses import pause
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.fusion.belief import Belief
from pneunet_ros.fusion.bent_arm import bend_arm, BentArm, causes_with_contact
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.model_error import ModelDiscrepancy
from pneunet_ros.measurement.blocks.motion import Motion
from pneunet_ros.measurement.blocks.timing import Timing
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.disturbances import SMALLEST_STD
from pneunet_ros.measurement.gauss_newton import End, gauss_newton
from pneunet_ros.measurement.inference.gaussian import innovation_factor, root_after
from pneunet_ros.measurement.inference.variance_component import ErrorGrowth
from pneunet_ros.measurement.painted_targets import paint, PaintedTargets
from pneunet_ros.measurement.predicted_targets import target_jacobian
from pneunet_ros.measurement.swinging_arm import ERRORS, Reference, SwingDeviation, SwingingArm
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.model.part_load import PartLoad
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.solver.solution import SolverNodes
from scipy.linalg.lapack import dpotri, dpotrs

LIMIT_POINT = 1e6  # sigma of a target that one sigma of the prior moves it
MOST_STEPS = 12  # largest number of steps of the search in a frame
MOST_HALVINGS = 6  # of a step that does not lower the cost
# Std of the force, of its scale: the last step is not checked; idle in acceptance/sweep.py.
LINEAR = 0.015

Mask = npt.NDArray[np.bool_]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """A trial point of the search: unknowns xi, the arm, the whitened residual, and the cost.

    Targets are complex, x + i y. seen (targets,) m: predicted positions relative to the clamp in
    the camera; painted: nominal positions before the rotation of the camera; back (targets,):
    rotation from the camera to the directions along and across the arm. residual (coordinates,):
    along and across the arm, target by target. solved: xi at which the arm was solved; xi itself
    may be one linear step further. swing_deviation: offset of a swinging arm's targets from
    equilibrium.
    """

    xi: Array
    solved: Array
    bent: BentArm
    seen: Complex
    painted: PaintedTargets
    back: Complex
    residual: Array
    cost: float
    swing_deviation: SwingDeviation | None = None


def solve_factored(factor: Array, sides: Array) -> Array:
    """Return S^-1 sides, from the Cholesky factor of S below its diagonal."""
    solved, _ = dpotrs(factor, sides, lower=1)
    return np.asarray(solved)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameLinearization:
    """A trial with its Jacobian with respect to xi, the innovation, and its covariance.

    jacobian (coordinates, unknowns) of the prediction, whitened; by_model_error (coordinates,
    errors): effect of a model error of size 1; innovation (coordinates,): residual at the mean of
    the prior, to first order; factor: Cholesky factor of its covariance; weighed (coordinates,):
    inverse of that covariance times the innovation; force (2, 2) N^2: posterior covariance of the
    tip force; step (unknowns,): Gauss-Newton step in xi, and its gain. turning (causes, links):
    rotation of the links of a swinging arm by each cause.
    """

    trial: Trial
    jacobian: Array
    by_model_error: Array
    innovation: Array
    factor: Array
    weighed: Array
    force: Array
    step: Array
    gain: float
    turning: Array | None = None

    def solve(self, sides: Array) -> Array:
        """Return S^-1 sides, of the covariance S of the innovation."""
        return solve_factored(self.factor, sides)

    @property
    def cost(self) -> float:
        """The squared whitened residual, including the prior."""
        return self.trial.cost

    def size_information(self, growth: ErrorGrowth) -> tuple[Array, Array]:
        """Return H^T S^-1 v (errors,) and H^T S^-1 H for errors of unknown size."""
        displacement = self.by_model_error * growth.grown
        return displacement.T @ self.weighed, displacement.T @ self.solve(displacement)

    def errors_after(self, root: Array) -> Array:
        """Return what errors before the frame contribute to unknowns after it, as rows of a root.

        root (n, unknowns): rows before the frame.
        """
        return np.asarray(root - self.solve(self.jacobian @ root.T).T @ self.jacobian)

    def newton_step(self) -> tuple[Array, float]:
        """Return the step (unknowns,) in xi to the minimum of the cost, and its gain."""
        return self.step, self.gain

    def stepped(self) -> FrameLinearization:
        """Return the linearization after its step, without solving the arm again."""
        trial = replace(
            self.trial,
            xi=self.trial.xi + self.step,
            residual=self.trial.residual - self.jacobian @ self.step,
            cost=self.cost - self.gain,
        )
        return replace(self, trial=trial, step=np.zeros(self.step.size), gain=0.0)

    @property
    def log_evidence_cost(self) -> float:
        """Minus twice the log evidence (Laplace) of this solution, up to a constant.

        A sharply peaked solution, as near buckling, is less likely than its cost suggests.
        """
        return self.cost + 2.0 * float(np.log(np.diagonal(self.factor)).sum())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameProblem:
    """Estimation problem of one frame: the cost of targets and prior over the unknowns.

    prior: propagated to the stamp of the frame, with the noise of its readings; growth: of the
    model error since the last frame, None if no pressure was read; used (targets,): mask of the
    targets to use.

    For a swinging arm: swinging; late: first column of the root for force changes since the last
    frame, and response_share: the share of the response of the arm so far; considered: a direction
    (2, 1) of the tip force, and the share of the information that it uses; left_out: first column
    of the errors that belong to this frame only: truncation errors of the swing, then row_errors
    (errors, 2, targets) m of a rolling shutter, None without.

    Constant during the search: std (coordinates,) m of white noise; measured (targets,) m, x + i
    y; causes (causes, unknowns): derivatives of every cause by the unknowns; cause_root:
    derivatives of the causes, of the camera position (x, y) and of its rotation by xi; painted
    (coordinates, xi) of the painted positions, whitened; sized_causes (causes, errors): effect of
    a model error of size 1; force (2, 2) N^2: covariance of the tip force before the frame;
    still_root: the root of the unknowns for the bending of the arm.
    """

    table: PerturbationTable
    unknowns: Unknowns
    settings: FusionSettings
    prior: Belief
    growth: ErrorGrowth | None
    inputs: FrameInputs
    sightings: TargetSightings
    used: Mask
    swinging: SwingingArm | None = None
    late: int | None = None
    response_share: float = 1.0
    considered: tuple[Array, float] | None = None
    left_out: int | None = None
    row_errors: Array | None = None
    still_root: Array = field(init=False)
    touched: bool = field(init=False)
    counting: npt.NDArray[np.intp] | None = field(init=False)
    std: Array = field(init=False)
    measured: Complex = field(init=False)
    causes: Array = field(init=False)
    cause_root: Array = field(init=False)
    painted: Array = field(init=False)
    sized_causes: Array = field(init=False)
    force: Array = field(init=False)

    def __post_init__(self) -> None:
        """Prepare the used targets, their white noise, and the derivatives by the unknowns."""
        unknowns, root, sightings = self.unknowns, self.prior.root, self.sightings
        counting = None if self.used.all() else np.flatnonzero(self.used)
        white = sightings.std if counting is None else sightings.std[counting]
        std = np.fmax(white, max(self.table.arm.sensors.target_std, SMALLEST_STD)).repeat(2)
        causes, touched = unknowns.causes_at(self.inputs), self.prior.touched
        static_root = root
        if self.late is not None:
            static_root = root.copy()
            static_root[unknowns.at(TipForce), self.late :] *= self.response_share
        cause_count, size = len(causes), root.shape[1]
        added = [unknowns.at(Push)] if touched else []
        if self.swinging is not None and self.prior.reference is not None:
            added.append(self.swinging.part(Motion.PLACE))
        left_out = self.errors_left_out
        cause_root = np.zeros((cause_count + 2 * len(added) + left_out + 3, size))
        if self.left_out is not None:
            columns = slice(self.left_out, self.left_out + left_out)
            cause_root[-3 - left_out : -3, columns] = np.eye(left_out)
        np.matmul(causes, static_root, out=cause_root[:cause_count])
        for which, where in enumerate(added):
            cause_root[cause_count + 2 * which : cause_count + 2 * which + 2] = root[where]
        np.matmul(unknowns.camera, root, out=cause_root[-3:])
        places = unknowns.dots_moved(root).transpose(1, 0, 2)
        if counting is not None:
            places = places[counting]
        painted = np.empty((std.size // 2, 2, size))
        np.divide(places, std.reshape(-1, 2, 1), out=painted)
        sized, force = unknowns.sized, root[unknowns.at(TipForce)]
        for name, value in (
            ('touched', touched),
            ('still_root', static_root),
            ('counting', counting),
            ('std', std),
            ('measured', sightings.x + 1j * sightings.y),
            ('causes', causes),
            ('cause_root', cause_root),
            ('painted', painted.reshape(std.size, size)),
            ('sized_causes', causes[:, sized] * unknowns.std[sized]),
            ('force', force @ force.T),
        ):
            object.__setattr__(self, name, value)

    @property
    def mean(self) -> Array:
        """Mean of the prior."""
        return self.prior.mean

    @property
    def root(self) -> Array:
        """Root of the covariance of the prior."""
        return self.prior.root

    def start_at(self, force: Array) -> Array:
        """Return the most likely xi given a force (2,) N."""
        tip = self.unknowns.at(TipForce)
        root = self.root[tip]
        gain = np.linalg.lstsq(root @ root.T, force - self.mean[tip], rcond=None)[0]
        return np.asarray(root.T @ gain)

    def try_at(self, xi: Array, start: SolverNodes | None) -> Trial | None:
        """Predict the targets at xi; None if there is no stable shape."""
        pause()
        x = self.mean + self.still_root @ xi
        contact = self.contact_of(x) if self.touched else None
        if contact is None and self.touched:
            return None
        bent = bend_arm(
            self.table,
            self.inputs,
            self.causes @ x,
            start,
            self.table.arm.target_arclength,
            quick=True,
            contact=contact,
        )
        if not bent.shape.converged or bent.shape.stable is False:
            return None
        return self.trial_of(xi, bent)

    def trial_of(self, xi: Array, bent: BentArm) -> Trial | None:
        """Compare the targets of an arm solved at xi with the frame; None if not finite."""
        unknowns, arm, shape = self.unknowns, self.table.arm, bent.shape
        x = self.mean + self.still_root @ xi
        arm_x, arm_y, theta, swing_deviation = (
            shape.x,
            shape.y,
            shape.theta,
            self.swing_deviation(bent, x),
        )
        curvature = shape.curvature
        if swing_deviation is not None:
            moved_x, moved_y, rotation, bends = swing_deviation.deviation
            curvature = curvature + bends
            arm_x, arm_y, theta = (arm_x + moved_x, arm_y + moved_y, theta + rotation)
        if self.left_out is not None:
            left_out = self.moves_left_out(swing_deviation)
            own = xi[self.left_out : self.left_out + len(left_out)]
            off_x, off_y = np.tensordot(own, left_out, axes=1)
            arm_x, arm_y = arm_x + off_x, arm_y + off_y
        painted = paint(theta, curvature, unknowns.dots_moved(x))
        clamp_x, clamp_y, angle = (unknowns.camera @ x).tolist()
        clamp, turn = complex(clamp_x, clamp_y), cmath.rect(1.0, angle)
        seen_x, seen_y = arm.see(arm_x, arm_y)
        seen = turn * (seen_x + 1j * seen_y + painted.displacement)
        back = painted.to_arm / turn
        residual = self.whiten((self.measured - clamp - seen) * back)
        cost = float(xi @ xi + residual @ residual)
        if not math.isfinite(cost):
            return None
        return Trial(
            xi=xi,
            solved=xi,
            bent=bent,
            swing_deviation=swing_deviation,
            seen=seen,
            painted=painted,
            back=back,
            residual=residual,
            cost=cost,
        )

    def swing_deviation(self, bent: BentArm, x: Array) -> SwingDeviation | None:
        """Return the offset of the targets from equilibrium; None if the arm does not swing."""
        arm, reference = self.swinging, self.prior.reference
        if arm is None or reference is None:
            return None
        return arm.swing_deviation(bent.solution, x, reference, arm.targets)

    @property
    def errors_left_out(self) -> int:
        """Number of errors of this frame alone."""
        of_swing = 0 if self.prior.reference is None else ERRORS
        return of_swing + (0 if self.row_errors is None else len(self.row_errors))

    def moves_left_out(self, deviation: SwingDeviation | None) -> Array:
        """Return one sigma of the errors of this frame alone, (errors, 2, targets) m."""
        of_swing = [] if deviation is None else [deviation.left_out]
        of_rows = [] if self.row_errors is None else [self.row_errors]
        return np.concatenate([*of_swing, *of_rows])

    def add_swing(self, trial: Trial, sensitivity: Sensitivity, moves: Array) -> Array | None:
        """Add, in place, the effect of causes on the swing to moves (causes, 4, targets).

        Returns the rotation of the equilibrium links by each cause; None if the arm does not
        swing.
        """
        if self.swinging is None or trial.swing_deviation is None:
            return None
        turning = self.swinging.headings(sensitivity)
        moves += trial.swing_deviation.moves(turning)
        return turning

    def whiten(self, moves: Complex) -> Array:
        """Return whitened coordinates (.., coordinates) of the used targets (.., targets) m.

        moves: along + i across the arm.
        """
        if self.counting is not None:
            moves = moves.take(self.counting, axis=-1)
        return np.asarray(moves.view(np.float64) / self.std)

    def along_arm(self, trial: Trial, moves: Array) -> Complex:
        """Return moves (n, targets) m of targets, along + i across the arm.

        moves (n, 4, targets): x, y (m) of their nominal positions, before the rotation of the
        camera, and heading (rad) and curvature (1/m) of the arm there.
        """
        painted = trial.painted
        displacement = moves[:, 0] + 1j * moves[:, 1]
        displacement += painted.by_theta * moves[:, 2]
        displacement += painted.by_curvature * moves[:, 3]
        return np.asarray(displacement * painted.to_arm)

    def stretch(self, trial: Trial) -> Array:
        """Return the derivatives of targets by their placement, (coordinates,): along, across."""
        along = (trial.painted.by_along * trial.painted.to_arm).real
        stretch = np.ones(self.std.size)
        stretch[::2] = along if self.counting is None else along[self.counting]
        return stretch

    def linearize(self, trial: Trial) -> FrameLinearization | None:
        """Linearize the prediction around a trial; None at a limit point of the arm."""
        xi, root, tip = trial.xi, self.root, self.unknowns.at(TipForce)
        sensitivity = trial.bent.linearize()
        by_cause = target_jacobian(self.table, sensitivity)
        turning = self.add_swing(trial, sensitivity, by_cause)
        added = [] if trial.swing_deviation is None else [trial.swing_deviation.by_shape]
        if self.left_out is not None:
            left_out = self.moves_left_out(trial.swing_deviation)
            added.append(np.pad(left_out, ((0, 0), (0, 2), (0, 0))))
        by_cause = np.concatenate([by_cause, *added]) if added else by_cause
        moves = np.empty((len(by_cause) + 3, by_cause.shape[2]), dtype=np.complex128)
        moves[:-3] = self.along_arm(trial, by_cause)
        moves[-3], moves[-2] = trial.back, 1j * trial.back
        np.multiply(trial.seen, moves[-2], out=moves[-1])
        whitened = self.whiten(moves)
        jacobian = whitened.T @ self.cause_root
        jacobian += self.painted * self.stretch(trial)[:, None]
        if not max(jacobian.max(), -jacobian.min()) < LIMIT_POINT:
            return None
        factor = innovation_factor(jacobian)
        sides = np.empty((3, xi.size))
        sides[0], sides[1:] = xi, root[tip]
        seen = jacobian @ sides.T
        seen[:, 0] += trial.residual
        solved = solve_factored(factor, seen)
        innovation, weighed = seen[:, 0], solved[:, 0]
        step = weighed @ jacobian - xi
        gain = float(step @ (trial.residual @ jacobian - xi))
        force = self.force - seen[:, 1:].T @ solved[:, 1:]
        if gain > self.settings.small_gain:
            tip_step = root[tip] @ step
            force += tip_step[:, None] * tip_step
        known = len(self.sized_causes)
        return FrameLinearization(
            trial=trial,
            jacobian=jacobian,
            by_model_error=whitened[:known].T @ self.sized_causes,
            innovation=innovation,
            factor=factor,
            weighed=weighed,
            force=force,
            step=step,
            gain=gain,
            turning=turning,
        )

    def linearize_at(self, xi: Array, start: SolverNodes | None) -> FrameLinearization | None:
        """Return the linearization at xi; None if there is no stable shape."""
        trial = self.try_at(xi, start)
        return None if trial is None else self.linearize(trial)

    def search(self, xi: Array, start: SolverNodes | None) -> FrameLinearization | None:
        """Search from xi for the lowest cost; None if there is no shape at the start."""
        first = self.linearize_at(xi, start)
        if first is None:
            return None

        def lower(at: FrameLinearization, step: Array) -> Trial | None:
            trial = self.try_at(at.trial.xi + step, at.trial.bent.solution)
            most = at.cost - self.settings.small_gain
            return trial if trial is not None and trial.cost < most else None

        found = gauss_newton(
            first,
            FrameLinearization.newton_step,
            lower,
            self.linearize,
            small=self.settings.small_gain,
            most_steps=MOST_STEPS,
            most_halvings=MOST_HALVINGS,
            predict_end=True,
        )
        return self.last_step(found.last) if found.end is End.CONVERGED else found.last

    def last_step(self, fit: FrameLinearization) -> FrameLinearization:
        """Take the last step of a search, with its small gain.

        If the frame determines the force, the problem is nearly linear and the cost is not
        checked. Along a barely observed force, the step may lead to an arm about to buckle, so the
        cost is checked.
        """
        step, _ = fit.newton_step()
        if self.force_is_known(fit, LINEAR) and self.is_allowed(fit.trial.xi + step):
            return fit.stepped()
        trial = self.try_at(fit.trial.xi + step, fit.trial.bent.solution)
        if trial is None or trial.cost > fit.cost:
            return fit
        return self.linearize(trial) or fit

    def at_targets(self, fit: FrameLinearization) -> Array:
        """Return the chi squared of each used target given all others, (used targets,).

        It uses the residual after the fit, with its covariance.
        """
        precision, _ = dpotri(fit.factor, lower=1)
        along, across = precision.diagonal().reshape(-1, 2).T
        off_diagonal = precision.diagonal(-1)[::2]
        x, y = fit.trial.residual.reshape(-1, 2).T
        found = (across * x**2 - 2.0 * off_diagonal * x * y + along * y**2) / (
            along * across - off_diagonal**2
        )
        return np.asarray(found)

    def is_allowed(self, xi: Array) -> bool:
        """Whether a contact, if there is one, is on the arm."""
        if not self.touched:
            return True
        x = self.mean + self.root @ xi
        return self.contact_of(x) is not None

    def contact_of(self, x: Array) -> PartLoad | None:
        """Return the contact among the unknowns; None if it is off the arm."""
        unknowns = self.unknowns
        return unknowns.block(Push).load_of(x[unknowns.at(Push)])

    def force_is_known(self, fit: FrameLinearization, most: float) -> bool:
        """Whether the force is known after the frame, to within `most` of its scale."""
        largest = most * self.unknowns.block(TipForce).scale
        return bool(fit.force[0, 0] + fit.force[1, 1] <= largest**2)

    def posterior(self, fit: FrameLinearization) -> Belief:
        """Return the posterior belief after the frame.

        If the search was stopped, for example at a loss of stability, the remaining step is added
        as an error.
        """
        root = root_after(self.root, fit.jacobian, fit.factor)
        step, gain = fit.newton_step()
        if gain > self.settings.small_gain:
            root = np.column_stack([root, self.root @ step])
        mean = self.mean + self.root @ fit.trial.xi
        if self.considered is not None:
            mean, root = self.consider(mean, root, *self.considered)
        sizes, growth = self.prior.sizes, self.growth
        if growth is not None:
            grid = self.unknowns.block(ModelDiscrepancy).grid
            sizes = grid.after(sizes, growth, fit.size_information(growth))
        after = replace(
            self.prior,
            mean=freeze(mean),
            root=freeze(np.ascontiguousarray(root)),
            sizes=sizes,
            chamber=math.nan if growth is None else self.inputs.chamber,
            solution=fit.trial.bent.solution,
            frames=self.prior.frames + 1,
            reference=self.reference_after(fit),
        )
        return self.at_instant(after)

    def at_instant(self, belief: Belief) -> Belief:
        """Return the belief at the instant that the frame shows, by the pressure.

        One frame shows no delay beyond the time for which its rate of the pressure is known.
        """
        alone = self.growth is None
        if alone or self.swinging is not None or Timing not in self.unknowns.places:
            return belief
        where, rate = self.unknowns.at(Timing).start, self.inputs.pressure_rate
        most = max(self.prior.std(where), Timing.WINDOW)
        delay, mean = float(np.clip(belief.mean[where], -most, most)), belief.mean.copy()
        mean[where] = 0.0
        later_ns = round(delay * NANOSECONDS_PER_SECOND)
        return replace(
            belief,
            stamp_ns=belief.stamp_ns + later_ns,
            delay_ns=belief.delay_ns + later_ns,
            mean=freeze(mean),
            chamber=belief.chamber + rate * delay,
        )

    def consider(
        self, mean: Array, root: Array, axis: Array, reliability: float
    ) -> tuple[Array, Array]:
        """Return a posterior using a share of the information on a direction of the tip force.

        All other unknowns are updated with the prior uncertainty of that force (Schmidt's filter).
        axis (2, 1): that direction; reliability: the share. Source: Brink, J. Guidance, Control,
        and Dynamics 40 (2017).
        """
        tip = self.unknowns.at(TipForce)
        before, after = axis.T @ self.root[tip], axis.T @ root[tip]
        kept = max(float(np.sum(before**2) - np.sum(after**2)), 0.0)
        column = np.zeros((len(root), 1))
        column[tip] = math.sqrt((1.0 - reliability) * kept) * axis
        mean = mean.copy()
        mean[tip] -= (1.0 - reliability) * axis[:, 0] * float(axis[:, 0] @ (mean - self.mean)[tip])
        return mean, np.hstack([root, column])

    def walk_information(self, fit: FrameLinearization) -> tuple[Array, Array, float] | None:
        """Return H^T S^-1 v (2,) and H^T S^-1 H of the tip force walk, and its assumed size.

        None if the force did not change since the last frame, or if a sensor measures it.
        """
        size = self.prior.walk.recent
        if self.late is None:
            return None
        displacement = fit.jacobian[:, self.late : self.late + 2] / size
        return displacement.T @ fit.weighed, displacement.T @ fit.solve(displacement), size

    def reference_after(self, fit: FrameLinearization) -> Reference | None:
        """Return the reference of a swing, with the equilibrium estimated from this frame."""
        trial, reference = fit.trial, self.prior.reference
        if reference is None or trial.swing_deviation is None or fit.turning is None:
            return None
        causes = causes_with_contact(self.unknowns, self.causes, trial.bent.contact)
        return reference.at_estimate(
            trial.swing_deviation,
            freeze(self.mean + self.still_root @ trial.solved),
            freeze(fit.turning.T @ causes),
        )
