"""The paper's two experiments: recordings without and with end load -> a model with error bars.

Experiment 1 gives kappa_p0(p, s) from unloaded recordings alone; experiment 2 the moment law from
loaded ones. The last fit takes all recordings together, through the equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pneunet_ros.calibration.consistency import outlier_recordings
from pneunet_ros.calibration.experiments import (
    continued,
    LawScore,
    pressure_span,
    Progress,
    Stages,
)
from pneunet_ros.calibration.identifiability import undetermined_quantities
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.noise_estimate import estimate_noise, NoiseEstimate
from pneunet_ros.calibration.parameters import Hyperparameters
from pneunet_ros.calibration.posterior import posterior_of, PosteriorState
from pneunet_ros.calibration.preconditions import check_runs
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.errors import RequestError
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.moment_law import PiecewiseLinearLaw


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """What came out: the arm, the fits behind it, the noise, and how the moment laws compare.

    knowledge is what another calibration may go on from. free is the fit of experiment 1; joint
    that of all recordings (the same where there is no loaded one). captured is the share of the
    shape's variance that the few columns of the model file's covariance have. notes are sentences
    on what the data could not determine, and on recordings that do not fit the others.
    """

    arm: Arm
    noise: NoiseEstimate
    hyperparameters: Hyperparameters
    posterior: PosteriorState
    free: Fit
    joint: Fit
    laws: tuple[LawScore, ...]
    captured: float
    notes: tuple[str, ...]


def calibrate(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    frame: Arm,
    *,
    kind: str = PiecewiseLinearLaw.kind,
    compare: bool = True,
    earlier: PosteriorState | None = None,
    each: Progress = lambda stage, done, total: None,
) -> Calibration:
    """Calibrate; `frame` gives length, weight, clamp, targets, effects and what cannot be found.

    kind: the moment law to fit. earlier: go on from what another calibration knew, and its tables;
    the unloaded recordings may then be missing. compare: fit the other laws too, each time without
    one of the loaded recordings. Raises RequestError and RecordingError where the recordings do
    not fit the experiments.
    """
    if kind not in MOMENT_LAW_PARAMETERS:
        allowed = ', '.join(MOMENT_LAW_PARAMETERS)
        raise RequestError(f'the moment law must be one of {allowed}, not {kind}')
    check_runs(unloaded, loaded, frame, first=earlier is None)
    unloaded = [run.unloaded() for run in unloaded]
    runs = [*unloaded, *loaded]
    noise = estimate_noise(runs, frame.target_arclength, frame.sensors)
    frame = replace(frame, sensors=noise.noise, covariance=None)
    low, high = pressure_span(inputs_of(frame, runs))
    stage = Stages(frame, noise, low, high, each)
    laws: tuple[LawScore, ...] = ()
    if earlier is not None:
        free = joint = continued(stage, runs, kind, earlier, bool(loaded))
        low, high, hyperparameters = earlier.low, earlier.high, joint.parameters.hyperparameters
    else:
        free, hyperparameters = stage.first_experiment(unloaded)
        joint = free
    if loaded and earlier is None:
        law = stage.law(kind, stage.stiffness(unloaded, loaded, free, hyperparameters))
        joint = stage.joint(unloaded, loaded, free, hyperparameters, law)
        if compare and len(loaded) > 1:
            laws = stage.compared(unloaded, loaded, free, hyperparameters, law)
    covariance, captured = low_rank(joint)
    arm = replace(joint.arm, covariance=covariance)
    return Calibration(
        arm=arm,
        noise=noise,
        hyperparameters=hyperparameters,
        posterior=posterior_of(joint, low, high),
        free=free,
        joint=joint,
        laws=laws,
        captured=captured,
        notes=(*undetermined_quantities(joint), *outlier_recordings(joint)),
    )
