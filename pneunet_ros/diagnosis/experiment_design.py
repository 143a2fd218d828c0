"""Experiment design: choose the most informative next recording by simulation."""

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


EXPERIMENTS = (
    Experiment(
        words='without a load, steps of pressure up and down with holds of 8 s',
        corners=(
            (0, 0, 0, 0), (8, 0, 0, 0), (9, 0.4, 0, 0), (17, 0.4, 0, 0), (18, 0.9, 0, 0),
            (26, 0.9, 0, 0), (27, 0.4, 0, 0), (35, 0.4, 0, 0), (36, 0, 0, 0), (44, 0, 0, 0),
        ),
    ),
    Experiment(
        words='without a load, the same ramp in 1 s and in 15 s, up and down, with holds of 10 s',
        corners=(
            (0, 0.1, 0, 0), (5, 0.1, 0, 0), (6, 0.9, 0, 0), (16, 0.9, 0, 0), (17, 0.1, 0, 0),
            (27, 0.1, 0, 0), (42, 0.9, 0, 0), (52, 0.9, 0, 0), (67, 0.1, 0, 0),
        ),
    ),
    Experiment(
        words='a force along the arm at rest (E1), swept up and down at a low and a high pressure',
        corners=(
            (0, 0.2, 0, 0), (10, 0.2, 1, 0), (20, 0.2, 0, 0), (22, 0.8, 0, 0), (32, 0.8, 1, 0),
            (42, 0.8, 0, 0),
        ),
    ),
    Experiment(
        words='a force across the arm at rest (E2), swept both ways at a low and a high pressure',
        corners=(
            (0, 0.2, 0, 0), (8, 0.2, 0, 1), (24, 0.2, 0, -1), (32, 0.2, 0, 0), (34, 0.8, 0, 0),
            (42, 0.8, 0, 1), (58, 0.8, 0, -1), (66, 0.8, 0, 0),
        ),
    ),
    Experiment(
        words='a fresh arm under a constant load, ramps to half and to full pressure, each twice',
        corners=(
            (0, 0, 0.5, 0.5), (10, 0.5, 0.5, 0.5), (20, 0, 0.5, 0.5), (30, 0.5, 0.5, 0.5),
            (40, 0, 0.5, 0.5), (55, 1, 0.5, 0.5), (70, 0, 0.5, 0.5), (85, 1, 0.5, 0.5),
        ),
    ),
)  # fmt: skip


def propose_experiment(
    refit: Refit, wanted: Sequence[Candidate], rivals: Sequence[Candidate]
) -> str:
    """Propose the most informative experiment on a wanted effect, with its rivals fitted jointly.

    Maximizes chi squared of each wanted effect at the far end of its prior range. Empty if no
    effect is wanted.
    """
    if not wanted:
        return ''
    force, pressure_range = largest_force(refit), refit.point.arm.pressure_range
    items = list({item.name: item for item in (*wanted, *rivals)}.values())
    tried = informations(refit, EXPERIMENTS, items, pressure_range, force)
    if tried is None:
        return ''
    names = [item.name for item in items]
    places = {item.name: names.index(item.name) for item in rivals}
    best, words, name = 0.0, '', ''
    for experiment, inner in zip(EXPERIMENTS, tried[1], strict=True):
        for item in wanted:
            others = [place for other, place in places.items() if other != item.name]
            shown = effect_information(inner, names.index(item.name), others)
            shown *= prior_end_factor(item)
            if shown > best:
                best, words, name = shown, experiment.words, item.name
    if not words:
        return ''
    return (
        f'Record next: {words}. It would show {name} best: chi squared of {best:.0f} at the end '
        'of its prior range.'
    )


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


def largest_force(refit: Refit) -> float:
    """Return the largest force (N) of the training runs; the weight if no load was recorded."""
    fitted = refit.linearization
    force = max(float(np.abs(run.force).max()) for run in fitted.runs[: fitted.training])
    return force or refit.point.arm.weight


def effect_information(inner: Array, effect: int, rivals: Sequence[int]) -> float:
    """Return chi squared of one of the effects, with its rivals fitted jointly.

    inner (n, n): as in `informations`.
    """
    information = float(inner[effect, effect])
    if rivals:
        cross = inner[effect, rivals]
        information -= float(cross @ np.linalg.pinv(inner[np.ix_(rivals, rivals)]) @ cross)
    return max(information, 0.0)


def prior_end_factor(candidate: Candidate) -> float:
    """Return the ratio of chi squared at the end of the prior range to that at the tried value."""
    coordinate = candidate.hypothesis.coordinates[candidate.which]
    tried = max(abs(float(candidate.tried[candidate.which])), 1e-300)
    return float((coordinate.end / tried) ** 2)
