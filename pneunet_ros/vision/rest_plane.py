"""Scale and base frame from the arm at rest, the paper's way: its row of targets is straight.

Some frames are averaged. What is looked for has the number and spacing of the targets and nothing
more, as neither its place nor its scale is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.association import rows_anywhere, share_of_blobs, TargetRow
from pneunet_ros.vision.gating import consistent_spacing, gating_numbers
from pneunet_ros.vision.settings import RestPlaneSettings, VISION, VisionSettings
from pneunet_ros.vision.working_plane import Plane, plane_from_rest

RESTING = 'resting'  # reason of a frame that is averaged, in which all is well


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestAverage:
    """Where the ends of the row are on average, normalized, and over how many frames."""

    frames: int = 0
    ends: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def with_frame(
        self, ends: Array, spacing: float, settings: RestPlaneSettings = VISION.rest_plane
    ) -> RestAverage:
        """Return the average with one more frame (2, 2); it begins anew where the arm moved."""
        if self.frames and np.hypot(*(ends - self.ends).T).max() > settings.still * spacing:
            return RestAverage(frames=1, ends=ends)
        frames = self.frames + 1
        return RestAverage(frames=frames, ends=self.ends + (ends - self.ends) / frames)

    def plane(self, arclength: Array) -> Plane:
        """Return the working plane; arclength (targets,) m."""
        return plane_from_rest(
            self.ends[0], self.ends[1], float(arclength[0]), float(arclength[-1])
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Why a frame does not show the arm: a key for counting, a sentence for a person."""

    reason: str
    sentence: str


def row_at_rest(
    points: Array,
    pixels: Array,
    areas: Array,
    arclength: Array,
    clamp_pixel: tuple[float, float] | None,
    straightness: float,
    vision: VisionSettings = VISION,
) -> TargetRow | Failure:
    """Find the straight row of targets among blobs, first target at the clamp.

    points (blobs, 2) normalized; pixels (blobs, 2); areas (blobs,) px^2; arclength (targets,) m;
    clamp_pixel: (u, v) of the first target, None for the left-most end; straightness: largest
    distance from the line between the ends, of its length.
    """
    count = arclength.size
    rows = rows_anywhere(points, areas, arclength, vision.association, vision.beam_search)
    rows = [row for row in rows if _is_regular(row_points(row, points), arclength, vision)]
    if clamp_pixel is not None and rows:
        near = vision.rest_plane.near_clamp
        rows = [row for row in rows if _begins_at(row_points(row, pixels), clamp_pixel, near)]
        if not rows:
            return Failure(
                reason='wrong_clamp',
                sentence=f'no row of {count} targets begins at clamp_pixel {list(clamp_pixel)}',
            )
    if not rows:
        return Failure(
            reason='no_row',
            sentence=f'no row of {count} targets at their distances among {len(points)} bright '
            'areas: is the whole arm in view, straight, and are target_arclength, grey_band and '
            'area right?',
        )
    best = rows[0]
    if any(share_of_blobs(row, best) == 0.0 for row in rows):
        return Failure(
            reason='several_rows',
            sentence=f'there is more than one row of {count} targets: give clamp_pixel, or take '
            'the others out of view',
        )
    if clamp_pixel is None:
        best = min(rows, key=lambda row: float(pixels[row.chosen[0], 0]))
    off = bow(points[best.chosen[best.chosen >= 0]])
    if off > straightness:
        return Failure(
            reason='not_straight',
            sentence=f'the arm is not straight: a target is {off:.1%} of the length off the line '
            f'between the ends, {straightness:.1%} is allowed (rest_straightness); scale and base '
            'frame come from the arm at rest',
        )
    return best


def bow(points: Array) -> float:
    """Return the largest distance of points (n, 2) from the line of its ends, in its length."""
    way = points[-1] - points[0]
    off = (points - points[0]) @ np.array([-way[1], way[0]])
    return float(np.abs(off).max() / (way @ way))


def row_points(row: TargetRow, points: Array) -> Array:
    """Return the points of a row (targets, 2), NaN where a target is missing."""
    found = np.where(row.chosen[:, None] >= 0, points[row.chosen], np.nan)
    return np.asarray(found)


def _is_regular(points: Array, arclength: Array, vision: VisionSettings) -> bool:
    """Whether enough targets of a row, both ends among them, lie on a smooth line (targets, 2)."""
    length = float(arclength[-1] - arclength[0])
    size = math.hypot(*(points[-1] - points[0]))
    if not size > 0.0:
        return False
    x, y = np.ascontiguousarray(points.T) * (length / size)
    gating = gating_numbers(vision.gating)
    seen = consistent_spacing(x, y, arclength, gating.farthest, gating)
    least = vision.rest_plane.seen * arclength.size
    return bool(seen[0] and seen[-1] and np.count_nonzero(seen) >= least)


def _begins_at(pixels: Array, clamp_pixel: tuple[float, float], near: float) -> bool:
    """Whether the first target of a row (targets, 2) is at the clamp, to `near` spacings."""
    steps = np.hypot(*np.diff(pixels, axis=0).T)
    away = math.hypot(*(pixels[0] - np.array(clamp_pixel)))
    return bool(away <= near * np.nanmedian(steps))
