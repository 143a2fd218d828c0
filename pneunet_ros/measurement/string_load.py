"""End load of a string from the measured tip to its anchor, frame by frame."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.string import radius_of, String

FEWEST = 3  # last targets that must be seen, or the tip itself
# Arm lengths: targets so close to the soft end determine the tangent there. With targets every 5
# mm, at the largest curvature of the paper's arm, curvature and noise then cause about equal
# errors of the tip.
TANGENT = 0.25


def with_string(run: RecordingData, arm: Arm, string: String) -> tuple[RecordingData, int]:
    """Return a run under the load of a string, and the number of frames without a visible tip.

    These frames are dropped. Raises RecordingError if no frame shows the tip, and RequestError if
    the eye lies on the arm.
    """
    string.check_clearance(run.x, run.y, radius_of(arm))
    tips = tips_of(run.points, arm)
    if run.tip_pose is not None:
        measured = np.isfinite(run.tip_pose[:, :2]).all(axis=1)
        tips[measured] = run.tip_pose[measured, :2]
    known = np.flatnonzero(np.isfinite(tips).all(axis=1))
    if not known.size:
        raise RecordingError(
            f'{run.name}: no frame shows the tip, to which the string is tied (the last target '
            'must be seen, or the last three if none is at the tip)',
            reason='no_tip',
        )
    kept = run.subset(known).with_end_load(0.0, 0.0)
    return replace(kept, force=string.pull(tips[known])), len(run.stamp_ns) - known.size


def tips_of(points: Array, arm: Arm) -> Array:
    """Return the tip position (frames, 2) m from points (frames, 2, targets) m; NaN if unknown.

    If the last target is not at the tip, a parabola through the last targets is extrapolated to
    the soft end, and its tangent there to the end of the cap.
    """
    places = arm.target_arclength
    if places.size and math.isclose(places[-1], arm.reach):
        return np.array(points[:, :, -1])
    tips = np.full((len(points), 2), np.nan)
    if places.size < FEWEST:
        return tips
    near = np.searchsorted(places, (1.0 - TANGENT) * arm.length)
    first = min(int(near), places.size - FEWEST)
    beyond = places[first:] - arm.length
    curve = np.stack([np.ones(beyond.size), beyond, np.minimum(beyond, 0.0) ** 2], axis=1)
    tip = np.array([1.0, arm.tip_cap, 0.0])
    points = points[:, :, first:]
    seen = np.asarray(np.isfinite(points).all(axis=1))
    enough = seen[:, -FEWEST:].all(axis=1)
    for shown in np.unique(seen[enough], axis=0):
        frames = enough & np.asarray(seen == shown).all(axis=1)
        tips[frames] = points[frames][:, :, shown] @ (tip @ np.linalg.pinv(curve[shown]))
    return tips
