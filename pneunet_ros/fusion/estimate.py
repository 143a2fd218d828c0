"""One estimate of shape, tip force and pressure bias, and what of it is known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.fusion.contact import Contact
from pneunet_ros.fusion.force_sensor import ForceSensorFault


class Mode(IntEnum):
    """From what an estimate is made."""

    FUSED = 0
    CAMERA_ONLY = 1
    PREDICTION = 2

    @property
    def sentence(self) -> str:
        """Say it to a person."""
        return MODE_SENTENCES[self]


MODE_SENTENCES = {
    Mode.FUSED: 'targets and pressure',
    Mode.CAMERA_ONLY: 'targets alone: the pressure is too old',
    Mode.PREDICTION: 'pressure alone: no frame of targets lately; the force is held',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedEstimate:
    """Shape, tip force and pressure bias from all sensors that are there; SI, base frame.

    estimate: the shape with its uncertainty, also of the tip. force (2,) N at the tip and its
    force_covariance (2, 2) N^2, NaN in components that are not determined, and everywhere where it
    is ambiguous. contact: along the arm, None where none is likely. pressure_bias (Pa) and its
    std: what the model lacks, as an error of the pressure: creep, hysteresis and a drifting sensor
    look like that. force_sensor: one that is off and not used, None where none is known to be.
    nis: running mean of the normalized innovation squared of frames per coordinate, 1 where all is
    noise, nis_limit what noise rarely exceeds; NaN before the first. target_age: s since the last
    frame that was used, None before the first.
    """

    estimate: ShapeEstimate
    mode: Mode
    force: Array
    force_covariance: Array
    contact: Contact | None
    pressure_bias: float
    pressure_bias_std: float
    force_sensor: ForceSensorFault | None
    ambiguous: bool
    nis: float
    nis_limit: float
    target_age: float | None

    @property
    def stamp_ns(self) -> int:
        """The stamp of the reading it comes from."""
        return self.estimate.stamp_ns


FusionOutcome = FusedEstimate | Refusal | None
