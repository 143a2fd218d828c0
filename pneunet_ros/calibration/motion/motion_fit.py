"""Tip mass and damping of an arm, from recordings in which it oscillates.

If an arm was plucked, its initial state is fitted as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from pneunet_ros.calibration.motion.motion_problem import (
    DIFFERENCE_STEP,
    Flags,
    motion_problem,
    MotionProblem,
)
from pneunet_ros.calibration.settings import EXPERIMENTS
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import millimeters, NANOSECONDS_PER_SECOND
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.measurement.dataset import RecordingData, thin_runs
from pneunet_ros.measurement.moving_arm import unloaded_modes, WITHIN_95
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.perturbation import COLUMN_STEP, neighbors

# Relative model error of fits: in MuJoCo the mass is off by up to 0.3 %, the damping by 0.6 %.
MODEL_ERROR = 0.004


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFit:
    """Fitted mass and damping, with standard errors.

    tip_mass kg, damping_time s; hertz and decay_time (s) of the slowest vibration of the unloaded
    arm at mid-range pressure. still_rms, moving_rms (m): residuals of targets with the arm in
    equilibrium and in motion. in_motion: number of frames in which motion displaces the tip by
    more than 1.96 standard deviations of a target. shares (arms,): fitted steps towards the
    perturbed arms. objection: why a moving arm does not explain the recordings; empty if it does.
    The standard errors include those of the static arm, unlike `mass_error` and `damping_error`.
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
    objection: str = ''

    @property
    def sentence(self) -> str:
        """The result as a sentence."""
        return (
            f'{self.in_motion} of {self.frames} frames show the arm in motion ({self.hertz:.2g} '
            f'Hz, decays in {self.decay_time:.2g} s): tip_mass {1e3 * self.motion.tip_mass:.2g} '
            f'± {1e3 * self.tip_mass_std:.1g} g, damping_time '
            f'{1e3 * self.motion.damping_time:.3g} ± {1e3 * self.damping_time_std:.1g} ms; '
            f'targets are {millimeters(self.moving_rms):.2g} mm away from the moving arm, and '
            f'{millimeters(self.still_rms):.2g} mm from its equilibrium'
        )

    @property
    def described(self) -> str:
        """The result as a sentence, with the objection to it, if any."""
        return f'{self.sentence}; but {self.objection}' if self.objection else self.sentence

    def apply_to(self, arm: Arm) -> Arm:
        """Return an arm with the fitted motion."""
        moving = arm.with_motion(self.motion)
        return replace(moving, sources={**arm.sources, 'motion': self.described})


