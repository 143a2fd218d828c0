"""`pneunet check`: contents, gaps and possible uses of recordings."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.core.units import kilopascals
from pneunet_ros.messages.readings import SENSORS
from rich.console import Console

HOLDS_SHOWN = 20


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'recordings', nargs='+', type=Path, metavar='REC', help='.mcap files or rosbag2 folders'
    )
    verb.add_model(parser)
    verb.add_topics(parser)
    verb.add_settings(parser, verb.SENSOR_SETTINGS)


def run(arguments: Namespace) -> int:
    """Check the recordings and print the findings."""
    # These imports take a second, which --help does not need.
    from pneunet_ros.offline.check import check_recording
    from pneunet_ros.offline.uses import UseRequest
    from pneunet_ros.recordings.images.image_sources import TOPIC_NAMES

    request = UseRequest(
        arm=verb.model_of(arguments),
        own_model=arguments.model is not None,
        settings=verb.settings_of(arguments),
        overrides=verb.topics_of(
            arguments.topic, [*(sensor.name for sensor in SENSORS), *TOPIC_NAMES]
        ),
    )
    with verb.reading_bar(shown=not arguments.json):
        found = [check_recording(path, request) for path in arguments.recordings]
    content = {'model': request.arm.name, 'recordings': found}
    verb.present(arguments, content, lambda console: show(found, console))
    verdicts = [verdict for content in found for verdict in content['verdicts'].values()]
    return verb.NEGATIVE if any(verdict['doubted'] for verdict in verdicts) else verb.DONE


def show(recordings: list[dict[str, Any]], console: Console) -> None:
    """Print the findings on recordings."""
    for found in recordings:
        print_recording_findings(found, console)


def print_recording_findings(found: dict[str, Any], console: Console) -> None:
    """Print the findings on one recording."""
    rows = []
    for topic in found['topics']:
        timed = topic['rate'] is not None
        rate, jitter = (
            (f'{topic["rate"]:.4g} Hz', f'{1e3 * topic["jitter"]:.3f} ms') if timed else ('-', '-')
        )
        gaps = f'{topic["gaps"]}, longest {topic["longest_gap"]:.3g} s' if topic['gaps'] else '0'
        count = str(topic['count'])
        rows.append((topic['name'], topic['type'], count, rate, jitter, gaps, topic['stamps']))
    title = f'{found["recording"]}, {found["seconds"]:.4g} s'
    columns = ('topic', 'type', 'count', 'rate', 'jitter', 'gaps', 'by')
    print_rows(console, title, columns, rows, empty='no topics')
    for line in [*sync_lines(found['sync']), *range_lines(found['ranges'])]:
        console.print(line)
    holds = found['holds']
    shown = ', '.join(
        f'{hold["to"] - hold["from"]:.3g} s at {kilopascals(hold["pressure"]):.3g} kPa'
        for hold in holds[:HOLDS_SHOWN]
    )
    more = ', ...' if len(holds) > HOLDS_SHOWN else ''
    console.print(f'holds: {len(holds)}{": " if holds else ""}{shown}{more}')
    for name, use in found['uses'].items():
        usable = 'yes' if use['usable'] else 'no'
        console.print(f'{name}: {", ".join(part for part in (usable, use["reason"]) if part)}')
    verb.print_notes(console, found['sentences'])


def sync_lines(sync: dict[str, Any]) -> list[str]:
    """Describe the timing of other topics relative to the pressure."""
    return [
        f'{name} to pressure: {100.0 * numbers["share"]:.4g} % within half a period, '
        f'{time_difference(1e3 * numbers["offset"], "ms")} than the nearest, first one '
        f'{time_difference(numbers["starts"], "s")}'
        for name, numbers in sync.items()
    ]


def time_difference(time: float, unit: str) -> str:
    """Return a time difference in words."""
    return f'{abs(time):.3g} {unit} {"earlier" if time < 0.0 else "later"}'


def range_lines(ranges: dict[str, Any]) -> list[str]:
    """Describe the ranges of readings."""
    lines = []
    for component in (item for sensor in SENSORS for item in sensor.components):
        if component.name in ranges:
            low, high = (component.shown_per_si * limit for limit in ranges[component.name])
            lines.append(f'{component.name}: {low:z.4g} to {high:z.4g} {component.shown_unit}')
    if 'targets' in ranges:
        frames, seen = ranges['frames'], ranges['seen_per_target'].tolist()
        missing = ', '.join(
            f'{target}: {frames - count}' for target, count in enumerate(seen) if count < frames
        )
        lines.append(
            f'targets: {ranges["targets"]} in {frames} frames; '
            + (f'not seen, by target: {missing}' if missing else 'all seen in every frame')
        )
    return lines
