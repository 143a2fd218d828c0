"""All numbers by which a diagnosis decides: one class per algorithm, `DiagnosisSettings` has all.

Where no source is given a number is invented: somebody chose it, and blind trials did not refute
it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from pneunet_ros.core.settings import tuned


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseFitSettings:
    """The refit of the base model, and how much of the recordings is used."""

    frames: int = tuned(48, 'of every run, diagnosed; neighbors differ by white noise alone')
    first_frames: int = tuned(24, 'of every run, for the fit to begin with')
    fewest_uniform: int = tuned(3, 'frames of a recording, for a model of constant curvature')
    harmless_camera: float = tuned(5e-4, 'camera motion that is no finding', unit='length')


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearizationSettings:
    """Recordings around a fit, and the generic fields that stand for departures of any kind."""

    tolerance: float = tuned(0.001, 'rms of harmless departures', unit='length')
    most_lost: float = tuned(0.02, 'share of frames that may have no equilibrium')
    curvature_modes: int = tuned(4, 'Legendre polynomials along the arm')
    stretch_modes: int = tuned(3, 'Legendre polynomials along the arm')
    time_constants: tuple[float, ...] = tuned((0.3, 3.0, 30.0), 'of past pressure', unit='s')
    unloading: float = tuned(0.02, 'below the highest pressure so far', unit='pressure range')
    windows: int = tuned(10, 'of time, in every run')
    window_modes: int = tuned(3, 'Legendre polynomials of curvature in each window')


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisSettings:
    """Where in its prior range an effect is tried."""

    first_size: float = tuned(5e-4, 'of effects linear in their size', unit='prior range')
    first_sizes: tuple[float, ...] = tuned((0.05, 0.25, 0.8), 'with memory', unit='prior range')
    shapes: int = tuned(5, 'values of a shape parameter, over its prior range')
    shape_margin: float = tuned(10.0, 'factor by which a shape may leave its prior range')


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreTestSettings:
    """The score of each effect before it is fitted."""

    draws: int = tuned(5000, 'simulations of the largest score of clean data')
    nugget: float = tuned(1e-9, 'added to the variance, as effects may be indistinguishable')
    smallest_step: float = tuned(0.3, 'of an effect with memory', unit='size tried')
    largest_step: float = tuned(3.0, 'of an effect with memory', unit='size tried')


@dataclass(frozen=True, slots=True, kw_only=True)
class LackOfFitSettings:
    """The tests whether anything is left to explain."""

    level: float = tuned(0.002, 'of a false alarm of all tests together', source='convention')
    least_seen: float = tuned(0.3, 'variance from which a field counts as seen', unit='prior')
    field_size: float = tuned(1e-4, 'rms of fields of single targets and windows', unit='m')
    draws: int = tuned(2000, 'simulations of clean data')
    placement_dof: int = tuned(20, 'values that placement_std is known from')
    camera_dof: int = tuned(8, 'values that registration_std and drift_std are known from')
    white_error: float = tuned(0.01, 'of the standard deviation of white noise', unit='itself')
    law_error: float = tuned(0.2, 'excess that the law of an effect may miss', unit='base excess')


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitSettings:
    """The joint fit of effects and base model."""

    rounds: int = tuned(5, 'relinearizations at most')
    most_steps: int = tuned(5, 'Gauss-Newton steps in a round at most')
    most_halvings: int = tuned(5, 'of a step')
    least_gain: float = tuned(0.1, 'of a step in cost; less is converged')
    settled: float = tuned(0.5, 'change of cost from round to round; less is settled')
    # The base takes up most of what gravity does: a coarser difference is bent by more than is
    # left, and taken for information.
    difference: float = tuned(5e-4, 'of a number, for its derivative', unit='prior std')


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionSettings:
    """Forward selection of effects, and backward elimination."""

    most_effects: int = tuned(3, 'effects that may be missing together')
    shortlist: int = tuned(5, 'candidates that are fitted, by their score')
    finalists: int = tuned(2, 'of these, fitted until settled')
    near: float = tuned(0.3, 'that a finalist must reach', unit='best improvement')
    worth_a_fit: float = tuned(4.0, 'score', unit='chi squared')
    least_gain: float = tuned(16.0, 'of one effect more: four sigma', unit='chi squared')
    finalist_gain: float = tuned(0.25, 'that a finalist must reach in cost', unit='least_gain')
    least_evidence: float = tuned(3.0, 'that counts', unit='log probability')
    law_evidence: float = tuned(0.02, 'that does not tell two laws apart', unit='evidence')
    next_gain: float = tuned(0.02, 'of one effect more', unit='chi squared explained')
    most_left: float = tuned(0.5, 'excess beside one effect more', unit='excess before it')
    hopeless: float = tuned(
        0.2, 'excess beside two effects: no third is tried', unit='base excess'
    )
    plausible: float = tuned(4.0, 'a size may be off: twice the prior range', unit='prior std')


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectabilitySettings:
    """What the recordings could have shown."""

    visible: float = tuned(25.0, 'of a visible effect: five sigma', unit='chi squared')
    prior_range: float = tuned(2.0, 'its far end', unit='prior std', source='convention')
    least_cosine: float = tuned(0.3, 'of two effects, to be reported')
    same_class: float = tuned(0.98, 'cosine of effects that cannot be distinguished')


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationSettings:
    """Shares of the misfit over arclength, pressure, force, time and direction."""

    arclength_bins: int = tuned(5, 'along the arm')
    pressure_bins: int = tuned(5, 'of chamber pressure')
    force_bins: int = tuned(4, 'of the end force')
    time_bins: int = tuned(4, 'since the start of a recording')
    moving: float = tuned(0.02, 'per second; slower is a hold', unit='pressure range')
    trend: float = tuned(2.0, 'ratio of misfit at the ends of an axis that is reported')
    floor: float = tuned(0.1, 'that a ratio is taken of at least', unit='mean misfit')
    significant: float = tuned(1e-3, 'p-value', source='convention')


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentDesignSettings:
    """Experiments that are tried out with the model."""

    frames: int = tuned(60, 'of a recording')
    rate: float = tuned(20.0, 'of readings', unit='Hz')
    usual_force: float = tuned(0.2, 'where none was recorded so far', unit='N')


@dataclass(frozen=True, slots=True, kw_only=True)
class AugmentedModelSettings:
    """The base model fitted with the effects, and their standard errors."""

    settled: float = tuned(0.3, 'step at which the fit has converged', unit='std of all')
    law_worth: float = tuned(0.05, 'error of the plain law of an effect', unit='size')


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisSettings:
    """The settings of all algorithms of a diagnosis."""

    base_fit: BaseFitSettings = BaseFitSettings()
    linearization: LinearizationSettings = LinearizationSettings()
    hypothesis: HypothesisSettings = HypothesisSettings()
    score_test: ScoreTestSettings = ScoreTestSettings()
    lack_of_fit: LackOfFitSettings = LackOfFitSettings()
    refit: RefitSettings = RefitSettings()
    selection: SelectionSettings = SelectionSettings()
    detectability: DetectabilitySettings = DetectabilitySettings()
    localization: LocalizationSettings = LocalizationSettings()
    experiment_design: ExperimentDesignSettings = ExperimentDesignSettings()
    augmented_model: AugmentedModelSettings = AugmentedModelSettings()

    @property
    def parts(self) -> tuple[Any, ...]:
        """The settings of each algorithm."""
        return tuple(getattr(self, item.name) for item in fields(self))


DEFAULTS = DiagnosisSettings()
