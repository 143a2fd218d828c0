"""A frame with its tracking context."""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Image
from pneunet_ros.vision.camera.camera_model import Lens
from pneunet_ros.vision.camera.camera_settings import CameraSettings, CurvedRestPlane
from pneunet_ros.vision.camera.working_plane import Plane
from pneunet_ros.vision.dots.areas import Appearance, RoundAreas
from pneunet_ros.vision.dots.blobs import find_areas, MOST_AREAS, same_blobs
from pneunet_ros.vision.dots.centroid import axes_of, COLUMNS, Mask, U, V
from pneunet_ros.vision.rest_plane import Failure
from pneunet_ros.vision.settings import VisionSettings

# Mean, and the components with one and two periods, of eight points around an outline.
TURN = 0.25 * math.pi * np.arange(8)
AROUND = freeze(
    0.25
    * np.stack(
        [0.5 + 0.0 * TURN, np.cos(TURN), np.sin(TURN), np.cos(2.0 * TURN), np.sin(2.0 * TURN)]
    )
)
NONE_TAKEN = freeze(np.empty((0, COLUMNS)))
NO_AREAS = Failure(
    reason='no_areas',
    sentence='no area looks like a target: check light, exposure, focus, grey_band and area',
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A frame with its tracking context.

    areas: candidate areas, if already found; shallow: search only salient areas, because another
    search can follow; limits: largest cost of the targets of a row at rest for each search among
    the areas, empty if they were searched before; taken (n, COLUMNS): blobs that are targets of
    other rows; lost: targets that were seen when the row was lost.
    """

    image: Image
    lens: Lens
    plane: Plane
    arclength: Array
    clamp_angle: float
    settings: CameraSettings
    vision: VisionSettings
    areas: RoundAreas | None = None
    shallow: bool = False
    limits: tuple[float, ...] = ()
    taken: Array = field(default_factory=lambda: NONE_TAKEN)
    lost: Mask | None = None

    def is_taken(self, table: Array) -> Mask:
        """Whether blobs (n, COLUMNS) belong to other rows (n,)."""
        return np.asarray(same_blobs(table, self.taken).any(axis=1))

    def dot_centers(self, table: Array) -> Array:
        """Return the centers of dots (n, COLUMNS), normalized (n, 2).

        The center is that of the undistorted outline, because a lens distorts outlines. For an
        oblique camera, the center is the pole of the horizon with respect to the outline.
        """
        slope, bent = self.plane.base_from_normalized[2], self.lens.distortion.any()
        if not (bent or slope[:2].any()):
            return self.lens.undistort(table[:, :2])
        points = np.empty((AROUND.shape[1], len(table), 2))
        xx, xy, yy = axes_of(table).T
        cosine, sine = 4.0 * AROUND[1:3, :, None]
        points[:, :, 0] = table[:, U] + cosine * xx + sine * xy
        points[:, :, 1] = table[:, V] + cosine * xy + sine * yy
        outline = self.lens.undistort(points.reshape(-1, 2)).reshape(len(points), -1)
        center, first, second, cosine, sine = (AROUND @ outline).reshape(len(AROUND), -1, 2)
        # A distortion of an ellipse with two periods around it shifts the best fit.
        size = _cross(first, second)
        along = (_cross(cosine, second) + _cross(first, sine)) / size
        aside = (_cross(sine, second) - _cross(first, cosine)) / size
        center = center + 0.5 * (along[:, None] * first + aside[:, None] * second)
        pole = first * (first @ slope[:2, None]) + second * (second @ slope[:2, None])
        return np.asarray(center - pole / (center @ slope[:2, None] + slope[2]))

    def round_areas(self) -> RoundAreas:
        """Return candidate areas for blobs, most salient first."""
        if self.areas is None:
            return find_areas(self.image, self.appearance)
        return self.areas.only(slice(MOST_AREAS))

    @property
    def rest_straightness(self) -> float:
        """Largest deviation of an arm at rest from a straight line, relative to its length."""
        bent = isinstance(self.settings.plane, CurvedRestPlane)
        return math.inf if bent else self.settings.rest_straightness

    @property
    def appearance(self) -> Appearance:
        """Criteria for a blob."""
        return self.vision.appearance(self.settings)


def _cross(first: Array, second: Array) -> Array:
    """Return the cross products of vectors (n, 2), (n,)."""
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
