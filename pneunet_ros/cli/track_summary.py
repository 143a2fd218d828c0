"""The results of `pneunet track`: numbers, and a table for users."""

from __future__ import annotations

from argparse import Namespace
import math
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_facts
from pneunet_ros.core.units import millimeters
from pneunet_ros.files.model_file import model_hash
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.track import TrackTally
from pneunet_ros.recordings.images.image_stream import ImageStream
from pneunet_ros.vision.rest_plane import TURN
from rich.console import Console


def summary_of(
    arguments: Namespace, arm: Arm, stream: ImageStream, tally: TrackTally
) -> dict[str, Any]:
    """Return the numbers of the summary, SI."""
    return {
        'source': arguments.source,
        'kind': stream.kind,
        'clock': stream.clock,
        'output': arguments.output,
        'table': arguments.table,
        'preview': arguments.preview,
        'model': arm.name,
        'model_hash': model_hash(arm),
        'topics': {'image_raw': stream.image_topic, 'camera_info': stream.lens_source},
        'frames': tally.frames,
        'explained': tally.explained,
        'reasons': dict(tally.reasons),
        'resting': tally.resting,
        'targets': tally.targets,
        'seen': int(tally.seen.sum()),
        'missing': int(tally.missing.sum()),
        'seen_per_target': tally.seen.astype(int),
        'missing_per_target': tally.missing.astype(int),
        'curves': tally.curves,
        'smoothing_rms': tally.rms,
        'worst_smoothing_rms': tally.worst_rms,
        'scale': tally.scale,
        'last_sentences': tally.sentences,
        'main_sentence': tally.main_sentence,
    }


def show(summary: dict[str, Any], console: Console) -> None:
    """Print the summary for people."""
    frames, explained = summary['frames'], summary['explained']
    reasons = ', '.join(f'{count} {reason}' for reason, count in summary['reasons'].items())
    missing = summary['missing_per_target']
    often = ', '.join(f'{id_}: {missing[id_]}' for id_ in missing.nonzero()[0].tolist())
    facts = {
        'images': f'{summary["kind"]}, {summary["topics"]["image_raw"]}',
        'lens': str(summary['topics']['camera_info']),
        'stamps': summary['clock'],
        'frames': str(frames),
        'frames tracked': share(explained, frames),
        'without targets': reasons or 'none',
        'targets seen': share(summary['seen'], explained * summary['targets']),
        'frames missing, by target': often or 'none',
    }
    if explained:
        facts['scale'] = f'{millimeters(summary["scale"]):.4g} mm/px'
    if explained and 'rest_bow' in summary:
        turn = TURN * summary['rest_bow']
        facts['row at rest'] = (
            f'{summary["rest_bow"]:.2%} of its length off a straight line: x may be '
            f'{math.degrees(turn):.1f} deg off the arm at the clamp, and the tip {turn:.1%} of '
            'the length off (not in the std)'
        )
    if summary['curves']:
        facts['rms of smoothing'] = (
            f'{millimeters(summary["smoothing_rms"]):.3g} mm '
            f'(worst frame {millimeters(summary["worst_smoothing_rms"]):.3g} mm)'
        )
    if 'delay_sentence' in summary:
        facts['delay'] = summary['delay_sentence']
    if summary.get('frames_covered'):
        facts['frames within the table'] = share(summary['frames_covered'], frames)
    if summary.get('frames_repeated'):
        facts['frames excluded'] = (
            f'{summary["frames_repeated"]}: the image does not change although the pressure does '
            '(a lost frame was replaced by a copy, or a step lies within the error of the delay)'
        )
    seconds, rate = summary['seconds'], summary['frames_per_second']
    facts['took'] = f'{seconds:.2f} s, at {rate:.0f} frames/s'
    print_facts(console, f'{summary["source"]} through {summary["model"]}', facts)
    verb.print_notes(console, summary['sentences'])
    if summary['main_sentence']:
        console.print(f'frames without targets: {summary["main_sentence"]}')
    if not explained and not summary['preview']:
        console.print('Use --preview FILE.png to see what was found in these frames.')
    written = [summary[name] for name in ('output', 'table', 'preview') if summary[name]]
    for path in written:
        console.print(f'wrote {path}')
    if 'delay_sentence' in summary and not summary['output']:
        console.print(
            'No recording was written: the pressures at which the frames were taken are unknown.'
        )
    elif not written:
        console.print('Nothing was written; --output OUT.mcap saves the tracker topics.')


def share(part: int, total: int) -> str:
    """Return a number with its percentage of a total."""
    return f'{part} of {total} ({100.0 * part / total:.1f} %)' if total else '0'
