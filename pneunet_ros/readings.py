"""What the sensors said: immutable, SI, stamped in integer nanoseconds of the message header.

A reading is kept as it came. What it means (gauge or absolute, sign and yaw of a force sensor,
sensing effects of the model) is the estimator's business.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureReading:
    """A pressure reading: Pa as the sensor reports it; `variance` in Pa^2, 0 = unknown."""

    stamp_ns: int
    pressure: float
    variance: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchReading:
    """An end load reading: force (N) and moment about z (N m) in the frame `frame_id`."""

    stamp_ns: int
    force_x: float
    force_y: float
    moment: float
    frame_id: str


Reading = PressureReading | WrenchReading
