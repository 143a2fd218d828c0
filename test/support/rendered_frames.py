"""Rendered frames of an arm among things that are no targets, as different as seeds are."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from pneunet_ros.core.image import Image
from pneunet_ros.lab.pictures.lens import Camera, overhead_camera
from pneunet_ros.lab.pictures.renderer import Renderer, Truth
from pneunet_ros.lab.pictures.scene import Dots, Glint, Label, Light, Occluder, Scene, Spot
from pneunet_ros.model.arm import Arm
from pneunet_ros.vision.camera.camera_model import Lens

from support.camera_images import as_image, bar, hand
from support.moving_arm import motion_of

FRAME_NS = 33_333_333
REST_FRAMES = 7  # in which the arm is straight and nothing hides it
VISIBLE, HIDDEN = 0.99, 0.5  # share of a target's image: above it is to be found, below never
FALSE_PX = 1.5  # a center further off is not that of the target


def lens_of(camera: Camera) -> Lens:
    """Return what a camera_info tells of a camera of the lab."""
    return Lens(
        width=camera.width,
        height=camera.height,
        model=camera.model,
        matrix=camera.matrix,
        distortion=camera.distortion,
    )


def plain_camera(width: int = 640, height: int = 480, **changes) -> Camera:
    """Return a camera that has all of the arm's motion in view, however many pixels it has."""
    view = {'focal_px': 1.1 * width, 'scale': 0.178 / width, 'middle': (0.05, 0.02)}
    view |= {'distortion': (-0.25, 0.06, 0.0005, -0.0003), **changes}
    return overhead_camera(width=width, height=height, **view)


class View:
    """A camera, things in its view, an arm that bends, and hands or bars that pass over it.

    Iterating gives an image and the truth about it, frame by frame. `clamp_pixel` is where the
    first target is at rest.
    """

    def __init__(self, arm: Arm, seed: int, frames: int, size=(640, 480), noise=3.0, hidden=True):
        rng = self.rng = np.random.default_rng(seed)
        self.frames = frames
        width, height = size
        self.camera = plain_camera(width, height, roll=rng.uniform(-0.2, 0.2))
        self.lens = lens_of(self.camera)
        top = rng.uniform(15e3, 50e3)
        self.period = rng.uniform(40.0, 100.0)
        self.motion = motion_of(arm, (0.0, top))
        u, v = self.camera.project(*self.motion.targets(0.0))
        self.clamp_pixel = (float(u[0]), float(v[0]))
        self.renderer = Renderer(self._scene(np.column_stack([u, v]), noise, seed))
        self.hidden = hidden

    def _scene(self, rest, noise: float, seed: int) -> Scene:
        rng, camera = self.rng, self.camera
        width, height = camera.width, camera.height
        unit = width / 640.0

        def away_from_rest(count):
            # What lies over a target at rest for good would hide it while scale is learnt.
            places = rng.uniform([0, 0], [width, height], (count, 2))
            apart = np.hypot(*(places[:, None] - rest[None]).transpose(2, 0, 1)).min(axis=1)
            return places[apart > 14.0 * unit].tolist()

        spots = [
            Spot(
                u=u,
                v=v,
                major=unit * rng.uniform(1.5, 6.0),
                minor=unit * rng.uniform(1.5, 4.0),
                angle=rng.uniform(0.0, 3.0),
                grey=rng.uniform(150.0, 240.0),
            )
            for u, v in away_from_rest(rng.integers(0, 15))
        ]
        glints = [
            Glint(u=u, v=v, major=8.0 * unit, minor=1.2 * unit, angle=rng.uniform(0.0, 3.0))
            for u, v in away_from_rest(rng.integers(0, 5))
        ]
        count = rng.integers(5, 13)
        x = rng.uniform(-0.01, 0.05) + rng.uniform(0.004, 0.007) * np.arange(count)
        return Scene(
            camera=camera,
            light=Light(
                gradient_u=rng.uniform(-0.4, 0.4), gradient_v=rng.uniform(-0.3, 0.3), vignette=0.2
            ),
            labels=(Label(u=0.8 * width, v=0.9 * height, width=90 * unit, height=40 * unit),),
            spots=tuple(spots),
            glints=tuple(glints),
            decoys=Dots(x=x, y=np.full(count, rng.choice([-0.035, -0.03]))),
            noise=noise,
            seed=seed + 1,
        )

    def pressure(self, frame: float) -> float:
        """Return the pressure (Pa) at a frame; 0 during the rest."""
        top = self.motion.pressure_range[1]
        since = max(frame - REST_FRAMES, 0.0) / self.period
        return 0.5 * top * (1.0 - math.cos(2.0 * math.pi * since))

    def occluders(self, frame: int, start: float, kind: int) -> tuple[Occluder, ...]:
        """Return what passes over the arm: nothing, a hand or a bar."""
        width, height = self.camera.width, self.camera.height
        along = (frame - start) / 60.0
        if not self.hidden or kind == 0 or frame < REST_FRAMES or along < 0.0:
            return ()
        if kind == 1:
            return hand((1.6 * along - 0.25) * width, 0.35 * height, 0.22 * width, 0.3)
        return (bar(1.3 * along * width, 0.5 * height, 0.9 * height, 0.08 * width, 1.4),)

    def __iter__(self) -> Iterator[tuple[Image, Truth]]:
        start, kind = self.rng.uniform(10.0, 40.0), int(self.rng.integers(0, 3))
        for frame in range(self.frames):
            moment = self.motion.frame_state(
                self.pressure(frame),
                self.pressure(frame - 0.15),
                self.pressure(frame + 0.15),
                self.occluders(frame, start, kind),
            )
            grey, truth = self.renderer.render(moment, self.rng)
            yield as_image(grey, stamp_ns=(frame + 1) * FRAME_NS), truth


class Score:
    """How many targets were found, missed, false or swapped, and how far off, px."""

    def __init__(self) -> None:
        self.frames = self.visible = self.found = self.false = self.swapped = 0
        self.squares: list[np.ndarray] = []
        self.lost: list[tuple[int, list[int]]] = []

    def count(self, sightings, truth: Truth) -> None:
        """Compare what was seen in a frame with the truth."""
        seen = np.isfinite(sightings.u)
        off = np.hypot(sightings.u - truth.centroid_u, sightings.v - truth.centroid_v)
        spacing = np.hypot(np.diff(truth.u), np.diff(truth.v)).min()
        visible = truth.visible > VISIBLE
        missed = visible & ~seen
        if missed.any():
            self.lost.append((self.frames, np.flatnonzero(missed).tolist()))
        self.frames += 1
        self.visible += np.count_nonzero(visible)
        self.found += np.count_nonzero(visible & seen)
        self.false += np.count_nonzero(seen & ((off > FALSE_PX) | (truth.visible < HIDDEN)))
        self.swapped += np.count_nonzero(seen & (off > 0.5 * spacing))
        self.squares.append(off[visible & seen] ** 2)

    @property
    def rms_px(self) -> float:
        """Root mean square error of a center, per axis."""
        return float(np.sqrt(0.5 * np.concatenate(self.squares).mean()))
