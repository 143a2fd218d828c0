"""Refit of the base model to the recordings of a diagnosis, with its effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.preconditions import check_runs, has_one_pressure
from pneunet_ros.calibration.checks.resolution import resolve
from pneunet_ros.calibration.experiments import FitSequence
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.noise_estimate import estimate_noise
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import EXPERIMENTS, GAUGE_PASCALS
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.diagnosis.settings import BASE_FIT
from pneunet_ros.measurement.dataset import RecordingData, thin_runs
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.model.arm import Arm


def fit_base(
    frame: Arm,
    training: Sequence[RecordingData],
    on_progress: OnProgress,
    declared: PressureConvention | None = GAUGE_PASCALS,
) -> Fit:
    """Fit the base model to few frames of all training runs, with the noise of all frames.

    RequestError or RecordingError if the recordings are unsuitable.
    """
    unloaded, loaded, one_pressure = checked_runs(frame, training, declared)
    # A wrong scale of the camera looks like another spacing: the spacing of the arm file is used.
    assumed = replace(frame.sensors, row_spacing_std=0.0)
    noise = estimate_noise(training, frame.target_arclength, assumed)
    frame = replace(frame, sensors=noise.noise, covariance=None, domain=None)
    most = BASE_FIT.first_frames
    unloaded, loaded = ([run.thin(most) for run in runs] for runs in (unloaded, loaded))
    resolution = resolve(frame, unloaded, loaded)
    fits = FitSequence(
        frame,
        noise,
        training,
        on_progress,
        uniform=has_uniform_curvature(frame) or resolution.shapes == 1,
        resolution=resolution if one_pressure else None,
    )
    kind = frame.moment_law.kind
    if one_pressure and loaded and kind in MOMENT_LAW_PARAMETERS:
        return fits.at_one_pressure([*unloaded, *loaded], kind)
    fit = fits.first_experiment(unloaded)
    if loaded and kind in MOMENT_LAW_PARAMETERS:
        runs = [*unloaded, *loaded]
        law = fits.law(kind, fits.stiffness(runs, fit))
        fit = fits.joint(runs, fit, law, most)
    return fit


def checked_runs(
    frame: Arm, training: Sequence[RecordingData], declared: PressureConvention | None
) -> tuple[list[RecordingData], list[RecordingData], bool]:
    """Return few frames of unloaded and loaded runs, and whether all have one pressure.

    RequestError or RecordingError if the recordings are unsuitable.
    """
    fitted = thin_runs(training, EXPERIMENTS.most_frames)
    unloaded = [run for run in fitted if not run.loaded]
    loaded = [run for run in fitted if run.loaded]
    one_pressure = has_one_pressure(fitted, frame)
    if not unloaded and not one_pressure:
        raise RequestError(
            'a diagnosis needs a training recording without a load, which shows the effect of '
            'pressure alone (if its force sensor read only noise, list it after --unloaded)',
            reason='no_unloaded',
        )
    check_runs(unloaded, loaded, frame, declared=declared)
    return unloaded, loaded, one_pressure


def has_uniform_curvature(arm: Arm) -> bool:
    """Whether the intrinsic curvature of a model is uniform along the arm by construction."""
    table = arm.intrinsic_curvature
    return table.arclength.size == 2 and bool(np.all(np.ptp(table.curvature, axis=1) == 0.0))
