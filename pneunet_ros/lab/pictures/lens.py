"""A camera of the virtual lab: projects points of the base frame to its image.

The lens models are implemented independently of the tracker's camera, so that each can test the
other.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import CameraError

# Distortion model -> how many coefficients it may have (k1 k2 p1 p2 k3 | k4 k5 k6).
MODELS = {'plumb_bob': (0, 4, 5), 'rational_polynomial': (0, 8)}
FACING_DOWN = np.diag([1.0, -1.0, -1.0])  # x of base to the right, y of base up in the image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """A camera with its lens and its pose.

    width, height px; matrix (3, 3), the K of camera_info; distortion, its D; position (3,) m and
    rotation (3, 3) of the optical frame (z forward, x right, y down) in the base frame. Raises
    CameraError for an unknown model or a wrong number of coefficients.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    model: str = 'plumb_bob'
    position: Array
    rotation: Array

    def __post_init__(self) -> None:
        """Check the sizes."""
        distortion = frozen_array(self.distortion)
        if distortion.size not in MODELS.get(self.model, ()):
            raise CameraError(
                f'a lens {self.model!r} with {distortion.size} coefficients is not one of '
                f'{", ".join(f"{name} with {counts}" for name, counts in MODELS.items())}',
                reason='unknown_kind',
            )
        object.__setattr__(self, 'distortion', distortion)
        object.__setattr__(self, 'matrix', frozen_array(self.matrix, (3, 3)))
        object.__setattr__(self, 'position', frozen_array(self.position, (3,)))
        object.__setattr__(self, 'rotation', frozen_array(self.rotation, (3, 3)))

    def project(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Project points (m) of the plane z = 0 to pixels u, v; NaN behind the camera."""
        rotation, position = self.rotation, self.position
        # Camera coordinates are R^T (point - position).
        dx, dy = x - position[0], y - position[1]
        seen = [
            rotation[0, i] * dx + rotation[1, i] * dy - rotation[2, i] * position[2]
            for i in range(3)
        ]
        depth = np.where(seen[2] > 0.0, seen[2], np.nan)
        bent_x, bent_y = self.distort(seen[0] / depth, seen[1] / depth)
        matrix = self.matrix
        return (
            matrix[0, 0] * bent_x + matrix[0, 1] * bent_y + matrix[0, 2],
            matrix[1, 1] * bent_y + matrix[1, 2],
        )

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distort normalized coordinates like the lens."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion.tolist(), *[0.0] * 8)[:8]
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        if self.distortion.size == 8:
            radial = radial / (1.0 + square * (k4 + square * (k5 + square * k6)))
        cross = 2.0 * x * y
        return (
            x * radial + p1 * cross + p2 * (square + 2.0 * x * x),
            y * radial + p2 * cross + p1 * (square + 2.0 * y * y),
        )


def overhead_camera(
    *,
    width: int,
    height: int,
    focal_px: float,
    scale: float,
    middle: tuple[float, float],
    distortion: tuple[float, ...] = (),
    model: str = 'plumb_bob',
    roll: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """Return a camera that looks along -z at the point `middle` (m in base).

    focal_px: focal length in px; scale: m of the working plane per px at the image center. roll
    (rad) rotates the camera about its axis, tilt (rad) about its x and y, while it looks at
    `middle`. The principal point is slightly off the image center, as in real cameras.
    """
    rotation = FACING_DOWN @ turn(0, tilt[0]) @ turn(1, tilt[1]) @ turn(2, roll)
    center = (0.5 * (width - 1) + 3.2, 0.5 * (height - 1) - 2.7)
    matrix = [[focal_px, 0.0, center[0]], [0.0, focal_px, center[1]], [0.0, 0.0, 1.0]]
    return Camera(
        width=width,
        height=height,
        matrix=np.array(matrix),
        distortion=np.array(distortion),
        model=model,
        position=np.array([*middle, 0.0]) - focal_px * scale * rotation[:, 2],
        rotation=rotation,
    )


def turn(axis: int, angle: float) -> Array:
    """Return the matrix (3, 3) of a rotation by an angle (rad) about a coordinate axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = math.cos(angle)
    matrix[second, first] = math.sin(angle)
    matrix[first, second] = -matrix[second, first]
    return matrix
