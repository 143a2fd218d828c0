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
from pneunet_ros.vision.dots.blobs import find_areas, same_blobs
from pneunet_ros.vision.dots.centroid import axes_of, COLUMNS, Mask
from pneunet_ros.vision.rest_plane import Failure
from pneunet_ros.vision.settings import VisionSettings

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
    these, empty if they were searched before; taken (n, COLUMNS): blobs that are targets of other
    rows.
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

    def is_taken(self, table: Array) -> Mask:
        """Whether blobs (n, COLUMNS) belong to other rows (n,)."""
        return np.asarray(same_blobs(table, self.taken).any(axis=1))

    def dot_centers(self, table: Array) -> Array:
        """Return the centers of dots (n, COLUMNS), normalized (n, 2).

        If a camera looks obliquely, the center of a round dot is not that of its outline, but the
        pole of the horizon with respect to it.
        """
        places = table[:, :2]
        outline = self.lens.undistort(places)
        nearness = self.plane.base_from_normalized[2]
        if not nearness[:2].any():
            return outline
        along_u = self.lens.undistort(np.add(places, (1.0, 0.0))) - outline  # of a pixel
        along_v = self.lens.undistort(np.add(places, (0.0, 1.0))) - outline
        xx, xy, yy = axes_of(table).T[:, :, None]
        first, second = xx * along_u + xy * along_v, xy * along_u + yy * along_v
        slope = nearness[:2, None]
        off = first * (first @ slope) + second * (second @ slope)
        return np.asarray(outline - off / (outline @ slope + nearness[2]))

    def round_areas(self) -> RoundAreas:
        """Return candidate areas for blobs, most salient first."""
        if self.areas is None:
            return find_areas(self.image, self.appearance)
        return self.areas.only(slice(self.appearance.blobs.most))

    @property
    def rest_straightness(self) -> float:
        """Largest deviation of an arm at rest from a straight line, relative to its length."""
        bent = isinstance(self.settings.plane, CurvedRestPlane)
        return math.inf if bent else self.settings.rest_straightness

    @property
    def appearance(self) -> Appearance:
        """Criteria for a blob."""
        return self.vision.appearance(self.settings)
