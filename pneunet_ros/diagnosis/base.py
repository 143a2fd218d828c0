"""The base model refitted to the recordings of a diagnosis, with the effects that it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pneunet_ros.arm import Arm
from pneunet_ros.calibration.drive import drives_of
from pneunet_ros.calibration.fitted import Fit
from pneunet_ros.calibration.law_unknowns import LAW_UNKNOWNS
from pneunet_ros.calibration.noise_estimate import estimated_noise, NoiseEstimate
from pneunet_ros.calibration.plausible import check_runs
from pneunet_ros.calibration.stages import pressure_span, Stages
from pneunet_ros.errors import RequestError
from pneunet_ros.run import Run

FRAMES = 60  # of every run; neighbors say nearly the same, but for white noise
FIRST_FRAMES = 24  # of every run, for a fit to begin with

Each = Callable[[str, int, int], None]  # what is done, how far, of how much (0 = unknown)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Base:
    """The base model fitted to few frames of all training runs, and the noise of the whole."""

    frame: Arm
    noise: NoiseEstimate
    fit: Fit


def refitted(frame: Arm, training: Sequence[Run], each: Each) -> Base:
    """Refit; RequestError and RecordingError where the recordings are not fit for it."""
    unloaded = [run for run in training if not run.loaded]
    loaded = [run for run in training if run.loaded]
    if not unloaded:
        raise RequestError(
            'a diagnosis needs a training recording without a load: it says what the arm does '
            'by pressure alone'
        )
    check_runs(unloaded, loaded, frame, first=True)
    noise = estimated_noise(training, frame.target_arclength, frame.sensors)
    frame = replace(frame, sensors=noise.noise, covariance=None)
    low, high = pressure_span(drives_of(frame, training))
    unloaded, loaded = ([run.thinned(FIRST_FRAMES) for run in runs] for runs in (unloaded, loaded))
    stage = Stages(frame, noise, low, high, each)
    fit, smoothness = stage.first_experiment(unloaded)
    if loaded and frame.moment_law.kind in LAW_UNKNOWNS:
        stiffness = stage.stiffness(unloaded, loaded, fit, smoothness)
        law = stage.law(frame.moment_law.kind, stiffness)
        fit = stage.joint(unloaded, loaded, fit, smoothness, law, FIRST_FRAMES)
    return Base(frame=frame, noise=noise, fit=fit)
