"""A model's arm that bends with its pressure before the camera of the virtual lab.

Shapes are taken once, at a grid of pressures, and interpolated from then on: thousands of images
need no more solves. What is drawn is what the truth says, whatever the interpolation left.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.pictures.scene import Body, Dots, FrameState, Occluder
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve, station_arclength
from scipy.interpolate import CubicSpline

STATIONS = 225  # of a solve, from which places between them are interpolated
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


def motion_of(
    arm: Arm,
    pressure_range: tuple[float, float],
    force: tuple[float, float] = (0.0, 0.0),
    placement: Array | None = None,
) -> ArmMotion:
    """Return an arm under a constant end force (N) at pressures (Pa) of a range.

    placement (targets, 2) m: that of `ArmMotion`. Raises RequestError without an equilibrium.
    """

    def shape_at(pressure: float) -> Array:
        shape = solve(arm, pressure, force=force, stations=STATIONS)
        if not shape.converged:
            raise RequestError(shape.status, reason='no_equilibrium')
        return np.array([shape.x, shape.y, shape.theta])

    arclength = station_arclength(arm.length, STATIONS)
    return ArmMotion(shape_at, arclength, arm.target_arclength, pressure_range, placement)
