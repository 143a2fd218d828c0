"""The row of targets in one frame: followed from the last one, or found among all bright areas."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.camera import Plane
from pneunet_ros.camera_settings import CameraSettings
from pneunet_ros.detection import Areas, find_areas, measure_areas
from pneunet_ros.frames import rotate
from pneunet_ros.image import Image
from pneunet_ros.lens import Lens
from pneunet_ros.readings import TargetSightings
from pneunet_ros.registration import Failure, row_at_rest, row_points
from pneunet_ros.row_search import least_seen, LEAST_TARGETS, MOST_AREAS, row_from_clamp
from pneunet_ros.shape import Array, freeze
from pneunet_ros.tracking import (
    believable,
    expected,
    FARTHEST,
    look_alike,
    Mask,
    moved_together,
    usual_size,
)
from pneunet_ros.units import seconds_between

MEASURED = ('u', 'v', 'area', 'major', 'minor', 'angle', 'std')
AREA, MAJOR, MINOR, STD = (MEASURED.index(name) for name in ('area', 'major', 'minor', 'std'))
REACH_AGAIN = 0.3  # of the spacing: how near to where its neighbors say a lost target is sought
MOST_PASSES = 3  # over a frame, while lost targets are found again
NEAR_CLAMP = 4  # targets that can hardly move, but with the camera
OFF_ALONG, OFF_ASIDE = 0.1, 0.5  # spacings from their place, more with each: stretch and bend
LONGEST_PREDICTION = 0.5  # s since the last frame, beyond which velocities tell nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowedRow:
    """A row of targets as it was in a frame, from which the next one is predicted.

    pixels (targets, 2): where each target was, or must have been; velocity (targets, 2) px/s;
    area (targets,): how large each is to be expected, px^2; seen (targets,): whether it was.
    """

    stamp_ns: int
    pixels: Array
    velocity: Array
    area: Array
    seen: Mask

    @property
    def spacing(self) -> float:
        """Return the distance of neighbors, px."""
        return float(np.median(np.hypot(*np.diff(self.pixels, axis=0).T)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenRow:
    """The targets in a frame, NaN where one is not seen.

    measured (7, targets): rows named in MEASURED, px and rad; points (targets, 2) m in base.
    """

    measured: Array
    points: Array

    @property
    def seen(self) -> int:
        """How many targets are seen."""
        return int(np.count_nonzero(np.isfinite(self.points[:, 0])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A frame with all that is needed to look at it."""

    image: Image
    lens: Lens
    plane: Plane
    arclength: Array
    clamp_angle: float
    settings: CameraSettings

    def points(self, pixels: Array) -> Array:
        """Return points (n, 2) m in base of pixels (n, 2); NaN where there is none."""
        return self.plane.points(self.lens.undistorted(pixels))

    def pixels(self, points: Array) -> Array:
        """Return pixels (n, 2) of points (n, 2) m in base; NaN where there is none."""
        return self.lens.distorted(self.plane.normalized(points))

    def measured(self, around: Array, reach: float, area: Array) -> Array:
        """Return what is nearest to these pixels (n, 2), NaN where nothing is; (7, n).

        reach: px, from there to the center at most; area (n,) px^2: how large it should be.
        """
        size = math.sqrt(4.0 / math.pi * float(area.max()))
        settings = self.settings
        found = measure_areas(self.image, around, reach, size, settings.grey_band, settings.area)
        return found.table[: len(MEASURED)].copy()


def follow(view: View, row: FollowedRow) -> SeenRow | None:
    """Find the row near where it must be by now; None where it is lost."""
    seconds = seconds_between(row.stamp_ns, view.image.stamp_ns)
    predicted = row.pixels
    if seconds <= LONGEST_PREDICTION:
        predicted = row.pixels + seconds * row.velocity
    spacing = row.spacing
    measured = view.measured(predicted, view.settings.gate * spacing, row.area)
    seen = checked(view, as_predicted(measured, predicted, row), row.area, math.inf)
    for _ in range(MOST_PASSES):
        lost = np.isnan(seen.points[:, 0])
        if not lost.any() or seen.seen < 2:
            break
        x, y = expected(*columns(seen.points), view.arclength)
        again = view.pixels(np.column_stack([x[lost], y[lost]]))
        measured = seen.measured.copy()
        measured[:, lost] = view.measured(again, REACH_AGAIN * spacing, row.area[lost])
        more = checked(view, as_predicted(measured, predicted, row), row.area, math.inf)
        if more.seen <= seen.seen:
            break
        seen = more
    if seen.seen < LEAST_TARGETS or not at_clamp(view, seen):
        return None
    return seen


