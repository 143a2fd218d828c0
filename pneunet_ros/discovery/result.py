"""The results of a discovery."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.result import Diagnosis, Estimated, Evaluation


@dataclass(frozen=True, slots=True, kw_only=True)
class TermOfLaw:
    """A term of a law: a covariate, and the coefficient of the amplitude per covariate (SI)."""

    name: str
    function: str
    coefficient: float
    std: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeLaw:
    """A course in time: its form, and parameters such as a period (s)."""

    form: str
    parameters: Mapping[str, Estimated]


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovered:
    """A confirmed law that no effect of the library describes.

    location (s / l), None without a position; size: parameters of the proposed effect; share of
    the lack of fit that it explains; left_out_gain: in log probability of every training recording
    predicted from the others; tied_with: kinds that explain equally much; effect_file: name of the
    file of the proposed effect, None if no measured quantity predicts the law; source: its text.
    """

    kind: str
    location: Estimated | None
    size: Mapping[str, Estimated]
    covariates: tuple[TermOfLaw, ...]
    time_law: TimeLaw | None
    share: float
    left_out_gain: float
    tied_with: tuple[str, ...]
    sentence: str
    effect_file: str | None
    source: str | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CauseMap:
    """Share of the lack of fit that each kind explains with its best law, by place.

    share (kinds, places): NaN where a kind was not tried; for kinds without a position, the same
    everywhere.
    """

    kinds: tuple[str, ...]
    positions: Array
    share: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AmplitudeSeries:
    """The amplitude of a kind in every frame of a recording: free estimate, and value of the law.

    seconds (frames,) from the start of the recording; value, std and law (frames,) in `unit`.
    """

    recording: str
    unit: str
    seconds: Array
    value: Array
    std: Array
    law: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Discovery:
    """The result of `discover`: laws, their evidence, and the model with the first of them.

    searched: whether there was a search; found: empty if no law was found or confirmed, with the
    reason in the notes. evaluation: of the model with the proposed effect, None without one;
    closed: share of the reducible error on held-out recordings that it removes. overruling: the
    diagnosis without its name, if the law predicts recordings better than the named effects; None
    if the diagnosis is kept.
    """

    searched: bool
    found: tuple[Discovered, ...] = ()
    causes: CauseMap | None = None
    amplitudes: tuple[AmplitudeSeries, ...] = ()
    evaluation: Evaluation | None = None
    closed: float | None = None
    overruling: Diagnosis | None = None
    notes: tuple[str, ...] = ()


NOTHING_SEARCHED = Discovery(searched=False)
