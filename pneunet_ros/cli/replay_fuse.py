"""`pneunet replay --fuse`: the fusion on a recording, without a ROS graph."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
import time
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.cli.replaying import (
    common_summary,
    counts_text,
    judge,
    open_replay_output,
    refuse_readings,
    show_replay,
)
from pneunet_ros.core.settings import settings_used
from pneunet_ros.core.units import millimeters
from pneunet_ros.fusion.estimate import force_words
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.messages.readings import PRESSURE, SENSORS
from pneunet_ros.offline.fuse import fusion_topics, FusionTally, record_fusion
from pneunet_ros.recordings.recording import open_recording
from rich.console import Console


def run_fusion(arguments: Namespace) -> int:
    """Fuse the recording and summarize."""
    arm = verb.model_of(arguments)
    settings = replace(FUSION, free_tip=arguments.free_tip, delay_std=arguments.delay_std)
    fusion = Fusion(arm=arm, sensors=verb.settings_of(arguments), settings=settings)
    overrides = verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    recording = open_recording(arguments.recording)
    wrench = not (arguments.no_wrench or arguments.free_tip)
    topics = fusion_topics(recording, overrides, wrench=wrench, gravity=fusion.gravity)
    sensors = replace(fusion.sensors, wrench_required=wrench)
    verdicts = judge(arguments, recording, arm, sensors, overrides)
    # The fusion itself excludes a wrong force sensor.
    if PRESSURE.name in verdicts.contradicted or verdicts.model_mismatch:
        return refuse_readings(arguments, verdicts)
    tally = FusionTally()
    start = time.perf_counter()
    with open_replay_output(arguments, recording, topics, 'fusing', tally.count) as (
        writer,
        on_progress,
    ):
        record_fusion(writer, recording, fusion, topics, on_progress)
    state, last = tally.state, tally.last
    sensor = None if last is None else last.force_sensor
    summary = common_summary(arguments, arm, topics, verdicts, tally.refusal) | {
        'estimates': state.counts.estimates,
        'modes': tally.modes,
        'frames_used': state.counts.frames,
        'frames_unused': dict(state.counts.unused),
        'rejected': dict(state.readings.rejected),
        'force_determined': tally.determined,
        'ambiguous': tally.ambiguous,
        'contacts': tally.contacts,
        'force_sensor': None if sensor is None else sensor.numbers,
        'frame_delay_s': state.frame_delay,
        'nis': None if last is None else last.nis,
        'nis_limit': None if last is None else last.nis_limit,
        'beyond_noise': tally.inconsistent,
        'of_the_bench': {sentence: count for sentence, count in tally.warnings.items() if count},
        'settings': settings_used(fusion.settings, *fusion.model.unknowns.blocks),
        'seconds': time.perf_counter() - start,
        'sentences': [
            *([f'{verdicts.findings}: give {verdicts.options}'] if verdicts.contradicted else []),
            *recording.sentences,
            *fusion.other_sensors(state).values(),
        ],
    }
    verb.present(arguments, summary, lambda console: show(summary, tally, console))
    return verb.DONE if state.counts.estimates else verb.NEGATIVE


def show(summary: dict[str, Any], tally: FusionTally, console: Console) -> None:
    """Print the summary for users."""
    modes = ', '.join(f'{count} {mode}' for mode, count in tally.modes.items() if count)
    first, second = tally.determined
    facts = {
        'estimates': modes or 'none',
        'frames used': str(summary['frames_used']),
        'frames not used': counts_text(summary['frames_unused']),
        'rejected readings': counts_text(summary['rejected']),
        'force determined': f'F1 in {first}, F2 in {second} estimates',
    }
    if tally.ambiguous:
        facts['ambiguous'] = f'{tally.ambiguous} estimates: two loads explain the targets'
    if any(tally.contacts):
        definite, ambiguous = tally.contacts
        facts['contact along the arm'] = (
            f'{definite} estimates, and {ambiguous} in which a tip force would fit as well'
        )
    last = tally.last
    if last is not None:
        x, y, _ = last.estimate.shape.tip
        force = ', '.join(force_words(value) for value in last.force.tolist())
        facts['last estimate'] = (
            f'tip at ({millimeters(x):.2f}, {millimeters(y):.2f}) mm, force ({force}) N'
        )
        if last.force_sensor is not None:
            facts['force sensor'] = last.force_sensor.words
        delay = summary['frame_delay_s']
        if delay is not None:
            side = 'after' if delay > 0.0 else 'before'
            facts['last frame taken'] = f'{abs(delay):.3f} s {side} its stamp, by the pressure'
        if last.contact is not None and not last.contact.ambiguous:
            touch = last.contact
            facts['contact in it'] = (
                f'{touch.force:.4f} ± {touch.std_force:.4f} N at s = '
                f'{millimeters(touch.arclength):.1f} ± {millimeters(touch.std_arclength):.1f} mm'
            )
    sentences = [
        f'{sentence} (in {count} estimates)' for sentence, count in summary['of_the_bench'].items()
    ]
    if tally.inconsistent:
        sentences.insert(
            0,
            f'in {tally.inconsistent} estimates targets were further from the fused shape than '
            'noise explains: run pneunet diagnose',
        )
    if summary['std_leaves_out']:
        sentences.append(summary['std_leaves_out'])
    show_replay(console, summary, facts, sentences, 'fused')
