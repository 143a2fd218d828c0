"""The row of targets in one frame: followed from the last one, or found among all bright areas."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.area_kernels import ANGLE, AREA, MAJOR, MINOR, U, V
from pneunet_ros.camera import Plane
from pneunet_ros.camera_settings import CameraSettings
from pneunet_ros.detection import Areas, find_areas, measure_areas
from pneunet_ros.frames import rotate
from pneunet_ros.image import Image
from pneunet_ros.lens import Lens
from pneunet_ros.readings import TargetSightings
from pneunet_ros.registration import Failure, row_at_rest, row_points
from pneunet_ros.row_search import least_seen, LEAST_TARGETS, MOST_AREAS, row_from_clamp
from pneunet_ros.row_step import check_row, next_row, Optics, pixels_of
from pneunet_ros.shape import Array, freeze
from pneunet_ros.tracking import expected, FARTHEST, first_size, Mask
from pneunet_ros.units import seconds_between

REACH_AGAIN = 0.3  # of the spacing: how near to where its neighbors say a lost target is sought
MOST_PASSES = 3  # over a frame, while lost targets are found again
NEAR_CLAMP = 4  # targets that can hardly move, but with the camera
OFF_ALONG, OFF_ASIDE = 0.1, 0.5  # spacings from their place, more with each: stretch and bend
LONGEST_PREDICTION = 0.1  # s; velocities tell nothing of what comes later


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

    rows (targets, columns): what was measured in the image, in the columns of `area_kernels`;
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
    def spacing(self) -> float:
        """Distance of the first two targets along the arm, m."""
        return float(self.arclength[1] - self.arclength[0])

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

    def measured(self, around: Array, reach: float, area: Array) -> Array:
        """Return what is nearest to these pixels (n, 2), NaN where nothing is; a row for each.

        reach: px, from there to the center at most; area (n,) px^2: how large it should be.
        """
        size = math.sqrt(4.0 / math.pi * area.max())
        settings = self.settings
        found = measure_areas(self.image, around, reach, size, settings.grey_band, settings.area)
        return found.table.T.copy()


def follow(view: View, row: FollowedRow) -> SeenRow | None:
    """Find the row near where it must be by now; None where it is lost."""
    seconds = seconds_between(row.stamp_ns, view.image.stamp_ns)
    predicted = row.pixels + min(seconds, LONGEST_PREDICTION) * row.velocity

    def checked(rows: Array) -> SeenRow:
        count, points, std = check_row(
            rows,
            predicted,
            row.seen,
            row.area,
            row.spacing,
            view.arclength,
            math.inf,
            view.optics,
        )
        return SeenRow(rows=rows, points=points, std=std, seen=count)

    seen = checked(view.measured(predicted, view.settings.gate * row.spacing, row.area))
    for _ in range(MOST_PASSES):
        if seen.seen == len(predicted) or seen.seen < 2:
            break
        lost = np.isnan(seen.std)
        x, y = expected(*columns(seen.points), view.arclength)
        again = pixels_of(x[lost], y[lost], view.optics)
        rows = seen.rows.copy()
        rows[lost] = view.measured(again, REACH_AGAIN * row.spacing, row.area[lost])
        more = checked(rows)
        if more.seen <= seen.seen:
            break
        seen = more
    if seen.seen < LEAST_TARGETS or not at_clamp(view, seen):
        return None
    return seen


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
    seen = found_row(view, rows)
    targets, least = view.arclength.size, least_seen(view.arclength.size)
    if seen.seen < least or not at_clamp(view, seen):
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


def found_row(view: View, rows: Array) -> SeenRow:
    """Return those targets of a row found from nothing (targets, columns) that are believed."""
    nowhere, nobody = np.zeros((len(rows), 2)), np.zeros(len(rows), np.bool_)
    usual = first_size(rows[:, AREA])
    count, points, std = check_row(
        rows, nowhere, nobody, usual, 1.0, view.arclength, FARTHEST, view.optics
    )
    return SeenRow(rows=rows, points=points, std=std, seen=count)


def columns(points: Array) -> tuple[Array, Array]:
    """Return x and y of points (n, 2), as kernels take them."""
    x, y = np.ascontiguousarray(points.T)
    return x, y


def at_clamp(view: View, seen: SeenRow) -> bool:
    """Whether the first target that is seen, if it is near the clamp, is where it must be."""
    near = zip(
        view.arclength[:NEAR_CLAMP].tolist(), seen.points[:NEAR_CLAMP].tolist(), strict=True
    )
    for first, (arclength, point) in enumerate(near):
        x, y = rotate(-view.clamp_angle, *point)
        if math.isnan(x):
            continue
        allowed = (1.0 + first) * view.spacing
        off_along = abs(math.hypot(x, y) - arclength)
        return off_along <= OFF_ALONG * allowed and abs(y) <= OFF_ASIDE * allowed
    return True


def followed(view: View, seen: SeenRow, before: FollowedRow | None) -> FollowedRow:
    """Return the row as the next frame needs it; before: the row of the frame before, if any."""
    stamp_ns = view.image.stamp_ns
    if before is None:
        pixels, nobody = seen.rows[:, :2].copy(), np.zeros(len(seen.rows), np.bool_)
        last = (pixels, nobody, first_size(seen.rows[:, AREA]), 1.0)
    else:
        seconds = seconds_between(before.stamp_ns, stamp_ns)
        last = (before.pixels, before.seen, before.area, seconds)
    pixels, velocity, area, who, spacing = next_row(
        seen.rows, seen.points, view.arclength, view.optics, *last
    )
    return FollowedRow(
        stamp_ns=stamp_ns, pixels=pixels, velocity=velocity, area=area, seen=who, spacing=spacing
    )


def sightings(view: View, seen: SeenRow) -> TargetSightings:
    """Return what is published of the targets that are seen."""
    x, y = columns(seen.points)
    table = freeze(np.ascontiguousarray(seen.rows.T))
    return TargetSightings(
        stamp_ns=view.image.stamp_ns,
        x=freeze(x),
        y=freeze(y),
        std=freeze(seen.std),
        u=table[U],
        v=table[V],
        area=table[AREA],
        major=table[MAJOR],
        minor=table[MINOR],
        angle=table[ANGLE],
    )
