"""`pneunet track FILM --readings TABLE`: options, and joining frames with readings."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from pneunet_ros.cli.quantity_option import quantity_of, string_of
from pneunet_ros.cli.table_options import AUTO, table_request
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import as_weight
from pneunet_ros.estimation.clock_delay import ClockDelay
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.string import String
from pneunet_ros.offline.film import (
    check_no_forces,
    check_readings,
    delay_of,
    FilmedRun,
    join_clocks,
    with_end_load,
    with_string,
)
from pneunet_ros.recordings.images.image_stream import ImageStream
from pneunet_ros.tables.reading_table import ReadingTable
from pneunet_ros.tables.table_reader import read_table
from pneunet_ros.vision.tracker import Tracking

LARGEST_DELAY = 1e8  # s, three years: stamps have 64 bits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmReadings:
    """Options for the table of a film; delay (s), None to estimate it; string: at the tip."""

    path: Path
    table: ReadingTable
    sentences: tuple[str, ...]
    delay: float | None
    string: String | None = None


def film_readings(arguments: Namespace, stream: ImageStream) -> FilmReadings | None:
    """Return the options for the table, None without one; RequestError if it is unusable."""
    if arguments.readings is None:
        for option in ('delay', 'end_load', 'string', 'select', 'rename', 'offset', 'ignore'):
            if getattr(arguments, option):
                name = option.replace('_', '-')
                raise RequestError(f'--{name} needs --readings TABLE.csv', reason='missing')
        return None
    if stream.recording is not None:
        raise RequestError(
            f'{arguments.source} is a recording, and its topics already have stamps: --readings '
            'is only for videos and folders of images',
            reason='other_source',
        )
    if arguments.output is None:
        raise RequestError(
            '--readings needs --output OUT.mcap, to which frames and readings are written',
            reason='missing',
        )
    table, sentences = read_table(arguments.readings, table_request(arguments))
    check_readings(table, arguments.readings)
    if arguments.string is not None:
        check_no_forces(table, '--string')
        if arguments.end_load is not None:
            raise RequestError('give either --end-load or --string, not both', reason='exclusive')
    string = None if arguments.string is None else string_of('--string', arguments.string)
    if string is not None:
        sentences = (*sentences, f'--string pulls with {as_weight(string.tension)}')
    if arguments.end_load is not None:
        load = [quantity_of('--end-load', text, 'force') for text in arguments.end_load]
        table = with_end_load(table, *load)
        sentences = (*sentences, f'--end-load is {as_weight(math.hypot(*load))}')
    automatic = arguments.delay in (None, AUTO)
    return FilmReadings(
        path=arguments.readings,
        table=table,
        sentences=sentences,
        delay=None if automatic else quantity_of('--delay', arguments.delay, 'time'),
        string=string,
    )


def join_film_and_table(
    readings: FilmReadings, trackings: Sequence[Tracking], arm: Arm, rejected: Sequence[int]
) -> tuple[FilmedRun | None, dict[str, Any]]:
    """Return frames and readings on one clock (None if the delay is unknown), and a summary.

    rejected: stamps of unreadable frames. Raises RequestError if a given delay leaves no frame
    within the table.
    """
    found: ClockDelay | None = None
    delay = readings.delay
    if delay is not None and abs(delay) > LARGEST_DELAY:
        raise RequestError(
            f'--delay {delay:g} must lie between -{LARGEST_DELAY:g} and {LARGEST_DELAY:g} s',
            reason='out_of_bounds',
        )
    if not trackings:
        return None, summary_of(readings, None, None, 'no frame was processed')
    if delay is None:
        found = delay_of(trackings, readings.table)
        if found.trouble:
            return None, summary_of(readings, found, None, f'{found.trouble}; give --delay S')
        delay = found.delay
        trackings = [one for index, one in enumerate(trackings) if index not in found.repeated]
    run = join_clocks(trackings, readings.table, delay, rejected)
    if readings.string is not None:
        run = with_string(run, readings.string, arm)
    if not run.covered:
        raise RequestError(
            f'--delay {delay:g}: no frame of the film lies within the time range of '
            f'{readings.path}',
            reason='nothing_in_common',
        )
    sentence = found.sentence if found is not None else f'a delay of {delay:g} s was given'
    return run, summary_of(readings, found, run, sentence)


def summary_of(
    readings: FilmReadings, found: ClockDelay | None, run: FilmedRun | None, sentence: str
) -> dict[str, Any]:
    """Return the estimate of the delay for the summary."""
    known = found is not None and not found.trouble
    return {
        'readings': readings.path,
        'delay': found.delay if known and found is not None else readings.delay,
        'delay_std': found.std if known and found is not None else None,
        'delay_sentence': sentence,
        'frames_covered': 0 if run is None else run.covered,
        'frames_repeated': 0 if found is None else len(found.repeated),
    }