def fit_motion(
    arm: Arm,
    runs: Sequence[RecordingData],
    *,
    start_motion: Motion | None = None,
    perturbed_arms: Sequence[Arm] = (),
    trusted_error: float = 0.0,
) -> MotionFit:
    """Fit mass at the tip and damping to recordings in which the arm swings.

    At most as many frames as in a calibration are fitted, evenly in time and pressure.

    Args:
        arm: the calibrated arm; its weight is its mass.
        runs: recordings with quick changes of the pressure, or of an arm that was plucked and let
            go at constant pressure.
        start_motion: start of the search; None: scan a grid.
        perturbed_arms: arms that differ from this one by one error each, by `DIFFERENCE_STEP` of a
            standard deviation; the sizes of these errors are fitted too.
        trusted_error: relative error of the mass below which the model file overrules a
            swing that suggests a lighter arm.

    Returns:
        Mass and damping with standard errors.

    Raises:
        RequestError: the arm hardly swings in the recordings, or no tip mass explains its motion.
    """
    runs = thin_runs(runs, EXPERIMENTS.most_frames)
    problem = motion_problem(arm, runs)
    start = problem.best_of_scan() if start_motion is None else problem.parameters_of(start_motion)
    problem, fitted = search_released(problem, runs, start, perturbed_arms)
    if 0.0 < -fitted.x[0] <= trusted_error:
        fitted = problem.search(np.array([0.0, *fitted.x[1:]]), least_mass=0.0)
    deviations, at_rest = problem.simulate(fitted.x)
    residuals = problem.residuals(deviations)
    static_residuals = problem.residuals([np.zeros_like(item) for item in deviations])
    moving_rms = problem.root_mean_square(residuals)
    still_rms = problem.root_mean_square(static_residuals)
    in_motion = sum(int(np.count_nonzero(~item)) for item in at_rest)
    frames = sum(len(item) for item in at_rest)
    if not in_motion or not moving_rms < still_rms:
        raise RequestError(
            f'the recordings after --motion do not show the arm swinging ({in_motion} of '
            f'{frames} frames, none of them explained by mass): change the pressure by half of '
            'its range within 0.1 s, or pluck the arm and let it go',
            reason='not_in_motion',
        )
    errors = standard_errors(problem, fitted.jac, residuals, float(fitted.x[0]))
    tip_mass, damping_time = problem.motion(fitted.x)
    inertia = max(1.0 + float(fitted.x[0]), 1.0)  # in units of the effective mass of the arm
    mass_error = math.hypot(errors[0] / inertia, MODEL_ERROR)
    damping_error = math.hypot(errors[1], MODEL_ERROR)
    mass_shift, damping_shift = np.linalg.norm(static_shifts(problem, runs, fitted), axis=0)[:2]
    tip_std = problem.effective_mass * math.hypot(mass_error * inertia, mass_shift)
    objection = objection_to(problem, residuals, deviations, at_rest)
    check_tip_mass(problem, tip_mass, tip_std, objection)
    motion = Motion(
        tip_mass=max(tip_mass, 0.0),
        damping_time=damping_time,
        mass_error=mass_error,
        damping_error=damping_error,
    )
    found = unloaded_modes(replace(arm, covariance=None).with_motion(motion))
    assert found is not None
    sizes = problem.without_nuisance(problem.whitened(residuals))[1]
    return MotionFit(
        motion=motion,
        tip_mass_std=tip_std,
        damping_time_std=damping_time * math.hypot(damping_error, damping_shift),
        objection=objection,
        hertz=found.hertz,
        decay_time=found.decay_time,
        still_rms=still_rms,
        moving_rms=moving_rms,
        in_motion=in_motion,
        frames=frames,
        shares=tuple(sizes[: len(perturbed_arms)].tolist()),
    )


def search_released(
    problem: MotionProblem,
    runs: Sequence[RecordingData],
    start: Array,
    perturbed_arms: Sequence[Arm],
) -> tuple[MotionProblem, Any]:
    """Fit the parameters, drop the frames in which the arm was held, and fit again.

    Returns the recordings without these frames, and the fit of `MotionProblem.search`.
    """
    while True:
        problem = problem.with_nuisance(perturbed_arms, runs, start)
        fitted = problem.search(start)
        released = problem.without_held_frames(
            problem.residuals(problem.simulate(fitted.x)[0]), float(fitted.x[0])
        )
        if released is None:
            return problem, fitted
        problem, start = released, released.initial_parameters(0.0, 0.1)
        start[:2] = fitted.x[:2]


def check_tip_mass(
    problem: MotionProblem, tip_mass: float, tip_std: float, objection: str
) -> None:
    """Reject a mass (kg) at the tip that is significantly negative, with its likely cause."""
    if not tip_mass < -WITHIN_95 * tip_std:
        return
    if objection:
        raise RequestError(
            f'no mass explains how the arm moves in the recordings after --motion ({objection}): '
            'it lags, creeps or has friction, or the clocks differ. Run `pneunet diagnose`',
            reason='not_in_motion',
        )
    weight = problem.arm.weight
    needed_weight = (1.0 + tip_mass / problem.effective_mass) * weight
    raise RequestError(
        f'the arm swings faster than its weight allows: arm.weight is {weight:.4g} N, '
        f'but the swing would need {needed_weight:.4g} N. Weigh the arm, and give --arm a '
        'file with that weight',
        reason='wrong_weight',
    )


def static_shifts(problem: MotionProblem, runs: Sequence[RecordingData], fitted: Any) -> Array:
    """Return the changes of the fitted parameters per sigma of each error of the static arm.

    (columns, parameters), a row of zeros without a covariance. A stiffer arm swings like a lighter
    one.
    """
    arm = problem.arm
    if arm.covariance is None:
        return np.zeros((1, fitted.x.size))
    shifts = []
    for column in arm.covariance.columns():
        near = next(one for one in neighbors(arm, column)[:2] if one is not arm)
        (change,) = problem.error_columns([near], runs, fitted.x)
        change, _ = problem.without_nuisance(change * DIFFERENCE_STEP / COLUMN_STEP)
        # `fitted.jac` is scaled by the loss, as in `standard_errors`.
        scale = (1.0 + fitted.fun[: change.size] ** 2) ** -0.75
        shifts.append(np.linalg.lstsq(fitted.jac[: change.size], scale * change)[0])
    return np.array(shifts)


