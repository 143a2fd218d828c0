"""Mass and damping as unknowns of recordings of an oscillating arm.

The statics of the arm are known; each recording is simulated reading by reading, and the measured
motion about equilibrium is compared with that of the link chain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.motion.swinging_run import LARGE_SWING, swinging_run, SwingingRun
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, STANDARD_GRAVITY
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.disturbances import disturbance_jacobian, Disturbances
from pneunet_ros.measurement.inference.adequacy import chi_square_limit
from pneunet_ros.measurement.moving_arm import (
    follow_reading,
    follow_readings,
    Places,
    places_along,
    SHAPES,
    unloaded_modes,
    WITHIN_95,
)
from pneunet_ros.measurement.painted_targets import paint
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.vibration import masses_of
from pneunet_ros.solver.links import Masses
from pneunet_ros.solver.modes import Modes

SCANNED_MASSES = np.geomspace(
    0.4, 8.0, 13
).tolist()  # at the tip, in units of the arm's effective mass
SCANNED_RATIOS = (0.03, 0.1, 0.3)  # damping ratios of the first mode
SCANNED_READINGS = 1000
# Effective mass at the tip in the first mode, as a share of the arm's: 33 / 140, by Rayleigh.
MASS_AT_TIP = 33.0 / 140.0
MOST_STEPS = 30  # of the fit
LEAST_MASS = 0.2  # lower bound of the arm's mass during the search, as a share of its weight
DIFFERENCE_STEP = 0.01  # of a standard deviation, for numerical derivatives by other errors
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionProblem:
    """Recordings, and the fitted parameters.

    The parameters: mass at the tip, in units of the arm's effective mass there, negative if the
    arm itself is lighter; log of the damping time (s); then q and p at the start of each plucked
    recording. std (m): white noise of a target. nuisance (rows, unknowns): change of the residuals
    by one sigma of each other uncertainty; covariance (unknowns, unknowns): inverse of the
    information on the nuisance unknowns.
    """

    arm: Arm
    runs: tuple[SwingingRun, ...]
    modes: Modes
    places: Places
    std: float
    nuisance: Array | None = None
    covariance: Array | None = None

    @property
    def diverged_position(self) -> float:
        """Position (m) of a chain whose simulation diverged, farther away than any arm reaches."""
        return 2.0 * self.arm.length

    @property
    def effective_mass(self) -> float:
        """The effective mass of the arm at its tip, kg."""
        return MASS_AT_TIP * self.arm.weight / STANDARD_GRAVITY

    def motion(self, parameters: Array) -> tuple[float, float]:
        """Return mass at the tip (kg) and damping time (s)."""
        return self.effective_mass * float(parameters[0]), math.exp(float(parameters[1]))

    def masses(self, mass: float) -> Masses:
        """Return the masses for this tip mass; a negative value lightens the whole arm."""
        own = masses_of(self.arm)
        if mass >= 0.0:
            return own._replace(tip=self.effective_mass * mass)
        return own._replace(mass=freeze(own.mass * max(1.0 + mass, LEAST_MASS)))

    def period(self, mass: float) -> float:
        """Return the period (s) of the slowest vibration with this mass at the tip."""
        heavier = math.sqrt(max(1.0 + mass, LEAST_MASS))
        return 2.0 * math.pi * heavier / float(self.modes.frequency[0])

    def initial_parameters(self, mass: float, ratio: float) -> Array:
        """Return initial parameters: tip mass as a share of the effective mass; damping ratio."""
        frequency = float(self.modes.frequency[0]) / math.sqrt(1.0 + mass)
        starts = [value for run in self.runs if run.plucked for value in self.initial_state(run)]
        return np.array([mass, math.log(2.0 * ratio / frequency), *starts])

    def initial_state(self, run: SwingingRun) -> list[float]:
        """Return the initial q closest to the first frame of a run, at zero velocity."""
        masses = masses_of(self.arm)
        panels, ends, nodes = run.solved
        rod = panels[0], ends[0], nodes[0]
        first = follow_reading(None, 0, rod, masses, 0.0, self.modes)[1]
        along = (first.at_nodes[3:] @ self.places.nodes).reshape(SHAPES, 3, -1)[:, :2]
        seen = run.deviation[0].reshape(-1)
        known = np.isfinite(seen)
        q, *_ = np.linalg.lstsq(along.reshape(SHAPES, -1)[:, known].T, seen[known], rcond=None)
        return [*q.tolist(), *[0.0] * SHAPES]

    def simulate(self, parameters: Array) -> tuple[list[Array], list[Flags]]:
        """Return, per run, the deviation of targets (frames, 2, targets) m, and frames at rest."""
        _, damping_time = self.motion(parameters)
        masses = self.masses(float(parameters[0]))
        starts = iter(parameters[2:].reshape(-1, 2, SHAPES))
        deviations, at_rest = [], []
        for run in self.runs:
            start = next(starts) if run.plucked else np.zeros((2, SHAPES))
            simulated = follow_readings(
                run.stamp_ns, run.solved, start, masses, damping_time, self.modes
            )
            is_small = np.hypot(*simulated[:, :, -1].T) <= WITHIN_95 * self.std
            # if the chain diverges, a target must not look unseen
            bounded = np.clip(
                np.nan_to_num(simulated, nan=self.diverged_position),
                -self.diverged_position,
                self.diverged_position,
            )
            deviations.append(bounded[run.reading] @ self.places.nodes)
            at_rest.append(is_small[run.reading])
        return deviations, at_rest

    def residuals(self, deviations: Sequence[Array]) -> list[Array]:
        """Return the residuals of the targets per run, (frames, 2, targets) m, `centered`."""
        return [
            run.centered(run.deviation - deviation)
            for run, deviation in zip(self.runs, deviations, strict=True)
        ]

    def residual_vector(self, parameters: Array) -> Array:
        """Return all residuals as one vector in units of the noise, then the nuisance unknowns."""
        return np.concatenate(
            self.without_nuisance(self.whitened(self.residuals(self.simulate(parameters)[0])))
        )

    def whitened(self, residuals: Sequence[Array]) -> Array:
        """Return residuals per run as one vector, in units of the noise."""
        return np.nan_to_num(np.concatenate([item.ravel() for item in residuals]) / self.std)

    def root_mean_square(self, residuals: Sequence[Array]) -> float:
        """Return the root mean square (m) of target distances without nuisance."""
        remaining, _ = self.without_nuisance(self.whitened(residuals))
        return self.std * math.sqrt(
            2.0
            * float(remaining @ remaining)
            / sum(int(np.isfinite(item).sum()) for item in residuals)
        )

    def without_nuisance(self, residuals: Array) -> tuple[Array, Array]:
        """Return residuals (rows,) without nuisance, and the values of the nuisance unknowns.

        values (unknowns,): most probable, in sigma.
        """
        if self.nuisance is None or self.covariance is None:
            return residuals, np.zeros(0)
        sizes = self.covariance @ (self.nuisance.T @ residuals)
        return residuals - self.nuisance @ sizes, sizes

    def with_nuisance(
        self, arms: Sequence[Arm], runs: Sequence[RecordingData], parameters: Array
    ) -> MotionProblem:
        """Return the problem with all nuisance unknowns, at these parameters.

        The nuisance unknowns are a step towards each of these arms, then the positions of targets
        and camera, because on a slow ramp errors of both resemble damping.
        """
        columns = np.column_stack(
            [*self.error_columns(arms, runs, parameters), self.disturbance_columns(runs)]
        )
        gram = columns.T @ columns + np.eye(columns.shape[1])
        return replace(self, nuisance=columns, covariance=np.asarray(np.linalg.inv(gram)))

    def disturbance_columns(self, runs: Sequence[RecordingData]) -> Array:
        """Return the columns (rows, n) of the disturbances, in units of their prior."""
        disturbances = Disturbances(
            arclength=self.arm.target_arclength, runs=runs, noise=self.arm.sensors
        )
        root = np.linalg.cholesky(disturbances.prior) / self.std
        rows = np.zeros((sum(run.points.size for run in self.runs), len(root)))
        end = 0
        for which, (run, recording) in enumerate(zip(self.runs, runs, strict=True)):
            start, end = end, end + run.points.size
            if run.plucked:  # constant about one equilibrium
                continue
            theta, curvature = run.theta_and_curvature[run.reading].swapaxes(0, 1)
            no_placement = np.zeros((2, theta.shape[1]))
            jacobian = disturbance_jacobian(recording, paint(theta, curvature, no_placement))
            jacobian = np.nan_to_num(run.centered(jacobian)).reshape(end - start, -1)
            rows[start:end] = jacobian @ root[disturbances.of_run(which)]
        return rows

    def error_columns(
        self, arms: Sequence[Arm], runs: Sequence[RecordingData], parameters: Array
    ) -> list[Array]:
        """Return columns (rows,) of one sigma towards each of these arms, at these parameters."""
        deviations = self.simulate(parameters)[0]
        residuals, columns = self.whitened(self.residuals(deviations)), []
        for arm in arms:
            other = motion_problem(arm, runs)
            pairs = list(zip(other.runs, self.runs, strict=True))
            other = replace(
                other,
                runs=tuple(run.beginning_with(one) if one.plucked else run for run, one in pairs),
            )
            shifted = [
                deviation + run.equilibrium[run.reading] - one.equilibrium[one.reading]
                for run, one, deviation in zip(
                    other.runs, self.runs, other.simulate(parameters)[0], strict=True
                )
            ]
            columns.append((residuals - self.whitened(self.residuals(shifted))) / DIFFERENCE_STEP)
        return columns

    def best_of_scan(self) -> Array:
        """Return the grid parameters that fit the first swing of each run best."""
        short = self.shortened(SCANNED_READINGS)
        guesses = [
            short.initial_parameters(mass - 1.0, ratio)
            for mass in SCANNED_MASSES
            for ratio in SCANNED_RATIOS
        ]
        return min(
            guesses, key=lambda parameters: float(np.sum(short.residual_vector(parameters) ** 2))
        )

    def search(self, start: Array, least_mass: float = -math.inf) -> Any:
        """Search for the most likely parameters; least_mass: lower bound of the first one."""
        from scipy.optimize import least_squares  # slow to import, and few fits need it

        return least_squares(
            self.residual_vector,
            start,
            bounds=([least_mass, *[-math.inf] * (start.size - 1)], math.inf),
            x_scale='jac',
            loss='soft_l1',
            diff_step=1e-4,
            max_nfev=MOST_STEPS,
        )

    def without_held_frames(self, residuals: Sequence[Array], mass: float) -> MotionProblem | None:
        """Remove the frames in which plucked arms were still held; None if there are none.

        residuals: per run; mass: at the tip. If the arm was released after the last large swing,
        some frames within the first period do not fit a free swing, and their residuals are larger
        than later ones.
        """
        period = self.period(mass) * NANOSECONDS_PER_SECOND
        runs = list(self.runs)
        for which, (run, residual) in enumerate(zip(self.runs, residuals, strict=True)):
            if not run.plucked:
                continue
            coordinates = np.maximum(np.isfinite(residual).sum(axis=(1, 2)), 1)
            chi_square = np.nansum((residual / self.std) ** 2, axis=(1, 2)) / coordinates
            typical = max(float(np.median(chi_square)), 1.0)
            limits = [typical * chi_square_limit(count) for count in coordinates.tolist()]
            early = run.stamp_ns[run.reading] - run.stamp_ns[0] < period
            held = np.flatnonzero(early & (chi_square > limits))
            if held.size and held[-1] + 2 < len(residual):
                runs[which] = run.starting_at(int(held[-1]) + 1)
        if all(after is before for after, before in zip(runs, self.runs, strict=True)):
            return None
        return replace(self, runs=tuple(runs), nuisance=None, covariance=None)

    def with_fitted_starts(self, parameters: Array) -> Array:
        """Return the parameters with starts of plucked runs fitted to their frames."""
        if parameters.size == 2:
            return parameters
        from scipy.optimize import least_squares  # slow to import, and few fits need it

        motion, starts = parameters[:2], parameters[2:]
        found = least_squares(
            lambda starts: self.residual_vector(np.concatenate([motion, starts])),
            starts,
            x_scale='jac',
            max_nfev=MOST_STEPS,
        )
        return np.concatenate([motion, found.x])

    def parameters_of(self, motion: Motion) -> Array:
        """Return parameters with this mass and damping; runs start at their first frame."""
        parameters = self.initial_parameters(0.0, 0.1)
        parameters[:2] = motion.tip_mass / self.effective_mass, math.log(motion.damping_time)
        return parameters

    def shortened(self, most: int) -> MotionProblem:
        """Return the problem with this many readings of each run, starting at its first swing."""
        runs = []
        for run in self.runs:
            first = max(min(self.before_swing(run), len(run.stamp_ns) - most), 0)
            frames = np.searchsorted(run.reading, [first, first + most]).tolist()
            runs.append(run.part(slice(*frames), slice(first, first + most)))
        return replace(self, runs=tuple(runs))

    def before_swing(self, run: SwingingRun) -> int:
        """Return the reading a period before the first large swing of a run; 0 if plucked."""
        distance = np.hypot(*run.centered(run.deviation).transpose(1, 0, 2))
        seen = np.flatnonzero(np.isfinite(distance).any(axis=1))
        if run.plucked or not seen.size:
            return 0
        median = np.nanmedian(distance[seen], axis=1)
        large = seen[np.argmax(median >= LARGE_SWING * median.max())]
        period = self.period(SCANNED_MASSES[-1] - 1.0) * NANOSECONDS_PER_SECOND
        return int(np.searchsorted(run.stamp_ns, run.stamp_ns[run.reading[large]] - period))


def motion_problem(arm: Arm, runs: Sequence[RecordingData]) -> MotionProblem:
    """Set up the fit of motion to recordings; RequestError if the arm cannot swing."""
    without_motion = arm.with_motion(Motion())
    modes = unloaded_modes(without_motion)
    if modes is None:
        raise RequestError(
            f'{arm.name} has no stable unloaded shape to swing about', reason='no_equilibrium'
        )
    return MotionProblem(
        arm=without_motion,
        runs=tuple(swinging_run(without_motion, run) for run in runs),
        modes=modes,
        places=places_along(arm.reach, arm.target_arclength),
        std=max(arm.sensors.target_std, 1e-6 * arm.length),
    )
