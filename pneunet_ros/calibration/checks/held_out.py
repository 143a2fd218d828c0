"""Prediction error of a model on a held-out recording, with registration removed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs, inputs_of
from pneunet_ros.measurement.painted_targets import in_plane, paint
from pneunet_ros.measurement.predicted_targets import target_displacement
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.columns import CURVATURE, THETA


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Score:
    """Measured minus predicted targets of one run, minus their mean (registration error).

    Predictions are at the painted positions.

    rms (m) per coordinate; p95 (m): 95th percentile of the distance; error (frames, 2, targets) m,
    NaN where not seen or without equilibrium; rms and p95 are NaN if no frame can be used;
    missing: fraction of frames without equilibrium.
    """

    name: str
    rms: float
    p95: float
    missing: float
    error: Array


def score(
    arm: Arm, run: RecordingData, inputs: Inputs | None = None, placement: Array | None = None
) -> Score:
    """Predict a run from its readings and compare.

    inputs: of the run, if its history continues earlier runs; None: computed from the run alone.
    placement (2, targets) m of the targets along and across the arm; None: estimated with the
    covariance of the arm.
    """
    model = ForwardModel(arm.target_arclength, run.points)
    inputs = inputs_of(arm, [run])[0] if inputs is None else inputs
    solved = model.solve(arm, inputs)
    theta, curvature = model.fields[:, THETA], model.fields[:, CURVATURE]
    if placement is None:
        placement_shift, _ = target_displacement(arm, theta, curvature)
    else:
        placement_shift = in_plane(paint(theta, curvature, placement).displacement)
    error = run.points - model.points - placement_shift
    error = np.where(solved[:, None, None], error, np.nan)
    missing = float(1.0 - solved.mean()) if solved.size else 1.0
    if not np.isfinite(error).any():
        return Score(name=run.name, rms=np.nan, p95=np.nan, missing=missing, error=error)
    error = error - np.nanmean(error, axis=(0, 2), keepdims=True)
    distance = np.hypot(error[:, 0], error[:, 1])
    return Score(
        name=run.name,
        rms=float(np.sqrt(np.nanmean(error**2))),
        p95=float(np.nanpercentile(distance, 95.0)),
        missing=missing,
        error=error,
    )
