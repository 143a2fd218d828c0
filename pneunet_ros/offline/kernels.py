"""Every kernel called once, on recordings that are shipped: so all are compiled before work."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import numpy as np
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.core.progress import OnProgress, say_nothing
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.files.model_file import load_model
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.batch import solve_many
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.model.inverse import solve_tip
from pneunet_ros.offline.replay import input_topics, steps, targets_topic
from pneunet_ros.offline.track import track_steps
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.image_sources import open_images, SourceRequest
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem
from pneunet_ros.vision.tracker import Tracker

FRAMES = 12  # of a recording, for a calibration that nobody reads
IMAGES = 30


def call_kernels(on_progress: OnProgress = say_nothing) -> None:
    """Call every kernel, each with what it is called with at work; nothing comes of it."""
    tasks: tuple[tuple[str, Callable[[], None]], ...] = (
        ('estimator', estimate),
        ('tracker', track),
        ('calibration', calibrate_roughly),
        ('virtual lab', play),
    )
    for place, (name, task) in enumerate(tasks):
        on_progress(name, place, len(tasks))
        task()
    on_progress('', len(tasks), len(tasks))


def estimate() -> None:
    """Replay a recording with targets; solve for a tip, and many at once."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    estimator = Estimator(arm=arm)
    recording = open_recording(share_path('bags/lab_day/heldout.mcap'))
    topics = input_topics(recording, estimator, {})
    for _ in steps(recording, estimator, topics, targets_topic(recording, estimator, {})):
        pass
    shape = solve(arm, 31e3, (0.175, 0.07))
    solve_tip(arm, 31e3, shape.tip[:2])
    BoundaryValueProblem(arm.rods(np.array([31e3])), (0.1, 0.1), 0.0).continue_in_load()
    pressures = np.linspace(0.0, 60e3, 8)
    solve_many(arm, pressures, np.full((8, 2), 0.05), start=shape)


def track() -> None:
    """Track the beginning of a recording of images."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    tracker = Tracker(arm=arm, settings=load_camera(share_path('config/camera.yaml')))
    stream = open_images(share_path('bags/camera_demo'), SourceRequest())
    for _ in islice(track_steps(stream, tracker), IMAGES):
        pass


def calibrate_roughly() -> None:
    """Calibrate an arm by a few frames, and fit the force at its tip."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    unloaded, loaded = (
        read_run(share_path(f'bags/lab_day/{name}.mcap'), arm.target_arclength.size)[0].thin(
            FRAMES
        )
        for name in ('unloaded', 'loaded')
    )
    found = calibrate([unloaded], [loaded], arm, compare=False)
    end_forces(found.arm, loaded)


def play() -> None:
    """Simulate a second of the virtual lab."""
    scenario = load_scenario(share_path('scenarios/strings.yaml'))
    simulate(scenario)
