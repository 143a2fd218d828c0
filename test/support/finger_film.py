"""A film and a table of the virtual lab: what a camera and a logger would have kept of a finger.

The camera starts when it is started, and counts from its first frame; so does the logger.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.pictures.lens import Camera, overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Body, Dots, FrameState, Scene

RADIUS = 0.0015  # m, of a dot
CAMERA = overhead_camera(
    width=640, height=480, focal_px=600.0, scale=0.00026, middle=(0.055, 0.03)
)
BODY_EVERY = 4  # stations of the outline
PSI = 6894.757  # Pa


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """How film and table are kept.

    camera_first: seconds by which the camera is started before the logger, negative: after it.
    hidden: targets that have come off. wide: how many times as large single dots are; beside (m):
    how far to the left of the neutral line all of them are, as on a side wall; stuck: every so
    manieth frame shows the one before again, as films do where frames were lost (0: none).
    frames: of the film at most.
    """

    camera: Camera = CAMERA
    camera_first: float = 0.0
    hidden: tuple[int, ...] = ()
    wide: tuple[tuple[int, float], ...] = ()
    beside: float = 0.0
    stuck: int = 0
    frames: int | None = None
    codec: str = 'mp4v'
    seed: int = 1


def write_film(recording: LabRecording, film: Path, bench: Bench) -> float:
    """Write the film of a recording; returns the delay (s) of `pneunet track`."""
    truth = recording.truth
    renderer = Renderer(Scene(camera=bench.camera))
    random = np.random.default_rng(bench.seed)
    skipped = max(0.0, -bench.camera_first)
    frames = np.flatnonzero(truth.time >= skipped)[: bench.frames]
    rate = 1.0 / float(np.median(np.diff(truth.time)))
    radius = np.full(truth.target_x.shape[1], RADIUS)
    radius[list(bench.hidden)] = 0.0
    for target, times in bench.wide:
        radius[target] *= times
    rest = truth.x[0] - truth.target_x[0][:, None], truth.y[0] - truth.target_y[0][:, None]
    nearest = np.argmin(np.hypot(*rest), axis=1)
    camera = bench.camera
    writer = cv2.VideoWriter(
        str(film),
        cv2.CAP_FFMPEG,
        cv2.VideoWriter.fourcc(*bench.codec),
        rate,
        (camera.width, camera.height),
    )
    for frame in frames.tolist():
        body = Body(
            x=truth.x[frame, ::BODY_EVERY],
            y=truth.y[frame, ::BODY_EVERY],
            theta=truth.theta[frame, ::BODY_EVERY],
        )
        theta = truth.theta[frame, nearest]
        dots = Dots(
            x=truth.target_x[frame] - bench.beside * np.sin(theta),
            y=truth.target_y[frame] + bench.beside * np.cos(theta),
            radius=radius,
        )
        if frame == frames[0] or not bench.stuck or frame % bench.stuck:
            grey, _ = renderer.render(FrameState(dots=dots, body=body), random)
        writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    return float(reading_times(recording, bench)[0] - truth.time[frames[0]])


def reading_times(recording: LabRecording, bench: Bench) -> Array:
    """Return when the logger read the pressure, (readings,) s since the beginning."""
    stamps = recording.reading_stamp_ns
    times = (stamps - stamps[0]) * 1e-9
    return times[times >= max(0.0, bench.camera_first)]


def write_table(recording: LabRecording, table: Path, bench: Bench, *, forces: bool) -> None:
    """Write the readings as a logger exports them: semicolons, decimal commas, time from zero."""
    times = reading_times(recording, bench)
    pressure = recording.pressure[-times.size :]
    columns = {'Time (s)': times - times[0], 'Pressure [kPa]': 1e-3 * pressure}
    if forces:
        wrench_time = (recording.wrench_stamp_ns - recording.reading_stamp_ns[0]) * 1e-9
        for name, force in zip(('X', 'Y'), recording.wrench_force.T, strict=True):
            columns[f'Force {name} [N]'] = np.interp(times, wrench_time, force)
    lines = [';'.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(';'.join(f'{value:.5f}'.replace('.', ',') for value in row))
    table.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def write_arduino_table(recording: LabRecording, table: Path, bench: Bench) -> None:
    """Write what a sketch prints: milliseconds since its start, and psi with two decimals."""
    times = reading_times(recording, bench)
    pressure = recording.pressure[-times.size :] / PSI
    rows = zip(np.rint(1e3 * (times - times[0])).astype(int).tolist(), pressure, strict=True)
    lines = ['millis,psi', *(f'{milliseconds},{value:.2f}' for milliseconds, value in rows)]
    table.write_text('\n'.join(lines) + '\n', encoding='utf-8')
