"""Model error on recordings, in meters and in chi squared, and its noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.held_out import Score, score
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.result import Adequacy, Misfit
from pneunet_ros.diagnosis.scores.lack_of_fit import LackOfFit, worst_test
from pneunet_ros.diagnosis.settings import LACK_OF_FIT
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import coordinate_stds, target_std, target_stds
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise


def scores(arm: Arm, runs: Sequence[RecordingData]) -> tuple[Score, ...]:
    """Score every run; the history of the arm continues from run to run by their stamps."""
    pairs = zip(runs, inputs_of(arm, runs), strict=True)
    return tuple(score(arm, run, inputs) for run, inputs in pairs)


def misfit(
    run_scores: Sequence[Score], chi_squared: Sequence[float], runs: Sequence[RecordingData]
) -> Misfit:
    """Return the misfit over all runs; chi_squared: of the whitened residuals of each run.

    Residuals are those of the fit to the training runs; nothing is fitted to held-out runs.
    """
    squares = np.concatenate([item.error[np.isfinite(item.error)] ** 2 for item in run_scores])
    lengths = np.concatenate([distances(item.error) for item in run_scores])
    count = sum(2 * int(run.seen.sum()) for run in runs)
    return Misfit(
        rms=float(np.sqrt(squares.mean())) if squares.size else float('nan'),
        p95=float(np.percentile(lengths, 95.0)) if lengths.size else float('nan'),
        chi_squared=sum(chi_squared) / max(count, 1),
    )


def distances(error: Array) -> Array:
    """Return the lengths of errors (frames, 2, targets) where known."""
    lengths = np.hypot(error[:, 0], error[:, 1]).ravel()
    return lengths[np.isfinite(lengths)]


def noise_floor(
    arm: Arm, runs: Sequence[RecordingData], noise: SensorNoise
) -> tuple[float, float]:
    """Return the rms (m) of a perfect model, and its scatter.

    The errors are white noise (independent per coordinate), readings (common to a frame), and
    placement (common to a target; after a calibration, its remaining uncertainty).
    """
    known = None if arm.covariance is None else arm.covariance.placement
    if known is not None:
        noise = replace(noise, placement_std=float(np.sqrt(np.mean(known.std**2))))
    squares, variance = 0.0, 0.0
    seen = np.zeros((2, arm.target_arclength.size))
    white = target_stds(replace(noise, placement_std=0.0), np.array(noise.target_std))
    for run, inputs in zip(runs, inputs_of(arm, runs), strict=True):
        std = coordinate_stds(arm, run, inputs, noise)
        shown = np.isfinite(std)
        square = np.where(shown, std, 0.0) ** 2
        by_readings = np.maximum(square - shown * target_std(noise) ** 2, 0.0).sum(axis=(1, 2))
        squares += float(square.sum())
        variance += 2.0 * float((shown * white**4).sum() + (by_readings**2).sum())
        seen += shown.sum(axis=0)
    variance += 2.0 * noise.placement_std**4 * float((seen**2).sum())
    if not squares:
        return 0.0, 0.0
    floor = float(np.sqrt(squares / seen.sum()))
    return floor, float(np.sqrt(variance) / seen.sum()) / (2.0 * floor)


def removed_share(before: float, after: float, floor: float) -> float | None:
    """Return the share of the reducible error that is removed; None if there was none."""
    reducible = before**2 - floor**2
    if reducible <= 0.0:
        return None
    return 1.0 - (after**2 - floor**2) / reducible


def adequacy(tests: Sequence[LackOfFit], test: LackOfFit | None = None) -> Adequacy:
    """Return one of the tests, or the worst one, with its p-value adjusted for their number."""
    test = test or worst_test(tests)
    return Adequacy(
        test=test.name,
        statistic=test.statistic,
        threshold=test.threshold(LACK_OF_FIT.level / len(tests)),
        p_value=min(1.0, test.p_value * len(tests)),
    )
