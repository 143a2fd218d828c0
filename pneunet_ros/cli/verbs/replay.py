"""`pneunet replay`: the estimator on a recording, without a ROS graph."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import ExitStack
import dataclasses
from pathlib import Path
import time
from typing import TYPE_CHECKING

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_table
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals, millimeters
from rich.table import Table

if TYPE_CHECKING:
    from pneunet_ros.estimation.consistency import Agreement
    from pneunet_ros.offline.replay import Step, Tally


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'recording', type=Path, metavar='REC', help='an .mcap file or a rosbag2 folder'
    )
    verb.add_model(parser)
    verb.add_gravity(parser)
    parser.add_argument(
        '--output',
        type=Path,
        metavar='OUT.mcap',
        help='write inputs and all estimator topics here (default: print the summary only)',
    )
    parser.add_argument(
        '--views',
        action='store_true',
        help='write markers, the transform to the tip (/tf) and joint_states as well',
    )
    parser.add_argument(
        '--fuse',
        action='store_true',
        help='fuse pressure, targets and end wrench into fused/shape, fused/end_wrench, ...',
    )
    parser.add_argument(
        '--no-wrench',
        action='store_true',
        help='with --fuse: ignore the force sensor and estimate the force',
    )
    parser.add_argument(
        '--free-tip',
        action='store_true',
        help='with --fuse: no load acts at the tip; estimate contacts along the arm instead',
    )
    verb.add_overwrite(parser)
    verb.add_topics(parser)
    verb.add_settings(parser)
    verb.add_json(parser)


def run(arguments: Namespace) -> int:
    """Replay the recording and summarize."""
    if arguments.fuse:  # imported here: a replay without it starts a quarter of a second earlier
        from pneunet_ros.cli.replay_fuse import run_fusion

        return run_fusion(arguments)
    if arguments.no_wrench:
        raise RequestError(
            '--no-wrench needs --fuse; without --fuse, use --no-wrench-required',
            reason='exclusive',
        )
    if arguments.free_tip:
        raise RequestError('--free-tip needs --fuse', reason='exclusive')
    return run_estimator(arguments)


def run_estimator(arguments: Namespace) -> int:
    """Replay a recording through the estimator and summarize."""
    from pneunet_ros.cli.judged import refuse_readings
    from pneunet_ros.estimation.estimator import Estimator
    from pneunet_ros.files.model_file import model_hash
    from pneunet_ros.messages.link_chain import JOINT_STATES
    from pneunet_ros.messages.markers import markers_output, TIP_FRAME, transform_output
    from pneunet_ros.messages.readings import PRESSURE, SENSORS, TARGETS
    from pneunet_ros.model.uncertainty import error_left_out
    from pneunet_ros.offline.judge import judge_recording
    from pneunet_ros.offline.replay import (
        input_topics,
        record_steps,
        steps,
        Tally,
        targets_topic,
    )
    from pneunet_ros.recordings.recording import open_recording
    from pneunet_ros.recordings.recording_writer import write_recording

    arm = verb.model_of(arguments)
    estimator = Estimator(arm=arm, settings=verb.settings_of(arguments))
    overrides = verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    recording = open_recording(arguments.recording)
    topics = input_topics(recording, estimator, overrides)
    targets = targets_topic(recording, estimator, overrides)
    pressure_topic = next(name for name, sensor in topics.items() if sensor is PRESSURE)
    with verb.reading_bar(shown=not arguments.json):
        verdicts = judge_recording(
            recording,
            arm,
            estimator.settings,
            overrides,
            own_model=arguments.model is not None,
        )
    if verdicts.doubted or verdicts.strangeness:
        return refuse_readings(arguments, arguments.recording, verdicts)
    tally = Tally()
    begun = time.perf_counter()
    with ExitStack() as stack:
        bar = stack.enter_context(verb.progress_bar(shown=not arguments.json))
        task = bar.add_task(
            'replaying', total=recording.count([*topics, *([targets] if targets else [])])
        )

        def on_progress(step: Step) -> None:
            tally.count(step, pressure_topic)
            if tally.pressures % 200 == 0:
                bar.update(task, completed=tally.messages)

        if arguments.output is None:
            for step in steps(recording, estimator, topics, targets):
                on_progress(step)
        else:
            writer = stack.enter_context(
                write_recording(
                    arguments.output, overwrite=arguments.overwrite, inputs=[arguments.recording]
                )
            )
            markers = (markers_output(lambda: arm), transform_output(TIP_FRAME), JOINT_STATES)
            shown = markers if arguments.views else ()
            record_steps(writer, recording, estimator, topics, on_progress, shown, targets)
    agreement = tally.agreement(arm)
    seconds = time.perf_counter() - begun
    state = tally.state
    summary = {
        'recording': arguments.recording,
        'output': arguments.output,
        'model': arm.name,
        'model_hash': model_hash(arm),
        'topics': {sensor.name: name for name, sensor in topics.items()}
        | ({} if targets is None else {TARGETS.name: targets}),
        'pressure_readings': tally.pressures,
        'estimates': 0 if state is None else state.estimates,
        'rejected': {} if state is None else dict(state.rejected),
        'warned': tally.warned,
        'std_leaves_out': error_left_out(arm.covariance, arm.sources),
        'resets': 0 if state is None else state.resets,
        'worst_residual': tally.worst_residual,
        'motion': motion_summary(tally),
        'watch': None if targets is None else consistency_summary(tally, agreement),
        'seconds': seconds,
        'verdicts': verdicts.summary,
        'sentences': list(recording.sentences),
        'last_refusal': tally.refusal.sentence if tally.refusal else None,
    }
    if arguments.json:
        verb.print_json(summary)
    else:
        show(summary, tally, agreement)
    return verb.DONE if summary['estimates'] else verb.NEGATIVE


def motion_summary(tally: Tally) -> dict[str, float] | None:
    """Return the motion of the arm; None if the model has no motion.

    settled: fraction of the estimates; frequency (Hz) and decay_time (s): of the last one.
    """
    motion = tally.last.motion if tally.last else None
    modes = motion.modes() if motion else None
    if modes is None or tally.state is None:
        return None
    return {
        'settled': tally.settled / tally.state.estimates,
        'frequency': modes.hertz,
        'decay_time': modes.decay_time,
    }


def consistency_summary(tally: Tally, agreement: Agreement | None) -> dict[str, object]:
    """Return the agreement of targets and estimates, with the largest disagreement."""
    worst = tally.disagreement
    return {
        'agreement': None if agreement is None else dataclasses.asdict(agreement),
        'holds': None if agreement is None else agreement.holds,
        'targets_matched': tally.consistency.matched,
        'targets_unmatched': dict(tally.consistency.unmatched),
        'worst': None if worst is None else dataclasses.asdict(worst),
    }


def show(summary: dict[str, object], tally: Tally, agreement: Agreement | None) -> None:
    """Print the summary for people."""
    console = verb.output_console()
    table = Table(title=f'{summary["recording"]} through {summary["model"]}', show_header=False)
    table.add_column()
    table.add_column()
    table.add_row('pressure readings', str(summary['pressure_readings']))
    table.add_row('estimates', str(summary['estimates']))
    rejected = summary['rejected']
    assert isinstance(rejected, dict)
    table.add_row(
        'rejected readings',
        ', '.join(f'{count} {reason}' for reason, count in rejected.items()) or 'none',
    )
    table.add_row('worst residual', f'{summary["worst_residual"]:.1e} rad')
    motion = summary['motion']
    if isinstance(motion, dict):
        table.add_row(
            'motion',
            f'at rest in {motion["settled"]:.0%} of the estimates ({motion["frequency"]:.2g} Hz, '
            f'decays in {motion["decay_time"]:.2g} s)',
        )
    worst = tally.disagreement
    if agreement is not None:
        table.add_row('measured targets', agreement.sentence)
    if tally.last is not None:
        x, y, _ = tally.last.shape.tip
        pressure = kilopascals(tally.last.shape.pressure)
        table.add_row(
            'last estimate',
            f'{pressure:.2f} kPa, tip at ({millimeters(x):.2f}, {millimeters(y):.2f}) mm',
        )
    seconds = summary['seconds']
    assert isinstance(seconds, float)
    table.add_row('took', f'{seconds:.2f} s ({tally.pressures / seconds:.0f} readings/s)')
    print_table(console, table)
    sentences = summary['sentences']
    assert isinstance(sentences, list)
    if worst is not None and worst.beyond:
        sentences = [*sentences, f'at stamp {worst.stamp_ns} ns {worst.sentence}']
    sentences = [
        *sentences,
        *(f'{count} estimates: {warning}' for warning, count in tally.warned.items()),
        *([summary['std_leaves_out']] if summary['std_leaves_out'] else []),
    ]
    if summary['last_refusal']:
        sentences = [*sentences, f'last rejected reading: {summary["last_refusal"]}']
    for sentence in sentences:
        console.print(f'note: {sentence}')
    if summary['output'] is None:
        console.print(
            'Nothing was written; --output OUT.mcap saves the inputs and all estimator topics.'
        )
    else:
        console.print(f'wrote {summary["output"]}')
