"""Small valid inputs of every kind, as the basis of hostile inputs."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from importlib import import_module
import io
import math
from pathlib import Path
import shutil

import cv2
from mcap.writer import CompressionType, Writer
import numpy as np
from pneunet_ros.calibration.parameters import PosteriorState
from pneunet_ros.cli.main import main, parser, VERBS
from pneunet_ros.core.image import Image
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import seconds_between
from pneunet_ros.offline.calibration_files import save_knowledge
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.recording import open_recording

DRAWING = ('pneunet_ros.reports.tracking.preview', 'matplotlib.backends.backend_agg')
CAMERA_DEMO = share_path('bags/camera_demo')
IMAGES = 7  # enough for a rest of five
KNOWLEDGE = PosteriorState(
    pressure=np.array([0.0, 3e4, 6e4]),
    arclength=np.array([0.0, 0.5, 1.0]),
    kind='piecewise_linear',
    stiffness=2e-4,
    low=0.0,
    high=6e4,
    values=np.arange(2.0),
    information=np.eye(2),
    placement=np.arange(2.0),
    covariance=np.eye(4),
)
SCENARIO = """\
schema_version: 1
name: hostile
seed: 3
arm:
  name: arm
  length: 0.112
  weight: 0.17
  targets: [0.0, 0.05, 0.11]
  intrinsic_curvature: {pressure: [0.0, 6e4], modes: [[0.0, 0.0], [25.0, -7.0]]}
  moment_law: {pressure: [0.0, 6e4], split: [0.1, 0.2], rigidity: [[0.08, 0.04], [0.09, 0.05]]}
