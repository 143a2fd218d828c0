"""Tuning constants of a diagnosis: one class per algorithm, all in `DiagnosisSettings`.

Blind trials tested all settings together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pneunet_ros.calibration.settings import FIXED as FIXED_IN_CALIBRATION
from pneunet_ros.calibration.settings import GAUGE_PASCALS, NOISE_ESTIMATE
from pneunet_ros.core.settings import setting, tuning
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.reading_filter import READING_FILTER
from pneunet_ros.model.domain import DOMAIN

# Log probability that counts as evidence: strong, 20 to 1 (Kass and Raftery, 1995). No figure of
# acceptance/sweep.py moves when it is halved or doubled.
LEAST_EVIDENCE = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseFitSettings:
    """Settings of the base refit, and the share of recordings used."""

    frames: int = tuning(
        48, 'frames of every run; neighbors differ by white noise alone', source='sweep'
    )

    @property
    def first_frames(self) -> int:
        """Frames of every run for the fit of the base model: every other one."""
        return self.frames // 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearizationSettings:
    """Settings of the linearization of recordings, and of generic fields for departures."""

    tilt: float = tuning(
        0.005,
        'negligible change of scale over the length, due to a tilted image',
        unit='-',
        source='sweep',
    )
    modes: int = tuning(
        3,
        'number of Legendre polynomials along the arm for stretch, curvature in windows of '
        'time, and law errors; highest degree of curvature',
        source='sweep',
    )
    time_constants: tuple[float, ...] = tuning(
        (0.3, 3.0, 30.0),
        'time constants of low-pass filters; the second one is the past in bending and '
        'stretch fields',
        unit='s',
        source='sweep',
    )
    unloading: float = tuning(
        0.02,
        'distance from the highest pressure so far, default width of a play operator, and change '
        'per second below which the pressure is constant',
        unit='pressure range',
        source='sweep',
    )
    windows: int = tuning(10, 'number of windows of time in every run', source='sweep')

    @property
    def tolerance(self) -> float:
        """Rms of negligible departures, of the length: as of painted targets from their places."""
        return NOISE_ESTIMATE.placement


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisSettings:
    """Settings for the values at which an effect is tried."""

    shapes: int = tuning(
        5, 'number of values of a shape parameter over its prior range', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreTestSettings:
    """Settings of score tests and detection limits."""

    largest_step: float = tuning(
        3.0,
        'largest ratio of the start of an effect with memory to the size tried, or its inverse',
        source='sweep',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LackOfFitSettings:
    """Settings of the lack-of-fit tests."""

    level: float = tuning(
        0.002, 'probability of a false alarm in any of the tests', source='sweep'
    )
    least_seen: float = tuning(
        0.3, 'smallest score variance of a field observable in the data', source='sweep'
    )
    camera_dof: int = tuning(
        8,
        'number of values from which registration_std and drift_std are estimated',
        source='sweep',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitSettings:
    """Settings of the joint fit of effects and base model."""

    rounds: int = tuning(5, 'largest number of relinearizations', source='sweep')
    least_gain: float = tuning(
        0.1,
        'gain of a step below which the fit has converged, and of a relinearization',
        source='sweep',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingNoiseSettings:
    """Settings for reading noise that acts through effects with a history."""

    draws: int = tuning(12, 'number of draws of additional noise', source='sweep')


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionSettings:
    """Settings of forward selection and backward elimination of effects."""

    finalists: int = tuning(2, 'number of candidates fitted to convergence', source='sweep')
    near: float = tuning(0.3, 'smallest gain of a finalist', unit='of the best', source='sweep')

    @property
    def least_gain(self) -> float:
        """Smallest gain of an additional effect, chi squared."""
        return DOMAIN.significant**2


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfirmationSettings:
    """Requirements for a name besides the tests, and its probability."""

    wrong: float = tuning(
        0.02,
        'probability that a confirmed name is wrong',
        source='blind trials: 1 of 97 names, and one more (docs/diagnosis.md)',
    )
    unconfirmed: float = tuning(
        0.1,
        'probability that a name is wrong if not all requirements could be tested',
        source='sweep',
    )


BASE_FIT, LINEARIZATION = BaseFitSettings(), LinearizationSettings()
HYPOTHESIS, SCORE_TEST = HypothesisSettings(), ScoreTestSettings()
LACK_OF_FIT = LackOfFitSettings()
REFIT, SELECTION = RefitSettings(), SelectionSettings()
CONFIRMATION = ConfirmationSettings()
READING_NOISE = ReadingNoiseSettings()
FIXED: tuple[Any, ...] = (  # common to all diagnoses
    *FIXED_IN_CALIBRATION, READING_FILTER, BASE_FIT, LINEARIZATION, HYPOTHESIS, SCORE_TEST,
    LACK_OF_FIT, REFIT, READING_NOISE, SELECTION, CONFIRMATION,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisSettings:
    """The settings of a diagnosis that can change; declared: as in `calibrate`."""

    declared: PressureConvention | None = GAUGE_PASCALS
    withheld: tuple[str, ...] = setting((), 'effects that are excluded')
    tested: bool = setting(True, 'whether a name must have been tested')


DEFAULTS = DiagnosisSettings()
