"""Tuning constants of a diagnosis: one class per algorithm, all in `DiagnosisSettings`.

Numbers without a source are invented; blind trials tested all of them together.
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.calibration.settings import (
    CALIBRATION,
    CalibrationSettings,
    CHANGEABLE_IN_CALIBRATION,
)
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.reading_filter import READING_FILTER, ReadingFilterSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseFitSettings:
    """Settings of the base refit, and the share of recordings used."""

    frames: int = tuning(48, 'frames of every run; neighbors differ by white noise alone')
    first_frames: int = tuning(24, 'frames of every run for the fit of the base model')


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearizationSettings:
    """Settings of the linearization of recordings, and of generic fields for departures."""

    tolerance: float = tuning(0.001, 'rms of departures that are harmless', unit='length')
    tilt: float = tuning(
        0.005,
        'change of scale over the length, by a tilted picture, that is harmless',
        unit='-',
        source='invented: 2.5 degrees, seen from nine lengths away',
    )
    most_lost: float = tuning(0.02, 'share of frames that may have no equilibrium')
    curvature_modes: int = tuning(4, 'Legendre polynomials of curvature along the arm')
    stretch_modes: int = tuning(3, 'Legendre polynomials of stretch along the arm')
    time_constants: tuple[float, ...] = tuning((0.3, 3.0, 30.0), 'of low-passes', unit='s')
    field_memory: float = tuning(3.0, 'the one of them whose past bends and stretches', unit='s')
    unloading: float = tuning(0.02, 'distance to highest pressure so far', unit='pressure range')
    windows: int = tuning(10, 'windows of time in every run')
    window_modes: int = tuning(3, 'Legendre polynomials of curvature in every window')
    reading_filter: ReadingFilterSettings = READING_FILTER

    def __post_init__(self) -> None:
        """Reject an invalid time constant for the memory of the fields."""
        if self.field_memory not in self.time_constants:
            raise RequestError(
                f'field_memory must be one of {self.time_constants} s', reason='unknown_kind'
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisSettings:
    """Settings for the values at which an effect is tried."""

    shapes: int = tuning(5, 'values of a shape parameter over its prior range')
    shape_margin: float = tuning(10.0, 'factor by which a shape may leave its prior range')
    fewest_in_time: int = tuning(20, 'frames of a recording that may show an effect with memory')
    withheld: tuple[str, ...] = tuning((), 'effects that are not considered', source='convention')


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreTestSettings:
    """Settings of score tests and detection limits."""

    smallest_step: float = tuning(0.3, 'least step of effects with memory', unit='size tried')
    largest_step: float = tuning(3.0, 'largest step of effects with memory', unit='size tried')
    visible: float = tuning(25.0, 'chi squared that is visible: five sigma', source='convention')
    prior_range: float = tuning(2.0, 'end of the prior range', unit='std', source='convention')
    least_cosine: float = tuning(0.3, 'cosine of two effects from which it is reported')
    same_class: float = tuning(0.98, 'cosine from which effects cannot be distinguished')


@dataclass(frozen=True, slots=True, kw_only=True)
class LawErrorSettings:
    """Settings of the law errors of effects, allowed for when other effects are compared."""

    size: float = tuning(0.3, 'error of a size in every frame, each for itself', unit='of it')
    shapes: int = tuning(3, 'Legendre polynomials along the arm, each with such an error')
    most_left: float = tuning(0.5, 'excess that such errors may be', unit='of the base')
    left_open: float = tuning(0.05, 'excess that laws leave beside them', unit='of the base')


@dataclass(frozen=True, slots=True, kw_only=True)
class LackOfFitSettings:
    """Settings of the lack-of-fit tests."""

    level: float = tuning(0.002, 'probability of a false alarm in any of the tests')
    least_seen: float = tuning(0.3, 'score variance from which a field is seen in the data')
    placement_dof: int = tuning(20, 'values that placement_std is estimated from')
    camera_dof: int = tuning(8, 'values that registration_std and drift_std are estimated from')
    white_error: float = tuning(0.01, 'relative error of the std of white noise')
    law_error: float = tuning(
        0.2, 'excess that the law of an effect may leave', unit='of the base'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitSettings:
    """Settings of the joint fit of effects and base model."""

    rounds: int = tuning(5, 'most relinearizations')
    base_rounds: int = tuning(20, 'most relinearizations of the base fit, without effects')
    least_gain: float = tuning(0.1, 'cost that a step must gain; below it has converged')
    settled: float = tuning(0.5, 'change of cost from round to round; below it is settled')
    unsettled: float = tuning(1e-3, 'gain of a step more that is no answer', unit='of misfit')


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingNoiseSettings:
    """Settings for reading noise that acts through effects with a history."""

    draws: int = tuning(12, 'times that noise is added once more')


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionSettings:
    """Settings of forward selection and backward elimination of effects."""

    most_effects: int = tuning(3, 'effects that may be missing together')
    shortlist: int = tuning(5, 'candidates that are fitted, in order of their score')
    finalists: int = tuning(2, 'candidates that are fitted until settled')
    near: float = tuning(0.3, 'gain that makes a finalist', unit='of the best')
    worth_a_fit: float = tuning(4.0, 'score that is worth a fit', unit='chi squared')
    least_gain: float = tuning(16.0, 'gain of an effect: four sigma', unit='chi squared')
    finalist_gain: float = tuning(0.25, 'cost that a finalist gains at least', unit='least_gain')
    least_evidence: float = tuning(3.0, 'evidence that counts', unit='log probability')
    absent: float = tuning(
        3.0,
        'size of an effect below which the others are fitted once more without it, from where '
        'they are',
        unit='sigma',
    )
    law_evidence: float = tuning(0.02, 'share of evidence that does not tell two laws apart')
    partial: float = tuning(
        0.5, 'gain that is too little beside a more probable set', unit='of it'
    )
    most_left: float = tuning(0.5, 'excess that an effect more may leave', unit='of that before')
    hopeless: float = tuning(0.2, 'excess with two effects; above no third', unit='of the base')
    plausible: float = tuning(4.0, 'distance of a size from its prior mean', unit='prior std')


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfirmationSettings:
    """Requirements for a name besides the tests, and its probability."""

    most_left: float = tuning(
        2.0, 'chi squared per coordinate of the training that a law may leave', unit='noise alone'
    )
    fall: float = tuning(
        2.7, 'held-out chi squared that is significant: 95 % one-sided', source='convention'
    )
    batches: int = tuning(8, 'parts of a held-out run, for the standard error of its rms')
    tested: bool = tuning(True, 'whether something must have tested a name', source='convention')
    wrong: float = tuning(
        0.02,
        'probability that a confirmed name is wrong',
        source='blind trials: 1 of 97 names, and one more (docs/diagnosis.md)',
    )
    unconfirmed: float = tuning(0.1, 'the same, where a part of it could not be tested')


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationSettings:
    """Settings of the misfit shares over arclength, pressure, force, time and direction."""

    moving: float = tuning(0.02, 'rate of pressure; below it holds', unit='pressure range/s')
    trend: float = tuning(2.0, 'ratio of misfits that is called a difference')
    floor: float = tuning(0.1, 'least misfit of a ratio', unit='mean misfit')
    significant: float = tuning(1e-3, 'p-value', source='convention')


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentDesignSettings:
    """Settings for simulated experiments."""

    frames: int = tuning(60, 'frames of an experiment')
    rate: float = tuning(20.0, 'rate of readings', unit='Hz')


@dataclass(frozen=True, slots=True, kw_only=True)
class AugmentedModelSettings:
    """Settings of the base model fitted with the effects."""

    settled: float = tuning(0.3, 'step at which the fit has converged', unit='std of all')


BASE_FIT, LINEARIZATION = BaseFitSettings(), LinearizationSettings()
SCORE_TEST = ScoreTestSettings()
LAW_ERRORS, LACK_OF_FIT = LawErrorSettings(), LackOfFitSettings()
REFIT, SELECTION = RefitSettings(), SelectionSettings()
READING_NOISE, LOCALIZATION = ReadingNoiseSettings(), LocalizationSettings()
EXPERIMENT_DESIGN, AUGMENTED_MODEL = ExperimentDesignSettings(), AugmentedModelSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedSettings:
    """Settings that are the same in every diagnosis, as they are recorded with its result."""

    base_fit: BaseFitSettings = BASE_FIT
    linearization: LinearizationSettings = LINEARIZATION
    score_test: ScoreTestSettings = SCORE_TEST
    law_errors: LawErrorSettings = LAW_ERRORS
    lack_of_fit: LackOfFitSettings = LACK_OF_FIT
    refit: RefitSettings = REFIT
    reading_noise: ReadingNoiseSettings = READING_NOISE
    selection: SelectionSettings = SELECTION
    localization: LocalizationSettings = LOCALIZATION
    experiment_design: ExperimentDesignSettings = EXPERIMENT_DESIGN
    augmented_model: AugmentedModelSettings = AUGMENTED_MODEL


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisSettings:
    """The settings of a diagnosis."""

    calibration: CalibrationSettings = CALIBRATION
    hypothesis: HypothesisSettings = HypothesisSettings()
    confirmation: ConfirmationSettings = ConfirmationSettings()
    fixed: FixedSettings = FixedSettings()


DEFAULTS = DiagnosisSettings()
CHANGEABLE_IN_DIAGNOSIS = CHANGEABLE_IN_CALIBRATION | {
    'ConfirmationSettings.tested', 'HypothesisSettings.withheld',
}  # fmt: skip
