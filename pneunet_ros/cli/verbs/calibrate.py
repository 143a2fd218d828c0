"""`pneunet calibrate`: a model file with error bars from the paper's two experiments."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from pneunet_ros.cli import verb
from pneunet_ros.cli.experiments import add_experiments, as_measured, read_experiments
from pneunet_ros.cli.provenance import provenance_of
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.atomic import all_or_none
from pneunet_ros.files.model_file import load_model, save_model
from pneunet_ros.model.moment_law import LinearLaw, MOMENT_LAWS, PiecewiseLinearLaw

if TYPE_CHECKING:
    from pneunet_ros.calibration.calibration import Calibration
    from pneunet_ros.calibration.motion.motion_fit import MotionFit
    from pneunet_ros.calibration.parameters import PosteriorState
    from pneunet_ros.core.progress import OnProgress
    from pneunet_ros.measurement.dataset import RecordingData
    from pneunet_ros.model.arm import Arm
    from pneunet_ros.reports.calibration.verdict import Files


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    for name, meaning in (
        (
            'unloaded',
            'recordings of the arm with nothing attached: experiment 1, kappa_p0(p, s) (default: '
            'the --loaded recordings without `end_wrench`, or with only noise in it)',
        ),
        ('loaded', 'recordings under end load: experiment 2, the moment law'),
    ):
        verb.add_recordings(parser, f'--{name}', meaning)
    verb.add_recordings(
        parser,
        '--motion',
        'recordings in which the arm swings, after quick pressure steps or after being plucked: '
        'only tip mass and damping are fitted to them',
    )
    parser.add_argument(
        '--arm',
        type=Path,
        metavar='FILE',
        help='model file that supplies what the recordings do not determine: the arm block '
        '(length, weight, targets), effects and sensors (default: the shipped model of the '
        "paper's arm)",
    )
    verb.add_output(parser, 'MODEL.yaml', 'write the model here')
    parser.add_argument(
        '--report', type=Path, metavar='DIR', help='write a report here: index.html and pictures'
    )
    parser.add_argument(
        '--law',
        choices=tuple(MOMENT_LAWS),
        help=f'moment law to fit (default: {PiecewiseLinearLaw.kind}, Eq 10, or {LinearLaw.kind} '
        'if there are too few loaded frames)',
    )
    parser.add_argument(
        '--continue',
        dest='earlier',
        type=Path,
        metavar='MODEL.yaml',
        help='continue this calibration; its .knowledge.npz must be in the same folder',
    )
    parser.add_argument(
        '--no-compare',
        action='store_true',
        help=(
            'skip the fits without each loaded recording, and those of the other moment laws: '
            'takes about half the time, but the error bars do not include the effect of leaving '
            'out a recording'
        ),
    )
    add_experiments(parser)
    verb.add_effects_path(parser)
    verb.add_gravity(parser, 'file after --arm')


def run(arguments: Namespace) -> int:
    """Read the recordings, fit, and write the model."""
    from pneunet_ros.calibration.calibration import calibrate
    from pneunet_ros.cli.calibrate_summary import show
    from pneunet_ros.offline.calibration_files import (
        check_distinct,
        check_recordings,
        described_arm,
        inputs_of,
        save_knowledge,
    )

    started = time.perf_counter()
    frame = load_model(arguments.arm or arguments.earlier or share_path(verb.PAPER_ARM))
    frame = verb.with_gravity(frame, arguments)
    frame, earlier, known = load_earlier_calibration(frame, arguments.earlier)
    check_outputs(arguments)
    check_recordings((*arguments.unloaded, *arguments.loaded, *arguments.motion))
    given = inputs_of((('unloaded', arguments.unloaded), ('loaded', arguments.loaded)))
    check_distinct([*known, *given])
    with all_or_none(), verb.progress_bar(shown=not arguments.json) as bar:
        read = read_experiments(
            (arguments.unloaded, arguments.loaded, arguments.motion), frame, arguments, bar
        )
        unloaded, loaded, swinging = read.groups
        frame = as_measured(frame, (*unloaded, *loaded))
        if not unloaded:
            unloaded = tuple(run for run in loaded if not run.loaded)
            loaded = tuple(run for run in loaded if run.loaded)
        on_progress = verb.progress_of(bar, 'fitting')
        calibration = calibrate(
            unloaded,
            loaded,
            frame,
            kind=arguments.law,
            compare=not arguments.no_compare,
            earlier=earlier,
            declared=verb.settings_of(arguments).judged_pressure,
            on_progress=on_progress,
        )
        roles = {'unloaded': unloaded, 'loaded': loaded, 'motion': swinging}
        motion, motion_note = None, ''
        provenance = provenance_of(arguments, calibration, roles)
        if calibration.joint.converged:
            arm = described_arm(calibration, arguments.output.stem, frame, provenance)
            if swinging:
                on_progress('motion', 0, 0)
                arm, motion, motion_note = with_fitted_motion(arm, swinging)
            calibration = replace(calibration, arm=arm)
            save_model(arm, arguments.output, overwrite=arguments.overwrite)
            save_knowledge(calibration.posterior, arguments.output, overwrite=arguments.overwrite)
        files = files_of(arguments)
        write_requested_report(arguments, calibration, provenance, files, on_progress)
    summary = summary_of(arguments, calibration, files, motion)
    summary |= {'seconds': time.perf_counter() - started} | read.summary
    if arguments.json:
        verb.print_json(summary | {'provenance': provenance})
    else:
        notes = (*read.sentences, *([motion_note] if motion_note else []))
        show(calibration, summary, notes, verb.output_console())
    return verb.DONE if summary['verdict']['fits'] else verb.NEGATIVE


def load_earlier_calibration(
    frame: Arm, earlier: Path | None
) -> tuple[Arm, PosteriorState | None, list[dict[str, str]]]:
    """Return the arm in the domain of an earlier calibration, its posterior, and its inputs."""
    from pneunet_ros.offline.calibration_files import fitted_recordings, load_knowledge

    if earlier is None:
        return frame, None, []
    posterior, before = load_knowledge(earlier), load_model(earlier)
    return replace(frame, domain=before.domain), posterior, fitted_recordings(before)


def write_requested_report(
    arguments: Namespace,
    calibration: Calibration,
    provenance: Mapping[str, Any],
    files: Files,
    on_progress: OnProgress,
) -> None:
    """Write the report, if it was requested."""
    from pneunet_ros.reports.calibration.report import write_report

    if arguments.report is None:
        return
    write_report(
        calibration,
        arguments.report,
        provenance=provenance,
        files=files,
        overwrite=arguments.overwrite,
        on_progress=on_progress,
    )


def summary_of(
    arguments: Namespace, calibration: Calibration, files: Files, motion: MotionFit | None
) -> dict[str, Any]:
    """Return the numbers of the summary, and the written files."""
    from pneunet_ros.cli.calibrate_summary import numbers_of
    from pneunet_ros.offline.calibration_files import knowledge_file

    converged = calibration.joint.converged
    return numbers_of(calibration, files) | {
        'output': arguments.output if converged else None,
        'knowledge': knowledge_file(arguments.output) if converged else None,
        'report': arguments.report,
        'motion': None if motion is None else asdict(motion),
    }


def with_fitted_motion(
    arm: Arm, runs: Sequence[RecordingData]
) -> tuple[Arm, MotionFit | None, str]:
    """Fit mass and damping; None and the reason if the recordings do not determine them."""
    from pneunet_ros.calibration.motion.motion_fit import fit_motion

    try:
        fit = fit_motion(arm, runs)
    except RequestError as error:
        return arm, None, f'the model has no motion: {error}'
    return fit.apply_to(arm), fit, fit.described


def files_of(arguments: Namespace) -> Files:
    """Return the files for the next command."""
    from pneunet_ros.reports.calibration.verdict import Files

    arm = arguments.arm or arguments.earlier
    files = Files(model=str(arguments.output))
    return files if arm is None else replace(files, arm=str(arm))


def check_outputs(arguments: Namespace) -> None:
    """Reject existing outputs before a long computation starts."""
    from pneunet_ros.offline.calibration_files import knowledge_file

    knowledge = knowledge_file(arguments.output)
    for path in (arguments.output, knowledge, arguments.report):
        if path is not None and path.exists() and not arguments.overwrite:
            why = f' (it belongs to {arguments.output}, for --continue)' * (path == knowledge)
            raise RecordingError(
                f'{path} exists already{why}: choose another name or pass --overwrite',
                reason='exists',
            )
    if arguments.output.suffix not in ('.yaml', '.yml'):
        raise RecordingError(
            f'{arguments.output} must end in .yaml, because it will be a model file',
            reason='wrong_suffix',
        )
