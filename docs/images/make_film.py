"""Make the moving picture of the README: dots that are tracked, and the shape that is predicted.

The film is `bags/camera_demo`, which the virtual lab has rendered. Dots are where the tracker sees
targets; the line is where the rod model expects the arm, from the pressure alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import tempfile

import cv2
import numpy as np
from PIL import Image as Picture  # comes with matplotlib
from pneunet_ros import load_model, solve, Tracker
from pneunet_ros.cli.main import main as pneunet
from pneunet_ros.core.image import Image
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.offline.track import track_steps
from pneunet_ros.recordings.images.image_sources import open_images, SourceRequest
from pneunet_ros.vision.tracker import Tracking

FILM = Path(__file__).resolve().parent / 'film.webp'
RECORDING = share_path('bags/camera_demo')
EVERY, WIDTH, QUALITY = 3, 480, 40
DURATION = 100  # ms a frame: as it was filmed, at 30 Hz
WHITE, DOT, LINE = (255, 255, 255), (255, 170, 40), (60, 150, 255)  # blue, green, red
FONT = cv2.FONT_HERSHEY_DUPLEX


def pressures() -> tuple[np.ndarray, np.ndarray]:
    """Return the stamps (ns) and readings (Pa) of the pressure sensor."""
    with tempfile.TemporaryDirectory() as scratch:
        table = Path(scratch) / 'readings.npz'
        if pneunet(['export', str(RECORDING), '--output', str(table)]) != 0:
            raise SystemExit('the recording has no readings')
        columns = np.load(table)
        read = ~np.isnan(columns['pressure_pa'])
        return columns['stamp_ns'][read], columns['pressure_pa'][read]


def drawn_frames() -> Iterator[Picture.Image]:
    """Yield every third image with what was measured and predicted in it."""
    arm = load_model(share_path('config/paper_arm.yaml'))
    stamps, readings = pressures()
    stream = open_images(RECORDING, SourceRequest(camera_info=None, rate=None, topics={}))
    tracker = Tracker(arm=arm, settings=load_camera(share_path('config/camera.yaml')))
    frames = (step for step in track_steps(stream, tracker) if step.frame)
    for place, step in enumerate(frames):
        image, tracking, plane = step.item.reading, step.outcome, step.state.plane
        if place % EVERY or plane is None:
            continue
        if not isinstance(image, Image) or not isinstance(tracking, Tracking):
            continue
        pressure = float(np.interp(image.stamp_ns, stamps, readings))
        shape = solve(arm, pressure)
        inside = plane.normalized(np.column_stack([shape.x, shape.y]))
        seen = np.column_stack([tracking.sightings.u, tracking.sightings.v])
        yield drawn(image, step.state.lens.distort(inside), seen, pressure)


def drawn(image: Image, line: np.ndarray, dots: np.ndarray, pressure: float) -> Picture.Image:
    """Return one frame."""
    picture = cv2.cvtColor(image.grey(), cv2.COLOR_GRAY2BGR)
    points = np.round(16 * line[np.isfinite(line).all(axis=1)]).astype(np.int32)
    cv2.polylines(picture, [points], False, LINE, 3, cv2.LINE_AA, shift=4)
    for u, v in dots[np.isfinite(dots).all(axis=1)]:
        cv2.circle(picture, (round(16 * u), round(16 * v)), 16 * 5, DOT, 2, cv2.LINE_AA, shift=4)
    seen = int(np.isfinite(dots[:, 0]).sum())
    words = [
        (f'{abs(pressure) / 1000:.0f} kPa', WHITE),
        ('predicted from pressure', LINE),
        (f'measured: {seen} of {len(dots)} dots', DOT),
    ]
    for row, (text, color) in enumerate(words):
        cv2.putText(picture, text, (350, 30 + 28 * row), FONT, 0.7, color, 1, cv2.LINE_AA)
    height = round(picture.shape[0] * WIDTH / picture.shape[1])
    small = cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)
    return Picture.fromarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))


def main() -> None:
    """Draw all frames and keep them as one file."""
    first, *others = drawn_frames()
    options = {'duration': DURATION, 'loop': 0, 'quality': QUALITY, 'method': 6}
    first.save(FILM, save_all=True, append_images=others, **options)


if __name__ == '__main__':
    main()
