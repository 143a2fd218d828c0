"""The measured pose of the tip: its position acts as a target, its heading as one number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

AT_TIP = 1e-6  # of the length: largest distance of a target that counts as the tip


def with_tip_target(
    arm: Arm, runs: Sequence[RecordingData], *, always: bool = False
) -> tuple[Arm, list[RecordingData]]:
    """Append the tip as the last target of arm and runs, if any run has its pose.

    A target painted at the tip keeps its own detections, and uses the pose in frames without one.
    always: append even if no run has a pose, so that the targets match another calibration.
    """
    if not always and all(run.tip_pose is None for run in runs):
        return arm, list(runs)
    painted = has_tip_target(arm)
    if not painted:
        places = np.append(arm.target_arclength, arm.reach)
        arm = replace(arm, target_arclength=places, covariance=None)
    return arm, [add_tip(run, painted=painted) for run in runs]


def has_tip_target(arm: Arm) -> bool:
    """Whether the last target is painted at the tip."""
    places = arm.target_arclength
    return places.size > 0 and bool(arm.reach - places[-1] <= AT_TIP * arm.length)


def add_tip(run: RecordingData, *, painted: bool) -> RecordingData:
    """Return a run with the position of the tip as its last target."""
    frames = len(run.stamp_ns)
    pose = np.full((frames, 3), np.nan) if run.tip_pose is None else run.tip_pose
    if painted:
        unseen = ~run.seen[:, -1]
        x, y = np.array(run.x), np.array(run.y)
        x[unseen, -1], y[unseen, -1] = pose[unseen, 0], pose[unseen, 1]
    else:
        x = np.column_stack([run.x, pose[:, 0]])
        y = np.column_stack([run.y, pose[:, 1]])
    half = np.isfinite(x) != np.isfinite(y)
    x[half] = y[half] = np.nan
    return replace(run, x=x, y=y)


def heading_residual(measured: Array, predicted: Array) -> Array:
    """Return measured minus predicted headings (rad), within half a turn."""
    return np.asarray((measured - predicted + np.pi) % (2.0 * np.pi) - np.pi)
