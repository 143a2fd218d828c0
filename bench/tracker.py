"""Accuracy, error calibration and speed of the tracker, on rendered images with known truth.

    python bench/tracker.py [--json] [--frames N] [--rounds N] [--endless N]

Centers against the Cramér-Rao bound; identity of targets among things that are none, half hidden
by hands and bars; speed against the textbook pipeline (undistort the image, threshold, label,
optimal assignment, scikit-learn's Gaussian process), both in turn on the same frames; memory over
many frames; curvature against the usual smoothers (`bench/centerline.py` alone tells more).
`bench/tracker_live.py` is about the node.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import itertools
import json
import os
from pathlib import Path
import platform
import statistics
import sys
import time
import warnings

from centerline import curvature_errors
import cv2
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.files.json_text import plain
from pneunet_ros.lab.pictures.lens import overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Dots, FrameState, Scene
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.dots.blobs import find_blobs
from pneunet_ros.vision.settings import VISION
from pneunet_ros.vision.tracker import Tracker, TrackerState
from rich.console import Console
from rich.progress import track
from scipy.optimize import linear_sum_assignment
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.camera_images import as_image
from support.center_bound import center_bound
from support.rendered_frames import Score, View

RADII, NOISES = (3.0, 4.0, 5.0, 8.0), (2.0, 4.0, 8.0)
WANTED = {3.0: 2.0, 4.0: 2.0, 5.0: 2.0, 8.0: 4.0}  # error of a center over the bound, at most
SIZES = ((640, 480), (1920, 1080))
BACKGROUND, WHITE, BLUR = 40.0, 210.0, 0.7
MOVING = 100  # frames of a view after its rest, in which things come before the arm
LOST_EVERY = 29  # frames, after which the tracker must find the row from nothing


def center_errors(images: int) -> list[dict[str, float]]:
    """Error of centers over the bound, and over what the detection says of it itself."""
    rows = []
    settings = CameraSettings()
    for radius, noise in itertools.product(RADII, NOISES):
        camera = overhead_camera(
            width=640, height=480, focal_px=640.0, scale=1e-4, middle=(0.0, 0.0)
        )
        scene = Scene(camera=camera, background=BACKGROUND, texture=0.0, noise=noise, blur=BLUR)
        renderer = Renderer(scene)
        rng = np.random.default_rng(int(100 * radius + noise))
        off, std = [], []
        for number in range(images):
            grid = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-4, 5)), axis=-1)
            places = 45e-4 * grid.reshape(-1, 2) + rng.uniform(-5e-5, 5e-5, (117, 2))
            dots = Dots(x=places[:, 0], y=places[:, 1], radius=radius * 1e-4, grey=WHITE)
            grey, truth = renderer.render(FrameState(dots=dots), rng)
            image = as_image(grey, stamp_ns=number + 1)
            areas = find_blobs(image, VISION.appearance(settings))
            apart_u = areas.u[None] - truth.centroid_u[:, None]
            apart_v = areas.v[None] - truth.centroid_v[:, None]
            nearest = np.hypot(apart_u, apart_v).argmin(axis=1)
            row = np.arange(len(nearest))
            off += [apart_u[row, nearest], apart_v[row, nearest]]
            std += [areas.std[nearest]] * 2
        error, claimed = np.concatenate(off), np.concatenate(std)
        bound = center_bound(radius, noise, amplitude=WHITE - BACKGROUND, blur=BLUR)
        rms = float(np.sqrt(np.mean(error**2)))
        rows.append({
            'radius_px': radius,
            'noise': noise,
            'rms_px': rms,
            'bound_px': bound,
            'over_bound': rms / bound,
            'wanted': WANTED[radius],
            'over_claimed': float(np.sqrt(np.mean((error / claimed) ** 2))),
        })  # fmt: skip
    return rows


def identity(arm, frames: int, shown: bool) -> dict[str, float]:
    """Who is who in rendered frames of different views, after the arm has been at rest."""
    score = Score()
    unexplained = 0
    resting = CameraSettings().rest_frames - 1
    views = range(-(-frames // MOVING))
    for seed in track(views, 'identity', disable=not shown, transient=True):
        view = View(arm, seed, resting + MOVING)
        clamp_pixel = view.clamp_pixel if seed % 2 else None
        tracker = Tracker(arm, CameraSettings(clamp_pixel=clamp_pixel))
        state, _ = tracker.step(TrackerState(), view.lens)
        for number, (image, truth) in enumerate(view):
            if number % LOST_EVERY == LOST_EVERY - 1:
                state = replace(state, row=None)
            state, tracking = tracker.step(state, image)
            if number >= resting:
                unexplained += bool(tracking.reason)
                score.count(tracking.sightings, truth)
    return {
        'frames': score.frames,
        'visible': score.visible,
        'found_share': score.found / score.visible,
        'false': score.false,
        'swapped': score.swapped,
        'unexplained_frames': unexplained,
        'rms_px': score.rms_px,
    }


class Textbook:
    """Undistort the image, threshold, label, assign, scale, and fit two Gaussian processes."""

    def __init__(self, lens, arm, start: np.ndarray, meters_per_pixel: float) -> None:
        self.matrix, self.distortion = lens.matrix, lens.distortion
        self.last, self.scale = start, meters_per_pixel
        self.arclength = arm.target_arclength[:, None]
        self.stations = np.linspace(0.0, arm.target_arclength[-1], 57)
        # The least that a textbook would take, and it goes on from what the last frame taught it.
        self.process = GaussianProcessRegressor(RBF(0.6) + WhiteKernel(1e-4), normalize_y=True)

    def step(self, grey: np.ndarray) -> np.ndarray:
        """Return the curvature at the stations."""
        image = cv2.undistort(grey, self.matrix, self.distortion)
        _, white = cv2.threshold(image, 130, 255, cv2.THRESH_BINARY)
        _, _, stats, centers = cv2.connectedComponentsWithStats(white)
        area = stats[:, cv2.CC_STAT_AREA]
        centers = centers[(area >= 12) & (area <= 4000)]
        apart = np.hypot(*(self.last[:, None] - centers[None]).transpose(2, 0, 1))
        rows, columns = linear_sum_assignment(apart)
        found = self.last.copy()
        found[rows] = centers[columns]
        self.last = found
        points = (found - found[0]) * self.scale / 0.11
        self.process.fit(self.arclength / 0.11, points)
        self.process.kernel = self.process.kernel_
        curve = self.process.predict(self.stations[:, None] / 0.11)
        first = np.gradient(curve, self.stations, axis=0)
        second = np.gradient(first, self.stations, axis=0)
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        return cross / np.hypot(*first.T) ** 3


def speed(arm, size: tuple[int, int], rounds: int) -> dict[str, float]:
    """Seconds of CPU per frame of the tracker, following and searching, and of the textbook's."""
    view = View(arm, 3, 40, size=size, hidden=False)
    frames = list(view)
    tracker = Tracker(arm, CameraSettings(clamp_pixel=view.clamp_pixel))
    state, _ = tracker.step(TrackerState(), view.lens)
    for image, _ in frames[:10]:
        state, tracking = tracker.step(state, image)
    assert not tracking.reason, tracking.sentence
    truth = frames[9][1]
    start = cv2.undistortPoints(
        np.column_stack([truth.u, truth.v])[:, None],
        view.lens.matrix,
        view.lens.distortion,
        P=view.lens.matrix,
    )[:, 0]
    length = float(np.hypot(*np.diff(start, axis=0).T).sum())
    after = [image for image, _ in frames[10:]]
    greys = [np.ascontiguousarray(image.grey()) for image in after]
    ratios: dict[str, list[float]] = {'following': [], 'searching': []}
    times: dict[str, list[float]] = {'following': [], 'searching': [], 'textbook': []}

    def follow() -> None:
        now = state
        for image in after:
            now, seen = tracker.step(now, replace(image))  # which remembers nothing made of it
            assert not seen.reason, seen.sentence

    def search() -> None:
        now = state
        for image in after:
            now, seen = tracker.step(replace(now, row=None), replace(image))
            assert not seen.reason, seen.sentence

    def textbook() -> None:
        pipeline = Textbook(view.lens, arm, start, 0.11 / length)
        for grey in greys[:6]:
            pipeline.step(grey)

    follow(), search(), textbook()
    for _ in range(rounds):
        for name, call, count in (
            ('following', follow, len(after)),
            ('textbook', textbook, 6),
            ('searching', search, len(after)),
        ):
            begun = time.process_time()
            call()
            times[name].append((time.process_time() - begun) / count)
        for name, ratio in ratios.items():
            ratio.append(times['textbook'][-1] / times[name][-1])
    middle = {f'{name}_us': 1e6 * statistics.median(values) for name, values in times.items()}
    return middle | {f'{name}_ratio': statistics.median(it) for name, it in ratios.items()}


