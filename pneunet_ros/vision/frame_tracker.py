"""The row of targets in one frame: followed from the last one, or found among all bright areas."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.image import Image
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.units import seconds_between
from pneunet_ros.vision.association import least_seen, MOST_AREAS, row_from_clamp
from pneunet_ros.vision.blobs import Areas, find_areas, look_of, picture_of
from pneunet_ros.vision.camera_model import Lens
from pneunet_ros.vision.camera_settings import CameraSettings
from pneunet_ros.vision.centroid import ANGLE, AREA, COLUMNS, MAJOR, MINOR, U, V
from pneunet_ros.vision.gating import FARTHEST, first_size, Mask
from pneunet_ros.vision.rest_plane import Failure, row_at_rest, row_points
from pneunet_ros.vision.row_tracker import (
    at_clamp,
    follow_row,
    Followed,
    found_row,
    next_row,
    Optics,
)
from pneunet_ros.vision.working_plane import Plane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowedRow:
    """A row of targets as it was in a frame, from which the next one is predicted.

    pixels (targets, 2): where each target was, or must have been; velocity (targets, 2) px/s;
    area (targets,): how large each is to be expected, px^2; seen (targets,): whether it was;
    spacing: distance of neighbors, px.
    """

    stamp_ns: int
    pixels: Array
    velocity: Array
    area: Array
    seen: Mask
    spacing: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenRow:
    """The targets in a frame, NaN where one is not seen.

    rows (targets, columns): what was measured in the image, in the columns of `weighing`;
    points (targets, 2) m in base; std (targets,) m; seen: how many are.
    """

    rows: Array
    points: Array
    std: Array
    seen: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A frame with all that is needed to look at it."""

    image: Image
    lens: Lens
    plane: Plane
    arclength: Array
    clamp_angle: float
    settings: CameraSettings

    @property
    def optics(self) -> Optics:
        """Lens and working plane, as kernels take them."""
        plane, lens = self.plane, self.lens
        return (
            lens.coefficients,
            lens.limit,
            plane.base_from_normalized,
            plane.normalized_from_base,
        )


def follow(view: View, row: FollowedRow) -> tuple[SeenRow, FollowedRow] | None:
    """Find the row near where it must be by now, and what comes next; None where it is lost."""
    image, settings = view.image, view.settings
    before = (row.pixels, row.velocity, row.area, row.seen, row.spacing)
    count, rows, points, std, after = follow_row(
        picture_of(image),
        look_of(settings.grey_band, settings.area),
        before,
        seconds_between(row.stamp_ns, image.stamp_ns),
        settings.gate,
        view.arclength,
        view.clamp_angle,
        view.optics,
    )
    if count == 0:
        return None
    return SeenRow(rows=rows, points=points, std=std, seen=count), followed(image, after)


def search(view: View) -> SeenRow | Failure:
    """Find the row that starts at the clamp among all bright areas of the frame."""
    areas = bright_areas(view.image, view.settings)
    if isinstance(areas, Failure):
        return areas
    points = view.plane.points(view.lens.undistorted(np.column_stack([areas.u, areas.v])))
    usable = np.flatnonzero(np.isfinite(points[:, 0]))
    row = row_from_clamp(points[usable], areas.area[usable], view.arclength, view.clamp_angle)
    rows = areas.table.T[usable[row.chosen]] if usable.size else np.zeros((0, 0))
    rows[row.chosen < 0] = np.nan
    usual = first_size(rows[:, AREA])
    count, found, std = found_row(rows, usual, view.arclength, FARTHEST, view.optics)
    seen = SeenRow(rows=rows, points=found, std=std, seen=count)
    targets, least = view.arclength.size, least_seen(view.arclength.size)
    if seen.seen < least or not at_clamp(seen.points, view.arclength, view.clamp_angle):
        return Failure(
            reason='no_row',
            sentence=f'only {seen.seen} of {targets} targets stand in a row from the clamp, among '
            f'{len(areas)} bright areas; {least} are needed: is the arm covered, or has the '
            'camera moved?',
        )
    return seen


def search_at_rest(
    image: Image, lens: Lens, arclength: Array, settings: CameraSettings
) -> Array | Failure:
    """Find first and last target of the straight arm, normalized (2, 2)."""
    areas = bright_areas(image, settings)
    if isinstance(areas, Failure):
        return areas
    pixels = np.column_stack([areas.u, areas.v])
    points = lens.undistorted(pixels)
    usable = np.isfinite(points[:, 0])
    row = row_at_rest(
        points[usable],
        pixels[usable],
        areas.area[usable],
        arclength,
        settings.clamp_pixel,
        settings.rest_straightness,
    )
    if isinstance(row, Failure):
        return row
    return row_points(row, points[usable])[[0, -1]]


def bright_areas(image: Image, settings: CameraSettings) -> Areas | Failure:
    """Return the white areas of a frame that can be targets, or why there are none to look at."""
    areas = find_areas(image, settings.grey_band, settings.area)
    if areas.crowded or len(areas) > MOST_AREAS:
        return Failure(
            reason='too_many_areas',
            sentence=f'more than {MOST_AREAS} bright areas could be targets: narrow grey_band or '
            'area, or darken the background',
        )
    if len(areas) == 0:
        return Failure(
            reason='no_areas',
            sentence='no bright area could be a target: look at light, exposure, focus, grey_band '
            'and area',
        )
    return areas


def begun(view: View, seen: SeenRow) -> FollowedRow:
    """Return a row that was found from nothing as the next frame needs it."""
    pixels, nobody = seen.rows[:, :2].copy(), np.zeros(len(seen.rows), np.bool_)
    nowhere = (pixels, np.zeros_like(pixels), first_size(seen.rows[:, AREA]), nobody, math.nan)
    after = next_row(seen.rows, seen.points, view.arclength, view.optics, nowhere, 1.0)
    return followed(view.image, after)


def followed(image: Image, row: Followed) -> FollowedRow:
    """Return a row of kernels as a frame leaves it."""
    pixels, velocity, area, seen, spacing = row
    return FollowedRow(
        stamp_ns=image.stamp_ns,
        pixels=pixels,
        velocity=velocity,
        area=area,
        seen=seen,
        spacing=spacing,
    )


def sightings(view: View, seen: SeenRow) -> TargetSightings:
    """Return what is published of the targets that are seen."""
    table = np.empty((COLUMNS + 2, len(seen.rows)))
    table[:COLUMNS], table[COLUMNS:] = seen.rows.T, seen.points.T
    freeze(table)
    return TargetSightings(
        stamp_ns=view.image.stamp_ns,
        x=table[COLUMNS],
        y=table[COLUMNS + 1],
        std=freeze(seen.std),
        u=table[U],
        v=table[V],
        area=table[AREA],
        major=table[MAJOR],
        minor=table[MINOR],
        angle=table[ANGLE],
    )
