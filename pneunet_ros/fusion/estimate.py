"""The estimate of shape, tip force and pressure bias, and which of them the data determine."""

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
        """Describe the mode for users."""
        return MODE_SENTENCES[self]


MODE_SENTENCES = {
    Mode.FUSED: 'targets and pressure',
    Mode.CAMERA_ONLY: 'targets alone: the pressure is too old',
    Mode.PREDICTION: 'pressure alone: no recent frame of targets; the force is held',
}


def force_words(value: float, error: str = '') -> str:
    """Return a force (N) and its error as text; `unknown` for NaN."""
    return f'{value:.4f}{error}' if math.isfinite(value) else 'unknown'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceSensorFault:
    """Reading of a faulty force sensor and the estimate from targets: (2,) N of F1 and F2.

    reading: NaN without a fresh one; targets and targets_std: NaN where not determined.
    """

    reading: Array
    targets: Array
    targets_std: Array

    @property
    def words(self) -> str:
        """Return the reading and the estimate as text."""
        read = ', '.join(force_words(value) for value in self.reading.tolist())
        pairs = zip(self.targets.tolist(), self.targets_std.tolist(), strict=True)
        estimated = ', '.join(force_words(value, f' ± {std:.4f}') for value, std in pairs)
        return f'ignored: it reads ({read}) N, but the targets give ({estimated}) N'

    @property
    def numbers(self) -> dict[str, list[float | None]]:
        """Return the reading and the estimate for programs, in N."""
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
    """Shape, tip force and pressure bias from all available sensors; SI, base frame.

    estimate: the shape with its uncertainty, also of the tip. force (2,) N at the tip and
    force_covariance (2, 2) N^2, NaN for components that are not determined, and for both if the
    force is ambiguous. contact: along the arm, None if none is likely. pressure_bias (Pa) and its
    std: the model error, expressed as a pressure error, such as creep, hysteresis or sensor drift.
    force_sensor: a sensor fault, None if none is known. nis: running mean of the normalized
    innovation squared of frames per coordinate, 1 for pure noise; nis_limit: limit that noise
    rarely exceeds; both are NaN before the first frame. target_age: s since the last used frame,
    None before the first.
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
        """The stamp of its pressure reading or frame."""
        return self.estimate.stamp_ns


FusionOutcome = FusedEstimate | Refusal | None