def as_predicted(measured: Array, predicted: Array, row: FollowedRow) -> Array:
    """Return what was measured (7, targets), NaN where a target has moved as no neighbor has.

    predicted (targets, 2) px; this is asked of targets only that were seen in the last frame.
    """
    off_x, off_y = np.where(row.seen, measured[:2] - predicted.T, np.nan)
    together = moved_together(off_x, off_y, row.spacing)
    measured[:, row.seen & ~together] = np.nan
    return measured


def search(view: View) -> SeenRow | Failure:
    """Find the row that starts at the clamp among all bright areas of the frame."""
    areas = bright_areas(view.image, view.settings)
    if isinstance(areas, Failure):
        return areas
    points = view.points(np.column_stack([areas.u, areas.v]))
    usable = np.flatnonzero(np.isfinite(points[:, 0]))
    row = row_from_clamp(points[usable], areas.area[usable], view.arclength, view.clamp_angle)
    chosen = np.where(row.chosen >= 0, usable[row.chosen] if usable.size else -1, -1)
    measured = areas.table[: len(MEASURED), chosen]
    measured[:, chosen < 0] = np.nan
    seen = checked(view, measured, usual_size(measured[AREA]), FARTHEST)
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


def checked(view: View, measured: Array, usual: Array, farthest: float) -> SeenRow:
    """Return those of the targets (7, targets) that make a believable row.

    usual (targets,): how large they are compared with each other, px^2.
    """
    alike = look_alike(measured[AREA], usual, measured[MAJOR] / measured[MINOR])
    measured[:, ~alike] = np.nan
    points = view.points(measured[:2].T)
    seen = believable(*columns(points), view.arclength, farthest)
    measured[:, ~seen] = np.nan
    points[~seen] = np.nan
    return SeenRow(measured=freeze(measured), points=freeze(points))


def columns(points: Array) -> tuple[Array, Array]:
    """Return x and y of points (n, 2), as kernels take them."""
    x, y = np.ascontiguousarray(points.T)
    return x, y


def at_clamp(view: View, seen: SeenRow) -> bool:
    """Whether the first target that is seen, if it is near the clamp, is where it must be."""
    first = int(np.isfinite(seen.points[:, 0]).argmax())
    if first >= NEAR_CLAMP:
        return True
    spacing = view.arclength[1] - view.arclength[0]
    x, y = rotate(-view.clamp_angle, *seen.points[first].tolist())
    allowed = (1.0 + first) * spacing
    off_along = abs(math.hypot(x, y) - view.arclength[first])
    return bool(off_along <= OFF_ALONG * allowed and abs(y) <= OFF_ASIDE * allowed)


def followed(view: View, seen: SeenRow, before: FollowedRow | None) -> FollowedRow:
    """Return the row as the next frame needs it; before: the row of the frame before, if any."""
    stamp_ns = view.image.stamp_ns
    x, y = expected(*columns(seen.points), view.arclength)
    pixels = np.ascontiguousarray(seen.measured[:2].T)
    lost = np.isnan(pixels[:, 0])
    if lost.any():
        pixels[lost] = view.pixels(np.column_stack([x[lost], y[lost]]))
    velocity = np.zeros_like(pixels)
    both = ~lost & (False if before is None else before.seen)
    if before is not None and both.any():
        moved = (pixels - before.pixels)[both] / seconds_between(before.stamp_ns, stamp_ns)
        for axis in range(2):
            velocity[:, axis] = np.interp(view.arclength, view.arclength[both], moved[:, axis])
    area = usual_size(seen.measured[AREA], None if before is None else before.area)
    return FollowedRow(
        stamp_ns=stamp_ns,
        pixels=freeze(pixels),
        velocity=freeze(velocity),
        area=freeze(area),
        seen=~lost,
    )


def sightings(view: View, seen: SeenRow) -> TargetSightings:
    """Return what is published of the targets that are seen."""
    normalized = view.lens.undistorted(seen.measured[:2].T)
    meters_per_pixel = view.lens.scale(normalized) * view.plane.scale(normalized)
    values = dict(zip(MEASURED, seen.measured, strict=True))
    values['std'] = seen.measured[STD] * meters_per_pixel
    x, y = seen.points.T
    return TargetSightings(stamp_ns=view.image.stamp_ns, x=x, y=y, **values)
