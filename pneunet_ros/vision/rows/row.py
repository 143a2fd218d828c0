"""A row of targets as a frame shows it, and as the next frame is expected to.

Tables of blobs have one line per target with the columns of `centroid`.
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

# Why a target of a row that was found is not seen, as a person reads it after "target N: ".
CAUSES = {
    'no_dot': 'nothing at its place looks like a dot: it is covered, out of focus, out of the '
    'picture, or stands out too little (grey_band, area)',
    'size': 'the dot at its place is not as large as it was: it is partly covered, or a glint '
    'touches it',
    'motion': 'the area at its place does not move like its neighbors: it is partly covered, '
    'or a glint is beside it',
    'place': ('the area near its place is off the row: is its entry in target_arclength right?'),
    'other': 'the dot at its place is a target of another arm',
    'part': 'too little of its edge is visible to locate its center',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackedRow:
    """A row of targets as it was in a frame, from which the next one is predicted.

    pixels (targets, 2): where each target was, or must have been; velocity (targets, 2) px/s, and
    velocity_std (targets,): one sigma of it per axis at this frame, infinite if it is unknown;
    area (targets,): how large each is to be expected, px^2; table (targets, columns): how each
    looked when it was last seen, NaN of one that never was; seen (targets,): whether it was;
    sized (targets,): whether its area is its own, as it has shown it;
    spacing: distance of neighbors, px; exposure: how long the shutter seems to be open, s,
    0 where nothing is known of it.
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

    def predict(self, stamp_ns: int, longest: float) -> Array:
        """Return the predicted targets at a stamp, (targets, 2) px.

        longest: how long (s) their velocities tell anything.
        """
        seconds = seconds_between(self.stamp_ns, stamp_ns)
        return np.asarray(self.pixels + min(seconds, longest) * self.velocity)

    def outlines(self, places: Array, vision: VisionSettings) -> Array:
        """Return the predicted outlines of targets with unchanged looks; places (n, 2) px."""
        blobs, smear = vision.blobs, self.exposure * self.velocity
        stds = blobs.smear_std + vision.row_tracker.smear_std * np.hypot(*smear.T)
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

    table (targets, columns): what was measured in the image, in the columns of `centroid`;
    points (targets, 2) m in base; std (targets,) m; seen: how many are; causes (targets,): why
    each is not seen, empty if it is.
    """

    table: Array
    points: Array
    std: Array
    seen: int
    causes: tuple[str, ...]

    @property
    def missing(self) -> dict[int, str]:
        """Targets that are not seen, and why: a key of CAUSES."""
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