def objection_to(
    problem: MotionProblem,
    residuals: Sequence[Array],
    deviations: Sequence[Array],
    at_rest: Sequence[Flags],
) -> str:
    """Return why a moving arm does not explain the swings; empty if it does.

    The noise is that of frames at rest, if there are any.
    """
    left = problem.std * problem.without_nuisance(problem.whitened(residuals))[0]
    seen = np.concatenate([np.isfinite(item).ravel() for item in residuals])
    moving = np.concatenate(
        [np.repeat(~rest, item[0].size) for rest, item in zip(at_rest, residuals, strict=True)]
    )
    swung = np.concatenate([item.ravel() for item in deviations])
    rested = left[seen & ~moving]
    floor = max(float(np.mean(rested**2)) if rested.size else 0.0, problem.std**2)
    swing = float(np.mean(swung[seen & moving] ** 2))
    return unexplained_swing(float(np.mean(left[seen & moving] ** 2)), floor, swing)


def unexplained_swing(left: float, floor: float, swing: float) -> str:
    """Return why a moving arm does not explain its swings; empty if it does.

    left: mean square (m^2) of the residuals; allowed are noise (floor) and the law error of
    inertia, relative to the mean square of the swing.
    """
    allowed = floor + Inertia.law_error**2 * swing
    if left <= allowed:
        return ''
    return (
        f'while it moves, targets are {millimeters(math.sqrt(left)):.2g} mm away from the moving '
        f'arm, where noise alone would leave {millimeters(math.sqrt(allowed)):.2g} mm'
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
        parameters = problem.with_fitted_starts(problem.parameters_of(motion))
        deviations, at_rest = problem.simulate(parameters)
        residuals = problem.residuals(deviations)
        released = problem.without_held_frames(residuals, float(parameters[0]))
        if released is None:
            break
        problem = released
    static_residuals = problem.residuals([np.zeros_like(item) for item in deviations])
    return tuple(static_residuals), tuple(residuals), tuple(deviations), tuple(at_rest)


def without_swing(arm: Arm, motion: Motion, runs: Sequence[RecordingData]) -> list[RecordingData]:
    """Subtract the swing of an arm with this mass and damping from recordings.

    Recordings of a plucked arm are unchanged.
    """
    problem = motion_problem(arm, runs)
    deviations, _ = problem.simulate(problem.parameters_of(motion))
    return [
        run if one.plucked else replace(run, x=run.x - swing[:, 0], y=run.y - swing[:, 1])
        for run, one, swing in zip(runs, problem.runs, deviations, strict=True)
    ]


def standard_errors(
    problem: MotionProblem, jacobian: Array, residuals: Sequence[Array], mass: float
) -> Array:
    """Return the standard errors of the parameters.

    Residuals are correlated from frame to frame, because the statics are not exact: the frames of
    one period of the arm count as one observation. Source: cluster-robust covariance, Liang and
    Zeger, Biometrika 73 (1986).

    Args:
        problem: the recordings.
        jacobian: as `MotionProblem.search` returns it, scaled by (1 + z)^(-3/4) for the loss,
            where z are the squared residuals in units of the noise.
        residuals: per run, (frames, 2, targets) m.
        mass: fitted mass at the tip, in units of the effective mass of the arm.

    Returns:
        Standard errors, in the order of the parameters.
    """
    period = problem.period(mass)
    blocks, first = [], 0
    for which, (run, residual) in enumerate(zip(problem.runs, residuals, strict=True)):
        seconds = (run.stamp_ns[run.reading] - run.stamp_ns[0]) / NANOSECONDS_PER_SECOND
        block = first + (seconds / period).astype(np.int64)
        blocks.append(np.repeat(block, residual[0].size))
        first = int(block[-1]) + 1 if which + 1 < len(problem.runs) else first
    whitened, _ = problem.without_nuisance(problem.whitened(residuals))
    jacobian = jacobian[: len(whitened)]
    # The score is the true Jacobian times the residual times (1 + z)^(-1/2).
    whitened = whitened * (1.0 + whitened**2) ** 0.25
    scores = np.zeros((int(np.concatenate(blocks).max()) + 1, jacobian.shape[1]))
    np.add.at(scores, np.concatenate(blocks), jacobian * whitened[:, None])
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread)))
