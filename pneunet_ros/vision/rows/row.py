"""A row of targets as observed in a frame, and its prediction for the next frame.

Tables of blobs have one row per target, with the columns of `centroid`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.units import seconds_between
from pneunet_ros.vision.dots.centroid import (
    ANGLE,
    AREA,
    axes_of,
    BLUR,
    COLUMNS,
    MAJOR,
    MINOR,
    outlines,
    U,
    V,
)
from pneunet_ros.vision.gating import Mask
from pneunet_ros.vision.rows.view import View
from pneunet_ros.vision.settings import VisionSettings

LONGEST_PREDICTION = 0.1  # s, longest extrapolation of velocities: later the arm may have reversed

# Causes of an unseen target of a found row, in messages that begin with "target N: ".
CAUSES = {
    'no_dot': 'nothing at its position looks like a dot: it is covered, out of focus, outside '
    'the image, or has too little contrast (grey_band, area)',
    'size': 'the dot at its position has become smaller: it is partly covered, or a glint '
    'touches it',
    'motion': 'the area at its position does not move like its neighbors: it is partly covered, '
    'or there is a glint next to it',
    'place': (
        'the area near its position is off the row: is its entry in target_arclength right?'
    ),
    'other': 'the dot at its position is a target of another arm',
    'part': 'too little of its edge is visible to locate its center',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackedRow:
    """State of the row of targets in a frame, from which the next frame is predicted.

    pixels (targets, 2): observed or predicted positions; velocity (targets, 2) px/s, and
    velocity_std (targets,): one sigma per axis at this frame, infinite if unknown; area
    (targets,): expected areas, px^2; table (targets, columns): appearance when last seen, NaN if
    never; seen (targets,): whether seen in this frame; sized (targets,): whether the area was
    measured on the target itself; spacing: distance of neighbors, px; exposure: estimated exposure
    time, s, 0 if unknown.
    """

    stamp_ns: int
    pixels: Array
    velocity: Array
    velocity_std: Array
    area: Array
    table: Array
    seen: Mask
    sized: Mask
    spacing: float
    exposure: float

    def predict(self, stamp_ns: int) -> Array:
        """Return the predicted targets at a stamp, (targets, 2) px."""
        seconds = min(seconds_between(self.stamp_ns, stamp_ns), LONGEST_PREDICTION)
        return np.asarray(self.pixels + seconds * self.velocity)

    def outlines(self, places: Array, vision: VisionSettings) -> Array:
        """Return predicted outlines of targets with unchanged appearance; places (n, 2) px."""
        blobs, smear = vision.blobs, self.exposure * self.velocity
        stds = blobs.smear_std + blobs.shape_std * np.hypot(*smear.T)
        return outlines(
            places,
            axes_of(self.table),
            self.table[:, BLUR],
            smear,
            (np.full(len(places), blobs.shape_std), blobs.blur_std, stds),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObservedRow:
    """The targets in a frame, NaN where one is not seen.

    table (targets, columns): measurements in the image, with the columns of `centroid`; points
    (targets, 2) m in base; std (targets,) m; seen: number of seen targets; causes (targets,): why
    a target is not seen, empty if it is.
    """

    table: Array
    points: Array
    std: Array
    seen: int
    causes: tuple[str, ...]

    @property
    def missing(self) -> dict[int, str]:
        """Targets that are not seen, with the cause, a key of CAUSES."""
        return {target: cause for target, cause in enumerate(self.causes) if cause}


def target_sightings(view: View, row: ObservedRow) -> TargetSightings:
    """Return the sightings to publish."""
    table = np.empty((COLUMNS + 2, len(row.table)))
    table[:COLUMNS], table[COLUMNS:] = row.table.T, row.points.T
    freeze(table)
    return TargetSightings(
        stamp_ns=view.image.stamp_ns,
        x=table[COLUMNS],
        y=table[COLUMNS + 1],
        std=freeze(row.std),
        u=table[U],
        v=table[V],
        area=table[AREA],
        major=table[MAJOR],
        minor=table[MINOR],
        angle=table[ANGLE],
    )
