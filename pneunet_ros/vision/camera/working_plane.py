"""Mapping between undistorted image coordinates and the working plane z = 0.

The mapping is a homography; `CameraSettings.plane` has the three ways to determine it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.vision.camera.camera_model import copy_pairs, Lens
from pneunet_ros.vision.camera.camera_settings import HomographyPlane, PosePlane

FARTHEST = 1e6  # m or normalized; beyond the view of any camera
DEGENERATE = 1e-9  # of the largest singular value; a matrix that maps the plane to a line
UNDETERMINED = 1e-2  # the same, of the equations for a homography; a square has 0.27
MISFIT = 0.05  # of the extent of the points; with a larger residual one of them is wrong
NEAREST = 1e-4  # m, from the camera to the working plane


@kernel
def project(points: Array, h: Array) -> None:
    """Project points (n, 2) in place by the homography h; NaN behind the horizon."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        points[i, 0] = points[i, 1] = np.nan
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            u = h[0, 0] * x + h[0, 1] * y + h[0, 2]
            v = h[1, 0] * x + h[1, 1] * y + h[1, 2]
            if abs(u) < FARTHEST * w and abs(v) < FARTHEST * w:
                points[i, 0] = u / w
                points[i, 1] = v / w


@kernel
def magnification(points: Array, h: Array, out: Array) -> None:
    """Compute the largest singular value of the homography's Jacobian at points (n, 2)."""
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        out[i] = np.nan
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            u = h[0, 0] * x + h[0, 1] * y + h[0, 2]
            v = h[1, 0] * x + h[1, 1] * y + h[1, 2]
            if abs(u) < FARTHEST * w and abs(v) < FARTHEST * w:
                u, v = u / w, v / w
                a, b = h[0, 0] - u * h[2, 0], h[0, 1] - u * h[2, 1]
                c, d = h[1, 0] - v * h[2, 0], h[1, 1] - v * h[2, 1]
                out[i] = 0.5 * (math.hypot(a + d, c - b) + math.hypot(a - d, c + b)) / w


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane:
    """The working plane as seen by the camera.

    base_from_normalized (3, 3): (x w, y w, w) in base, m, from (x, y, 1) normalized, with w > 0 in
    front of the camera. CameraError for a matrix that has no inverse.
    """

    base_from_normalized: Array
    normalized_from_base: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check that the plane is not seen edge-on."""
        matrix = frozen_array(self.base_from_normalized)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise CameraError(
                'the homography of the working plane must be 3 x 3 finite numbers',
                reason='wrong_shape',
            )
        sizes = np.linalg.svd(matrix, compute_uv=False)
        if not sizes[2] > DEGENERATE * sizes[0]:
            raise CameraError(
                'the camera sees the working plane as a line: it has no inverse',
                reason='not_determined',
            )
        object.__setattr__(self, 'base_from_normalized', matrix)
        object.__setattr__(self, 'normalized_from_base', frozen_array(np.linalg.inv(matrix)))

    def points(self, normalized: npt.ArrayLike) -> Array:
        """Return points (n, 2) m in base for normalized (n, 2); NaN at and above the horizon."""
        points = copy_pairs(normalized)
        project(points, self.base_from_normalized)
        return points

    def normalized(self, points_in_base: npt.ArrayLike) -> Array:
        """Return normalized (n, 2) for points (n, 2) m in base; NaN behind the camera."""
        points = copy_pairs(points_in_base)
        project(points, self.normalized_from_base)
        return points

    def scale(self, normalized: npt.ArrayLike) -> Array:
        """Return m in base per normalized unit at (n, 2), the largest in any direction."""
        points = copy_pairs(normalized)
        out = np.empty(len(points))
        magnification(points, self.base_from_normalized, out)
        return out


def plane_from_rest(
    first: npt.ArrayLike,
    last: npt.ArrayLike,
    first_arclength: float,
    last_arclength: float,
    clamp_angle: float = 0.0,
) -> Plane:
    """Return the plane from the first and last target of the straight arm, as in the paper.

    first, last (2,) normalized; their arclength in m; clamp_angle (rad) from x to the arm. The
    camera looks along -z: y points up in the image if x points to the right. The origin is one
    first_arclength before the first target. Raises CameraError if the two targets coincide.
    """
    start = frozen_array(first, (2,))
    way = frozen_array(last, (2,)) - start
    distance = math.hypot(*way)
    length = last_arclength - first_arclength
    if not (math.isfinite(distance) and distance > 1.0 / FARTHEST):
        raise CameraError(
            'the first and the last target of the arm at rest coincide in the image, or one of '
            'them is not visible',
            reason='not_determined',
        )
    if not (math.isfinite(length) and length > 0.0):
        raise CameraError(
            f'the last target, at {last_arclength} m along the arm, must come after the first, '
            f'at {first_arclength} m',
            reason='wrong_order',
        )
    along = length / distance**2 * way
    across = np.array([along[1], -along[0]])
    matrix = np.eye(3)
    matrix[0] = *along, first_arclength - along @ start
    matrix[1] = *across, -across @ start
    cosine, sine = math.cos(clamp_angle), math.sin(clamp_angle)
    matrix[:2] = np.array([[cosine, -sine], [sine, cosine]]) @ matrix[:2]
    return Plane(base_from_normalized=matrix)


def plane_from_pose(pose: PosePlane) -> Plane:
    """Return the plane z = 0 of base as seen by a camera in this pose.

    Raises CameraError if the camera is in the plane, or the clamp is behind it.
    """
    x, y, z, w = pose.quaternion
    rotation = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    position = np.array(pose.position)
    if not NEAREST <= abs(position[2]) <= FARTHEST:
        raise CameraError(
            f'plane.position = {pose.position}: the camera must be {NEAREST} m or more away from '
            'the working plane z = 0',
            reason='out_of_bounds',
        )
    if not -position @ rotation[:, 2] > 0.0:
        raise CameraError(
            f'plane.position = {pose.position} and plane.quaternion put the clamp behind '
            'the camera; the pose is that of the optical frame (z forward, x right, y '
            'down) in base',
            reason='behind_camera',
        )
    # The ray R (x, y, 1) from the camera at c meets the plane after -c_z / ray_z of its length.
    nearness = -rotation[2] / position[2]
    matrix = rotation + np.outer(position, nearness)
    matrix[2] = nearness
    return Plane(base_from_normalized=matrix)


def plane_from_homography(lens: Lens, plane: HomographyPlane) -> Plane:
    """Return the plane through known points, by least squares for more than four.

    Raises CameraError if the points do not lie in one plane in front of the camera, or do not
    determine it: four points must be distinct, no three of them on a line.
    """
    normalized = lens.undistort(plane.pixels)
    unseen = np.flatnonzero(np.isnan(normalized[:, 0]))
    if unseen.size:
        raise CameraError(
            f'plane.pixels[{unseen[0]}] = {plane.pixels[unseen[0]].tolist()} lies outside the '
            'field of view of the lens',
            reason='beyond_lens',
        )
    into, seen = _centered(normalized, 'plane.pixels')
    onto, known = _centered(plane.points, 'plane.points')
    ones, zeros = np.ones((len(seen), 1)), np.zeros((len(seen), 3))
    rays = np.hstack([seen, ones])
    equations = np.vstack(
        [
            np.hstack([rays, zeros, -known[:, :1] * rays]),
            np.hstack([zeros, rays, -known[:, 1:] * rays]),
        ]
    )
    _, sizes, directions = np.linalg.svd(equations)
    solution = directions[8].reshape(3, 3)
    if not sizes[7] > UNDETERMINED * sizes[0]:
        raise CameraError(
            'plane.pixels and plane.points do not determine the plane: four of the points must '
            'be distinct, no three of them on a line',
            reason='not_determined',
        )
    depth = rays @ solution[2]
    if depth[0] < 0.0:
        solution, depth = -solution, -depth
    if not np.all(depth > DEGENERATE * np.abs(solution).max()):
        raise CameraError(
            'plane.pixels and plane.points put a point behind the camera: '
            'are both lists in the same order?',
            reason='behind_camera',
        )
    misfit = np.hypot(*(rays @ solution[:2].T / depth[:, None] - known).T)
    worst = int(misfit.argmax())
    if misfit[worst] > MISFIT:
        raise CameraError(
            f'plane.pixels[{worst}] = {plane.pixels[worst].tolist()} and plane.points[{worst}] = '
            f'{plane.points[worst].tolist()} do not fit the others',
            reason='inconsistent',
        )
    return Plane(base_from_normalized=np.linalg.inv(onto) @ solution @ into)


def _centered(points: Array, where: str) -> tuple[Array, Array]:
    """Return the similarity (3, 3) that normalizes points (n, 2), and the normalized points."""
    center = points.mean(axis=0)
    size = float(np.sqrt(np.mean((points - center) ** 2)))
    if not 1e-9 < size < FARTHEST:
        raise CameraError(
            f'the points of {where} all coincide, or are too far apart', reason='not_determined'
        )
    matrix = np.diag([1.0 / size, 1.0 / size, 1.0])
    matrix[:2, 2] = -center / size
    return matrix, (points - center) / size
