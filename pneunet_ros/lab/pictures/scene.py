"""Image content of the virtual lab: static (Scene) and moving (FrameState).

Targets are in the working plane (m, base frame), distracting objects in the image (px). Grey
levels are those under even light, from 0 to 255.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.lab.pictures.lens import Camera


def nothing() -> Array:
    """Return an array without entries."""
    return np.zeros(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """White discs in the working plane.

    x, y (n,) m in base; radius m, one or (n,), 0 for a removed dot; motion (n, 2) m during the
    exposure; positions are those at mid-exposure.
    """

    x: Array = field(default_factory=nothing)
    y: Array = field(default_factory=nothing)
    radius: Array = field(default_factory=lambda: np.array(0.0011))
    grey: float = 225.0
    motion: Array = field(default_factory=nothing)

    def __post_init__(self) -> None:
        """Check the sizes."""
        x = frozen_array(self.x)
        count = (x.size,)
        radius = np.broadcast_to(np.asarray(self.radius, np.float64), count)
        motion = np.asarray(self.motion, np.float64)
        object.__setattr__(self, 'x', frozen_array(x, count))
        object.__setattr__(self, 'y', frozen_array(self.y, count))
        object.__setattr__(self, 'radius', frozen_array(radius))
        motion = motion if motion.size else np.zeros((x.size, 2))
        object.__setattr__(self, 'motion', frozen_array(motion, (x.size, 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """The arm from the side: a dark band around its centerline, with chambers on one side.

    x, y (m), theta (rad) at stations along it; above, below (m): thickness on both sides of the
    centerline, `above` on the left of its direction; pitch (m): from chamber to chamber.
    """

    x: Array
    y: Array
    theta: Array
    above: float = 0.006
    below: float = 0.004
    pitch: float = 0.008
    grey: float = 42.0

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in ('x', 'y', 'theta'):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(self.x),)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Occluder:
    """A polygon in front of the scene: corners (n, 2) px."""

    corners: Array
    grey: float = 62.0

    def __post_init__(self) -> None:
        """Check that it has three corners."""
        corners = frozen_array(self.corners)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise RequestError(
                f'an occluder needs at least 3 corners (u, v), not {corners.shape}',
                reason='wrong_shape',
            )
        object.__setattr__(self, 'corners', corners)


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """A bright rectangle with dark bars like text: center and size in px, angle in rad."""

    u: float
    v: float
    width: float = 90.0
    height: float = 40.0
    angle: float = 0.0
    lines: int = 3
    grey: float = 215.0
    ink: float = 70.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """A bright ellipse that is not a target: center and half axes in px, angle in rad."""

    u: float
    v: float
    major: float = 4.0
    minor: float = 4.0
    angle: float = 0.0
    grey: float = 220.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Glint:
    """Glare: a soft ellipse that adds up to `strength` grey levels."""

    u: float
    v: float
    major: float = 8.0
    minor: float = 1.2
    angle: float = 0.0
    strength: float = 260.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Illumination, 1 at the image center.

    gradient_u, gradient_v: change over the whole width or height; vignette: loss in the corners.
    """

    level: float = 1.0
    gradient_u: float = 0.0
    gradient_v: float = 0.0
    vignette: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Static scene and camera.

    decoys: dots that look like targets. blur: sigma of the optics in px; noise: sigma in grey
    levels; texture: sigma of the background texture, with its own `seed`.
    """

    camera: Camera
    light: Light = field(default_factory=Light)
    background: float = 92.0
    texture: float = 4.0
    seed: int = 1
    labels: tuple[Label, ...] = ()
    spots: tuple[Spot, ...] = ()
    decoys: Dots = field(default_factory=Dots)
    glints: tuple[Glint, ...] = ()
    blur: float = 0.7
    noise: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameState:
    """Moving objects in the middle of an exposure: targets, arm, and occluders."""

    dots: Dots
    body: Body | None = None
    occluders: tuple[Occluder, ...] = ()


def turn_points(points: Array, u: float, v: float, angle: float) -> Array:
    """Return points (n, 2) rotated by an angle (rad, from +u towards +v) and moved to (u, v)."""
    cos, sin = math.cos(angle), math.sin(angle)
    turned_points: Array = points @ np.array([[cos, sin], [-sin, cos]]) + np.array([u, v])
    return turned_points
