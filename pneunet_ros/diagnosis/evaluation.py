"""The model error on recordings, in meters, and the floor that noise puts under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.held_out import Score, score
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.result import Misfit
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.noise_model import attached_std, target_std
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise


def scores(arm: Arm, runs: Sequence[RecordingData]) -> tuple[Score, ...]:
    """Score every run; the arm's history is carried on from run to run by their stamps."""
    pairs = zip(runs, inputs_of(arm, runs), strict=True)
    return tuple(score(arm, run, inputs) for run, inputs in pairs)


def misfit(
    run_scores: Sequence[Score], chi_squared: Sequence[float], runs: Sequence[RecordingData]
) -> Misfit:
    """Return what the scores of runs come to; chi_squared: of the whitened residuals of each run.

    Residuals at the fit to the training runs: nothing is fitted to held-out ones.
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
    """Return the length of errors (frames, 2, targets) where they are known."""
    lengths = np.hypot(error[:, 0], error[:, 1]).ravel()
    return lengths[np.isfinite(lengths)]


def noise_floor(arm: Arm, runs: Sequence[RecordingData], noise: SensorNoise) -> float:
    """Return the rms (m) that a perfect model would have: white noise, placement, readings."""
    squares, count = 0.0, 0
    for run, inputs in zip(runs, inputs_of(arm, runs), strict=True):
        model = ForwardModel(arm.target_arclength)
        seen = run.seen & model.solve(arm, inputs)[:, None]
        points = model.points.copy()
        by_load = model.load_jacobian(arm, inputs) * attached_std(noise, run)[:, None]
        moved = np.sum(by_load**2, axis=2)
        model.solve(arm, replace(inputs, pressure=inputs.pressure + noise.pressure_std))
        moved += (model.points - points).reshape(moved.shape) ** 2
        both = np.concatenate([seen, seen], axis=1)
        squares += float(moved[both & np.isfinite(moved)].sum())
        squares += int(both.sum()) * target_std(noise) ** 2
        count += int(both.sum())
    return float(np.sqrt(squares / max(count, 1)))


def removed_share(before: float, after: float, floor: float) -> float | None:
    """Return the share of the reducible error that is removed; None where there was none."""
    reducible = before**2 - floor**2
    if reducible <= 0.0:
        return None
    return 1.0 - (after**2 - floor**2) / reducible
