"""The result of a diagnosis: the answer, its evidence, and the detection limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pneunet_ros.calibration.checks.held_out import Score
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings
from pneunet_ros.model.arm import Arm

Answer = Literal['none', 'named', 'inseparable', 'unknown', 'unobservable']
CLEAR: tuple[Answer, ...] = ('none', 'named')  # conclusive answers
Axis = Literal['arclength', 'pressure', 'force', 'time', 'direction']
AXES: tuple[Axis, ...] = ('arclength', 'pressure', 'force', 'time', 'direction')


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimated:
    """A fitted number, its standard error, and the unit of both."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedEffect:
    """An effect missing in the model, and its parameters by name.

    probability: that the effect is missing, from the evidence of all fitted sets and the error
    rate of such names in blind trials.
    """

    name: str
    parameters: Mapping[str, Estimated]
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Share of the misfit, and of the data, in an interval of an axis.

    start, stop in SI (s / l for arclength, Pa, N, s since the start of a recording, -1 or +1 for
    falling or rising pressure); p_value: probability of such a share under noise alone.
    """

    axis: Axis
    start: float
    stop: float
    share: float
    seen: float
    p_value: float
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """The model error on recordings: rms per coordinate, 95th percentile of the distance (m).

    chi_squared is per coordinate, whitened by the full noise model: 1 is noise alone.
    """

    rms: float
    p95: float
    chi_squared: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """A model, before or after, evaluated on all recordings.

    arm: the model with its covariance; fit: of its base to the training recordings. Scores and
    errors (m) exclude each recording's registration; held_out is None if there are none.
    """

    arm: Arm
    fit: Fit
    training: Misfit
    held_out: Misfit | None
    training_scores: tuple[Score, ...]
    held_out_scores: tuple[Score, ...]

    @property
    def rms(self) -> float:
        """Model error (m) per coordinate on held-out recordings; on training ones without any."""
        return (self.held_out or self.training).rms


@dataclass(frozen=True, slots=True, kw_only=True)
class Adequacy:
    """A lack-of-fit test: statistic, limit in clean data, and p-value."""

    test: str
    statistic: float
    threshold: float
    p_value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Detectable:
    """Detection limit: the smallest size of an effect that these recordings would have shown.

    parameter: the quantity of `smallest` (SI, `unit`), which is the largest value for a stiffness;
    observable: whether it is within the prior range; expected: this range (SI).
    """

    parameter: str
    observable: bool
    smallest: float
    expected: tuple[float, float]
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A quantity of the base model before and after adding an effect, and its error after."""

    before: float
    after: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Evidence for one effect or several.

    chi_squared: gain of the fit to the training recordings, including the prior and the volume of
    the errors; evidence: gain in log probability of every recording predicted from the others,
    summed, NaN if only the score was tested; adequate: the residuals are consistent with noise and
    law errors; p_value: of the worst lack-of-fit test, NaN if nothing was fitted; alike: effects
    that cannot be distinguished from these with these data.
    """

    effects: tuple[str, ...]
    chi_squared: float
    evidence: float
    adequate: bool
    p_value: float = float('nan')
    alike: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeatMap:
    """Whitened rms of the residual, 1 = noise alone, over arclength and another axis.

    edges (bins + 1,) of `axis` in SI, arclength (targets,) s / l, values (bins, targets) with NaN
    where nothing was measured.
    """

    axis: Axis
    edges: Array
    arclength: Array
    before: Array
    after: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """The result of `diagnose`.

    answer: one of five; sentence: the answer in words; certainty: the comparison that led to it,
    and the difference. effects: the missing ones, strongest first; alternatives: names of effects
    that cannot be distinguished from them with these data. where: shares of the misfit, in words
    `where_sentence`; heat_maps: over arclength and another axis. before, after: the base model,
    and the one with the effects (the same if none was added). noise_floor (m): the rms of a
    perfect model on these recordings, and its scatter. closed: share of the reducible error on
    held-out recordings that was removed, None if there was none. adequacy_before, _after: the
    worst lack-of-fit test of each; adequacy_same: the worst test before, repeated after.
    detectable: detection limit by effect. shift: base quantities, by dotted name, that were biased
    by the missing effect. evidence: all trials, best first. cosines: of the directions of two
    effects, -1 to 1, if large. proposal: the most informative next recording, empty if none. seed:
    of the simulated clean data.
    """

    answer: Answer
    sentence: str
    certainty: str
    effects: tuple[NamedEffect, ...]
    alternatives: tuple[str, ...]
    where: tuple[Share, ...]
    where_sentence: str
    heat_maps: tuple[HeatMap, ...]
    before: Evaluation
    after: Evaluation
    noise_floor: float
    noise_floor_std: float
    closed: float | None
    adequacy_before: Adequacy
    adequacy_after: Adequacy
    adequacy_same: Adequacy
    detectable: Mapping[str, Detectable]
    shift: Mapping[str, Shift]
    evidence: tuple[Evidence, ...]
    cosines: Mapping[tuple[str, str], float]
    notes: tuple[str, ...]
    seed: int
    settings: DiagnosisSettings = DEFAULTS
    proposal: str = ''


@dataclass(frozen=True, slots=True, kw_only=True)
class UnsettledDiagnosis:
    """A diagnosis without numbers, because the base fit did not converge.

    sentence: what happened; notes: further information; seed and settings as requested.
    """

    sentence: str
    notes: tuple[str, ...]
    seed: int
    settings: DiagnosisSettings = DEFAULTS
    answer: Answer = 'unknown'
