"""What a diagnosis says: the answer, its evidence, and what could not have been seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pneunet_ros.calibration.held_out import Score
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.arm import Arm

Answer = Literal['none', 'named', 'inseparable', 'unknown', 'unobservable']
Axis = Literal['arclength', 'pressure', 'force', 'time', 'direction']
AXES: tuple[Axis, ...] = ('arclength', 'pressure', 'force', 'time', 'direction')


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimated:
    """A number found, its standard error, and the unit of both."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedEffect:
    """An effect that is missing in the model, its parameters by name, and how probable it is."""

    name: str
    parameters: Mapping[str, Estimated]
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Which share of the misfit lies in a stretch of an axis.

    start, stop in SI (s / l for arclength, Pa, N, s since the start of a recording, -1 or +1 for
    falling or rising pressure); p_value: how often noise alone puts as much there.
    """

    axis: Axis
    start: float
    stop: float
    share: float
    p_value: float
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """How far a model is from recordings: rms per coordinate and 95th percentile (m).

    chi_squared is per coordinate, whitened by the full noise model.
    """

    rms: float
    p95: float
    chi_squared: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """A model, before or after, beside all recordings.

    score and errors are after removing each recording's registration; held_out may be empty.
    """

    arm: Arm
    fit: Fit
    training: Misfit
    held_out: Misfit | None
    training_scores: tuple[Score, ...]
    held_out_scores: tuple[Score, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Adequacy:
    """Is anything left? The omnibus statistic, what clean data reach, and how often they do."""

    statistic: float
    threshold: float
    p_value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Detectable:
    """The smallest size of an effect that these recordings would have shown, if any is likely.

    parameter: the quantity that `smallest` is of; observable: smallest is within its prior range.
    """

    parameter: str
    observable: bool
    smallest: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A quantity of the base model before and after an effect was added, and its error after."""

    before: float
    after: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What speaks for an effect, or for several together.

    chi_squared: by how much the fit to the training recordings gets better; evidence: the gain in
    log probability of every recording predicted from the others, summed; adequate: nothing is left
    beside them.
    """

    effects: tuple[str, ...]
    chi_squared: float
    evidence: float
    adequate: bool
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
    """All that was found.

    effects: what is missing, strongest first; alternatives: what these recordings cannot tell from
    it. where: shares of the misfit with `where_sentence` in plain words. closed: the share of the
    removable gap on held-out recordings that is gone, None where there is no gap to close.
    noise_floor (m): the rms that a perfect model would still have. shift: base quantities by
    dotted name. cosines: how alike two effects act on these recordings, -1 to 1. proposal: the
    next recording that would tell more.
    """

    answer: Answer
    sentence: str
    effects: tuple[NamedEffect, ...]
    alternatives: tuple[str, ...]
    where: tuple[Share, ...]
    where_sentence: str
    heat_maps: tuple[HeatMap, ...]
    before: Evaluation
    after: Evaluation
    noise_floor: float
    closed: float | None
    adequacy_before: Adequacy
    adequacy_after: Adequacy
    detectable: Mapping[str, Detectable]
    shift: Mapping[str, Shift]
    evidence: tuple[Evidence, ...]
    cosines: Mapping[tuple[str, str], float]
    proposal: str
    notes: tuple[str, ...]
    seed: int
