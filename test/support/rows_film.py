"""A film of three arms before one camera, by the virtual lab: two close on each other."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.image import Image
from pneunet_ros.lab.pictures.lens import overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer
from pneunet_ros.lab.pictures.scene import Dots, FrameState, Scene

from support.films import ARM, Picture, stamp_of

WIDTH, HEIGHT = 1024, 768
CAMERA = overhead_camera(
    width=WIDTH, height=HEIGHT, focal_px=900.0, scale=0.0002, middle=(0.06, 0.0)
)
REST, FRAMES = 6, 19
RADIUS = 0.0011  # m, of a dot
COVERED = 0.004  # m: the first arm hides dots of others so near to its centerline


class Pose(NamedTuple):
    """Where the clamp of an arm is in the picture's plane (m), and the side that it bends to."""

    x: float
    y: float
    side: float


POSES = {
    'upper': Pose(0.0, 0.026, -1.0),
    'lower': Pose(0.004, -0.026, 1.0),
    'beside': Pose(0.0, -0.06, 1.0),
}
STEPS = {'upper': 1100.0, 'lower': 1000.0, 'beside': 400.0}  # Pa from frame to frame


def clamp_pixel(arm: str) -> tuple[float, float]:
    """Return where the first target of an arm is in the picture (px), about."""
    u, v = CAMERA.project(*(np.array([value]) for value in POSES[arm][:2]))
    return float(np.rint(u[0])), float(np.rint(v[0]))


@cache
def place_of(arm: str, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where the targets of an arm are in a frame, x and y (m) in its base."""
    shape = solve(ARM, STEPS[arm] * max(0, index - REST + 1), (0.0, 0.0), stations=225)
    return tuple(
        np.interp(ARM.target_arclength, shape.arclength, way) for way in (shape.x, shape.y)
    )


def in_plane(arm: str, index: int) -> np.ndarray:
    """Return where the targets of an arm are in the picture's plane, (targets, 2) m."""
    (x, y), pose = place_of(arm, index), POSES[arm]
    return np.column_stack([pose.x + x, pose.y + pose.side * y])


def covered(arm: str, index: int) -> np.ndarray:
    """Whether targets of an arm are behind the first one (targets,)."""
    first, own = next(iter(POSES)), in_plane(arm, index)
    if arm == first:
        return np.zeros(len(own), np.bool_)
    apart = np.linalg.norm(own[:, None] - in_plane(first, index)[None], axis=2)
    return apart.min(axis=1) < COVERED


@cache
def pictures() -> tuple[Picture, ...]:
    """Render all arms, (HEIGHT, WIDTH) grey."""
    renderer, rng = Renderer(Scene(camera=CAMERA)), np.random.default_rng(7)
    film = []
    for index in range(FRAMES):
        x, y = np.concatenate([in_plane(arm, index) for arm in POSES]).T
        hidden = np.concatenate([covered(arm, index) for arm in POSES])
        dots = Dots(x=x, y=y, radius=np.where(hidden, 0.0, RADIUS))
        film.append(renderer.render(FrameState(dots=dots), rng)[0])
    return tuple(film)


def image_of(picture: Picture, index: int) -> Image:
    """Return a picture as a camera sends it."""
    return Image(
        stamp_ns=stamp_of(index),
        frame_id='camera',
        width=WIDTH,
        height=HEIGHT,
        step=WIDTH,
        encoding='mono8',
        data=np.ascontiguousarray(picture).reshape(-1),
    )
