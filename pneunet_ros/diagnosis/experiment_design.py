"""Which recording to make next: the one that would tell most, tried out with the model itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.detectability import PRIOR_RANGE
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.refit import Refit, Refitting
from pneunet_ros.diagnosis.score_test import Candidate
from pneunet_ros.measurement.dataset import RecordingData

FRAMES, RATE = 60, 20.0  # of a recording that is tried out; readings per second
USUAL_FORCE = 0.2  # N, where none was recorded so far; invented
Corners = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """A recording that could be made: corners of (s, share of pressure, F1, F2 in largest)."""

    words: str
    corners: Corners


IDEAS = (
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
    """Say which recording would show most of the wanted effects, beside their rivals.

    Of each wanted effect counts how large, in units of what is visible, it would be at the far
    end of its prior range. Empty where there is nothing to wish for.
    """
    if not wanted:
        return ''
    design = made(refit)
    if design is None:
        return ''
    first = design.training
    trial = Refitting(design, refit.hypotheses, len(design.blocks))
    at = trial.residuals(refit.base, refit.numbers)
    linear = None if at is None else trial.linear(refit.base, refit.numbers, at)
    if linear is None or at is None:
        return ''
    names = {item.hypothesis.name: item for item in (*wanted, *rivals)}
    answers = {name: answer(refit, design, at, item) for name, item in names.items()}
    best, words, name = 0.0, '', ''
    for place, idea in enumerate(IDEAS):
        kept = [*range(first), first + place]
        part = GaussianModel.of(
            [linear.columns[which] for which in kept],
            [linear.residuals[which] for which in kept],
            linear.position,
            [linear.grams[which] for which in kept],
        )
        for item in wanted:
            mine = item.hypothesis.name
            others = [one.hypothesis.name for one in rivals if one.hypothesis.name != mine]
            chosen = [answers[one] for one in (mine, *others)]
            shown = information(part, kept, chosen) * at_the_end(item)
            if shown > best:
                best, words, name = shown, idea.words, mine
    if not words:
        return ''
    return (
        f'Record next: {words}. It would show {name} best: chi squared of {best:.0f} at the end '
        'of its prior range.'
    )


def made(refit: Refit) -> Linearization | None:
    """Return a design with a run for each idea behind the training runs."""
    design = refit.design
    training = design.runs[: design.training]
    low, high = refit.point.arm.pressure_range
    force = max((float(np.abs(run.force).max()) for run in training), default=0.0) or USUAL_FORCE
    stamp = max(int(run.reading_stamp_ns[-1]) for run in training) + NANOSECONDS_PER_SECOND
    runs = [run_of(idea, low, high, force, stamp, training[0].x.shape[1]) for idea in IDEAS]
    try:
        return Linearization(refit.point, (*training, *runs), len(training), design.noise)
    except ModelError:
        return None


def run_of(
    idea: Experiment, low: float, high: float, force: float, stamp: int, targets: int
) -> RecordingData:
    """Return an idea as a run, its targets at zero."""
    corners = np.array(idea.corners, dtype=np.float64)
    time = np.arange(0.0, corners[-1, 0], 1.0 / RATE)
    pressure = low + (high - low) * np.interp(time, corners[:, 0], corners[:, 1])
    reading = np.linspace(0, time.size - 1, FRAMES).astype(np.int64)
    loads = np.column_stack([np.interp(time, corners[:, 0], corners[:, i]) for i in (2, 3)])
    stamps = stamp + np.rint(time * NANOSECONDS_PER_SECOND).astype(np.int64)
    none = np.zeros((FRAMES, targets))
    return RecordingData(
        name=idea.words,
        reading_stamp_ns=stamps,
        pressure=pressure,
        stamp_ns=stamps[reading],
        reading=reading,
        loaded=bool(np.any(loads)),
        force=force * loads[reading],
        moment=np.zeros(FRAMES),
        x=none,
        y=none,
    )


def answer(
    refit: Refit, design: Linearization, at: Sequence[Array], item: Candidate
) -> tuple[Array, ...] | None:
    """Return how all runs of a design answer to an effect; None where they have no shape."""
    effects = (*refit.effects, item.hypothesis.effect(item.tried))
    there = design.residual(refit.point.values, effects, range(len(design.blocks)))
    if there is None:
        return None
    return tuple(a - b for a, b in zip(at, there, strict=True))


def information(
    linear: GaussianModel, kept: Sequence[int], answers: Sequence[tuple[Array, ...] | None]
) -> float:
    """Return chi squared of the first of some effects in some runs, beside all others."""
    known = [item for item in answers if item is not None]
    if answers[0] is None:
        return 0.0
    columns = [np.column_stack([item[which] for item in known]) for which in kept]
    inner = linear.inner(columns, columns)
    mine = float(inner[0, 0])
    if len(known) > 1:
        mine -= float(inner[0, 1:] @ np.linalg.pinv(inner[1:, 1:]) @ inner[1:, 0])
    return max(mine, 0.0)


def at_the_end(item: Candidate) -> float:
    """Return by how much chi squared is larger at the end of the prior range than as tried."""
    coordinate = item.hypothesis.coordinates[item.which]
    tried = max(abs(float(item.tried[item.which])), 1e-300)
    return float((PRIOR_RANGE * coordinate.std / tried) ** 2)
