"""Tuning constants of a calibration, each with its meaning and source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention

GAUGE_PASCALS = PressureConvention()


@dataclass(frozen=True, slots=True, kw_only=True)
class SameArmSettings:
    """Criteria for a fit as good as the noise, and for recordings of the same arm."""

    as_noise: float = tuning(
        1.5,
        'largest chi squared per coordinate that counts as consistent with noise',
        source='sweep',
    )
    two_arms: float = tuning(
        0.03,
        'smallest significant distance of two arms; twice as much if no recording shows the '
        'effect of history',
        unit='length',
        source='sweep',
    )
    outlier: float = tuning(
        5.0,
        'chi squared per coordinate of an outlier recording',
        unit='median of the others, at least 1',
        source='sweep',
    )
    misfit: float = tuning(
        4.0, 'chi squared per coordinate that indicates a model error', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseEstimateSettings:
    """Settings of the noise estimate."""

    fewest: int = tuning(
        20,
        'smallest number of values for an estimate, of frames of a run for one, of loaded '
        'frames for a law of two sections, and of frames that can show an effect with '
        'memory',
        source='sweep',
    )
    even: float = tuning(
        1.5, 'largest mean over targets during smooth motion', unit='sigma', source='sweep'
    )
    blocks: int = tuning(
        8, 'number of blocks of a run for estimating the drift of the camera', source='sweep'
    )
    smooth_degree: int = tuning(
        6, 'largest degree of the polynomial along a straight arm', source='sweep'
    )
    placement: float = tuning(
        1e-3,
        "std of the position of a painted target, and of the camera's drift, if not estimated",
        unit='way to the last target',
        source='sweep',
    )
    registration: float = tuning(
        2e-3,
        'std of the position of the camera, if not estimated',
        unit='way to the last target',
        source='sweep',
    )
    differs: float = tuning(
        2.5,
        'smallest reported ratio to the stated noise; a run louder than the quietest by as much '
        'is in motion',
        source='sweep',
    )
    heading: float = tuning(
        0.02, 'std of a measured heading, if not estimated', unit='rad', source='sweep'
    )

    @property
    def many_targets(self) -> int:
        """Targets sufficient to estimate small placement errors, and equal noise."""
        return 2 * self.smooth_degree


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolutionSettings:
    """Resolution of recordings, and the prior for unresolved parameters."""

    knots: int = tuning(11, 'largest number of knots of kappa_p0 along the arm', source='sweep')
    resolved_gap: float = tuning(
        0.05,
        'smallest distance between targets that resolve two features',
        unit='length',
        source='sweep',
    )
    nonuniform_rest: float = tuning(
        0.05, 'std of the rest curvature along the arm', unit='1/length', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentSettings:
    """The table of kappa_p0, its prior, and the number of frames of the first fits."""

    rows: int = tuning(9, 'rows of kappa_p0 over the span of the pressure', source='sweep')
    amplitude: float = tuning(
        5.0, 'kappa_p0 at the highest pressure', unit='1/length', source='sweep'
    )
    std: float = tuning(
        0.5,
        'std of the part of kappa_p0 that is not proportional to pressure',
        unit='1/length',
        source='sweep',
    )
    length_scale: float = tuning(
        0.18, 'correlation length of kappa_p0', unit='length', source='sweep'
    )
    outliers: float = tuning(
        0.002, 'share of readings ignored at either end of the range', unit='share', source='sweep'
    )
    first_frames: int = tuning(40, 'frames of every run for the first search', source='sweep')
    most_frames: int = tuning(
        5400,
        'largest number of fitted frames of all recordings, spread over time and course',
        source='measured: 0.27 MB a frame, so that an hour of film stays below 2 GB',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HyperparameterSettings:
    """Candidates for the smoothness of kappa_p0, selected by evidence."""

    length_scales: tuple[float, ...] = tuning(
        (0.12, 0.18, 0.25, 0.35, 0.45, 0.55, 0.7, 0.9),
        'along the arm',
        unit='length',
        source='sweep',
    )
    stds: tuple[float, ...] = tuning(
        (0.003, 0.01, 0.03, 0.1, 0.3),
        'part not proportional to pressure',
        unit='amplitude',
        source='sweep',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentLawSettings:
    """The prior of the piecewise linear law."""

    split: float = tuning(0.12, 'l1 / l', source='literature: the paper reports 0.10 to 0.15')
    split_std: float = tuning(
        0.05, 'std of l1 / l, and of its change over the range of pressure', source='sweep'
    )
    split_wave_std: float = tuning(
        0.012, 'std of l1 / l about a straight line in pressure', source='sweep'
    )
    split_scale: float = tuning(
        0.5, 'correlation length of rows', unit='range of pressure', source='sweep'
    )
    bow_std: float = tuning(
        0.03, 'relative std of the bow of alpha, in the middle of the range', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapEstimationSettings:
    """Stopping criteria of the search for the most probable parameters."""

    small_step: float = tuning(
        0.05, 'step size at which the fit has converged', unit='sigma', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiabilitySettings:
    """Criteria for determined parameters."""

    well_known: float = tuning(
        0.5,
        'largest share of the prior sigma for a parameter to count as determined',
        source='sweep',
    )
    confounded: float = tuning(
        0.98, 'correlation of two confounded quantities, and of two effects', source='sweep'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class StiffnessVariationSettings:
    """Criteria for a stiffness that varies along the arm, and the consequences."""

    modes: int = tuning(4, 'number of Legendre polynomials of ln EI along the arm', source='sweep')
    significant: float = tuning(
        100.0, 'significant reduction of chi squared beyond noise', source='sweep'
    )


CONSISTENCY = SameArmSettings()
NOISE_ESTIMATE, EXPERIMENTS = NoiseEstimateSettings(), ExperimentSettings()
STIFFNESS_VARIATION = StiffnessVariationSettings()
RESOLUTION = ResolutionSettings()
HYPERPARAMETERS, MOMENT_LAW = HyperparameterSettings(), MomentLawSettings()
MAP_ESTIMATION, IDENTIFIABILITY = MapEstimationSettings(), IdentifiabilitySettings()
FIXED: tuple[Any, ...] = (  # common to all calibrations
    CONSISTENCY, NOISE_ESTIMATE, HYPERPARAMETERS, MOMENT_LAW, MAP_ESTIMATION,
    IDENTIFIABILITY, STIFFNESS_VARIATION, RESOLUTION, EXPERIMENTS,
)  # fmt: skip
