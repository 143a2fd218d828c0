"""`pneunet export`: a recording -> a table of readings and estimated tips."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError, RecordingError, RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.unit_system import UnitSystem
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.shape_error import Tips
from pneunet_ros.messages.builders import POSE_TYPE
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, Sensor, SENSORS, TARGETS, TIP_POSE
from pneunet_ros.offline.table_conversion import tabulate
from pneunet_ros.recordings.recorded_gravity import with_imu_mounting
from pneunet_ros.recordings.recorded_series import find_recorded, read_series
from pneunet_ros.recordings.recorded_shapes import read_tips, TIP
from pneunet_ros.recordings.recording import open_recording, Recording
from pneunet_ros.tables.reading_table import columns
from pneunet_ros.tables.table_writer import check_suffix, write_columns

NOT_IN_TABLES: dict[Sensor[Any], tuple[str, ...]] = {
    PRESSURE: ('variance',),
    END_WRENCH: ('force_z', 'moment_x', 'moment_y'),
    TARGETS: ('std',),
}


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'recording', type=Path, metavar='REC', help='an .mcap file or a rosbag2 folder'
    )
    meaning = 'write the table here; a .npz file gets arrays with the same names'
    verb.add_output(parser, 'TABLE.csv', meaning)
    verb.add_topics(parser)
    verb.add_settings(parser, {*verb.SENSOR_SETTINGS} - {'judge_readings'})
    verb.add_dimensionless(parser, 'write')
    verb.add_model(parser)


def run(arguments: Namespace) -> int:
    """Export the recording and summarize."""
    check_suffix(arguments.output)
    arm = verb.model_of(arguments)
    units = verb.units_of(arguments, arm)
    if arguments.model is not None and not arguments.dimensionless:
        raise RequestError(
            '--model only sets the scales of --dimensionless: give both options, or neither',
            reason='missing',
        )
    names = [sensor.name for sensor in SENSORS]
    overrides = verb.topics_of(arguments.topic, [*names, TIP])
    recording = open_recording(arguments.recording)
    topics = find_recorded(recording, SENSORS, overrides)
    tip_topic = overrides.get(TIP)
    if tip_topic is not None or recording.candidates(TIP, POSE_TYPE):
        tip_topic = recording.find(TIP, POSE_TYPE, tip_topic)
    if not topics and tip_topic is None:
        raise RecordingError(
            f'{arguments.recording} has nothing to export: no topic '
            f'{", ".join(names)} or {TIP}; `pneunet track` finds targets in images',
            reason='nothing_usable',
        )
    sentences = [*recording.sentences]
    tips = None
    with verb.reading_bar(shown=not arguments.json):
        settings = with_imu_mounting(recording, topics, verb.settings_of(arguments))
        sentences += left_out(recording, topics, settings)
        if not topics and tip_topic is None:
            raise RecordingError(f'nothing to export: {sentences[-1]}', reason='wrong_frame')
        series = read_series(recording, topics, settings)
        for item in series.values():
            sentences += item.sentences()
        if tip_topic is not None and recording.count([tip_topic]):
            tips, read = read_tips(recording, tip_topic)
            sentences += read.sentences
    table = tabulate(series, [] if tips is None else tips.stamp_ns)
    content = columns(table, units)
    if tips is not None:
        content |= tip_columns(tips, table.stamp_ns, units)
    write_columns(
        arguments.output, content, overwrite=arguments.overwrite, inputs=[arguments.recording]
    )
    summary = {
        'recording': arguments.recording,
        'output': arguments.output,
        'topics': topics | ({TIP: tip_topic} if tip_topic is not None else {}),
        'rows': len(table.stamp_ns),
        'columns': list(content),
        'units': units.name,
        'scales': {'length': units.length.size, 'force': units.force.size},
        'sentences': sentences,
    }
    text = f'{len(table.stamp_ns)} rows of {len(content)} columns: {", ".join(content)}'
    scales = [verb.scales_sentence(arm)] if arguments.dimensionless else []
    verb.print_outputs(arguments, summary, text, scales)
    return verb.DONE


def left_out(
    recording: Recording, topics: dict[str, str], settings: EstimatorSettings
) -> Iterator[Note]:
    """Describe content of messages that a table lacks; remove poses in another frame."""
    from pneunet_ros.recordings.dataset_reader import tip_frame

    frame = tip_frame(recording, topics.get(TIP_POSE.name), settings)
    if frame != BASE_FRAME:
        yield Note(
            f'{topics.pop(TIP_POSE.name)} was ignored: it is in the frame {frame}, and a table is '
            f'in {settings.frame_id}; add --frame-id {frame} if that is the frame of the clamp',
            reason='wrong_frame',
        )
    for sensor, names in NOT_IN_TABLES.items():
        topic = topics.get(sensor.name)
        unseen = list(names)
        for message in () if topic is None else recording.messages([topic]):
            with suppress(MessageError):
                reading = sensor.decode(message.message)
                unseen = [it for it in unseen if not np.any(np.nan_to_num(getattr(reading, it)))]
            if not unseen:
                break
        found = [name for name in names if name not in unseen]
        if found:
            yield Note(
                f'{topic}: {", ".join(found)} omitted: tables have no column for it',
                reason='not_supported',
            )


def tip_columns(tips: Tips, stamp_ns: Stamps, units: UnitSystem) -> dict[str, Array]:
    """Return the columns of estimated tips at these stamps, NaN where missing."""
    length = units.length
    rows = np.searchsorted(stamp_ns, tips.stamp_ns)
    values = np.full((3, stamp_ns.size), np.nan)
    values[:2, rows] = tips.place.T / length.size
    values[2, rows] = tips.heading
    names = (f'estimate_tip_x_{length.name}', f'estimate_tip_y_{length.name}')
    return dict(zip((*names, 'estimate_tip_theta_rad'), values, strict=True))
