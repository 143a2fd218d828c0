"""Persistent errors over a recording: one joint test of a model on all frames.

In a single frame, noise hides an error that is common to all frames. In this test, the stated
errors of a model are unknowns shared by all frames: the columns of its covariance, the placement
of the targets, and the path of the camera. Their prior is the posterior of the calibration; the
estimate uses all frames jointly. A model is adequate if the estimate is consistent with the prior
and with the noise of the frames, and if the residuals are consistent with this noise.

Errors correlated from frame to frame carry less information than independent errors; the factor is
estimated from the residuals. Source: Newey and West, Econometrica 55 (1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.disturbances import (
    BETWEEN_NODES,
    path_prior,
    path_weights,
    SMALLEST_STD,
)
from pneunet_ros.measurement.errors.covariance import Whitening
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.errors.noise_model import camera_errors
from pneunet_ros.measurement.inference.adequacy import ADEQUACY, LARGEST_95, RARE, RARELY
from pneunet_ros.measurement.painted_targets import paint
from pneunet_ros.measurement.predicted_targets import PredictedTargets
from pneunet_ros.model.arm import Arm
import scipy

READINGS = PRESSURE + 1  # number of errors of a frame due to its own readings; these come first
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
FEWEST_FRAMES = 20  # for a verdict
SEEN = 0.1  # of the variance of a prior: with a smaller reduction the unknown is not observed
REPAINTED = 0.25  # of placement_std: few columns do not hold all of its uncertainty


@dataclass(frozen=True, slots=True, kw_only=True)
class PersistenceSettings:
    """Criteria for persistent errors beyond the uncertainty of the model."""

    frames: int = tuning(
        200,
        'number of frames used, evenly spread over a recording, up to twice as many',
        source='sweep',
    )
    white_error: float = tuning(0.05, 'relative error of the std of white noise', source='sweep')


PERSISTENCE = PersistenceSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameEvidence:
    """A frame and its prediction, in the form used by `persistent_errors`.

    residual (2, targets) m: measured minus predicted, NaN where not seen; std (targets,) m of the
    white noise, NaN: that of the model; tip_errors (sources, 2) m: displacement of the tip by one
    sigma of each error of readings and model; tip_covariance (2, 2) m^2 of the estimate. beyond:
    whether the frame alone deviates by more than noise can explain.
    """

    stamp_ns: int
    residual: Array
    std: Array
    predicted: PredictedTargets
    tip_errors: Array
    tip_covariance: Array
    beyond: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KeptFrames:
    """Frames evenly spread over a recording, however long: every `stride`-th of `count`."""

    frames: tuple[FrameEvidence, ...] = ()
    stride: int = 1
    count: int = 0

    def after(self, frame: FrameEvidence) -> KeptFrames:
        """Return the record with one more frame; a full record drops every other frame."""
        kept, stride = self.frames, self.stride
        if self.count % stride == 0:
            kept = (*kept, frame)
        if len(kept) > 2 * PERSISTENCE.frames:
            kept, stride = kept[::2], 2 * stride
        return KeptFrames(frames=kept, stride=stride, count=self.count + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PersistentErrors:
    """Joint evidence of the frames of a recording for errors within the model's uncertainty.

    frames: number used; repeated: number of frames equivalent to one independent frame, 1 if the
    noise is independent. moved: chi squared of the estimated columns of the model's covariance, of
    which `unknowns` are determined by the frames; moved_with_places, unknowns_with_places: these
    numbers including the target positions. chance: p-value of this chi squared; sure: significance
    level. left: chi squared per degree of freedom of the remaining residual; left_limit: its limit
    for noise alone. tip_rms (m): resulting displacement of the tip; tips_outside: share of frames
    with the true tip outside its stated 95 % ellipse, given this displacement.
    """

    frames: int
    repeated: float
    moved: float
    unknowns: int
    moved_with_places: float
    unknowns_with_places: int
    chance: float
    sure: float
    left: float
    left_limit: float
    tip_rms: float
    tips_outside: float

    @property
    def within_prior(self) -> bool:
        """Whether the shared unknowns are consistent with the covariance of the model."""
        return self.chance >= self.sure

    @property
    def noise_left(self) -> bool:
        """Whether the remaining residual is consistent with noise."""
        return self.left <= self.left_limit

    @property
    def holds(self) -> bool:
        """Whether the model is consistent with all frames jointly."""
        return self.within_prior and self.noise_left

    @property
    def sentence(self) -> str:
        """Describe the deviation for users; empty if there is none."""
        if self.holds:
            return ''
        facts = []
        if not self.within_prior:
            facts.append(
                'all frames together deviate from the model by more than its covariance allows '
                f'(chi squared {self.moved:.3g} for {self.unknowns} parameters of the model, '
                f'{self.moved_with_places:.3g} for {self.unknowns_with_places} with the '
                'positions of the targets): with the model alone, the tip is off by '
                f'{millimeters(self.tip_rms):.2g} mm rms, and outside its ellipse in about '
                f'{self.percent_outside} %'
            )
        if not self.noise_left:
            facts.append(
                'and the residual that its covariance cannot explain is '
                f'{math.sqrt(self.left):.2g} x the noise (noise alone: less than '
                f'{math.sqrt(self.left_limit):.2g})'
            )
        return ', '.join(facts).removeprefix('and ')

    @property
    def percent_outside(self) -> str:
        """The share of tips outside in percent."""
        return f'{100.0 * self.tips_outside:.0f}'

    @property
    def advice(self) -> str:
        """Return the advice to users."""
        if self.noise_left:
            return 'the same model with other parameters would fit: recalibrate'
        return (
            'the arm has changed, an effect is missing in the model, or the noise is correlated '
            'from frame to frame. Recalibrate, and run pneunet diagnose on the new recordings'
        )


def persistent_errors(kept: Sequence[FrameEvidence], arm: Arm) -> PersistentErrors | None:
    """Test for errors common to all frames (in order of time); None for too few frames.

    The problem is linearized at the estimates. The shared unknowns (columns of the model's
    covariance, correlated target positions, camera) have the prior of the arm. Independent errors
    of each frame are those of its readings, and the white noise of targets.
    """
    odd = [frame.beyond for frame in kept]
    if any(odd) and np.mean(odd) <= ADEQUACY.outside:
        kept = [frame for frame in kept if not frame.beyond]
    if len(kept) < FEWEST_FRAMES:
        return None
    problem = linear_problem(kept, arm)
    count, unknowns = len(kept), problem.shared.shape[2]
    model = GaussianModel.of(
        [problem.shared.reshape(-1, unknowns)], [problem.residual.ravel()], np.zeros(unknowns)
    )
    rest = model.best_residuals()[0].reshape(count, -1)
    gram, covariance = model.grams[0], model.covariance
    columns = problem.columns
    scores = np.einsum('tci,tc->ti', problem.shared, rest) @ covariance
    repeated = equivalent_frames(scores[:, : columns or unknowns])
    # Covariance of a step before the frames are known, due to the prior and their noise.
    spread = covariance @ (gram @ gram + repeated * gram) @ covariance
    places = columns + 2 * arm.target_arclength.size
    model_distance, model_observed = distance(model.step[:columns], spread[:columns, :columns])
    all_distance, all_observed = distance(model.step[:places], spread[:places, :places])
    likely = min(chance_of(model_distance, model_observed), chance_of(all_distance, all_observed))
    dof = float(problem.coordinates - np.trace(gram @ covariance))
    spread_left = math.hypot(math.sqrt(2.0 * repeated / dof), 2.0 * PERSISTENCE.white_error)
    chance = min(2.0 * likely, 1.0)  # the best of two candidates
    step, known = model.step[:columns], covariance[:columns, :columns]
    if chance < RARE:
        step, known = without_prior(step, known)
    tip_offsets = [tip_displacement_of(frame, step, known) for frame in kept]
    squares, outside = np.mean(tip_offsets, axis=0).tolist()
    return PersistentErrors(
        frames=count,
        repeated=repeated,
        moved=model_distance,
        unknowns=model_observed,
        moved_with_places=all_distance,
        unknowns_with_places=all_observed,
        chance=chance,
        sure=RARE,
        left=float(np.sum(rest**2)) / dof,
        left_limit=1.0 + RARELY * spread_left,
        tip_rms=math.sqrt(squares),
        tips_outside=outside,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearProblem:
    """Frames as one linear problem, whitened except for their common unknowns.

    residual (frames, coordinates); shared (frames, coordinates, unknowns): effect of one sigma of
    each: columns of the model's covariance (their number is `columns`), target positions along and
    across the arm, nodes of the camera's path. coordinates: number seen in all frames.
    """

    residual: Array
    shared: Array
    columns: int
    coordinates: int


def linear_problem(kept: Sequence[FrameEvidence], arm: Arm) -> LinearProblem:
    """Return the frames whitened by their independent errors."""
    noise, count, targets = arm.sensors, len(kept), arm.target_arclength.size
    size = 2 * targets
    residual = np.array([frame.residual for frame in kept])
    seen = np.tile(np.isfinite(residual).all(axis=1), (1, 2))
    white = np.array([np.fmax(frame.std, noise.target_std) for frame in kept])
    std = np.tile(np.maximum(white, SMALLEST_STD), (1, 2))
    errors = np.array([frame.predicted.errors for frame in kept])
    errors = errors.reshape(count, -1, size).transpose(0, 2, 1)
    last = kept[0].predicted.frame_error_count
    columns = errors[:, :, READINGS:-last]
    theta = np.array([frame.predicted.theta for frame in kept])
    placing = paint(theta, np.zeros(targets), np.zeros((2, targets))).jacobian()
    placing = placing.reshape(count, size, size)
    known = None if arm.covariance is None else arm.covariance.placement
    if known is None:
        places = noise.placement_std * placing
    else:
        residual = residual - np.array([frame.predicted.placed for frame in kept])
        placement_std = np.hypot(known.std, REPAINTED * noise.placement_std)
        places, columns = placing * placement_std, columns + placing @ known.factor
    stamps = np.array([frame.stamp_ns for frame in kept])
    progress = (stamps - stamps.min()) / max(int(np.ptp(stamps)), 1)
    # A displaced camera is no error of the arm.
    prior = path_prior(replace(noise, registration_std=arm.length))
    path = path_weights(progress) @ np.linalg.cholesky(prior)
    camera = np.zeros((count, 2, targets, 2, path.shape[1]))
    camera[:, 0, :, 0] = camera[:, 1, :, 1] = path[:, None]
    shared = np.concatenate([columns, places, camera.reshape(count, size, -1)], axis=2)
    between = camera_errors(noise.drift_std * BETWEEN_NODES, targets)
    frame_errors = np.concatenate(
        [
            errors[:, :, :READINGS],
            errors[:, :, -last:],
            np.broadcast_to(between, (count, *between.shape)),
        ],
        axis=2,
    )
    residual = residual.reshape(count, size)
    whitening = Whitening(1.0, frame_errors / std[:, :, None], seen)
    return LinearProblem(
        residual=whitening((residual / std)[:, :, None])[:, :, 0],
        shared=whitening(shared / std[:, :, None]),
        columns=columns.shape[2],
        coordinates=int(np.count_nonzero(seen)),
    )


def equivalent_frames(scores: Array) -> float:
    """Return the number of correlated frames equivalent to one independent frame, at least 1.

    scores (frames, unknowns): contribution of the residual of each frame to each unknown.
    """
    alone = scores.T @ scores
    lags = math.isqrt(len(scores))
    summed = alone.copy()
    for lag in range(1, lags + 1):
        product = scores[lag:].T @ scores[:-lag]
        summed += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    ratio = np.trace(np.linalg.pinv(alone, hermitian=True) @ summed)
    return max(float(ratio) / max(int(np.linalg.matrix_rank(alone, hermitian=True)), 1), 1.0)


def distance(step: Array, spread: Array) -> tuple[float, int]:
    """Return chi squared of a step (n,) with covariance spread (n, n), and its degrees of freedom.

    Directions that are barely observable in the frames are excluded.
    """
    variances, axes = np.linalg.eigh(spread)
    seen = variances > SEEN
    along = (axes.T @ step)[seen]
    return float(np.sum(along**2 / variances[seen])), int(np.count_nonzero(seen))


def without_prior(step: Array, covariance: Array) -> tuple[Array, Array]:
    """Return a step (n,) and its covariance (n, n) from the frames alone, without the prior.

    A prior in conflict with the frames would shorten the step. If the frames are uninformative,
    the step is unchanged.
    """
    remaining, axes = np.linalg.eigh(covariance)
    information = np.where(1.0 - remaining > SEEN, 1.0 - remaining, 1.0)
    covariance = axes @ np.diag(remaining / information) @ axes.T
    return axes @ ((axes.T @ step) / information), covariance


def chance_of(distance: float, unknowns: int) -> float:
    """Return the probability of a chi squared at least this large."""
    return float(scipy.special.chdtrc(unknowns, distance)) if unknowns else 1.0


def tip_displacement_of(
    frame: FrameEvidence, step: Array, covariance: Array
) -> tuple[float, float]:
    """Return the squared tip displacement (m^2) in a frame due to a step of the model columns.

    Also returns the resulting probability that the true tip is outside its stated 95 % ellipse,
    including the errors of its readings. covariance (columns, columns) of the step. A sum of
    squares of normal variables is approximated by a gamma law with the same mean and variance.
    """
    readings, columns = frame.tip_errors[:READINGS], frame.tip_errors[READINGS:]
    offset = step @ columns
    spread = readings.T @ readings + columns.T @ covariance @ columns
    stated = np.linalg.inv(frame.tip_covariance + SMALLEST_STD**2 * np.eye(2))
    shared = stated @ spread
    mean = offset @ stated @ offset + np.trace(shared)
    variance = 2.0 * np.trace(shared @ shared) + 4.0 * offset @ shared @ stated @ offset
    if variance <= 0.0:  # nothing moves the tip, or its square underflows
        return float(offset @ offset), float(mean > LARGEST_95)
    outside = scipy.special.gammaincc(mean**2 / variance, LARGEST_95 * mean / variance)
    return float(offset @ offset), float(outside)
