"""One estimate of shape, tip force and pressure bias, and what of it is known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
import math

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.fusion.contact import Contact


class Mode(IntEnum):
    """Inputs of an estimate: pressure and targets, targets alone, or pressure alone."""

    FUSED = 0
    CAMERA_ONLY = 1
    PREDICTION = 2

    @property
    def sentence(self) -> str:
        """Describe it for users."""
        return MODE_SENTENCES[self]


MODE_SENTENCES = {
    Mode.FUSED: 'targets and pressure',
    Mode.CAMERA_ONLY: 'targets alone: the pressure is too old',
    Mode.PREDICTION: 'pressure alone: no recent frame of targets; the force is held',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorFault:
    """Reading of a faulty force sensor and the estimate from targets: (2,) N of F1 and F2.

    reading: NaN while none is fresh; targets and targets_std: NaN where not determined.
    """

    reading: Array
    targets: Array
    targets_std: Array

    @property
    def words(self) -> str:
        """Return the numbers as text."""
        read = ', '.join(f'{value:.4f}' for value in self.reading.tolist())
        pairs = zip(self.targets.tolist(), self.targets_std.tolist(), strict=True)
        said = ', '.join(f'{value:.4f} ± {std:.4f}' for value, std in pairs)
        return f'ignored: it reads ({read}) N, the targets give ({said}) N'

    @property
    def numbers(self) -> dict[str, list[float | None]]:
        """Return the numbers for programs, in N."""
        return {
            name: [value if math.isfinite(value) else None for value in values.tolist()]
            for name, values in (
                ('reading', self.reading),
                ('targets', self.targets),
                ('targets_std', self.targets_std),
            )
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusedEstimate:
    """Shape, tip force and pressure bias from all sensors that are there; SI, base frame.

    estimate: the shape with its uncertainty, also of the tip. force (2,) N at the tip and its
    force_covariance (2, 2) N^2, NaN in components that are not determined, and everywhere where it
    is ambiguous. contact: along the arm, None if none is likely. pressure_bias (Pa) and its
    std: the model error, as an error of the pressure: creep, hysteresis and a drifting sensor
    look like that. force_sensor: one that is off and not used, None if none is known to be.
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
