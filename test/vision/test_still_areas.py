"""What stays in the picture while the arm moves is background: the row that rested before it."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.image import Image
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings
from pneunet_ros.vision.camera.working_plane import Plane
from pneunet_ros.vision.dots.blobs import Blobs
from pneunet_ros.vision.dots.centroid import AREA, BLUR, COLUMNS, MAJOR, MINOR, STD
from pneunet_ros.vision.rest_plane import row_at_rest
from pneunet_ros.vision.rows.row_search_at_rest import search_moved_areas
from pneunet_ros.vision.rows.view import View
from pneunet_ros.vision.settings import VISION
from pneunet_ros.vision.still_areas import is_moved, StillAreas
import pytest

NOISE, WANTED = 0.02, 5  # px, frames
ROW = np.column_stack([np.linspace(200.0, 1000.0, 6), np.full(6, 300.0)])
OTHER = np.array([30.0, 200.0])  # px, to a row that stays
FOCAL, MIDDLE = 1000.0, np.array([640.0, 360.0])
LENS = Lens(
    width=1280,
    height=720,
    model='plumb_bob',
    matrix=np.array([[FOCAL, 0.0, MIDDLE[0]], [0.0, FOCAL, MIDDLE[1]], [0.0, 0.0, 1.0]]),
    distortion=np.zeros(5),
)


def blobs(centers, rng):
    """Return areas alike, seen with noise."""
    table = np.full((COLUMNS, len(centers)), 0.5)
    table[:2] = centers.T + NOISE * rng.standard_normal((2, len(centers)))
    table[[STD, AREA, MAJOR, MINOR, BLUR]] = np.array([[NOISE, 80.0, 10.0, 10.0, 1.0]]).T
    return Blobs(table)


def look(targets=6):
    image = Image(
        stamp_ns=1, frame_id='camera', width=1280, height=720, step=1280, encoding='mono8',
        data=np.zeros(1280 * 720, np.uint8),
    )  # fmt: skip
    return View(
        image=image,
        lens=LENS,
        plane=Plane(base_from_normalized=np.eye(3)),
        arclength=np.linspace(0.0, 0.11, targets),
        clamp_angle=0.0,
        settings=CameraSettings(),
        vision=VISION,
    )


def crowd(rng, dots=400):
    """Return places all over the picture, and another row that does not move."""
    return np.vstack([rng.uniform([20.0, 20.0], [1260.0, 700.0], (dots, 2)), ROW + OTHER])


def seen_over(frames, moving, missed=0.0):
    """Return the areas of a film in which the row bends after the rest, if it does."""
    rng = np.random.default_rng(5)
    still, background = StillAreas(), crowd(rng)
    for frame in range(frames):
        bent = ROW.copy()
        if moving and frame >= WANTED:
            bent[:, 1] += 2.0 * (frame - WANTED + 1.0) * np.linspace(0.0, 1.0, 6) ** 2
        places = np.vstack([bent, background])
        shown = places[rng.uniform(size=len(places)) >= missed]
        still = still.with_frame(blobs(shown, rng), WANTED)
    return still


def test_what_moves_on_is_forgotten_and_what_rested_is_not():
    still = seen_over(2 * WANTED, moving=True)
    rested = still.only(still.seen >= WANTED)
    gone = rested.centers[rested.unseen >= WANTED]
    assert gone[np.argsort(gone[:, 0])] == pytest.approx(ROW[2:], abs=4.0 * NOISE)
    # One further off than noise would say, and the places that it passes, last no longer.
    assert len(seen_over(40, moving=True).seen) < 1.1 * (406 + 6)


def test_the_row_that_moved_is_found_among_many():
    view, still = look(), seen_over(2 * WANTED, moving=True)
    place = search_moved_areas(view, still, WANTED)
    assert place is not None
    assert place.frames >= WANTED
    pixels, seen = FOCAL * place.points + MIDDLE, place.seen > 0
    assert pixels[seen] == pytest.approx(ROW[seen], abs=4.0 * NOISE)
    assert seen[[0, 2, 3, 4, 5]].all()  # what stays is as bad as missing; the ends must be seen
    # No single frame says which row it is.
    points = view.lens.undistort(still.centers)
    alone = row_at_rest(
        points, still.centers, still.area, view.arclength, None, 0.02, VISION, still.shapes
    )
    assert getattr(alone, 'reason', '') == 'several_rows'


def test_nothing_is_decided_while_nothing_moves():
    assert search_moved_areas(look(), seen_over(3 * WANTED, moving=False), WANTED) is None
    flickering = seen_over(6 * WANTED, moving=False, missed=0.3)
    assert search_moved_areas(look(), flickering, WANTED) is None


def test_a_row_has_moved_where_nearly_all_of_it_has_gone():
    gone = np.zeros(300, np.bool_)
    gone[:5] = True
    assert is_moved(gone, np.arange(6), 0.01)
    assert not is_moved(gone, np.arange(3, 9), 0.01)
    assert not is_moved(np.ones(300, np.bool_), np.arange(6), 0.01)
    assert not is_moved(np.zeros(300, np.bool_), np.arange(6), 0.01)
