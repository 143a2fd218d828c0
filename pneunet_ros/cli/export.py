"""`pneunet export`: a recording -> a table of readings, and of tips that were estimated."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np
from pneunet_ros.cli.verb import (
    add_json,
    add_overwrite,
    add_settings,
    add_topics,
    DONE,
    output_console,
    print_json,
    SENSOR_SETTINGS,
    settings_of,
    topics_of,
)
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.messages.builders import POSE_TYPE
from pneunet_ros.messages.readings import SENSORS
from pneunet_ros.offline.table_conversion import tabulate
from pneunet_ros.recordings.recorded_series import find_all_series, read_series
from pneunet_ros.recordings.recorded_shapes import read_tips, TIP
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.tables.reading_table import columns
from pneunet_ros.tables.table_writer import check_suffix, write_columns

TIP_COLUMNS = ('estimate_tip_x_m', 'estimate_tip_y_m', 'estimate_tip_theta_rad')


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'recording', type=Path, metavar='REC', help='an .mcap file or a rosbag2 folder'
    )
    parser.add_argument(
        '--output',
        type=Path,
        metavar='TABLE.csv',
        required=True,
        help='write the table here; .npz writes arrays by the same names',
    )
    add_overwrite(parser)
    add_topics(parser)
    add_settings(parser, SENSOR_SETTINGS)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Export and summarize."""
    check_suffix(arguments.output)
    names = [sensor.name for sensor in SENSORS]
    overrides = topics_of(arguments.topic, [*names, TIP])
    recording = open_recording(arguments.recording)
    topics = find_all_series(recording, overrides)
    tip_topic = overrides.get(TIP)
    if tip_topic is not None or recording.candidates(TIP, POSE_TYPE):
        tip_topic = recording.find(TIP, POSE_TYPE, tip_topic)
    if not topics and tip_topic is None:
        raise RecordingError(
            f'{arguments.recording} has nothing to export: no topic '
            f'{", ".join(names)} or {TIP}; images are turned into targets by `track`'
        )
    series = read_series(recording, topics, settings_of(arguments))
    sentences = [*recording.sentences]
    for item in series.values():
        sentences += item.sentences()
    tips: dict[int, Array] = {}
    if tip_topic is not None and recording.count([tip_topic]):
        found, _ = read_tips(recording, tip_topic)
        rows = np.column_stack([found.place, found.heading])
        tips = dict(zip(found.stamp_ns.tolist(), rows, strict=True))
    table = tabulate(series, list(tips))
    content = columns(table)
    if tips:
        values = np.full((len(table.stamp_ns), len(TIP_COLUMNS)), np.nan)
        values[np.searchsorted(table.stamp_ns, list(tips))] = list(tips.values())
        content |= dict(zip(TIP_COLUMNS, values.T, strict=True))
    write_columns(
        arguments.output,
        content,
        overwrite=arguments.overwrite,
        inputs=[arguments.recording],
    )
    summary = {
        'recording': arguments.recording,
        'output': arguments.output,
        'topics': topics | ({TIP: tip_topic} if tip_topic is not None else {}),
        'rows': len(table.stamp_ns),
        'columns': list(content),
        'sentences': sentences,
    }
    if arguments.json:
        print_json(summary)
        return DONE
    console = output_console()
    console.print(f'{len(table.stamp_ns)} rows of {len(content)} columns: {", ".join(content)}')
    for sentence in sentences:
        console.print(f'note: {sentence}')
    console.print(f'wrote {arguments.output}')
    return DONE
