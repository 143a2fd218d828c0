"""Options and readers of recordings, shared by `calibrate` and `diagnose`."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pneunet_ros.cli import verb
from pneunet_ros.cli.quantity_option import quantity_of, string_of
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.progress import reporting_to
from pneunet_ros.core.units import as_weight

if TYPE_CHECKING:
    from pneunet_ros.measurement.dataset import RecordingData
    from pneunet_ros.model.arm import Arm
    from pneunet_ros.model.uncertainty import SensorNoise
    from rich.progress import Progress

T = TypeVar('T')

STATIC = (
    '--static: every frame is treated as a steady state and its stamp is ignored; no noise is '
    'estimated from differences in time, and the arm is assumed to have settled in every frame'
)

NO_PULL = 'the pull of a thread over a pulley changes direction with the tip: use --string for it'


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiments:
    """Groups of recordings, with notes on them.

    left_out: sentences on readings that were excluded or reinterpreted; unloaded: the recordings
    without a load, with the reason.
    """

    groups: tuple[tuple[RecordingData, ...], ...]
    left_out: tuple[str, ...]
    unloaded: str
    static: bool

    @property
    def sentences(self) -> tuple[str, ...]:
        """All notes on the recordings."""
        return (*self.left_out, self.unloaded, *((STATIC,) if self.static else ()))

    @property
    def summary(self) -> dict[str, object]:
        """The notes for programs."""
        return {'left_out': self.left_out, 'unloaded': self.unloaded, 'static': self.static}


def add_experiments(parser: ArgumentParser) -> None:
    """Add the options that describe the recordings and their readings."""
    verb.add_static(parser)
    parser.add_argument(
        '--end-load',
        nargs=3,
        action='append',
        default=[],
        metavar=('REC', 'FX', 'FY'),
        help='a known constant end load, such as a weight hanging from the tip, of a recording '
        'without `end_wrench` (base frame; N, or with a unit, e.g. 20g); its standard '
        'deviation is force_std of the model; may be repeated',
    )
    parser.add_argument(
        '--string',
        nargs=4,
        action='append',
        default=[],
        metavar=('REC', 'TENSION', 'X', 'Y'),
        help='a known tension of a thread from the tip over a fixed eye or pulley at X, Y (base '
        'frame; m, or with a unit, e.g. 300mm); like --end-load; may be repeated',
    )
    verb.add_topics(parser)
    verb.add_settings(parser, verb.SENSOR_SETTINGS)


def read_experiments(
    groups: Sequence[Sequence[Path]], frame: Arm, arguments: Namespace, bar: Progress
) -> Experiments:
    """Read groups of recordings and decide which of them are unloaded.

    Unloaded recordings are those given by `--unloaded`; without this option, recordings without
    `end_wrench` and recordings in which every wrench is within the noise of the sensor.
    """
    from pneunet_ros.calibration.checks.preconditions import check_unloaded
    from pneunet_ros.measurement.string_load import with_string
    from pneunet_ros.measurement.tip_frame import in_base_frame
    from pneunet_ros.messages.readings import SENSORS
    from pneunet_ros.recordings.dataset_reader import read_run

    paths = list(itertools.chain(*groups))
    loads = by_recording('--end-load', arguments.end_load, paths, force_of)
    threads = by_recording('--string', arguments.string, paths, string_of)
    if shared := loads.keys() & threads.keys():
        raise RequestError(
            f'{shared.pop()} is given both to --end-load and to --string', reason='exclusive'
        )
    loads = {**loads, **{key: (one.tension, 0.0) for key, one in threads.items()}}
    named = {resolve_links(path) for path in arguments.unloaded}
    check_given(named, paths, '--unloaded')
    if shared := named & loads.keys():
        raise RequestError(
            f'{shared.pop()} is listed under --unloaded and also under --end-load or --string: '
            'remove it from one of them',
            reason='exclusive',
        )
    topics = verb.topics_of(arguments.topic, [sensor.name for sensor in SENSORS])
    left_out: list[str] = []
    unloaded: list[str] = []

    def read(path: Path) -> RecordingData:
        run, sentences = read_run(
            path, frame.target_arclength.size, topics, verb.settings_of(arguments), frame.gravity
        )
        left_out.extend(f'{path.name}: {sentence}' for sentence in sentences)
        run = replace(run, static=arguments.static)
        key = resolve_links(path)
        if key in loads:
            size = as_weight(math.hypot(*loads[key]))
            left_out.append(
                f'{path.name}: --string pulls with {size}'
                if key in threads
                else f'{path.name}: --end-load is a constant force of {size}; {NO_PULL}'
            )
            return with_known_load(run, loads[key])
        if key in named:
            check_unloaded(run, frame)
            why = 'given'
        else:
            why = '' if named else reason_unloaded(run, frame.sensors)
        if why or not run.loaded:
            unloaded.append(f'{path.name} ({why or "no end_wrench"})')
            return run.without_load()
        return run

    with reporting_to(verb.progress_of(bar, 'reading')):
        runs = tuple(tuple(read(path) for path in group) for group in groups)
    flat, notes = in_base_frame(list(itertools.chain(*runs)), frame)
    left_out += notes
    for index, path in enumerate(paths):
        if thread := threads.get(resolve_links(path)):
            flat[index], unseen = with_string(flat[index], frame, thread)
            if unseen:
                left_out.append(f'{path.name}: excluded {unseen} frames that do not show the tip')
    framed = iter(flat)
    runs = tuple(tuple(itertools.islice(framed, len(group))) for group in runs)
    return Experiments(
        groups=runs,
        left_out=tuple(left_out),
        unloaded=f'without a load: {", ".join(unloaded) or "none"}',
        static=arguments.static,
    )


def as_measured(frame: Arm, runs: Sequence[RecordingData]) -> Arm:
    """Return an arm with the mean of the measured directions of gravity, if there are any."""
    import numpy as np

    measured = [run.gravity for run in runs if run.gravity is not None]
    if not measured:
        return frame
    x, y = np.mean(np.concatenate(measured), axis=0).tolist()
    norm = max(math.hypot(x, y), 1.0)
    return replace(frame, gravity=replace(frame.gravity, x=x / norm, y=y / norm))


def reason_unloaded(run: RecordingData, noise: SensorNoise) -> str:
    """Return why a run counts as unloaded; empty if it is loaded."""
    if not run.loaded:
        return 'no end_wrench'
    if not run.is_idle(noise):
        return ''
    reach = run.idle_reach()
    return (
        f'every wrench is within {reach:.2g} sigma of the sensor noise, '
        f'{reach * noise.force_std:.2g} N and {reach * noise.moment_std:.2g} N m'
    )


def with_known_load(run: RecordingData, load: tuple[float, float]) -> RecordingData:
    """Return a run with its known load; RequestError if it contains a measured load."""
    if run.loaded:
        raise RequestError(
            f'--end-load or --string {run.name}: the recording contains end_wrench readings, and '
            'this option is for recordings without them (--no-wrench-required ignores the topic)',
            reason='exclusive',
        )
    return run.with_end_load(*load)


def by_recording(
    option: str,
    given: Sequence[Sequence[str]],
    paths: Sequence[Path],
    read: Callable[[str, Sequence[str]], T],
) -> dict[Path, T]:
    """Return the values of an option by recording; RequestError for an unknown recording."""
    values: dict[Path, T] = {}
    for name, *texts in given:
        key = resolve_links(name)
        check_given({key}, paths, option)
        if key in values:
            raise RequestError(f'{option} {name} is given twice', reason='given_twice')
        values[key] = read(f'{option} {name}', texts)
    return values


def force_of(option: str, texts: Sequence[str]) -> tuple[float, float]:
    """Return a force (N) from two texts; RequestError names the option."""
    force_x, force_y = (quantity_of(option, text, 'force') for text in texts)
    return force_x, force_y


def check_given(keys: set[Path], paths: Sequence[Path], option: str) -> None:
    """Reject an option for a recording that is not among the inputs."""
    for key in sorted(keys - {resolve_links(path) for path in paths}):
        raise RequestError(
            f'{option} {key.name}: this recording is not among the inputs: add it',
            reason='not_found',
        )
