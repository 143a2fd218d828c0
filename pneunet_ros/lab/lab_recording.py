"""Output of the virtual lab: simulated sensor readings and ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.lab.lab_effect import Past
from pneunet_ros.lab.moving_arm import MotionTruth
from pneunet_ros.lab.scenario import Scenario

Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabMemory:
    """Memory of an arm: lab time (s), pressure (Pa), and states of effects."""

    time: float
    pressure: float
    past: Mapping[str, Past]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabTruth:
    """The truth behind the frames of a recording, in the base frame, SI.

    time (frames,) s since the beginning; pressure at the sensor and in the chamber (frames,);
    force (frames, 2), moment (frames,); target_x, target_y (frames, targets), positions of the
    painted targets; x, y, theta, curvature, intrinsic_curvature (frames, stations) at arclength
    (stations,): curvatures per unstretched length, the intrinsic one with creep. registration
    (2,), drift (frames, 2): displacement of the whole image; placement (targets, 2): offsets of
    targets from their nominal positions, along and across the arm.
    """

    time: Array
    pressure: Array
    chamber_pressure: Array
    force: Array
    moment: Array
    target_x: Array
    target_y: Array
    arclength: Array
    x: Array
    y: Array
    theta: Array
    curvature: Array
    intrinsic_curvature: Array
    registration: Array
    placement: Array
    drift: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabRecording:
    """A recording of the virtual lab: readings and truth.

    reading_stamp_ns, pressure (readings,): all pressure readings; wrench_stamp_ns, wrench_force
    (wrenches, 2), wrench_moment (wrenches,): all wrench readings, none if the arm is never loaded
    (`loaded` is False); stamp_ns (frames,), x, y (frames, targets): frames, NaN where a target was
    not seen. motion: additional truth of an arm with mass. imu_stamp_ns, imu (n, 4): specific
    force (m/s^2) and angular velocity about z (rad/s) at the clamp, in the base frame.
    """

    scenario: Scenario
    loaded: bool
    reading_stamp_ns: Stamps
    pressure: Array
    wrench_stamp_ns: Stamps
    wrench_force: Array
    wrench_moment: Array
    stamp_ns: Stamps
    x: Array
    y: Array
    truth: LabTruth
    memory: LabMemory
    motion: MotionTruth | None = None
    imu_stamp_ns: Stamps = field(default_factory=lambda: np.zeros(0, np.int64))
    imu: Array = field(default_factory=lambda: np.zeros((0, 4)))
