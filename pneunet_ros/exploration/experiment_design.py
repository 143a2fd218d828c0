"""Simulated experiments: their recordings, and the information on effects that they would add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.fit.linearization import KnownInputs, Linearization
from pneunet_ros.diagnosis.fit.refit import effect_direction, linearize_all_runs, Refit
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.measurement.dataset import RecordingData

# Of a simulated experiment. No figure of acceptance/sweep.py moves when one is halved or doubled.
FRAMES = 60
RATE = 20.0  # Hz, of readings


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """A possible recording: corners of (s, pressure, F1, F2), as shares of ranges."""

    words: str
    corners: tuple[tuple[float, ...], ...]

    @property
    def seconds(self) -> float:
        """Its duration."""
        return float(self.corners[-1][0])

    @property
    def loaded(self) -> bool:
        """Whether a load is attached."""
        return any(x or y for _, _, x, y in self.corners)

    def recording(
        self,
        pressure_range: tuple[float, float],
        force: float,
        stamp_ns: int,
        targets: int,
        frames: int | None = None,
    ) -> RecordingData:
        """Return the recording from a stamp on, with targets at zero; force (N): the largest."""
        corners = np.array(self.corners, dtype=np.float64)
        time = np.arange(0.0, corners[-1, 0], 1.0 / RATE)
        share, f1, f2 = (np.interp(time, corners[:, 0], corners[:, i]) for i in (1, 2, 3))
        frames = frames or FRAMES
        reading = np.linspace(0, time.size - 1, frames).astype(np.int64)
        loads = np.column_stack([f1, f2])
        stamps = stamp_ns + np.rint(time * NANOSECONDS_PER_SECOND).astype(np.int64)
        return RecordingData(
            name=self.words,
            reading_stamp_ns=stamps,
            pressure=pressures_at(share, pressure_range),
            stamp_ns=stamps[reading],
            reading=reading,
            loaded=bool(np.any(loads)),
            force=force * loads[reading],
            moment=np.zeros(frames),
            x=np.zeros((frames, targets)),
            y=np.zeros((frames, targets)),
        )


def pressures_at(share: Array, pressure_range: tuple[float, float]) -> Array:
    """Return pressures (n,) Pa of a range: share 0 is the end nearest to rest, 1 the farthest."""
    low, high = pressure_range
    rest = min(max(low, 0.0), high)
    return rest + (max(pressure_range, key=abs) - rest) * share


def informations(
    refit: Refit,
    experiments: Sequence[Experiment],
    candidates: Sequence[Candidate],
    pressure_range: tuple[float, float],
    force: float,
    frames: int | None = None,
) -> tuple[Array, list[Array]] | None:
    """Return the information (n, n) of effects, with all nuisance parameters fitted jointly.

    For the training runs alone, and together with each experiment. An effect with which the arm
    has no shape gets zero information. None if the arm has no shape in one of the experiments.
    """
    linearization = linearize_experiments(refit, experiments, pressure_range, force, frames)
    if linearization is None or not candidates:
        return None
    at_fit = linearize_all_runs(linearization, refit)
    if at_fit is None:
        return None
    residuals, gaussian = at_fit[0].residuals, at_fit[1]
    none = [np.zeros(values.size) for values in residuals]
    directions = [
        effect_direction(linearization, refit, residuals, item.hypothesis.effect(item.tried))
        or none
        for item in candidates
    ]
    columns = [np.column_stack(run) for run in zip(*directions, strict=True)]

    def inner(kept: Sequence[int]) -> Array:
        subset = [columns[which] for which in kept]
        return gaussian.subset(kept).inner(subset, subset)

    training = list(range(linearization.training))
    further = range(linearization.training, len(residuals))
    return inner(training), [inner([*training, which]) for which in further]


def linearize_experiments(
    refit: Refit,
    experiments: Sequence[Experiment],
    pressure_range: tuple[float, float],
    force: float,
    frames: int | None = None,
) -> Linearization | None:
    """Linearize the training runs and each candidate experiment at a refit.

    pressure_range (Pa) and force (N): full scale of the shares of an experiment. None if the arm
    has no shape in one.
    """
    fitted = refit.linearization
    training = fitted.runs[: fitted.training]
    stamp_ns = max(int(run.reading_stamp_ns[-1]) for run in training) + NANOSECONDS_PER_SECOND
    targets = training[0].x.shape[1]
    next_runs = [
        item.recording(pressure_range, force, stamp_ns, targets, frames) for item in experiments
    ]
    runs, noise = (*training, *next_runs), fitted.noise
    known = KnownInputs(runs, noise, alternatives=len(next_runs))
    try:
        return Linearization(refit.point, runs, len(training), noise, known)
    except ModelError:
        return None
