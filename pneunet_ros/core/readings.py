"""Sensor readings: immutable, SI, stamped in integer nanoseconds of the message header.

A reading is stored unchanged. The estimator interprets it (gauge or absolute, sign and yaw of a
force sensor, sensing effects of the model).
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.frames import Quaternion


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureReading:
    """A pressure reading: Pa as reported by the sensor; `variance` in Pa^2, 0 = unknown."""

    stamp_ns: int
    pressure: float
    variance: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchReading:
    """An end load reading: force (N) and moment about z (N m) in the frame `frame_id`.

    Out-of-plane components come last; NaN if not measured.
    """

    stamp_ns: int
    force_x: float
    force_y: float
    moment: float
    frame_id: str
    force_z: float = 0.0
    moment_x: float = 0.0
    moment_y: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TipPoseReading:
    """Position (m) and heading (rad) of the tip in the frame `frame_id`; NaN: unknown."""

    stamp_ns: int
    x: float
    y: float
    heading: float
    frame_id: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuReading:
    """A reading of an IMU at the base: specific force (m/s^2) in its `frame_id`.

    At rest, the specific force is 9.81 m/s^2 upwards. known: whether the sensor reports that it
    measures acceleration. rate: angular velocity (rad/s), NaN if it is not measured. variance: of
    each component of the force, 0 = unknown.
    """

    stamp_ns: int
    x: float
    y: float
    z: float
    frame_id: str
    known: bool = True
    rate: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    variance: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReading:
    """Rotation of a frame in its parent: unit quaternion x, y, z, w; fixed: whether static."""

    stamp_ns: int
    frame_id: str
    parent: str
    quaternion: Quaternion
    fixed: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetSightings:
    """Seen positions of the targets on the arm: one entry per target, in order along the arm.

    x, y, std (targets,) m in the base frame, std per axis; u, v px in the raw image; area px^2,
    largest and smallest axis major, minor (px) and angle (rad, of the major axis in the image from
    +u towards +v) of the white area. NaN in all of them where a target was not seen.
    """

    stamp_ns: int
    x: Array
    y: Array
    std: Array
    u: Array
    v: Array
    area: Array
    major: Array
    minor: Array
    angle: Array

    def __post_init__(self) -> None:
        """Check that there is one entry per target."""
        shape = (len(self.x),)
        for name in ('x', 'y', 'std', 'u', 'v', 'area', 'major', 'minor', 'angle'):
            given = getattr(self, name)
            values = frozen_array(given, shape)
            if values is not given:
                object.__setattr__(self, name, values)

    @property
    def seen(self) -> int:
        """Number of targets seen."""
        return int(np.count_nonzero(np.isfinite(self.x)))


def unseen_targets(stamp_ns: int, count: int) -> TargetSightings:
    """Return the sightings of a frame in which none of the targets is seen."""
    unseen = freeze(np.full(count, np.nan))
    values = dict.fromkeys(('x', 'y', 'std', 'u', 'v', 'area', 'major', 'minor', 'angle'), unseen)
    return TargetSightings(stamp_ns=stamp_ns, **values)


Reading = PressureReading | WrenchReading
BaseReading = ImuReading | tuple[FrameReading, ...]  # gives the direction of gravity
