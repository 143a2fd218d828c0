"""`pneunet replay`: the estimator on a recording, without a ROS graph."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
import dataclasses
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from pneunet_ros.cli import verb
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals, millimeters
from rich.console import Console

if TYPE_CHECKING:
    from pneunet_ros.estimation.consistency import Agreement
    from pneunet_ros.offline.replay import Tally


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
    parser.add_argument(
        '--delay-std',
        type=float,
        default=0.0,
        metavar='S',
        help='with --fuse: std of the time between frames and pressure (s), if they are not '
        'stamped by one clock or a film has lost frames: 0.03 is one frame; for a model without '
        'motion (default: 0, none)',
    )
    verb.add_overwrite(parser)
    verb.add_topics(parser)
    verb.add_settings(parser)


def run(arguments: Namespace) -> int:
    """Replay the recording and summarize."""
    if arguments.fuse:  # imported here, because the import takes a quarter of a second
        from pneunet_ros.cli.replay_fuse import run_fusion

        if arguments.views:
            raise RequestError(
                '--views shows the estimates of a replay without --fuse', reason='exclusive'
            )
        if not verb.settings_of(arguments).wrench_required:
            raise RequestError(
                '--no-wrench-required is for a replay without --fuse; with --fuse, a recording '
                'needs no end wrench, and --no-wrench ignores it',
                reason='exclusive',
            )
        return run_fusion(arguments)
    if arguments.no_wrench:
        raise RequestError(
            '--no-wrench needs --fuse; without --fuse, use --no-wrench-required',
            reason='exclusive',
        )
    if arguments.free_tip:
        raise RequestError('--free-tip needs --fuse', reason='exclusive')
    if arguments.delay_std:
        raise RequestError('--delay-std needs --fuse', reason='exclusive')
    return run_estimator(arguments)


def run_estimator(arguments: Namespace) -> int:
    """Replay a recording through the estimator and summarize."""
    from pneunet_ros.cli.replaying import (
        common_summary,
        judge,
        open_replay_output,
        refuse_readings,
    )
    from pneunet_ros.estimation.estimator import Estimator
    from pneunet_ros.messages.link_chain import JOINT_STATES
    from pneunet_ros.messages.markers import markers_output, TIP_FRAME, transform_output
    from pneunet_ros.messages.readings import SENSORS
    from pneunet_ros.offline import replay
    from pneunet_ros.recordings.recording import open_recording

    arm = verb.model_of(arguments)
    estimator = Estimator(arm=arm, settings=verb.settings_of(arguments))
    overrides = verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    recording = open_recording(arguments.recording)
    topics = replay.input_topics(recording, estimator, overrides)
    targets = replay.targets_topic(recording, estimator, overrides)
    inputs = replay.with_targets(topics, targets)
    verdicts = judge(arguments, recording, arm, estimator.settings, overrides)
    if verdicts.contradicted or verdicts.model_mismatch:
        return refuse_readings(arguments, verdicts)
    tally = replay.Tally()
    pressure = replay.topic_of_pressure(topics)
    views = (markers_output(lambda: arm), transform_output(TIP_FRAME), JOINT_STATES)
    start = time.perf_counter()
    with open_replay_output(
        arguments, recording, inputs, 'replaying', lambda step: tally.count(step, pressure)
    ) as (writer, on_progress):
        shown = views if arguments.views else ()
        replay.record_steps(writer, recording, estimator, topics, on_progress, shown, targets)
    agreement = tally.agreement(arm)
    seconds = time.perf_counter() - start
    state = tally.state
    summary = common_summary(arguments, arm, inputs, verdicts, tally.refusal) | {
        'pressure_readings': tally.pressures,
        'estimates': 0 if state is None else state.estimates,
        'rejected': {} if state is None else dict(state.rejected),
        'warned': tally.warned,
        'resets': 0 if state is None else state.resets,
        'worst_residual': tally.worst_residual,
        'motion': motion_summary(tally),
        'watch': None if targets is None else consistency_summary(tally, agreement),
        'seconds': seconds,
        'sentences': list(recording.sentences),
    }
    verb.present(arguments, summary, lambda console: show(summary, tally, agreement, console))
    return verb.DONE if summary['estimates'] else verb.NEGATIVE


def motion_summary(tally: Tally) -> dict[str, float] | None:
    """Return the motion of the arm; None if the model has no motion.

    settled: fraction of the estimates in which the arm is at rest; frequency (Hz) and decay_time
    (s) of the last estimate.
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


def show(
    summary: dict[str, Any], tally: Tally, agreement: Agreement | None, console: Console
) -> None:
    """Print the summary for people."""
    from pneunet_ros.cli.replaying import counts_text, show_replay

    facts = {
        'pressure readings': str(summary['pressure_readings']),
        'estimates': str(summary['estimates']),
        'rejected readings': counts_text(summary['rejected']),
        'worst residual': f'{summary["worst_residual"]:.1e} rad',
    }
    if motion := summary['motion']:
        facts['motion'] = (
            f'at rest in {motion["settled"]:.0%} of the estimates ({motion["frequency"]:.2g} Hz, '
            f'decays in {motion["decay_time"]:.2g} s)'
        )
    if agreement is not None:
        facts['measured targets'] = agreement.sentence
    if tally.last is not None:
        x, y, _ = tally.last.shape.tip
        pressure = kilopascals(tally.last.shape.pressure)
        facts['last estimate'] = (
            f'{pressure:.2f} kPa, tip at ({millimeters(x):.2f}, {millimeters(y):.2f}) mm'
        )
    seconds = summary['seconds']
    facts['took'] = f'{seconds:.2f} s ({tally.pressures / seconds:.0f} readings/s)'
    worst = tally.disagreement
    sentences = [
        *([f'at stamp {worst.stamp_ns} ns {worst.sentence}'] if worst and worst.beyond else []),
        *(f'{count} estimates: {warning}' for warning, count in tally.warned.items()),
        *([summary['std_leaves_out']] if summary['std_leaves_out'] else []),
    ]
    show_replay(console, summary, facts, sentences, 'estimator')
