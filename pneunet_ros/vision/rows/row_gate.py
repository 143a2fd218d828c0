"""Gating of blobs as targets of the row, and predicted positions of the others."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.vision.dots.centroid import AREA, MAJOR, MINOR, STD, U
from pneunet_ros.vision.gating import (
    consistent_motion,
    consistent_size,
    consistent_spacing,
    expected_points,
    FARTHEST,
    Mask,
)
from pneunet_ros.vision.rows.row import ObservedRow, TrackedRow
from pneunet_ros.vision.rows.view import View

NEAR_CLAMP = 4  # targets that hardly move unless the camera moves


def gate_row(
    view: View,
    table: Array,
    usual: Array,
    last: TrackedRow | None = None,
    parts: Mask | None = None,
    causes: tuple[str, ...] | None = None,
) -> ObservedRow:
    """Return the blobs of a table accepted as targets.

    usual (targets,) px^2: sizes relative to each other; parts (targets,): mask of targets measured
    from a part, with the size of their neighbors; causes: why some targets are not in the table.
    Targets seen in the last row must have moved like their neighbors; without a last row, the end
    targets must be near the others.
    """
    table, gating = table.copy(), view.vision.gating
    there, taken = np.isfinite(table[:, U]), view.is_taken(table)
    why = np.array(causes or ('',) * len(table), dtype='U8')
    why[there] = ''
    table[taken], why[taken] = np.nan, 'other'
    why[~there & (why == '')] = 'no_dot'
    farthest = FARTHEST
    if last is not None:
        off = table[:, :2] - last.predict(view.image.stamp_ns)
        off[~last.seen] = np.nan
        alone = consistent_motion(off, last.spacing, gating)[1]
        table[alone], why[alone] = np.nan, 'motion'
        farthest = math.inf
    normalized = view.dot_centers(table)
    points = view.plane.points(normalized)
    sized = consistent_size(table[:, AREA], usual, table[:, MAJOR] / table[:, MINOR], gating)
    if parts is not None:
        sized |= parts
    points[~sized] = np.nan
    why[~sized & (why == '')] = 'size'
    x, y = np.ascontiguousarray(points.T)
    seen = consistent_spacing(x, y, view.arclength, farthest, DOMAIN.stretch)
    std = table[:, STD] * view.lens.scale(normalized) * view.plane.scale(normalized)
    table[~seen] = points[~seen] = std[~seen] = np.nan
    why[~seen & (why == '')] = 'place'
    return ObservedRow(
        table=table,
        points=points,
        std=std,
        seen=int(np.count_nonzero(seen)),
        causes=tuple(why.tolist()),
    )


def expected_pixels(view: View, points: Array) -> Array:
    """Return the predicted positions of all targets from those seen, (targets, 2) px.

    points (targets, 2) m in base, NaN where a target is not seen.
    """
    x, y = np.ascontiguousarray(points.T)
    expected = np.column_stack(expected_points(x, y, view.arclength))
    return view.lens.distort(view.plane.normalized(expected))


def is_at_clamp(view: View, points: Array) -> bool:
    """Whether the first seen target, if near the clamp, is at a possible position."""
    arclength = view.arclength
    seen = np.flatnonzero(np.isfinite(points[:NEAR_CLAMP, 0]))
    if not seen.size:
        return True
    first = int(seen[0])
    x, y = points[first].tolist()
    allowed = (1.0 + first) * float(arclength[1] - arclength[0])
    off = abs(math.hypot(x, y) - float(arclength[first]))
    return off <= view.vision.row_tracker.off_along * allowed