def memory(arm, frames: int, shown: bool) -> dict[str, float]:
    """Resident memory after a tenth of the frames, and after all of them."""
    view = View(arm, 5, 70)
    images = [image for image, _ in view]
    tracker = Tracker(arm, CameraSettings(clamp_pixel=view.clamp_pixel))
    state, _ = tracker.step(TrackerState(), view.lens)
    for image in images[:7]:
        state, _ = tracker.step(state, image)
    there_and_back = [*images[7:], *images[-2:7:-1]]
    after: dict[int, float] = {}
    tenth = max(frames // 10, 1)
    for number in track(range(frames), 'memory', disable=not shown, transient=True):
        image = there_and_back[number % len(there_and_back)]
        state, _ = tracker.step(state, replace(image, stamp_ns=(number + 8) * 33_333_333))
        if number + 1 in (tenth, frames):
            after[number + 1] = resident_megabytes()
    return {
        'frames': frames,
        'explained_share': (state.explained - 3) / frames,
        'after_a_tenth_mb': after[tenth],
        'after_all_mb': after[frames],
    }


def resident_megabytes() -> float:
    """Memory of this process (Linux)."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def show(result: dict) -> None:
    """Print for people."""
    console = Console(highlight=False)
    console.print('centers: error over the Cramér-Rao bound (wanted), over its own claim')
    for row in result['centers']:
        console.print(
            f'  radius {row["radius_px"]:.0f} px, noise {row["noise"]:.0f}: '
            f'{row["rms_px"]:.4f} px, {row["over_bound"]:.2f} x bound ({row["wanted"]:.0f}), '
            f'{row["over_claimed"]:.2f} x claim'
        )
    who = result['identity']
    console.print(
        f'identity: {who["frames"]} frames, {who["found_share"]:.2%} of {who["visible"]} visible '
        f'targets found (99.5 %), {who["false"]} false (0), {who["swapped"]} swapped (0), '
        f'{who["unexplained_frames"]} frames unexplained, {who["rms_px"]:.3f} px'
    )
    for size, row in result['speed'].items():
        console.print(
            f'speed {size}: following {row["following_us"]:.0f} us (8000 us), '
            f'{row["following_ratio"]:.0f} x textbook; '
            f'searching {row["searching_us"]:.0f} us, {row["searching_ratio"]:.1f} x; '
            f'textbook {row["textbook_us"]:.0f} us'
        )
    flat = result['memory']
    console.print(
        f'memory: {flat["after_a_tenth_mb"]:.1f} MB after {flat["frames"] // 10} frames, '
        f'{flat["after_all_mb"]:.1f} MB after {flat["frames"]} '
        f'({flat["explained_share"]:.1%} explained)'
    )
    console.print('curvature: see bench/centerline.py')


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument(
        '--frames',
        type=int,
        default=2000,
        help='frames for identity, 100 of a view (default: 2000)',
    )
    command.add_argument('--rounds', type=int, default=7, help='rounds for speed (default: 7)')
    command.add_argument(
        '--endless', type=int, default=100_000, help='frames for memory (default: 100000)'
    )
    arguments = command.parse_args()
    warnings.simplefilter('ignore', ConvergenceWarning)  # of the textbook's Gaussian process
    shown = not arguments.json
    arm = load_model(share_path('config/paper_arm.yaml'))
    result = {
        'bench': 'tracker',
        'machine': platform.machine(),
        'python': platform.python_version(),
        'opencv': cv2.__version__,
        'speed': {f'{w}x{h}': speed(arm, (w, h), arguments.rounds) for w, h in SIZES},
        'centers': center_errors(12),
        'identity': identity(arm, arguments.frames, shown),
        'memory': memory(arm, arguments.endless, shown),
        'curvature': curvature_errors(arm, 5),
    }
    if arguments.json:
        print(json.dumps(plain(result)))
    else:
        show(result)


if __name__ == '__main__':
    main()
