"""The base model refitted to the recordings of a diagnosis, with the effects that it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.experiments import FitSequence
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.noise_estimate import estimate_noise, NoiseEstimate
from pneunet_ros.calibration.preconditions import check_runs
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import CALIBRATION, PRECONDITIONS
from pneunet_ros.core.errors import RequestError
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

FRAMES = 48  # of every run; neighbors say nearly the same, but for white noise
HARMLESS_CAMERA = 5e-4  # of the length, that a camera may move without a word; invented
FIRST_FRAMES = 24  # of every run, for a fit to begin with
FEWEST_UNIFORM = 3  # frames of a recording, for a model of constant curvature

Each = Callable[[str, int, int], None]  # what is done, how far, of how much (0 = unknown)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Base:
    """The base model fitted to few frames of all training runs, and the noise of the whole."""

    frame: Arm
    noise: NoiseEstimate
    fit: Fit


def refitted(frame: Arm, training: Sequence[RecordingData], each: Each) -> Base:
    """Refit; RequestError and RecordingError where the recordings are not fit for it."""
    unloaded = [run for run in training if not run.loaded]
    loaded = [run for run in training if run.loaded]
    if not unloaded:
        raise RequestError(
            'a diagnosis needs a training recording without a load: it says what the arm does '
            'by pressure alone'
        )
    plain = uniform(frame)
    known = replace(PRECONDITIONS, fewest_frames=FEWEST_UNIFORM) if plain else PRECONDITIONS
    settings = replace(CALIBRATION, preconditions=known)
    check_runs(unloaded, loaded, frame, settings=settings)
    noise = estimate_noise(training, frame.target_arclength, frame.sensors)
    noise = replace(noise, noise=with_harmless_camera(noise.noise, frame.length))
    frame = replace(frame, sensors=noise.noise, covariance=None)
    unloaded, loaded = ([run.thinned(FIRST_FRAMES) for run in runs] for runs in (unloaded, loaded))
    fits = FitSequence(frame, noise, training, each, uniform=plain, settings=settings)
    fit = fits.first_experiment(unloaded)
    if loaded and frame.moment_law.kind in MOMENT_LAW_PARAMETERS:
        runs = [*unloaded, *loaded]
        law = fits.law(frame.moment_law.kind, fits.stiffness(runs, fit))
        fit = fits.joint(runs, fit, law, FIRST_FRAMES)
    return Base(frame=frame, noise=noise, fit=fit)


def uniform(arm: Arm) -> bool:
    """Whether curvature without knots between the ends, the same at both, is part of a model."""
    table = arm.intrinsic_curvature
    return table.arclength.size == 2 and bool(np.all(np.ptp(table.curvature, axis=1) == 0.0))


def with_harmless_camera(noise: SensorNoise, length: float) -> SensorNoise:
    """Return the noise with a camera that moves a little at least.

    Its place and its drift are known from few values, and may be found to be nothing.
    """
    least = HARMLESS_CAMERA * length
    return replace(
        noise,
        registration_std=max(noise.registration_std, least),
        drift_std=max(noise.drift_std, least),
    )
