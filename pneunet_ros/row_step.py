"""What a frame makes of a row: which targets are believed, where they are, what comes next.

Compiled as a whole, as it is done for every frame. Rows are those of `area_kernels`, one per
target. `optics` are the lens and the working plane: coefficients and limit of the lens, homography
into the base frame and back.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.area_kernels import AREA, MAJOR, MINOR, STD, U, V
from pneunet_ros.camera import magnification, project
from pneunet_ros.lens_kernels import distort_points, magnify_points, undistort_points
from pneunet_ros.shape import Array
from pneunet_ros.solver.compiled import kernel
from pneunet_ros.tracking import believable, expected, look_alike, Mask, moved_together

Optics = tuple[Array, float, Array, Array]

FOLLOWING = 0.1  # share of a new area in the area that is expected next


@kernel
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
def next_row(
    rows: Array,
    points: Array,
    arclength: Array,
    optics: Optics,
    last_pixels: Array,
    last_seen: Mask,
    last_area: Array,
    seconds: float,
) -> tuple[Array, Array, Array, Mask, float]:
    """Return what the next frame starts from: pixels, velocity, usual area, who is seen, spacing.

    last_*: the same of the last frame, `seconds` ago; without one nobody was seen in it. Targets
    that are not seen are where the others say, and move as those next to them.
    """
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
