"""`pneunet replay --fuse`: the fusion on a recording, without a ROS graph."""

from __future__ import annotations

from argparse import Namespace
from contextlib import ExitStack
from dataclasses import replace
import time

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_table
from pneunet_ros.cli.judged import refuse_readings
from pneunet_ros.core.settings import settings_used
from pneunet_ros.core.units import millimeters
from pneunet_ros.files.model_file import model_hash
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.messages.readings import PRESSURE, SENSORS
from pneunet_ros.model.uncertainty import error_left_out
from pneunet_ros.offline.fuse import (
    fusion_steps,
    fusion_topics,
    FusionStep,
    FusionTally,
    record_fusion,
)
from pneunet_ros.offline.judge import judge_recording
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
from rich.table import Table


def run_fusion(arguments: Namespace) -> int:
    """Fuse the recording and summarize."""
    arm = verb.model_of(arguments)
    settings = replace(FUSION, free_tip=arguments.free_tip)
    fusion = Fusion(arm=arm, sensors=verb.settings_of(arguments), settings=settings)
    overrides = verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    recording = open_recording(arguments.recording)
    wrench = not (arguments.no_wrench or arguments.free_tip)
    topics = fusion_topics(recording, overrides, wrench=wrench, gravity=fusion.gravity)
    with verb.reading_bar(shown=not arguments.json):
        verdicts = judge_recording(
            recording,
            arm,
            replace(fusion.sensors, wrench_required=wrench),
            overrides,
            own_model=arguments.model is not None,
        )
    if (
        PRESSURE.name in verdicts.doubted or verdicts.strangeness
    ):  # a wrong force sensor the fusion leaves out by itself
        return refuse_readings(arguments, arguments.recording, verdicts)
    tally = FusionTally()
    begun = time.perf_counter()
    with ExitStack() as stack:
        bar = stack.enter_context(verb.progress_bar(shown=not arguments.json))
        task = bar.add_task('fusing', total=recording.count(list(topics)))

        def on_progress(step: FusionStep) -> None:
            tally.count(step)
            if tally.messages % 200 == 0:
                bar.update(task, completed=tally.messages)

        if arguments.output is None:
            for step in fusion_steps(recording, fusion, topics):
                on_progress(step)
        else:
            writer = stack.enter_context(
                write_recording(
                    arguments.output, overwrite=arguments.overwrite, inputs=[arguments.recording]
                )
            )
            record_fusion(writer, recording, fusion, topics, on_progress)
    state, last = tally.state, tally.last
    sensor = None if last is None else last.force_sensor
    summary = {
        'recording': arguments.recording,
        'output': arguments.output,
        'model': arm.name,
        'model_hash': model_hash(arm),
        'topics': {sensor.name: name for name, sensor in topics.items()},
        'estimates': state.counts.estimates,
        'modes': tally.modes,
        'frames_used': state.counts.frames,
        'frames_unused': dict(state.counts.unused),
        'rejected': dict(state.readings.rejected),
        'force_determined': tally.determined,
        'ambiguous': tally.ambiguous,
        'contacts': tally.contacts,
        'force_sensor': None if sensor is None else sensor.numbers,
        'nis': None if last is None else last.nis,
        'nis_limit': None if last is None else last.nis_limit,
        'beyond_noise': tally.beyond,
        'of_the_bench': {sentence: count for sentence, count in tally.said.items() if count},
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'settings': settings_used(fusion.settings, *fusion.model.unknowns.blocks),
        'seconds': time.perf_counter() - begun,
        'verdicts': verdicts.summary,
        'sentences': [
            *([f'{verdicts.findings}: give {verdicts.options}'] if verdicts.doubted else []),
            *recording.sentences,
            *fusion.other_sensors(state).values(),
        ],
        'last_refusal': tally.refusal.sentence if tally.refusal else None,
    }
    if arguments.json:
        verb.print_json(summary)
    else:
        show(summary, tally)
    return verb.DONE if state.counts.estimates else verb.NEGATIVE


def show(summary: dict[str, object], tally: FusionTally) -> None:
    """Print the summary for people."""
    console = verb.output_console()
    table = Table(title=f'{summary["recording"]} through {summary["model"]}', show_header=False)
    table.add_column()
    table.add_column()
    modes = ', '.join(f'{count} {mode}' for mode, count in tally.modes.items() if count)
    table.add_row('estimates', modes or 'none')
    table.add_row('frames used', str(tally.state.counts.frames))
    for what, counts in (
        ('frames not used', tally.state.counts.unused),
        ('rejected readings', tally.state.readings.rejected),
    ):
        words = ', '.join(f'{count} {reason}' for reason, count in counts.items())
        table.add_row(what, words or 'none')
    first, second = tally.determined
    table.add_row('force determined', f'F1 in {first}, F2 in {second} estimates')
    if tally.ambiguous:
        table.add_row('ambiguous', f'{tally.ambiguous} estimates: two loads explain the targets')
    if any(tally.contacts):
        clear, alike = tally.contacts
        words = f'{clear} estimates, and {alike} in which a tip force would fit as well'
        table.add_row('contact along the arm', words)
    last = tally.last
    if last is not None:
        x, y, _ = last.estimate.shape.tip
        force = ', '.join(f'{value:.4f}' for value in last.force.tolist())
        table.add_row(
            'last estimate',
            f'tip at ({millimeters(x):.2f}, {millimeters(y):.2f}) mm, force ({force}) N',
        )
        if last.force_sensor is not None:
            table.add_row('force sensor', last.force_sensor.words)
        if last.contact is not None and not last.contact.ambiguous:
            touch = last.contact
            table.add_row(
                'contact in it',
                f'{touch.force:.4f} ± {touch.std_force:.4f} N at s = '
                f'{millimeters(touch.arclength):.1f} ± {millimeters(touch.std_arclength):.1f} mm',
            )
    print_table(console, table)
    sentences = summary['sentences']
    assert isinstance(sentences, list)
    if tally.beyond:
        sentences = [
            *sentences,
            f'in {tally.beyond} estimates targets were further from the fused shape than noise '
            'explains: run pneunet diagnose',
        ]
    for sentence, count in tally.said.items():
        if count:
            sentences = [*sentences, f'{sentence} (in {count} estimates)']
    if summary['std_leaves_out']:
        sentences = [*sentences, summary['std_leaves_out']]
    if summary['last_refusal']:
        sentences = [*sentences, f'last rejected reading: {summary["last_refusal"]}']
    for sentence in sentences:
        console.print(f'note: {sentence}')
    if summary['output'] is None:
        console.print(
            'Nothing was written; --output OUT.mcap saves the inputs and all fused topics.'
        )
    else:
        console.print(f'wrote {summary["output"]}')
