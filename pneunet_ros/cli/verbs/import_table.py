"""`pneunet import`: a CSV table with units in its column names -> recording."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from pneunet_ros.cli import verb
from pneunet_ros.cli.table_options import add_table_options, table_request, unit_objections
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import seconds_between
from pneunet_ros.messages.readings import TARGETS
from pneunet_ros.offline.table_conversion import record_table
from pneunet_ros.recordings.file_kinds import recording_from, VIDEOS
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.tables.columns import known_names
from pneunet_ros.tables.table_reader import read_table


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        f'Known columns: {known_names()}. Targets are numbered from 0 at the clamp. Strings: a '
        'pulls along x, b along y, each turned counter-clockwise by its angle. tip_x, tip_y, '
        'tip_heading: the pose of the tip; any of the three may be missing. An empty cell: no '
        'reading, or target not seen.'
    )
    parser.add_argument('table', type=Path, metavar='TABLE.csv', help='a CSV file, UTF-8')
    verb.add_output(parser, 'REC.mcap', 'write the recording here')
    add_table_options(parser)
    parser.add_argument(
        '--rate', type=float, metavar='HZ', help='rows per second of a table without a time column'
    )
    verb.add_model(
        parser,
        'model whose pressure range the readings should fit (default: that of any soft actuator)',
    )
    verb.add_settings(parser, ['judge_readings'])


def run(arguments: Namespace) -> int:
    """Import the table and summarize."""
    if arguments.table.suffix.lower() in VIDEOS:
        raise RequestError(
            f'{arguments.table} {recording_from(arguments.table)}', reason='wrong_kind'
        )
    if arguments.table.suffix.lower() == '.mcap' and arguments.table.is_file():
        raise RequestError(
            f'{arguments.table} is already a recording: `pneunet export` converts it to a table',
            reason='wrong_kind',
        )
    request = table_request(arguments, rate=arguments.rate)
    with verb.reading_bar(shown=not arguments.json):
        table, sentences = read_table(arguments.table, request)
    objections, hints = unit_objections(table, arguments)
    with (
        verb.reading_bar(shown=not arguments.json),
        write_recording(
            arguments.output, overwrite=arguments.overwrite, inputs=[arguments.table]
        ) as writer,
    ):
        topics = record_table(writer, table)
    seconds = seconds_between(int(table.stamp_ns[0]), int(table.stamp_ns[-1]))
    summary = {
        'table': arguments.table,
        'output': arguments.output,
        'rows': len(table.stamp_ns),
        'targets': table.values[TARGETS.name].shape[2],
        'seconds': seconds,
        'topics': topics,
        'sentences': [*objections, *hints, *sentences],
    }
    counts = ', '.join(f'{count} of {name}' for name, count in topics.items())
    text = f'{len(table.stamp_ns)} rows over {seconds:g} s: {counts}'
    verb.print_outputs(arguments, summary, text)
    return verb.NEGATIVE if objections else verb.DONE
