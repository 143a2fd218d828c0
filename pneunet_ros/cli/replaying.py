"""Parts shared by `replay` and `replay --fuse`: verdicts, output, progress, summary."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
import itertools
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_facts
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.model_file import model_hash
from pneunet_ros.messages.builders import Input
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import error_left_out
from pneunet_ros.offline.judge import judge_recording, Verdicts
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.recordings.recording_writer import RecordingWriter, write_recording
from rich.console import Console

SHOWN_EVERY = 200  # messages between two reports of the progress


def judge(
    arguments: Namespace,
    recording: Recording,
    arm: Arm,
    settings: EstimatorSettings,
    overrides: Mapping[str, str],
) -> Verdicts:
    """Judge the meaning of the readings of a recording, with a progress bar."""
    own_model = arguments.model is not None
    with verb.reading_bar(shown=not arguments.json):
        return judge_recording(recording, arm, settings, overrides, own_model=own_model)


def refuse_readings(arguments: Namespace, verdicts: Verdicts) -> int:
    """Print the likely meaning of the readings and the command to use; return the exit code.

    Nothing is estimated or written.
    """
    path = arguments.recording
    sentence = f'{path}: {verdicts.model_mismatch}'
    if verdicts.contradicted:
        sentence = (
            f'{path}: {verdicts.findings}. Type: pneunet {arguments.verb} {path} '
            f'{verdicts.options} (or --no-judge-readings if the readings are right)'
        )
    summary: dict[str, Any] = {
        'recording': path,
        'output': None,
        'estimates': 0,
        'verdicts': verdicts.summary,
        'sentences': [sentence],
    }
    text = f'{sentence}\nNothing was estimated and nothing was written.'
    verb.present(arguments, summary, lambda console: console.print(text))
    return verb.NEGATIVE


@contextmanager
def open_replay_output(
    arguments: Namespace,
    recording: Recording,
    topics: Collection[str],
    what: str,
    count: Callable[[Any], None],
) -> Iterator[tuple[RecordingWriter | None, Callable[[Any], None]]]:
    """Open the requested output and a progress bar with the text `what`.

    Yields the writer of the output (None without an output) and a callback that passes every step
    to `count`.
    """
    output, overwrite = arguments.output, arguments.overwrite
    counter = itertools.count(1)
    with (
        verb.progress_bar(shown=not arguments.json) as bar,
        nullcontext()
        if output is None
        else write_recording(output, overwrite=overwrite, inputs=[recording.path]) as writer,
    ):
        task = bar.add_task(what, total=recording.count(topics))

        def on_progress(step: Any) -> None:
            count(step)
            if (messages := next(counter)) % SHOWN_EVERY == 0:
                bar.update(task, completed=messages)

        yield writer, on_progress


def common_summary(
    arguments: Namespace,
    arm: Arm,
    inputs: Mapping[str, Input[Any]],
    verdicts: Verdicts,
    refusal: Refusal | None,
) -> dict[str, Any]:
    """Return the summary entries common to all replays; refusal: the last refusal."""
    return {
        'recording': arguments.recording,
        'output': arguments.output,
        'model': arm.name,
        'model_hash': model_hash(arm),
        'topics': {sensor.name: name for name, sensor in inputs.items()},
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'verdicts': verdicts.summary,
        'last_refusal': refusal.sentence if refusal else None,
    }


def counts_text(counts: Mapping[str, int]) -> str:
    """Return counts by reason as text."""
    return ', '.join(f'{count} {reason}' for reason, count in counts.items()) or 'none'


def show_replay(
    console: Console,
    summary: Mapping[str, Any],
    facts: Mapping[str, str],
    sentences: Sequence[str],
    topics: str,
) -> None:
    """Print the facts and notes of a replay; topics: names of the topics of an output."""
    print_facts(console, f'{summary["recording"]} through {summary["model"]}', facts)
    verb.print_notes(console, (*summary['sentences'], *sentences))
    if summary['last_refusal']:
        verb.print_notes(console, [f'last rejected reading: {summary["last_refusal"]}'])
    if summary['output'] is None:
        console.print(
            f'Nothing was written; --output OUT.mcap saves the inputs and all {topics} topics.'
        )
    else:
        console.print(f'wrote {summary["output"]}')
