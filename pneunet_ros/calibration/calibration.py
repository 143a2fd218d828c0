"""Calibration by the paper's two experiments: recordings without and with end load.

Experiment 1 determines kappa_p0(p, s) from unloaded recordings alone, experiment 2 the moment law
from loaded ones. The last fit uses all recordings together, through the equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration import elongation
from pneunet_ros.calibration.camera_clock import (
    camera_clocks,
    CameraClock,
    clock_improves_fit,
    combined_clock,
    correct_stamps,
    MOST_ROUNDS,
)
from pneunet_ros.calibration.checks.consistency import (
    describe_misfit,
    describe_pressure_noise,
    outlier_recordings,
)
from pneunet_ros.calibration.checks.frames_in_motion import FramesInMotion
from pneunet_ros.calibration.checks.identifiability import undetermined_quantities
from pneunet_ros.calibration.checks.left_out_levels import leave_levels_out, LeftOutLevels, LEVELS
from pneunet_ros.calibration.checks.left_out_recordings import (
    leave_recordings_out,
    LeftOutRecordings,
)
from pneunet_ros.calibration.checks.nonuniformity import (
    consider_nonuniformity,
    describe_nonuniformity,
)
from pneunet_ros.calibration.checks.preconditions import describe_clamp
from pneunet_ros.calibration.checks.resolution import Resolution
from pneunet_ros.calibration.checks.stiffness_variation import (
    describe_variation,
    guessed_columns,
    stiffness_variation,
    StiffnessVariation,
)
from pneunet_ros.calibration.experiments import FitSequence, LawScore
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.parameters import PosteriorState
from pneunet_ros.calibration.prepared_recordings import prepare, PreparedRecordings
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import GAUGE_PASCALS
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.core.units import kilopascals
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain, spanned_domain
from pneunet_ros.model.moment_law import PiecewiseLinearLaw


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """The result: the arm, its fits, the noise, and a comparison of moment laws.

    posterior: the prior for continuing this calibration. free: the fit of experiment 1; joint: the
    fit to all recordings (identical to free if none is loaded). explained_variance: share of the
    shape's variance in the low-rank covariance of the model file. notes: undetermined quantities,
    and recordings that do not fit the others. variation: variation of the stiffness along the arm;
    None if it was not tested. motion: frames excluded because the arm was moving; None if there
    were none. settings: of the calibration.
    """

    arm: Arm
    noise: NoiseEstimate
    posterior: PosteriorState
    free: Fit
    joint: Fit
    laws: tuple[LawScore, ...]
    explained_variance: float
    notes: tuple[Note, ...]
    variation: StiffnessVariation | None = None
    left_out: LeftOutLevels | None = None
    motion: FramesInMotion | None = None


def calibrate(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    frame: Arm,
    *,
    kind: str | None = None,
    compare: bool = True,
    earlier: PosteriorState | None = None,
    on_progress: OnProgress = ignore_progress,
    declared: PressureConvention | None = GAUGE_PASCALS,
) -> Calibration:
    """Calibrate an arm: kappa_p0(p, s), the moment law, and their uncertainty.

    Args:
        unloaded: recordings with nothing attached: pressure in Pa gauge, targets in m in the base
            frame. Optional if `earlier` is given, or if the pressure of the arm never changes.
        loaded: recordings under end load, N and N m in the base frame; may be none.
        frame: an arm with the length, weight, clamp, targets, effects, and everything that the
            recordings do not determine; for a Majidi law also the cross-section.
        kind: the moment law to fit; None: the paper's, or a single stiffness if the loaded
            frames add no information.
        compare: also fit without each loaded recording, and with the other laws; the error bars
            include the changes.
        earlier: posterior of another calibration to continue from, with its tables.
        on_progress: called with the stage, its progress, and its total (0: unknown).
        declared: declared meaning of the pressure readings, to be judged; None: assumed to be
            right.

    Returns:
        The arm with error bars, and its fits; use it only if `joint.converged`.

    Raises:
        RequestError: no such law, no unloaded recording, or `earlier` does not fit.
        RecordingError: the recordings do not fit the experiments.
    """
    clocks, rounds = dict[str, CameraClock](), 0
    as_stamped: Calibration | None = None
    settled: tuple[Calibration, dict[str, CameraClock]] | None = None
    while True:
        found = calibrate_as_stamped(
            unloaded,
            loaded,
            frame,
            kind=kind,
            compare=compare,
            earlier=earlier,
            on_progress=on_progress,
            declared=declared,
        )
        as_stamped = as_stamped or found
        # The rest of a swing, an unconverged fit or a model error may look like a drifting clock:
        # only a better fit with the new stamps confirms it, and in the end one as good as noise.
        if settled is not None and not clock_improves_fit(found.joint, settled[0].joint):
            found, clocks = settled
            break
        settled = found, dict(clocks)
        may_correct = earlier is None and found.motion is None and found.joint.converged
        corrections = camera_clocks(found.joint, found.noise.noise) if may_correct else {}
        if not corrections or rounds == MOST_ROUNDS:
            break
        rounds += 1
        clocks |= {
            name: combined_clock(clocks.get(name), one) for name, one in corrections.items()
        }
        unloaded, loaded = (
            [correct_stamps(run, corrections.get(run.name)) for run in part]
            for part in (unloaded, loaded)
        )
    if clocks and not found.joint.as_noise:  # a model error, as hysteresis or creep
        found, clocks = as_stamped, {}
    clock_notes = tuple(clock.sentence for clock in clocks.values())
    return replace(found, notes=(*clock_notes, *found.notes)) if clock_notes else found


def calibrate_as_stamped(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    frame: Arm,
    *,
    kind: str | None,
    compare: bool,
    earlier: PosteriorState | None,
    on_progress: OnProgress,
    declared: PressureConvention | None,
) -> Calibration:
    """Calibrate once, without correcting the clocks of the cameras (see `calibrate`)."""
    check_kind(kind)
    prepared = prepare(unloaded, loaded, frame, earlier, declared)
    resolution = prepared.resolution
    if resolution.constant_pressure and kind == PiecewiseLinearLaw.kind:
        raise RequestError(
            f'the law {kind} needs several pressures, but the pressure never changes; use --law '
            'linear',
            reason='one_pressure',
        )
    fits = FitSequence(
        prepared.frame, prepared.noise, prepared.runs, on_progress, resolution=resolution
    )
    continued = earlier is not None
    fits.planned = 1 if continued else count_fits(resolution, len(prepared.loaded), compare)
    found = fit_experiments(fits, prepared, kind, compare, earlier)
    widened = widen(fits, prepared, found, continued)
    joint, posterior = widened.joint, widened.kept.posterior(*fits.span(earlier))
    if prepared.loaded:
        on_progress('stiffness along the arm', fits.done, fits.planned)
    variation = stiffness_variation(joint, prepared.noise.noise)
    guessed = guessed_columns(joint, variation)
    painted = frame.target_arclength
    covariance, explained_variance = low_rank(
        joint,
        painted=painted.size,
        guessed=guessed,
        base_turn_std=max(run.base_turn_std for run in prepared.runs),
    )
    joint = joint.widened(guessed)
    domain = domain_of(joint, frame.domain if continued else None)
    return Calibration(
        arm=replace(joint.arm, target_arclength=painted, covariance=covariance, domain=domain),
        noise=prepared.noise,
        posterior=posterior,
        free=found.free,
        joint=joint,
        laws=found.laws,
        explained_variance=explained_variance,
        notes=notes_of(fits, prepared, replace(widened, joint=joint), variation, kind),
        variation=variation,
        left_out=widened.left_out,
        motion=prepared.motion,
    )


def check_kind(kind: str | None) -> None:
    """Reject an unknown moment law."""
    if kind is not None and kind not in MOMENT_LAW_PARAMETERS:
        allowed = ', '.join(MOMENT_LAW_PARAMETERS)
        raise RequestError(
            f'the moment law must be one of {allowed}, not {kind}', reason='unknown_kind'
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExperimentFits:
    """The fits of both experiments.

    free, joint, laws: as in `Calibration`. without: fits without each loaded recording, if they
    were compared.
    """

    free: Fit
    joint: Fit
    laws: tuple[LawScore, ...] = ()
    without: tuple[Fit, ...] = ()


def fit_experiments(
    fits: FitSequence,
    prepared: PreparedRecordings,
    kind: str | None,
    compare: bool,
    earlier: PosteriorState | None,
) -> ExperimentFits:
    """Fit the recorded experiments; arguments as in `calibrate`."""
    unloaded, loaded, resolution = prepared.unloaded, prepared.loaded, prepared.resolution
    if earlier is not None:
        new = fits.continue_from(earlier, prepared.runs, kind, bool(loaded))
        return ExperimentFits(free=new, joint=new)
    fits.check_law(loaded)
    if resolution.constant_pressure:
        beam = fits.at_one_pressure(prepared.runs, kind or resolution.law)
        return ExperimentFits(free=beam, joint=beam)
    free = fits.first_experiment(unloaded)
    if not loaded:
        return ExperimentFits(free=free, joint=free)
    law = fits.law(kind or resolution.law, fits.stiffness(prepared.runs, free))
    joint = fits.joint(prepared.runs, free, law)
    if not compare or len(loaded) == 1:
        return ExperimentFits(free=free, joint=joint)
    if resolution.law != PiecewiseLinearLaw.kind:
        without = fits.without_each(unloaded, loaded, free, law)
        return ExperimentFits(free=free, joint=joint, without=without)
    laws = fits.compare_laws(unloaded, loaded, free, law.stiffness)
    without = next(item.fits for item in laws if item.kind == law.kind)
    return ExperimentFits(free=free, joint=joint, laws=laws, without=without)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WidenedFit:
    """The fit to all recordings, with error bars widened by leave-one-out changes.

    joint: widened also by the nonuniformity of the arm; kept: without the nonuniformity, for
    continuing this calibration. undetermined: notes on undetermined quantities. left_out,
    recordings: results of leaving out pressures and recordings; None if nothing was left out.
    """

    joint: Fit
    kept: Fit
    undetermined: Sequence[Note]
    left_out: LeftOutLevels | None
    recordings: LeftOutRecordings | None


def widen(
    fits: FitSequence, prepared: PreparedRecordings, found: ExperimentFits, continued: bool
) -> WidenedFit:
    """Widen the error bars of the fit to all recordings."""
    joint, resolution = found.joint, prepared.resolution
    recordings = leave_recordings_out(joint, found.without) if found.without else None
    left_out = None
    if resolution.free_shapes is not None and not prepared.loaded and not continued:
        left_out = leave_levels_out(prepared.unloaded, found.free, fits.first_experiment)
    undetermined = undetermined_quantities(joint)
    # A continued calibration estimates the nonuniformity again, but does not repeat the
    # cross-validation.
    kept = joint
    joint = consider_nonuniformity(joint, resolution.shapes)
    for checked in (left_out, recordings):
        if checked is not None:
            kept, joint = kept.widened(checked.excess), joint.widened(checked.excess)
    return WidenedFit(
        joint=joint, kept=kept, undetermined=undetermined, left_out=left_out, recordings=recordings
    )


def notes_of(
    fits: FitSequence,
    prepared: PreparedRecordings,
    widened: WidenedFit,
    variation: StiffnessVariation | None,
    kind: str | None,
) -> tuple[Note, ...]:
    """Return the notes of a calibration, in order of its stages."""
    joint, left_out, recordings = widened.joint, widened.left_out, widened.recordings
    return (
        *(() if prepared.motion is None else (prepared.motion.left_out,)),
        *prepared.noise.notes,
        *describe_thinning(prepared.runs, prepared.every),
        *describe_clamp(prepared.runs, prepared.frame),
        *prepared.resolution.notes,
        *describe_structure(joint, prepared.resolution),
        *(() if left_out is None else (left_out.sentence,)),
        *(() if recordings is None else recordings.sentences),
        *(prepared.resolution.law_notes if kind is None else ()),
        *describe_nonuniformity(joint),
        *widened.undetermined,
        *describe_misfit(joint),
        *describe_pressure_noise(prepared.noise.noise.pressure_std, fits.high - fits.low),
        *describe_variation(joint, variation, law_given=kind is not None),
        *outlier_recordings(joint),
    )


def count_fits(resolution: Resolution, loaded: int, compare: bool) -> int:
    """Return the number of model fits in a calibration with this many loaded runs."""
    if resolution.constant_pressure:
        return 2
    if not loaded:
        left_out = LEVELS if resolution.free_shapes is not None else 0
        return 2 * (1 + left_out)
    if not compare or loaded == 1:
        return 5
    laws = len(MOMENT_LAW_PARAMETERS) if resolution.law == PiecewiseLinearLaw.kind else 1
    return 5 + loaded * laws


def describe_thinning(
    fitted: Sequence[RecordingData], every: Sequence[RecordingData]
) -> tuple[Note, ...]:
    """Describe the share of frames that were fitted; empty if all were."""
    frames, all_frames = (sum(len(run.stamp_ns) for run in runs) for runs in (fitted, every))
    if frames == all_frames:
        return ()
    return (
        Note(
            f'only {frames} of {all_frames} frames are fitted, to stay within 2 GB of memory: '
            'evenly spread over time and over the changes of pressure and load. The noise is '
            'estimated from all frames',
            reason='thinned',
        ),
    )


def describe_structure(fit: Fit, resolution: Resolution) -> list[Note]:
    """Describe the selected model structure: numbers along the arm, and elongation."""
    notes, parameters = [], fit.parameters
    if parameters.shapes is not None and parameters.shapes < resolution.shapes:
        notes.append(
            Note(
                f'the model describes the curvature along the arm by {parameters.shapes} '
                'numbers: the recordings are more probable with these than with the '
                f'{resolution.shapes} that the targets resolve',
                reason='shapes_by_evidence',
            )
        )
    if parameters.elongates:
        elongation_values = slice(parameters.cells, parameters.before_law)
        pressure = max(parameters.pressure.tolist(), key=abs)
        top = elongation.slopes(np.array([pressure]))[0]
        strain = 100.0 * float(top @ fit.values[elongation_values])
        std = 100.0 * float(
            np.sqrt(top @ fit.covariance[elongation_values, elongation_values] @ top)
        )
        notes.append(
            Note(
                f'the arm {"lengthens" if strain > 0.0 else "shortens"} under pressure, by '
                f'{abs(strain):.2g} ± {std:.1g} % at {kilopascals(pressure):.3g} '
                'kPa: the model includes the effect pressure_elongation, because this makes the '
                'recordings more probable',
                reason='elongation',
            )
        )
    return notes


def domain_of(joint: Fit, earlier: Domain | None = None) -> Domain:
    """Return the domain of the recordings of a fit, merged with the earlier domain."""
    observed = [
        np.column_stack([run.inputs.loads, run.inputs.pressure])[run.solved] for run in joint.runs
    ]
    loads = np.concatenate(
        [*observed, *([] if earlier is None else [earlier.end_load, earlier.unloaded])]
    )
    return spanned_domain(loads, joint.arm.length, joint.arm.table_range)
