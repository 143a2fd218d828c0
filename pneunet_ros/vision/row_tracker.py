"""What a frame makes of a row: which targets are believed, where they are, what comes next.

Compiled as a whole, as it is done for every frame. Rows are those of `weighing`, one per
target. `optics` are the lens and the working plane: coefficients and limit of the lens, homography
into the base frame and back.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import kernel, part
from pneunet_ros.vision.association import LEAST_TARGETS
from pneunet_ros.vision.background import Picture
from pneunet_ros.vision.blob_kernels import Look, nearest_areas
from pneunet_ros.vision.camera_kernels import distort_points, magnify_points, undistort_points
from pneunet_ros.vision.centroid import AREA, COLUMNS, MAJOR, MINOR, STD, U, V
from pneunet_ros.vision.gating import believable, expected, look_alike, Mask, moved_together
from pneunet_ros.vision.working_plane import magnification, project

Optics = tuple[Array, float, Array, Array]

# Pixels, velocity, usual area, who is seen, spacing: see `sighting.FollowedRow`.
Followed = tuple[Array, Array, Array, Mask, float]

FOLLOWING = 0.1  # share of a new area in the area that is expected next
REACH_AGAIN = 0.3  # of the spacing: how near to where its neighbors say a lost target is sought
MOST_PASSES = 3  # over a frame, while lost targets are found again
NEAR_CLAMP = 4  # targets that can hardly move, but with the camera
OFF_ALONG, OFF_ASIDE = 0.1, 0.5  # spacings from their place, more with each: stretch and bend
LONGEST_PREDICTION = 0.1  # s; velocities tell nothing of what comes later


@kernel
def found_row(
    rows: Array, usual: Array, arclength: Array, farthest: float, optics: Optics
) -> tuple[int, Array, Array]:
    """Check a row that was found from nothing: `check_row` where nothing was predicted."""
    nowhere, nobody = np.zeros((len(rows), 2)), np.zeros(len(rows), np.bool_)
    return check_row(rows, nowhere, nobody, usual, 1.0, arclength, farthest, optics)


@part
def check_row(
    rows: Array,
    predicted: Array,
    known: Mask,
    usual: Array,
    spacing: float,
    arclength: Array,
    farthest: float,
    optics: Optics,
) -> tuple[int, Array, Array]:
    """Put NaN into the rows of all targets that are not believed.

    predicted (targets, 2) px: where those that are `known` from the last frame were expected; they
    must have moved as their neighbors. usual (targets,) px^2: how large they are compared with
    each other; spacing: px; farthest: see `believable`. Return how many are seen, their points
    (targets, 2) m in base, and the standard error of these (targets,) m.
    """
    coefficients, limit, into_base, _ = optics
    count = len(rows)
    off = np.full((2, count), np.nan)
    for target in range(count):
        if known[target]:
            off[0, target] = rows[target, U] - predicted[target, 0]
            off[1, target] = rows[target, V] - predicted[target, 1]
    together = moved_together(off[0], off[1], spacing)
    for target in range(count):
        if known[target] and not together[target]:
            rows[target] = np.nan
    alike = look_alike(rows[:, AREA].copy(), usual, rows[:, MAJOR] / rows[:, MINOR])
    normalized = rows[:, :2].copy()
    undistort_points(normalized, coefficients, limit)
    points = normalized.copy()
    project(points, into_base)
    for target in range(count):
        if not alike[target]:
            points[target] = np.nan
    seen = believable(points[:, 0].copy(), points[:, 1].copy(), arclength, farthest)
    per_pixel, per_normalized = np.empty(count), np.empty(count)
    magnify_points(normalized, coefficients, limit, per_pixel)
    magnification(normalized, into_base, per_normalized)
    std = rows[:, STD] * per_pixel * per_normalized
    total = 0
    for target in range(count):
        if seen[target]:
            total += 1
        else:
            rows[target] = np.nan
            points[target] = np.nan
            std[target] = np.nan
    return total, points, std


@kernel
def pixels_of(x: Array, y: Array, optics: Optics) -> Array:
    """Return the pixels (n, 2) of points in base (m), NaN where there is none."""
    coefficients, limit, _, from_base = optics
    pixels = np.column_stack((x, y))
    project(pixels, from_base)
    distort_points(pixels, coefficients, limit)
    return pixels


@kernel
def follow_row(
    picture: Picture,
    look: Look,
    before: Followed,
    seconds: float,
    gate: float,
    arclength: Array,
    clamp_angle: float,
    optics: Optics,
) -> tuple[int, Array, Array, Array, Followed]:
    """Find a row near where it must be, `seconds` after the last frame.

    gate: largest jump of a target, spacings. Return how many targets are seen (0: the row is
    lost), rows, points and standard errors as `check_row`, and what the next frame starts from.
    """
    last_pixels, velocity, usual, known, spacing = before
    predicted = last_pixels + min(seconds, LONGEST_PREDICTION) * velocity
    count = len(predicted)
    size = math.sqrt(4.0 / math.pi * usual.max())
    rows = np.empty((count, COLUMNS))
    rows[:, :2] = predicted
    nearest_areas(picture, look, gate * spacing, size, rows)
    seen, points, std = check_row(
        rows, predicted, known, usual, spacing, arclength, np.inf, optics
    )
    for _ in range(MOST_PASSES):
        if seen == count or seen < 2:
            break
        lost = np.flatnonzero(np.isnan(std))
        x, y = expected(points[:, 0].copy(), points[:, 1].copy(), arclength)
        sought = np.empty((lost.size, COLUMNS))
        sought[:, :2] = pixels_of(x[lost], y[lost], optics)
        nearest_areas(
            picture, look, REACH_AGAIN * spacing, math.sqrt(4.0 / math.pi * usual[lost].max()),
            sought,
        )  # fmt: skip
        again = rows.copy()
        for place in range(lost.size):
            again[lost[place]] = sought[place]
        more, more_points, more_std = check_row(
            again, predicted, known, usual, spacing, arclength, np.inf, optics
        )
        if more <= seen:
            break
        seen, rows, points, std = more, again, more_points, more_std
    if seen < LEAST_TARGETS or not at_clamp(points, arclength, clamp_angle):
        return 0, rows, points, std, before
    return seen, rows, points, std, next_row(rows, points, arclength, optics, before, seconds)


@kernel
def at_clamp(points: Array, arclength: Array, clamp_angle: float) -> bool:
    """Whether the first target that is seen, if it is near the clamp, is where it must be."""
    cosine, sine = math.cos(clamp_angle), math.sin(clamp_angle)
    for first in range(min(NEAR_CLAMP, arclength.size)):
        point_x, point_y = points[first, 0], points[first, 1]
        if math.isnan(point_x):
            continue
        aside = point_y * cosine - point_x * sine
        allowed = (1.0 + first) * (arclength[1] - arclength[0])
        off_along = abs(math.hypot(point_x, point_y) - arclength[first])
        return bool(off_along <= OFF_ALONG * allowed and abs(aside) <= OFF_ASIDE * allowed)
    return True


@kernel
def next_row(
    rows: Array,
    points: Array,
    arclength: Array,
    optics: Optics,
    before: Followed,
    seconds: float,
) -> Followed:
    """Return what the next frame starts from.

    before: the same of the last frame, `seconds` ago; without one nobody was seen in it. Targets
    that are not seen are where the others say, and move as those next to them.
    """
    last_pixels, _, last_area, last_seen, _ = before
    count = len(rows)
    x, y = expected(points[:, 0].copy(), points[:, 1].copy(), arclength)
    guessed = pixels_of(x, y, optics)
    seen = np.isfinite(rows[:, U])
    pixels, area = np.empty((count, 2)), last_area.copy()
    for target in range(count):
        if seen[target]:
            pixels[target] = rows[target, :2]
            area[target] += FOLLOWING * (rows[target, AREA] - area[target])
        else:
            pixels[target] = guessed[target]
    velocity = np.zeros((count, 2))
    both = np.flatnonzero(seen & last_seen)
    if both.size > 0:
        for axis in range(2):
            moved = (pixels[both, axis] - last_pixels[both, axis]) / seconds
            velocity[:, axis] = np.interp(arclength, arclength[both], moved)
    ways = pixels[1:] - pixels[:-1]
    steps = np.hypot(ways[:, 0], ways[:, 1])
    known = steps[np.isfinite(steps)]
    spacing = float(np.median(known)) if known.size > 0 else math.nan
    return pixels, velocity, area, seen, spacing
