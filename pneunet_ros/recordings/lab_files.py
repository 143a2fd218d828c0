"""Recordings of the virtual lab as files: sensor messages as MCAP, ground truth as npz."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
import json
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import LARGEST
from pneunet_ros.core.errors import PneunetError, RecordingError, RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.paths import sibling_path
from pneunet_ros.estimation.shape_error import Centerlines, ShapeSeries, Tips
from pneunet_ros.files.atomic import all_or_none, atomic_output
from pneunet_ros.files.npz import ArchiveError, Declared, read_arrays
from pneunet_ros.files.yaml_file import one_line
from pneunet_ros.lab.lab_recording import LabMemory, LabRecording
from pneunet_ros.lab.scenario import describe
from pneunet_ros.messages.base_frames import imu_message
from pneunet_ros.messages.readings import BASE_IMU, END_WRENCH, PRESSURE, TARGETS, targets_message
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording

NAMESPACE = '/pneunet'
PRESSURE_FRAME = 'pressure_sensor'
TRANSPORT_NS = 1_000_000  # from sensor to recorder
TRACKING_NS = 20_000_000  # from exposure to recorder, including the tracker

FRAMES = ('frames', 'stations')
TRUTH = {
    'stamp_ns': Declared(kind='integer', axes=('frames',), increasing=True),
    'arclength': Declared(axes=('stations',), increasing=True),
    **{name: Declared(axes=FRAMES) for name in ('x', 'y', 'theta')},
    'scenario': Declared(kind='text', required=False),
}
MEMORY = {'memory': Declared(kind='text')}
# Errors while reading numbers from a text that is not a memory of the lab.
NO_MEMORY = (
    OSError,
    ArchiveError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RecursionError,
)

Message = tuple[int, str, Any]  # log time, topic, message


def truth_file(path: Path) -> Path:
    """Return the path of the truth of a recording: x.truth.npz for x.mcap or a folder x.

    RequestError for a path without a name, such as `.`.
    """
    return sibling_path(path, f'{path.name.removesuffix(".mcap")}.truth.npz')


def write_lab(
    recording: LabRecording,
    path: Path,
    *,
    overwrite: bool,
    on_progress: Callable[[], None],
    inputs: Sequence[Path] = (),
) -> Path:
    """Write a recording and, in a separate file, its truth; returns the path of the truth.

    Both appear only when both are complete. `on_progress` is called after every message. inputs:
    files being read, which are never replaced. Raises RecordingError like `write_recording`.
    """
    truth = truth_file(path)
    with (
        all_or_none(),
        atomic_output(truth, overwrite=overwrite, inputs=inputs) as temporary,
        write_recording(path, overwrite=overwrite, inputs=inputs) as writer,
    ):
        np.savez_compressed(temporary, allow_pickle=False, **truth_arrays(recording))
        topics = {
            sensor.name: writer.add(f'{NAMESPACE}/{sensor.name}', sensor.type)
            for sensor, count in (
                (PRESSURE, 1),
                (END_WRENCH, recording.loaded),
                (TARGETS, 1),
                (BASE_IMU, recording.imu_stamp_ns.size),
            )
            if count
        }
        for log_time, name, message in messages(recording):
            writer.write(topics[name], log_time, message)
            on_progress()
    return truth


def message_count(recording: LabRecording) -> int:
    """Count the messages of a recording."""
    stamps = (
        recording.reading_stamp_ns,
        recording.wrench_stamp_ns,
        recording.stamp_ns,
        recording.imu_stamp_ns,
    )
    return sum(item.size for item in stamps)


def messages(recording: LabRecording) -> Iterator[Message]:
    """Yield the messages of a recording in order of log time; at equal times the wrench first."""
    loads = np.column_stack([recording.wrench_force, recording.wrench_moment])

    def wrench(stamp_ns: int, index: int) -> Any:
        return END_WRENCH.message(stamp_ns, loads[index], BASE_FRAME, ROSBAGS_TYPES)

    def pressure(stamp_ns: int, index: int) -> Any:
        row = recording.pressure[index : index + 1]
        return PRESSURE.message(stamp_ns, row, PRESSURE_FRAME, ROSBAGS_TYPES)

    def targets(stamp_ns: int, index: int) -> Any:
        x, y, std = recording.x[index], recording.y[index], recording.scenario.noise.target_std
        # The tracker states the white part of its noise.
        return targets_message(stamp_ns, x, y, BASE_FRAME, ROSBAGS_TYPES, std)

    def imu(stamp_ns: int, index: int) -> Any:
        row, std = recording.imu[index], recording.scenario.noise.imu_std
        return imu_message(stamp_ns, row, BASE_FRAME, ROSBAGS_TYPES, std)

    sources = (
        (BASE_IMU, recording.imu_stamp_ns, TRANSPORT_NS, imu),
        (END_WRENCH, recording.wrench_stamp_ns, TRANSPORT_NS, wrench),
        (PRESSURE, recording.reading_stamp_ns, TRANSPORT_NS, pressure),
        (TARGETS, recording.stamp_ns, TRACKING_NS, targets),
    )
    order = [
        (stamp_ns + delay, rank, index, stamp_ns)
        for rank, (_, stamps, delay, _) in enumerate(sources)
        for index, stamp_ns in enumerate(stamps.tolist())
    ]
    for log_time, rank, index, stamp_ns in sorted(order):
        sensor, _, _, build = sources[rank]
        yield log_time, sensor.name, build(stamp_ns, index)


def truth_arrays(recording: LabRecording) -> dict[str, Any]:
    """Return the content of the truth file: arrays of the truth, scenario and memory as JSON.

    For an arm with mass it also has the arrays of `MotionTruth`.
    """
    truth, memory, motion = recording.truth, recording.memory, recording.motion
    remembered = {'time': memory.time, 'pressure': memory.pressure, 'past': dict(memory.past)}
    return {
        'stamp_ns': recording.stamp_ns,
        **{item.name: getattr(truth, item.name) for item in fields(truth)},
        **(
            {}
            if motion is None
            else {item.name: getattr(motion, item.name) for item in fields(motion)}
        ),
        'scenario': np.array(json.dumps(describe(recording.scenario))),
        'memory': np.array(json.dumps(remembered)),
    }


def read_truth(path: Path) -> ShapeSeries:
    """Return the true shapes of a recording of the lab; RecordingError if it is not a truth.

    The stations of a truth from another source, which has no scenario, may end before the tip.
    """
    try:
        arrays = read_arrays(path, TRUTH)
        points = np.stack([arrays['x'], arrays['y']], axis=1)
        stamp_ns, arclength, heading = (
            arrays[name] for name in ('stamp_ns', 'arclength', 'theta')
        )
        if not points.size:
            raise ArchiveError('it contains no frame', reason='no_frames')
        return ShapeSeries(
            name=str(path),
            centerlines=Centerlines(
                topic='truth', stamp_ns=stamp_ns, arclength=arclength, points=points
            ),
            tips=Tips(
                topic='truth', stamp_ns=stamp_ns, place=points[:, :, -1], heading=heading[:, -1]
            ),
            frame=BASE_FRAME,
            exact=True,
            whole='scenario' in arrays,
        )
    except (OSError, PneunetError) as error:
        raise RecordingError(
            f'{path} is not a ground truth, which is an .npz with stamp_ns (frames,), arclength '
            '(stations,) m, and x, y, theta (frames, stations), as `pneunet simulate` writes it '
            f'({one_line(error)})',
            reason='no_truth',
        ) from None


def memory_after(path: Path) -> LabMemory:
    """Return the memory of the arm after a recording of the lab, from its truth.

    Raises RequestError if there is no such truth.
    """
    truth = truth_file(path)
    try:
        memory = json.loads(read_arrays(truth, MEMORY)['memory'])
        histories = {
            name: tuple(_number(value) for value in values)
            for name, values in memory['past'].items()
        }
        time, pressure = _number(memory['time']), _number(memory['pressure'])
        return LabMemory(time=time, pressure=pressure, past=histories)
    except NO_MEMORY as error:
        raise RequestError(
            f'--after {path}: {truth} is not the ground truth of a lab recording '
            f'({one_line(error)}); give a recording written by `pneunet simulate`',
            reason='no_truth',
        ) from None


def _number(value: Any) -> float:
    """Return a number of the truth; ValueError if it is not one."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise ValueError(f'{str(value)[:40]!r} is not a number')
    return float(value)
