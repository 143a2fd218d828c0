"""`pneunet diagnose`: locate the model error, name its cause, and add it to the model."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import time
from typing import TYPE_CHECKING

from pneunet_ros.cli import verb
from pneunet_ros.cli.experiments import add_experiments, read_experiments
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.progress import OnProgress, part_of
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings
from pneunet_ros.effects import EFFECTS
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.files.model_file import load_model, model_hash

if TYPE_CHECKING:
    from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
    from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
    from pneunet_ros.discovery.result import Discovery
    from pneunet_ros.measurement.dataset import RecordingData
    from pneunet_ros.model.arm import Arm


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        'Exit codes: 0 the answer is "none" or "named"; 1 done, and the answer is "inseparable", '
        '"unknown" or "unobservable"; 2 invalid request or file. A model that cannot be fitted '
        'to the recordings also gives 1, and no model.yaml. Files: report.html, model.yaml (with '
        'the missing effect), diagnosis.json; if a law was discovered that is not in the '
        'library, also model_discovered.yaml and effects/proposed_*.py, which `--effects-path '
        'DIR/effects` loads.'
    )
    parser.add_argument(
        '--model',
        type=Path,
        required=True,
        metavar='MODEL.yaml',
        help='the calibrated model to be diagnosed',
    )
    verb.add_recordings(
        parser,
        '--train',
        'recordings with and without load, in which to look for the missing effect',
        required=True,
    )
    verb.add_recordings(
        parser,
        '--heldout',
        'other recordings, on which the model error is measured before and after (default: '
        'none; the answer is then not tested on new data)',
    )
    verb.add_recordings(
        parser,
        '--unloaded',
        'which of these recordings show the arm with nothing attached (default: those '
        'without `end_wrench`, or with only noise in it)',
    )
    verb.add_output(
        parser,
        'DIR',
        'write report.html, model.yaml, diagnosis.json and the pictures into this folder',
    )
    verb.add_seed(
        parser,
        'random seed of the simulated clean data from which the thresholds are computed '
        '(default: 0)',
    )
    parser.add_argument(
        '--without',
        nargs='+',
        default=[],
        metavar='EFFECT',
        help='effects of the library to ignore, as if they did not exist',
    )
    add_experiments(parser)
    verb.add_effects_path(parser)
    verb.add_gravity(parser)


def run(arguments: Namespace) -> int:
    """Read the recordings, diagnose, and write the results."""
    from pneunet_ros.cli.provenance import versions
    from pneunet_ros.diagnosis.diagnosis import PARTS
    from pneunet_ros.diagnosis.result import CLEAR
    from pneunet_ros.diagnosis.usable_frames import with_tips
    from pneunet_ros.exploration.proposal import with_proposal
    from pneunet_ros.exploration.safe_set import SafeSet
    from pneunet_ros.offline.calibration_files import check_distinct, check_recordings, inputs_of
    from pneunet_ros.reports.diagnosis.files import REPLACEABLE, write_diagnosis
    from pneunet_ros.reports.diagnosis.report import Given

    started = time.perf_counter()
    frame = verb.with_gravity(load_model(arguments.model), arguments)
    recordings = (*arguments.train, *arguments.heldout)
    check_recordings(recordings)
    inputs = inputs_of((('training', arguments.train), ('heldout', arguments.heldout)))
    check_distinct(inputs)
    provenance = {
        'model': {'file': arguments.model.name, 'content_sha256': model_hash(frame)},
        'inputs': inputs,
        'versions': versions(),
    }
    with (
        atomic_output(
            arguments.output,
            overwrite=arguments.overwrite,
            inputs=(arguments.model, *recordings),
            replaceable=REPLACEABLE,
        ) as folder,
        verb.progress_bar(shown=not arguments.json) as bar,
    ):
        read = read_experiments((arguments.train, arguments.heldout), frame, arguments, bar)
        frame, training, held_out, tips = with_tips(frame, *read.groups)
        read = replace(read, left_out=(*read.left_out, *tips))
        on_progress = verb.progress_of(bar, 'diagnosing')
        investigation, discovery = diagnose(arguments, frame, training, held_out, on_progress)
        overruled = investigation.overruled(discovery.overruling)
        found = with_proposal(overruled, SafeSet.of(frame)).diagnosis
        given = Given(
            notes=read.sentences,
            model=str(arguments.model),
            recordings=tuple(map(str, recordings)),
            folder=str(arguments.output),
        )
        used, tested = investigation.recordings  # minus the frames without an equilibrium
        content = write_diagnosis(
            found,
            folder,
            frame=frame,
            training=used,
            held_out=tested,
            provenance=provenance,
            discovery=discovery,
            given=given,
            on_progress=part_of(on_progress, 5, PARTS),
        )
    if arguments.json:
        seconds = time.perf_counter() - started
        verb.print_json(content | {'output': arguments.output, 'seconds': seconds} | read.summary)
    else:
        show_answer(found, discovery, read.sentences, arguments.output)
    return verb.DONE if found.answer in CLEAR else verb.NEGATIVE


def diagnose(
    arguments: Namespace,
    frame: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    on_progress: OnProgress,
) -> tuple[Investigation | UnsettledInvestigation, Discovery]:
    """Diagnose the recordings, and search for laws of the remaining misfit."""
    from pneunet_ros.diagnosis.diagnosis import investigate, PARTS
    from pneunet_ros.discovery.discovery import discover

    investigation = investigate(
        frame,
        training,
        held_out,
        seed=arguments.seed,
        on_progress=on_progress,
        settings=replace(
            settings_without(arguments.without),
            declared=verb.settings_of(arguments).judged_pressure,
        ),
    )
    return investigation, discover(investigation, on_progress=part_of(on_progress, 4, PARTS))


def show_answer(
    found: Diagnosis | UnsettledDiagnosis, discovery: Discovery, notes: Sequence[str], folder: Path
) -> None:
    """Print the answer for users."""
    from pneunet_ros.cli.diagnose_summary import show, show_unsettled
    from pneunet_ros.diagnosis.result import UnsettledDiagnosis

    if isinstance(found, UnsettledDiagnosis):
        show_unsettled(found, notes, folder, verb.output_console())
    else:
        show(found, discovery, notes, folder, verb.output_console())


def settings_without(names: Sequence[str]) -> DiagnosisSettings:
    """Return the settings of a diagnosis that excludes some effects."""
    for name in names:
        if name not in EFFECTS:
            raise RequestError(
                f'--without: there is no effect {name}; known effects: {", ".join(EFFECTS)}',
                reason='unknown_key',
            )
    return replace(DEFAULTS, withheld=tuple(sorted(names)))