effects: {gravity: {weight_y: -1.5}, creep: {amplitude: 0.05, time_constant: 2.0}}
protocol: {kind: random_mix, duration: 2.0, rest: 0.2, ramp: 0.1}
noise: {pressure_std: 60.0}
rates: {pressure: 20.0, wrench: 20.0, frames: 5.0}
detail: {elements: 32.0, stations: 9.0}
"""
FREE = 'kind: staircase, duration: 12.0, rest: 0.5, ramp: 0.2'
CAMERA_INFO = """\
image_width: {width}
image_height: {height}
camera_name: camera
camera_matrix: {{rows: 3, cols: 3, data: [500.0, 0, 320, 0, 510.0, 240, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [-0.03, 0.01, 0.001, -0.001, 0.0]}}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Corpus:
    """A folder with one whole input of every kind, and another in which cases are tried."""

    folder: Path
    trials: Path

    def options(self, verb: str) -> list[str]:
        """Return all options of a verb."""
        (verbs,) = (action for action in parser([verb])._actions if action.dest == 'verb')
        actions = verbs.choices[verb]._actions  # type: ignore[index]
        return [option for action in actions for option in action.option_strings]

    def whole(self, name: str) -> Path:
        """Return the whole input of this name."""
        return self.folder / name


def make_corpus(folder: Path) -> Corpus:
    """Make the whole inputs, by the verbs that make them."""
    for module in (*(verb.module for verb in VERBS), *DRAWING):
        import_module(module)  # once here, and not in every forked process
    whole = folder / 'whole'
    shutil.rmtree(whole, ignore_errors=True)
    whole.mkdir(parents=True)
    (folder / 'trials').mkdir(exist_ok=True)
    shutil.copy(share_path('config/paper_arm.yaml'), whole / 'model.yaml')
    shutil.copy(share_path('config/camera.yaml'), whole / 'camera.yaml')
    (whole / 'scenario.yaml').write_text(SCENARIO)
    for name in ('rec.mcap', 'bag'):
        _run('simulate', whole / 'scenario.yaml', '--output', whole / name)
    _run('replay', whole / 'rec.mcap', '--output', whole / 'replayed.mcap')
    _run('export', whole / 'replayed.mcap', '--output', whole / 'table.csv')
    for kind in CompressionType:
        # Without checksums, as fast writers leave them out, damage reaches what reads messages.
        packed = {'compression': kind, 'chunk_size': 2000, 'enable_crcs': False}
        _rewrite(whole / 'rec.mcap', whole / f'{kind.name.lower()}.mcap', **packed)
    _rewrite(whole / 'rec.mcap', whole / 'loose.mcap', use_chunking=False, enable_crcs=False)
    _images(whole)
    # Kernels that a verb needs are compiled here, and not in the process whose time is taken.
    _run('track', whole / 'images', '--camera-info', 'none')
    _run('predict', '--pressure', '20000', '--tip', '0.08', '0.05')
    save_knowledge(KNOWLEDGE, whole / 'model.yaml', overwrite=False)
    _calibrated(whole)
    return Corpus(folder=whole, trials=folder / 'trials')


def _calibrated(whole: Path) -> None:
    """Write a recording of an unloaded arm and a calibration of it, with what it knows."""
    text = SCENARIO.replace('kind: random_mix, duration: 2.0, rest: 0.2, ramp: 0.1', FREE)
    (whole / 'free.yaml').write_text(text)
    _run('simulate', whole / 'free.yaml', '--output', whole / 'free.mcap')
    (whole / 'more.yaml').write_text(text.replace('seed: 3', 'seed: 5'))
    _run('simulate', whole / 'more.yaml', '--output', whole / 'more.mcap')
    sizes = '--length 0.112 --weight 0.17 --pressure 60kPa --dot 3mm --places 0 0.05 0.11'
    _run('new-arm', *sizes.split(), '--no-template', '--output', whole / 'arm.yaml')
    words = ('calibrate', '--unloaded', whole / 'free.mcap', '--arm', whole / 'arm.yaml')
    _run(*words, '--output', whole / 'known.yaml')


def _run(*words: object) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        code = main([*map(str, words), '--json'])
    if code == 2:
        raise SystemExit(f'a whole input could not be made by {words[0]}')


def _rewrite(source: Path, path: Path, *, seconds: float = math.inf, **options: object) -> None:
    """Write the first seconds of a recording again by mcap's own writer, as other programs do."""
    recording = open_recording(source)
    with path.open('wb') as stream:
        writer = Writer(stream, **options)  # type: ignore[arg-type]
        writer.start('ros2')
        channels = {}
        for topic in recording.topics:
            schema = writer.register_schema(topic.type, 'ros2msg', topic.definition.encode())
            channels[topic.name] = writer.register_channel(topic.name, 'cdr', schema)
        for name, log_time, raw in recording.raw_messages(list(channels)):
            if seconds_between(recording.start_ns, log_time) > seconds:
                break
            writer.add_message(channels[name], log_time, raw, log_time)
        writer.finish()


def _images(whole: Path) -> None:
    """Write a few frames of the shipped recording as pictures, a film and a recording."""
    (whole / 'images').mkdir()
    frames = []
    for item in open_images(CAMERA_DEMO, SourceRequest()).read(()):
        if isinstance(item.reading, Image):
            frames.append(item.reading.grey())
            if len(frames) == IMAGES:
                break
    height, width = frames[0].shape
    film = cv2.VideoWriter(
        str(whole / 'film.mp4'), cv2.VideoWriter.fourcc(*'mp4v'), 10.0, (width, height)
    )
    for index, grey in enumerate(frames):
        suffix = ('png', 'jpg', 'bmp', 'tiff')[index % 4]
        cv2.imwrite(str(whole / 'images' / f'{index}.{suffix}'), grey)
        film.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    film.release()
    rows = [f'{0.05 * row:.2f};{10.0 * (row % 3)};{0.01 * row:.2f}' for row in range(-20, 60)]
    (whole / 'readings.csv').write_text('\n'.join(['Time [s];Pressure (kPa);Force X [N]', *rows]))
    (whole / 'camera_info.yaml').write_text(CAMERA_INFO.format(width=width, height=height))
    _rewrite(CAMERA_DEMO, whole / 'camera.mcap', seconds=0.7)
