"""The arm in front of the camera of the virtual lab: as it bends with its pressure, and live.

For the first, shapes are taken once, at a grid of pressures, and interpolated from then on:
thousands of images need no more solves. What is drawn is what the truth says, whatever the
interpolation left.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, Final

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.image import Bytes
from pneunet_ros.lab.chain import ChainShape
from pneunet_ros.lab.lens import looking_down
from pneunet_ros.lab.live import LiveLab
from pneunet_ros.lab.renderer import Renderer
from pneunet_ros.lab.scene import Body, Dots, FrameState, Light, Occluder, Scene
from scipy.interpolate import CubicSpline

OUTLINE = 57  # stations of the outline of the arm
# The camera looks squarely at the working plane; config/lab_camera.yaml says where it is.
SCENE: Final = Scene(
    camera=looking_down(
        width=640,
        height=480,
        focal_px=610.0,
        scale=0.00027,
        middle=(0.058, 0.032),
        distortion=(-0.25, 0.09, 0.0006, -0.0004, 0.0),
    ),
    light=Light(level=0.97, gradient_u=-0.2, gradient_v=0.1, vignette=0.25),
    background=96.0,
    texture=1.5,
    blur=0.75,
    noise=0.85,
)
DRAWN_EVERY = 4  # station of them, for the outline of the arm
GRID = 41  # pressures


class ArmMotion:
    """Shapes of an arm between two pressures: targets and body as functions of the pressure."""

    __slots__ = ('_body', '_targets', 'pressure_range')

    def __init__(
        self,
        shape_at: Callable[[float], Array],
        arclength: Array,
        target_arclength: Array,
        pressure_range: tuple[float, float],
        placement: Array | None = None,
    ) -> None:
        """Take the shapes of an arm at pressures (Pa) of the range.

        shape_at: pressure (Pa) -> x, y (m) and theta (rad), (3, stations), at stations of this
        arclength (stations,) m. target_arclength (targets,) m. placement (targets, 2) m: how far
        every target is from where it should have been painted, along the arm and across it (to
        the left), for good.
        """
        self.pressure_range = pressure_range
        pressures = np.linspace(*pressure_range, GRID)
        shapes = np.array([shape_at(pressure) for pressure in pressures.tolist()])
        along: Any = CubicSpline(arclength, shapes, axis=2)
        x, y, theta = along(target_arclength).transpose(1, 0, 2)
        if placement is not None:
            ahead, aside = placement[:, 0], placement[:, 1]
            x = x + ahead * np.cos(theta) - aside * np.sin(theta)
            y = y + ahead * np.sin(theta) + aside * np.cos(theta)
        self._targets: Any = CubicSpline(pressures, np.stack([x, y], axis=1))
        self._body: Any = CubicSpline(pressures, shapes[:, :, ::DRAWN_EVERY])

    def targets(self, pressure: float) -> Array:
        """Return x and y (2, targets) m of the targets at a pressure (Pa) of the range."""
        low, high = self.pressure_range
        if not low <= pressure <= high:
            raise RequestError(f'pressure {pressure:.6g} Pa is not within [{low:.6g}, {high:.6g}]')
        places: Array = self._targets(pressure)
        return freeze(places)

    def dots(
        self, pressure: float, opening: float, closing: float, radius: float, grey: float
    ) -> Dots:
        """Return the targets at a pressure, moving from the one at opening to that at closing."""
        places = self.targets(pressure)
        motion = (self.targets(closing) - self.targets(opening)).T
        return Dots(x=places[0], y=places[1], radius=np.array(radius), grey=grey, motion=motion)

    def frame_state(
        self,
        pressure: float,
        opening: float | None = None,
        closing: float | None = None,
        occluders: tuple[Occluder, ...] = (),
        radius: float = 0.0011,
        grey: float = 225.0,
    ) -> FrameState:
        """Return the arm at a pressure (Pa), for a Renderer.

        opening, closing: the pressures when the shutter opens and closes, None: as amid this time.
        """
        x, y, theta = self._body(pressure)
        opening = pressure if opening is None else opening
        closing = pressure if closing is None else closing
        return FrameState(
            dots=self.dots(pressure, opening, closing, radius, grey),
            body=Body(x=x, y=y, theta=theta),
            occluders=occluders,
        )


def up_and_down(time: float, *, rest: float, rise: float, hold: float, top: float) -> float:
    """Pressure (Pa) that rests at 0, rises to `top`, holds and falls again; all times in s.

    It rises and falls like half a cosine, without a jolt, and stays at 0 afterwards.
    """
    since = time - rest
    share = min(max(min(since, 2.0 * rise + hold - since) / rise, 0.0), 1.0)
    return 0.5 * top * (1.0 - math.cos(math.pi * share))


def sinus(time: float, *, rest: float, period: float, top: float) -> float:
    """Pressure (Pa) that rests at 0 until `rest` (s), then swings from 0 to `top` and back."""
    return 0.5 * top * (1.0 - math.cos(2.0 * math.pi * max(time - rest, 0.0) / period))


def ramp(time: float, *, rest: float, rate: float, top: float) -> float:
    """Pressure (Pa) that rests at 0 until `rest` (s) and rises at `rate` (Pa/s) up to `top`."""
    return min(max(time - rest, 0.0) * rate, top)


class Film:
    """Renders the arm of a live lab as it lies."""

    __slots__ = ('_lab', '_outline', '_renderer')

    def __init__(self, lab: LiveLab) -> None:
        """Draw what does not move."""
        self._lab = lab
        self._outline = np.linspace(0.0, lab.scenario.arm.length, OUTLINE)
        self._renderer = Renderer(SCENE)

    def image(self, shape: ChainShape, random: np.random.Generator) -> Bytes:
        """Return an image (height, width), grey levels, of the arm; nothing moves meanwhile."""
        points = self._lab.seen(shape)
        x, y, theta = (rows[0] for rows in shape.points(self._outline))
        moment = FrameState(
            dots=Dots(x=points[:, 0], y=points[:, 1]), body=Body(x=x, y=y, theta=theta)
        )
        picture, _ = self._renderer.render(moment, random)
        return picture
