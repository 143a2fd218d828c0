"""Recordings prepared for a calibration: at rest, with the tip as a target, thinned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pneunet_ros.calibration import elongation
from pneunet_ros.calibration.checks.frames_in_motion import check_runs_at_rest, FramesInMotion
from pneunet_ros.calibration.checks.resolution import Resolution, resolve
from pneunet_ros.calibration.noise_estimate import estimate_noise, NoiseEstimate
from pneunet_ros.calibration.parameters import PosteriorState
from pneunet_ros.calibration.settings import EXPERIMENTS
from pneunet_ros.measurement.dataset import RecordingData, thin_runs
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.tip_pose import with_tip_target
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedRecordings:
    """Recordings to be fitted, and the arm with all parameters that are not fitted.

    frame: with the noise of the recordings, without covariance and domain. every: the recordings
    with all frames, from which the noise is estimated. motion: frames excluded because the arm was
    moving; None if there were none.
    """

    frame: Arm
    unloaded: Sequence[RecordingData]
    loaded: Sequence[RecordingData]
    every: Sequence[RecordingData]
    noise: NoiseEstimate
    resolution: Resolution
    motion: FramesInMotion | None

    @property
    def runs(self) -> list[RecordingData]:
        """The unloaded recordings, then the loaded ones."""
        return [*self.unloaded, *self.loaded]


def prepare(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    frame: Arm,
    earlier: PosteriorState | None,
    declared: PressureConvention | None,
) -> PreparedRecordings:
    """Check and thin the recordings, and estimate their noise and resolution."""
    painted = frame.target_arclength.size
    frame, runs = with_tip_target(
        elongation.remove_fitted_elongation(frame),
        [*unloaded, *loaded],
        always=earlier is not None and earlier.has_tip(painted),
    )
    unloaded, loaded, motion = check_runs_at_rest(
        runs[: len(unloaded)],
        runs[len(unloaded) :],
        frame,
        first=earlier is None,
        declared=declared,
    )
    every = [*(run.without_load() for run in unloaded), *loaded]
    runs = thin_runs([*unloaded, *loaded], EXPERIMENTS.most_frames)
    count = len(unloaded)
    unloaded, loaded = [run.without_load() for run in runs[:count]], runs[count:]
    noise = estimate_noise(every, frame.target_arclength, frame.sensors)
    frame = replace(frame, sensors=noise.noise, covariance=None, domain=None)
    return PreparedRecordings(
        frame=frame,
        unloaded=unloaded,
        loaded=loaded,
        every=every,
        noise=noise,
        resolution=resolve(frame, unloaded, loaded),
        motion=motion,
    )
