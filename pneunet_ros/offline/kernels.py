"""Call every kernel once, with a recording and images from the virtual lab.

The data are simulated, because an installation may not have any recordings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import load_model
from pneunet_ros.files.scenario_file import load_lab, load_scenario
from pneunet_ros.lab.live import Film, LiveLab, SCENE
from pneunet_ros.lab.protocols import Strings
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import steady_inputs
from pneunet_ros.messages.builders import image
from pneunet_ros.messages.tracker import camera_info_message, decode_camera_info, decode_image
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.model.motion import Motion
from pneunet_ros.offline.replay import input_topics, steps, targets_topic
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.vision.tracker import Tracker, TrackerState

RECORDING = 'strings'  # name of its scenario
DURATION = 6.0  # s of the recording
MESSAGES = 200  # replayed messages
MOVING_MESSAGES = 10  # the same, for an arm with mass
FRAMES = 4  # of the recording, for a fit with an unused result
IMAGES = 14
PRESSURE = 2000.0  # Pa per image, after the images at rest
PERIOD_NS = 100_000_000  # between images


def call_kernels(on_progress: OnProgress = ignore_progress) -> None:
    """Call every kernel with typical arguments, to compile it."""
    tasks: tuple[tuple[str, Callable[[Path], None]], ...] = (
        ('virtual lab', play),
        ('estimator', estimate),
        ('tracker', track),
        ('fit', fit),
    )
    with TemporaryDirectory() as folder:
        for index, (name, task) in enumerate(tasks):
            on_progress(name, index, len(tasks))
            task(Path(folder))
    on_progress('', len(tasks), len(tasks))


def play(folder: Path) -> None:
    """Make a recording in the virtual lab."""
    scenario = load_scenario(share_path(f'scenarios/{RECORDING}.yaml'))
    recording = simulate(replace(scenario, protocol=Strings(duration=DURATION)))
    write_lab(recording, folder / f'{RECORDING}.mcap', overwrite=False, on_progress=lambda: None)


def estimate(folder: Path) -> None:
    """Replay a recording with targets; solve for a given tip."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    estimator = Estimator(arm=arm)
    recording = open_recording(folder / f'{RECORDING}.mcap')
    topics = input_topics(recording, estimator, {})
    every = steps(recording, estimator, topics, targets_topic(recording, estimator, {}))
    for _ in islice(every, MESSAGES):
        pass
    moving = Estimator(arm=replace(arm, motion=Motion()))
    for _ in islice(steps(recording, moving, topics), MOVING_MESSAGES):
        pass
    shape = solve(arm, 31e3, (0.175, 0.07))
    solve_tip(arm, 31e3, shape.tip[:2])
    BoundaryValueProblem(arm.rods(np.array([31e3])), (0.1, 0.1), 0.0).continue_in_load()


def track(folder: Path) -> None:
    """Track an arm that is at rest and then inflated."""
    lab = LiveLab(scenario=load_lab(share_path('scenarios/lab_arm.yaml')))
    film, random, now = Film(lab), np.random.default_rng(0), lab.begin()
    tracker = Tracker(
        arm=load_model(share_path('config/lab_arm.yaml')),
        settings=load_camera(share_path('config/lab_camera.yaml')),
    )
    info = camera_info_message(SCENE.camera, 1, 'camera', ROSBAGS_TYPES)
    state, _ = tracker.step(TrackerState(), decode_camera_info(info))
    for number in range(1, IMAGES + 1):
        inflated = PRESSURE * max(0, number - tracker.settings.rest_frames)
        now, shape = lab.shape(lab.step(now, 1e-9 * number * PERIOD_NS, inflated))
        info = camera_info_message(SCENE.camera, number * PERIOD_NS, 'camera', ROSBAGS_TYPES)
        picture = image(film.image(shape, random), info.header, ROSBAGS_TYPES)
        state, _ = tracker.step(state, decode_image(picture))


def fit(folder: Path) -> None:
    """Solve the frames of a recording and linearize, as every fit does."""
    arm = load_model(share_path('config/lab_arm.yaml'))
    run, _ = read_run(folder / f'{RECORDING}.mcap', arm.target_arclength.size)
    run = run.thin(FRAMES)
    inputs = steady_inputs(arm, run)
    model = ForwardModel(arm.target_arclength, run.points)
    model.solve(arm, inputs)
    model.load_jacobian(arm, inputs)
