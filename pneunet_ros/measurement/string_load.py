"""End load of a string from the seen tip to its anchor, frame by frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.string import radius_of, String

CURVE = 3  # last targets whose curve is extrapolated to the tip


def with_string(run: RecordingData, arm: Arm, string: String) -> tuple[RecordingData, int]:
    """Return a run under the load of a string, and the number of frames without a seen tip.

    Those frames are left out. Raises RecordingError if no frame shows the tip, and RequestError if
    the eye lies on the arm.
    """
    string.check_clearance(run.x, run.y, radius_of(arm))
    places, points = arm.target_arclength, run.points
    tips = tips_of(points, places, arm.reach)
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


def tips_of(points: Array, places: Array, reach: float) -> Array:
    """Return the tip position (frames, 2) m from points (frames, 2, targets) m; NaN if unknown.

    places (targets,): arclength (m) of the targets; reach: arclength (m) of the tip. If the last
    target is not at the tip, the curve through the last three is extrapolated.
    """
    last = places[-CURVE:] - reach
    if places.size < CURVE or last[-1] == 0.0:
        return np.array(points[:, :, -1])
    other_nodes = [np.delete(last, k) for k in range(CURVE)]
    weights = [
        np.prod(-other) / np.prod(one - other)
        for one, other in zip(last, other_nodes, strict=True)
    ]
    return np.array(points[:, :, -CURVE:] @ np.array(weights))
