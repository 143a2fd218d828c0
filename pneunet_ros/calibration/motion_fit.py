"""Tip mass and damping of an arm, from recordings of its oscillations.

The statics of the arm are known; each recording is simulated reading by reading, and the measured
motion about equilibrium is compared with that of the chain. At constant pressure the arm was
plucked: such a recording starts at the release, and its initial state is fitted as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.settings import EXPERIMENTS
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import millimeters, NANOSECONDS_PER_SECOND, STANDARD_GRAVITY
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.measurement.dataset import RecordingData, thinned
from pneunet_ros.measurement.disturbances import disturbance_jacobian, Disturbances
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inference.adequacy import chi_square_limit
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.moving_arm import (
    follow_reading,
    follow_readings,
    Places,
    places_along,
    SHAPES,
    unloaded_modes,
)
from pneunet_ros.measurement.painted_targets import paint
from pneunet_ros.measurement.reading_filter import without_reading_noise
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.vibration import masses_of
from pneunet_ros.solver.collocation import prepare
from pneunet_ros.solver.columns import CURVATURE, join_ends, PANEL_WIDTH, THETA
from pneunet_ros.solver.links import Masses
from pneunet_ros.solver.modes import Modes

SCANNED_MASSES = np.geomspace(0.4, 8.0, 13).tolist()  # of the tip with the arm's share, at first
SCANNED_RATIOS = (0.03, 0.1, 0.3)  # damping ratios of the first mode, at first
SCANNED_READINGS = 1000
# Of the arm's mass, what counts at the tip in its first mode: 33 / 140, by Rayleigh.
SHARE_AT_TIP = 33.0 / 140.0
MOST_STEPS = 30  # of the fit
LARGE = 0.5  # of the largest swing: behind the last so large one nothing holds the arm any more
LIGHTEST = 0.2  # of its weight that an arm may have as mass, while it is sought
# What fits leave out, relative: in MuJoCo they are off by up to 0.3 % of mass, 0.6 % of damping.
LEFT_OUT = 0.004
SURE = 1.96  # standard deviations, 95 % of a normal error
DIFFERENCE = 0.01  # of a standard deviation, for numerical derivatives by other errors

Solved = tuple[Array, Array, Array]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingingRun:
    """A recording with the equilibrium at each of its readings.

    stamp_ns (readings,); solved: tables of the rod, (readings, ...) each; still (readings, 2,
    targets) m: the targets in equilibrium; bent (readings, 2, targets): theta (rad) and curvature
    (1/m) there; reading (frames,): of each frame; points (frames, 2, targets) m. plucked: whether
    the pressure is constant.
    """

    name: str
    stamp_ns: Stamps
    solved: Solved
    still: Array
    reading: Stamps
    points: Array
    bent: Array
    plucked: bool

    @property
    def beside(self) -> Array:
        """Measured targets relative to equilibrium, (frames, 2, targets) m, NaN where not seen."""
        return self.points - self.still[self.reading]

    def part(self, frames: slice, readings: slice) -> SwingingRun:
        """Return these frames and readings of the recording."""
        panels, ends, nodes = self.solved
        return replace(
            self,
            stamp_ns=self.stamp_ns[readings],
            solved=(panels[readings], ends[readings], nodes[readings]),
            still=self.still[readings],
            reading=self.reading[frames] - (readings.start or 0),
            points=self.points[frames],
            bent=self.bent[readings],
        )

    def beginning_with(self, frame: int) -> SwingingRun:
        """Return the recording starting at the reading of a frame."""
        return self.part(slice(frame, None), slice(int(self.reading[frame]), None))

    def centered(self, values: Array) -> Array:
        """Subtract its mean from each coordinate of (frames, 2, targets, ...); NaN if unseen.

        The position of the camera is not motion. At the release, the state of the arm is not known
        yet.
        """
        left_out = ~np.isfinite(self.points)
        left_out[self.plucked * (self.reading == 0)] = True
        seen = values.copy()
        seen[left_out] = np.nan
        times_seen = np.maximum((~left_out).sum(axis=0), 1)
        mean = np.nansum(seen, axis=0).T / times_seen.T
        return np.asarray(seen - mean.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFit:
    """Fitted mass and damping, with standard errors.

    tip_mass kg, damping_time s; hertz and decay_time (s): of the slowest vibration of the unloaded
    arm at mid-range pressure. still_rms, moving_rms (m): residuals of targets from the arm in
    equilibrium and in motion. in_motion: number of frames in which motion moves the tip by more
    than 1.96 standard deviations of a target. shares (arms,): fitted step towards each of
    `nearby`.
    """

    motion: Motion
    tip_mass_std: float
    damping_time_std: float
    hertz: float
    decay_time: float
    still_rms: float
    moving_rms: float
    in_motion: int
    frames: int
    shares: tuple[float, ...] = ()

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return (
            f'{self.in_motion} of {self.frames} frames show the arm in motion ({self.hertz:.2g} '
            f'Hz, decays in {self.decay_time:.2g} s): tip_mass {1e3 * self.motion.tip_mass:.2g} '
            f'± {1e3 * self.tip_mass_std:.1g} g, damping_time '
            f'{1e3 * self.motion.damping_time:.3g} ± {1e3 * self.damping_time_std:.1g} ms; '
            f'targets are {millimeters(self.moving_rms):.2g} mm away from the moving arm, and '
            f'{millimeters(self.still_rms):.2g} mm from its equilibrium'
        )


def swinging_run(arm: Arm, run: RecordingData) -> SwingingRun:
    """Solve the equilibrium at every reading and frame of a recording."""
    run = without_reading_noise(run, arm.sensors).at_instants(arm.frame_delay)
    stamps, count = run.reading_stamp_ns, len(run.reading_stamp_ns)
    loads = np.zeros((count, 3))
    if run.loaded:
        known = (run.stamp_ns, run.load)
        if run.wrench_stamp_ns is not None and run.wrench is not None:
            known = (run.wrench_stamp_ns, run.wrench)
        loads = np.column_stack([interpolate(stamps, known[0], part) for part in known[1].T])
    unseen = np.full((count, arm.target_arclength.size), np.nan)
    every = replace(
        run,
        stamp_ns=stamps,
        reading=np.arange(count),
        force=loads[:, :2],
        moment=loads[:, 2],
        x=unseen,
        y=unseen,
        tip_pose=None,
        gravity=run.gravity_at(stamps),
        wrench_stamp_ns=None,
        wrench=None,
    )
    prompt_effects = tuple(item for item in arm.effects if not item.frame_delay)
    prompt = replace(arm, effects=prompt_effects, covariance=None)
    (inputs,) = inputs_of(prompt, [every])
    model = ForwardModel(arm.target_arclength)
    if not model.solve(arm, inputs).all():
        raise RequestError(
            f'{run.name}: at some readings the arm has no equilibrium; cut the recording to '
            'pressures and loads of the calibrated domain',
            reason='no_equilibrium',
        )
    rods = inputs.rods(arm)
    ends = join_ends(rods.clamp, inputs.loads)
    panels = np.empty((count, model.nodes.shape[1] - 1, PANEL_WIDTH))
    for index, table in enumerate(panels):
        sections, rotation = rods.sections[index], rods.rotation[index]
        prepare(rods.length, sections, rods.knots, rotation, ends[index], model.counts, table)
    still = stands_still(run, loads, arm)
    found = SwingingRun(
        name=run.name,
        stamp_ns=stamps,
        solved=(panels, ends, model.nodes.copy()),
        still=model.points,
        reading=run.reading,
        points=run.points,
        bent=model.fields[:, [THETA, CURVATURE]],
        plucked=still,
    )
    return let_go(found) if still else found


def stands_still(run: RecordingData, loads: Array, arm: Arm) -> bool:
    """Whether pressure and loads (readings, 3) are constant, so the arm must have been plucked."""
    reach, noise = 2.0 * run.idle_reach(), arm.sensors
    known = (run.pressure, noise.pressure_std), (loads[:, :2], noise.force_std)
    return all(float(np.max(np.ptp(values, axis=0))) <= reach * std for values, std in known)


def let_go(run: SwingingRun) -> SwingingRun:
    """Return a recording starting after the last frame of a large swing.

    Raises RequestError if there are no two frames with targets.
    """
    away = np.hypot(*run.beside.transpose(1, 0, 2))
    seen = np.isfinite(away).any(axis=1)
    if np.count_nonzero(seen) < 2:
        raise RequestError(
            f'{run.name}: fewer than two frames show targets; record the arm while it swings',
            reason='too_few_frames',
        )
    far = np.zeros(len(away))
    far[seen] = np.nanmean(away[seen], axis=1)
    large = np.flatnonzero(far[:-1] >= LARGE * far.max())
    return run.beginning_with(int(large[-1]) + 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionProblem:
    """Recordings, and the fitted parameters.

    The parameters: mass at the tip, in units of the arm's effective mass there, negative if the
    arm itself is lighter; log of the damping time (s); then q and p at the start of each plucked
    recording. std (m): white noise of a target. others (rows, unknowns): columns of residuals by
    other uncertainties, one sigma each; covariance (unknowns, unknowns): the inverse of their
    information.
    """

    arm: Arm
    runs: tuple[SwingingRun, ...]
    modes: Modes
    places: Places
    std: float
    others: Array | None = None
    covariance: Array | None = None

    @property
    def lost(self) -> float:
        """Position (m) used for a chain that diverged: farther away than any arm can be."""
        return 2.0 * self.arm.length

    @property
    def share(self) -> float:
        """The effective mass of the arm at its tip, kg."""
        return SHARE_AT_TIP * self.arm.weight / STANDARD_GRAVITY

    def motion(self, numbers: Array) -> tuple[float, float]:
        """Return mass at the tip (kg) and damping time (s)."""
        return self.share * float(numbers[0]), math.exp(float(numbers[1]))

    def masses(self, mass: float) -> Masses:
        """Return the masses with this mass at the tip; a negative one lightens the whole arm."""
        own = masses_of(self.arm)
        if mass >= 0.0:
            return own._replace(tip=self.share * mass)
        return own._replace(mass=freeze(own.mass * max(1.0 + mass, LIGHTEST)))

    def first_numbers(self, mass: float, ratio: float) -> Array:
        """Return initial parameters: tip mass as a share of the effective mass; damping ratio."""
        frequency = float(self.modes.frequency[0]) / math.sqrt(1.0 + mass)
        starts = [value for run in self.runs if run.plucked for value in self.first_start(run)]
        return np.array([mass, math.log(2.0 * ratio / frequency), *starts])

    def first_start(self, run: SwingingRun) -> list[float]:
        """Return the initial q closest to the first frame of a run, at zero velocity."""
        masses = masses_of(self.arm)
        panels, ends, nodes = run.solved
        rod = panels[0], ends[0], nodes[0]
        first = follow_reading(None, 0, rod, masses, 0.0, self.modes)[1]
        along = (first.at_nodes[3:] @ self.places.nodes).reshape(SHAPES, 3, -1)[:, :2]
        seen = run.beside[0].reshape(-1)
        known = np.isfinite(seen)
        q, *_ = np.linalg.lstsq(along.reshape(SHAPES, -1)[:, known].T, seen[known], rcond=None)
        return [*q.tolist(), *[0.0] * SHAPES]

    def follow(self, numbers: Array) -> tuple[list[Array], list[Flags]]:
        """Return, per run, the deviation of targets (frames, 2, targets) m, and frames at rest."""
        _, damping_time = self.motion(numbers)
        masses = self.masses(float(numbers[0]))
        starts = iter(numbers[2:].reshape(-1, 2, SHAPES))
        beside, settled = [], []
        for run in self.runs:
            start = next(starts) if run.plucked else np.zeros((2, SHAPES))
            along = follow_readings(
                run.stamp_ns, run.solved, start, masses, damping_time, self.modes
            )
            rest = np.hypot(*along[:, :, -1].T) <= SURE * self.std
            # of numbers with which the chain flies apart nothing may look like a target unseen
            found = np.clip(np.nan_to_num(along, nan=self.lost), -self.lost, self.lost)
            beside.append(found[run.reading] @ self.places.nodes)
            settled.append(rest[run.reading])
        return beside, settled

    def residuals(self, beside: Sequence[Array]) -> list[Array]:
        """Return the residuals of the targets per run, (frames, 2, targets) m, `centered`."""
        return [
            run.centered(run.beside - found) for run, found in zip(self.runs, beside, strict=True)
        ]

    def cost(self, numbers: Array) -> Array:
        """Return all residuals as one vector, in units of the noise, then shares of the others."""
        return np.concatenate(self.split(self.white(self.residuals(self.follow(numbers)[0]))))

    def white(self, left: Sequence[Array]) -> Array:
        """Return residuals per run as one vector, in units of the noise."""
        return np.nan_to_num(np.concatenate([item.ravel() for item in left]) / self.std)

    def root_mean_square(self, left: Sequence[Array]) -> float:
        """Return the root mean square (m) of target distances after subtracting the others."""
        rest, _ = self.split(self.white(left))
        return self.std * math.sqrt(
            2.0 * float(rest @ rest) / sum(int(np.isfinite(item).sum()) for item in left)
        )

    def split(self, left: Array) -> tuple[Array, Array]:
        """Return residuals (rows,) after subtracting the others, and the values of these.

        values (unknowns,): most probable, in sigma.
        """
        if self.others is None or self.covariance is None:
            return left, np.zeros(0)
        shares = self.covariance @ (self.others.T @ left)
        return left - self.others @ shares, shares

    def with_others(
        self, arms: Sequence[Arm], runs: Sequence[RecordingData], numbers: Array
    ) -> MotionProblem:
        """Return the problem with all other uncertainties, at these parameters.

        The others: an unknown step towards each of these arms, then the positions of targets and
        camera: on a slow ramp, errors of both look like damping.
        """
        others = np.column_stack([*self.steps_towards(arms, runs, numbers), self.disturbed(runs)])
        gram = others.T @ others + np.eye(others.shape[1])
        return replace(self, others=others, covariance=np.asarray(np.linalg.inv(gram)))

    def disturbed(self, runs: Sequence[RecordingData]) -> Array:
        """Return the columns (rows, n) of the disturbances, in units of their prior."""
        disturbances = Disturbances(
            arclength=self.arm.target_arclength, runs=runs, noise=self.arm.sensors
        )
        root = np.linalg.cholesky(disturbances.prior) / self.std
        rows = np.zeros((sum(run.points.size for run in self.runs), len(root)))
        end = 0
        for which, (run, recording) in enumerate(zip(self.runs, runs, strict=True)):
            start, end = end, end + run.points.size
            if run.plucked:  # about one equilibrium they are constant
                continue
            theta, curvature = run.bent[run.reading].swapaxes(0, 1)
            nowhere_else = np.zeros((2, theta.shape[1]))
            moved = disturbance_jacobian(recording, paint(theta, curvature, nowhere_else))
            moved = np.nan_to_num(run.centered(moved)).reshape(end - start, -1)
            rows[start:end] = moved @ root[disturbances.of_run(which)]
        return rows

    def steps_towards(
        self, arms: Sequence[Arm], runs: Sequence[RecordingData], numbers: Array
    ) -> list[Array]:
        """Return a column (rows,) of one sigma towards each of these arms, at these parameters."""
        here = self.follow(numbers)[0]
        left, columns = self.white(self.residuals(here)), []
        for arm in arms:
            other = motion_problem(arm, runs)
            moved = [
                mine if run.plucked else beside + run.still[run.reading] - one.still[one.reading]
                for run, one, beside, mine in zip(
                    other.runs, self.runs, other.follow(numbers)[0], here, strict=True
                )
            ]
            columns.append((left - self.white(self.residuals(moved))) / DIFFERENCE)
        return columns

    def best_of_scan(self) -> Array:
        """Return the grid parameters that explain the first readings of each run best."""
        short = self.shortened(SCANNED_READINGS)
        guesses = [
            short.first_numbers(mass - 1.0, ratio)
            for mass in SCANNED_MASSES
            for ratio in SCANNED_RATIOS
        ]
        return min(guesses, key=lambda numbers: float(np.sum(short.cost(numbers) ** 2)))

    def search(self, start: Array, least_mass: float = -math.inf) -> Any:
        """Search for the most likely parameters; least_mass: lower bound of the first one."""
        from scipy.optimize import least_squares  # slow to import, and few fits need it

        return least_squares(
            self.cost,
            start,
            bounds=([least_mass, *[-math.inf] * (start.size - 1)], math.inf),
            x_scale='jac',
            loss='soft_l1',
            diff_step=1e-4,
            max_nfev=MOST_STEPS,
        )

    def without_held_frames(self, left: Sequence[Array]) -> MotionProblem | None:
        """Remove the frames in which plucked arms were still held; None if there are none.

        left: residuals per run. If a push ends after the last large swing, some frames within the
        first period fit no free swing: their residuals are larger than later ones.
        """
        period = 2.0 * np.pi / float(self.modes.frequency[0]) * NANOSECONDS_PER_SECOND
        runs = list(self.runs)
        for which, (run, residual) in enumerate(zip(self.runs, left, strict=True)):
            if not run.plucked:
                continue
            coordinates = np.maximum(np.isfinite(residual).sum(axis=(1, 2)), 1)
            chi_square = np.nansum((residual / self.std) ** 2, axis=(1, 2)) / coordinates
            typical = max(float(np.median(chi_square)), 1.0)
            limits = [typical * chi_square_limit(count) for count in coordinates.tolist()]
            early = run.stamp_ns[run.reading] - run.stamp_ns[0] < period
            held = np.flatnonzero(early & (chi_square > limits))
            if held.size and held[-1] + 2 < len(residual):
                runs[which] = run.beginning_with(int(held[-1]) + 1)
        if all(after is before for after, before in zip(runs, self.runs, strict=True)):
            return None
        return replace(self, runs=tuple(runs), others=None, covariance=None)

    def with_starts(self, numbers: Array) -> Array:
        """Return the parameters with starts of plucked runs fitted to their frames."""
        if numbers.size == 2:
            return numbers
        from scipy.optimize import least_squares  # slow to import, and few fits need it

        motion, starts = numbers[:2], numbers[2:]
        found = least_squares(
            lambda starts: self.cost(np.concatenate([motion, starts])),
            starts,
            x_scale='jac',
            max_nfev=MOST_STEPS,
        )
        return np.concatenate([motion, found.x])

    def numbers_of(self, motion: Motion) -> Array:
        """Return parameters for a mass and damping; plucked runs start at their first frame."""
        numbers = self.first_numbers(0.0, 0.1)
        numbers[:2] = motion.tip_mass / self.share, math.log(motion.damping_time)
        return numbers

    def shortened(self, most: int) -> MotionProblem:
        """Return the problem with this many readings of each run."""
        runs = (
            run.part(slice(np.count_nonzero(run.reading < most)), slice(most)) for run in self.runs
        )
        return replace(self, runs=tuple(runs))


def fit_motion(
    arm: Arm,
    runs: Sequence[RecordingData],
    *,
    near: Motion | None = None,
    nearby: Sequence[Arm] = (),
    trusted_error: float = 0.0,
) -> MotionFit:
    """Fit mass at the tip and damping to recordings in which the arm swings.

    At most as many frames as in a calibration are fitted, evenly in time and pressure.

    Args:
        arm: the calibrated arm; its weight is its mass.
        runs: recordings with quick changes of the pressure, or of an arm that was plucked and let
            go at constant pressure.
        near: start of the search; None: scan a grid.
        nearby: arms that differ from this one by one error each, by `DIFFERENCE` of a standard
            deviation; the sizes of these errors are fitted too.
        trusted_error: relative error of the mass up to which a swing that suggests a lighter arm
            is overruled by the model file.

    Returns:
        Mass and damping with standard errors.

    Raises:
        RequestError: the arm hardly swings in the recordings, or no mass at the tip explains its
            motion.
    """
    runs = thinned(runs, EXPERIMENTS.most_frames)
    problem = motion_problem(arm, runs)
    start = problem.best_of_scan() if near is None else problem.numbers_of(near)
    while True:
        problem = problem.with_others(nearby, runs, start)
        fitted = problem.search(start)
        later = problem.without_held_frames(problem.residuals(problem.follow(fitted.x)[0]))
        if later is None:
            break
        problem, start = later, later.first_numbers(0.0, 0.1)
        start[:2] = fitted.x[:2]
    if 0.0 < -fitted.x[0] <= trusted_error:
        fitted = problem.search(np.array([0.0, *fitted.x[1:]]), least_mass=0.0)
    beside, settled = problem.follow(fitted.x)
    left = problem.residuals(beside)
    never = problem.residuals([np.zeros_like(item) for item in beside])
    moving_rms, still_rms = problem.root_mean_square(left), problem.root_mean_square(never)
    in_motion = sum(int(np.count_nonzero(~item)) for item in settled)
    frames = sum(len(item) for item in settled)
    if not moving_rms < still_rms:
        raise RequestError(
            f'the recordings after --motion do not show the arm swinging ({in_motion} of '
            f'{frames} frames, none of them explained by mass): change the pressure by half of '
            'its range within 0.1 s, or pluck the arm and let it go',
            reason='not_in_motion',
        )
    errors = standard_errors(problem, fitted.jac, left)
    tip_mass, damping_time = problem.motion(fitted.x)
    mass_error, damping_error = (
        math.hypot(errors[0] / max(1.0 + float(fitted.x[0]), 1.0), LEFT_OUT),
        math.hypot(errors[1], LEFT_OUT),
    )
    tip_std = mass_error * problem.share * max(1.0 + float(fitted.x[0]), 1.0)
    if tip_mass < -SURE * tip_std:
        whole = (1.0 + tip_mass / problem.share) * arm.weight
        raise RequestError(
            f'the arm swings faster than its weight allows: arm.weight is {arm.weight:.4g} N, '
            f'but the swing would need {whole:.4g} N. Weigh the arm, and give --arm a file with '
            'that weight',
            reason='wrong_weight',
        )
    tip_mass = max(tip_mass, 0.0)
    motion = Motion(
        tip_mass=tip_mass,
        damping_time=damping_time,
        mass_error=mass_error,
        damping_error=damping_error,
    )
    found = unloaded_modes(replace(arm, motion=motion, covariance=None))
    assert found is not None
    return MotionFit(
        motion=motion,
        tip_mass_std=tip_std,
        damping_time_std=damping_time * damping_error,
        hertz=found.hertz,
        decay_time=found.decay_time,
        still_rms=still_rms,
        moving_rms=moving_rms,
        in_motion=in_motion,
        frames=frames,
        shares=tuple(problem.split(problem.white(left))[1][: len(nearby)].tolist()),
    )


def predicted_motion(
    arm: Arm, motion: Motion, runs: Sequence[RecordingData]
) -> tuple[tuple[Array, ...], tuple[Array, ...], tuple[Array, ...], tuple[Flags, ...]]:
    """Predict recordings for given mass and damping, without a fit.

    Only the initial state of a plucked arm is fitted. Returns, per run, the measured and predicted
    deviations from equilibrium (frames, 2, targets) m, each minus its mean, and the frames at
    rest.
    """
    problem = motion_problem(arm, runs)
    while True:
        beside, rest = problem.follow(problem.with_starts(problem.numbers_of(motion)))
        left = problem.residuals(beside)
        later = problem.without_held_frames(left)
        if later is None:
            break
        problem = later
    still = problem.residuals([np.zeros_like(item) for item in beside])
    return tuple(still), tuple(left), tuple(beside), tuple(rest)


def less_swing(arm: Arm, motion: Motion, runs: Sequence[RecordingData]) -> list[RecordingData]:
    """Return recordings minus the swing of an arm of this mass and damping about equilibrium.

    Recordings of a plucked arm are unchanged.
    """
    problem = motion_problem(arm, runs)
    beside, _ = problem.follow(problem.numbers_of(motion))
    return [
        run if one.plucked else replace(run, x=run.x - swing[:, 0], y=run.y - swing[:, 1])
        for run, one, swing in zip(runs, problem.runs, beside, strict=True)
    ]


def motion_problem(arm: Arm, runs: Sequence[RecordingData]) -> MotionProblem:
    """Set up the fit of motion to recordings; RequestError if the arm cannot swing."""
    still = replace(arm, motion=Motion())
    modes = unloaded_modes(still)
    if modes is None:
        raise RequestError(
            f'{arm.name} has no stable unloaded shape to swing about', reason='no_equilibrium'
        )
    return MotionProblem(
        arm=still,
        runs=tuple(swinging_run(still, run) for run in runs),
        modes=modes,
        places=places_along(arm.reach, arm.target_arclength),
        std=max(arm.sensors.target_std, 1e-6 * arm.length),
    )


def standard_errors(problem: MotionProblem, jacobian: Array, left: Sequence[Array]) -> Array:
    """Return the standard errors of the parameters.

    Residuals are correlated from frame to frame, because the statics are not exact: the frames of
    one period of the arm count as one observation. Source: cluster-robust covariance, Liang and
    Zeger, Biometrika 73 (1986).
    """
    period = 2.0 * np.pi / float(problem.modes.frequency[0])
    blocks, first = [], 0
    for which, (run, residual) in enumerate(zip(problem.runs, left, strict=True)):
        seconds = (run.stamp_ns[run.reading] - run.stamp_ns[0]) / NANOSECONDS_PER_SECOND
        block = first + (seconds / period).astype(np.int64)
        blocks.append(np.repeat(block, residual[0].size))
        first = int(block[-1]) + 1 if which + 1 < len(problem.runs) else first
    residuals, _ = problem.split(problem.white(left))
    jacobian = jacobian[: len(residuals)]
    scores = np.zeros((int(np.concatenate(blocks).max()) + 1, jacobian.shape[1]))
    np.add.at(scores, np.concatenate(blocks), jacobian * residuals[:, None])
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread)))
