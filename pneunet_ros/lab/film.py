"""A camera above the live arm of the virtual lab: its scene, and images of the arm in it."""

from __future__ import annotations

from typing import Final

import numpy as np
from pneunet_ros.core.image import Bytes
from pneunet_ros.lab.chain import Lying
from pneunet_ros.lab.lens import looking_down
from pneunet_ros.lab.live import LiveLab
from pneunet_ros.lab.renderer import Renderer
from pneunet_ros.lab.scene import Body, Dots, Light, Moment, Scene

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


class Film:
    """Renders the arm of a live lab as it lies."""

    __slots__ = ('_lab', '_outline', '_renderer')

    def __init__(self, lab: LiveLab) -> None:
        """Draw what does not move."""
        self._lab = lab
        self._outline = np.linspace(0.0, lab.scenario.arm.length, OUTLINE)
        self._renderer = Renderer(SCENE)

    def image(self, shape: Lying, random: np.random.Generator) -> Bytes:
        """Return an image (height, width), grey levels, of the arm; nothing moves meanwhile."""
        points = self._lab.seen(shape)
        x, y, theta = (rows[0] for rows in shape.points(self._outline))
        moment = Moment(
            dots=Dots(x=points[:, 0], y=points[:, 1]), body=Body(x=x, y=y, theta=theta)
        )
        picture, _ = self._renderer.render(moment, random)
        return picture
