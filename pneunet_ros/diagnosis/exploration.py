"""The next recording: record, diagnose, see what is still possible, choose, until there is a name.

What is still possible are the effects of the library, each on top of what is named so far, and
that nothing more is missing; how probable each is comes from the diagnosis so far. Of all
experiments in the safe set the next is the one with the largest expected divergence between them
per second (Box and Hill, 1967, with the covariance of all recordings).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import itertools
import math

import numpy as np
from pneunet_ros.calibration.held_out import score
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError, RequestError
from pneunet_ros.core.progress import OnProgress, say_nothing
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.diagnosis import investigate, Investigation
from pneunet_ros.diagnosis.experiment_design import Experiment
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.refit import effect_direction, linearize_all_runs, Refit
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.diagnosis.score_test import Candidate
from pneunet_ros.diagnosis.selection import evidence_margin, Selection, Trial
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings, ExperimentDesignSettings
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

NOTHING = 'nothing'  # the rival that nothing is missing, beside what is named


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorationSettings:
    """When a search for the next recording ends, and how it chooses."""

    recordings: int = tuning(8, 'recordings at most: the fixed protocol of the lab has as many')
    stays: int = tuning(2, 'rounds in a row with the same name, so that a new one tests it')
    frames: int = tuning(30, 'frames of an experiment that is tried out')
    between: float = tuning(2.0, 'pause between recordings', unit='s')


EXPLORATION = ExplorationSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class SafeSet:
    """What may be done to the arm: gauge pressure (Pa) from low to high, force (N) at most."""

    low: float
    high: float
    force: float

    def __post_init__(self) -> None:
        """Check the order."""
        if not (self.low < self.high and self.force >= 0.0 and math.isfinite(self.force)):
            raise RequestError(
                f'the safe set goes from {self.low:g} to {self.high:g} Pa with at most '
                f'{self.force:g} N: pressures must rise, and the force be 0 or more'
            )

    @classmethod
    def of(cls, arm: Arm, usual_force: float) -> SafeSet:
        """Return what a model was calibrated to; the force where it was never loaded."""
        low, high = arm.pressure_range
        loads = np.zeros((0, 2)) if arm.domain is None else arm.domain.end_load[:, :2]
        force = float(np.hypot(*loads.T).max()) if loads.size else usual_force
        return cls(low=max(low, 0.0), high=high, force=force or usual_force)

    def corners(self, experiment: Experiment) -> Array:
        """Return the corners (k, 4) of an experiment: time s, pressure Pa, F1 and F2 N."""
        time, share, x, y = np.array(experiment.corners, dtype=np.float64).T
        pressure = self.low + (self.high - self.low) * share
        return np.column_stack([time, pressure, self.force * x, self.force * y])


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """An experiment, and what it is worth: expected divergence per second, and between whom.

    divergence: by pair of rivals, in log probability.
    """

    experiment: Experiment
    seconds: float
    rate: float
    divergence: Mapping[tuple[str, str], float]

    @property
    def words(self) -> str:
        """Which rivals it tells apart most, in words."""
        if not self.divergence:
            return 'to begin with'
        pair = max(self.divergence, key=self.divergence.__getitem__)
        return f'it would tell {pair[0]} from {pair[1]} best'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Round:
    """One recording, and what is known after it.

    choice: what was recorded and why; rivals: what is still possible, probability by name;
    predicted: rms (m) at which the model of the round before predicts this recording, of which it
    knew nothing; None in the first round.
    """

    choice: Choice
    run: RecordingData
    found: Investigation
    rivals: Mapping[str, float]
    predicted: float | None

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis of all recordings so far; None where it did not settle."""
        found = self.found.diagnosis
        return found if isinstance(found, Diagnosis) else None


# It leaves the upper pressures to later ones: what a first loading does is seen but once.
BEGINNING = Experiment(
    words='without a load, a fast step up and down, then slow ramps, to 60 % of the pressure',
    corners=(
        (0, 0, 0, 0), (2, 0, 0, 0), (2.6, 0.55, 0, 0), (10, 0.55, 0, 0), (10.6, 0.2, 0, 0),
        (17, 0.2, 0, 0), (26, 0.6, 0, 0), (29, 0.6, 0, 0), (38, 0, 0, 0), (40, 0, 0, 0),
    ),
)  # fmt: skip
DIRECTIONS = (
    ((1.0, 0.0), 'along the arm at rest (E1)'),
    ((0.0, 1.0), 'across the arm at rest (E2)'),
    ((0.7, 0.7), 'between E1 and E2'),
    ((0.7, -0.7), 'between E1 and -E2'),
)
LEVELS = ((0.15, 0.85), (0.4, 1.0), (0.0, 0.6))  # shares of the range at which forces are swept


def experiments() -> Iterator[Experiment]:
    """Yield recordings of 20 to 40 s that could be made, in shares of the safe set."""
    yield Experiment(
        words='without a load, steps of pressure up and down with holds of 6 s',
        corners=(
            (0, 0, 0, 0), (2, 0, 0, 0), (2.5, 0.5, 0, 0), (8.5, 0.5, 0, 0), (9, 1, 0, 0),
            (15, 1, 0, 0), (15.5, 0.5, 0, 0), (21.5, 0.5, 0, 0), (22, 0, 0, 0), (28, 0, 0, 0),
        ),
    )  # fmt: skip
    yield Experiment(
        words='without a load, pressure that goes up and down in 2 s, then in 6 s, over and over',
        corners=tuple(
            (time, 0.9 * (place % 2) + 0.05, 0, 0)
            for place, time in enumerate((0, 1, 2, 3, 4, 5, 6, 9, 12, 15, 18, 21, 24))
        ),
    )
    for (x, y), words in DIRECTIONS:
        for low, high in LEVELS:
            yield Experiment(
                words=f'a force {words}, swept up and down at {low:.0%} and {high:.0%} of the '
                'pressure',
                corners=(
                    (0, low, 0, 0), (7, low, x, y), (14, low, 0, 0), (16, high, 0, 0),
                    (23, high, x, y), (30, high, 0, 0),
                ),
            )  # fmt: skip
        yield Experiment(
            words=f'a constant force {words}, ramps to half and to full pressure, each twice',
            corners=(
                (0, 0, x, y), (5, 0.5, x, y), (10, 0, x, y), (15, 0.5, x, y), (20, 0, x, y),
                (25, 1, x, y), (30, 0, x, y), (35, 1, x, y), (40, 0, x, y),
            ),
        )  # fmt: skip


Record = Callable[[Experiment, SafeSet, int], RecordingData]


def explore(
    model: Arm,
    record: Record,
    safe: SafeSet,
    *,
    seed: int = 0,
    in_order: bool = False,
    on_progress: OnProgress = say_nothing,
    settings: ExplorationSettings = EXPLORATION,
    diagnosis_settings: DiagnosisSettings = DEFAULTS,
) -> Iterator[Round]:
    """Record, diagnose and choose, until there is a name or the budget is used up.

    Args:
        model: the arm, with the effects that are known already.
        record: makes a recording: an experiment, what is safe, and the number of the recording
            from 0 on. Its stamps must come after those of the recordings before.
        safe: what may be done to the arm.
        seed: of the simulated clean data behind the thresholds of the diagnosis.
        in_order: take the experiments one after the other, without a choice, to compare with.
        on_progress: called with what is done, how far, and of how much (0 = unknown).
        settings: the numbers by which it decides.
        diagnosis_settings: those of the diagnosis.

    Yields:
        Every round, the last one with the answer. It ends at a name that stayed when a recording
        came that had no part in it, or when the budget is used up.

    """
    runs: list[RecordingData] = []
    choice = Choice(experiment=BEGINNING, seconds=BEGINNING.seconds, rate=0.0, divergence={})
    before: Diagnosis | None = None
    names: list[frozenset[str]] = []
    while len(runs) < settings.recordings:
        on_progress(f'recording {len(runs) + 1}: {choice.experiment.words}', 0, 0)
        run = record(choice.experiment, safe, len(runs))
        predicted = None if before is None else score(before.after.arm, run).rms
        runs.append(run)
        found = investigate(
            model, runs, [], seed=seed, on_progress=on_progress, settings=diagnosis_settings
        )
        rivals = rival_probabilities(found)
        yield Round(choice=choice, run=run, found=found, rivals=rivals, predicted=predicted)
        before = found.diagnosis if isinstance(found.diagnosis, Diagnosis) else before
        names.append(named_effects(found))
        if names[-1] and len(names) >= settings.stays and len({*names[-settings.stays :]}) == 1:
            return
        on_progress('the next recording', 0, 0)
        if in_order:
            choice = choice_in_order(len(runs))
        else:
            choice = next_choice(found, rivals, safe, len(runs), settings, diagnosis_settings)


def named_effects(found: Investigation) -> frozenset[str]:
    """Return the names of the effects that are named; none where the answer is another one."""
    diagnosis = found.diagnosis
    if not isinstance(diagnosis, Diagnosis) or diagnosis.answer != 'named':
        return frozenset()
    return frozenset(item.name for item in diagnosis.effects)


def trial_in_question(found: Investigation) -> Trial | None:
    """Return what rivals stand on top of: what is named, else the base; None for nothing settled.

    Where effects cannot be told apart each is a rival of the other, on top of the base.
    """
    return found.trial if found.diagnosis.answer == 'named' else found.base


def rival_candidates(selection: Selection, trial: Trial) -> list[Candidate]:
    """Return every effect that may be missing beside those of a trial.

    Those that the recordings so far could not show at all stand in the middle of where they are
    tried, with no information.
    """
    scored = selection.score_candidates(trial)
    known = {*trial.names, *(item.name for item in scored)}
    unseen = []
    for item in selection.hypotheses:
        if item.name not in known:
            starts = item.starts()
            which, tried = starts[len(starts) // 2]
            unseen.append(
                Candidate(
                    hypothesis=item,
                    which=which,
                    tried=tried,
                    gain=0.0,
                    start=tried,
                    information=0.0,
                    direction=(),
                )
            )
    return [*scored, *unseen]


def rival_probabilities(found: Investigation) -> dict[str, float]:
    """Return what is still possible: how probable each effect is, and that none is missing.

    Each on top of what is named, alone where nothing is. Of an effect that was fitted by its
    evidence; else by its score, as if points were linear in it. What no recording could have shown
    so far is as probable as nothing.
    """
    selection, trial = found.selection, trial_in_question(found)
    if selection is None or trial is None:
        return {}
    logs = {NOTHING: 0.0}
    for item in rival_candidates(selection, trial):
        fitted = selection.tried.get(frozenset([*trial.names, item.name]))
        known = trial.record.evidence
        logs[item.name] = linear_evidence(item) if fitted is None else fitted.evidence - known
    values = np.array(list(logs.values()))
    settings = selection.settings.selection
    sharpness = settings.least_evidence / evidence_margin(float(values.max()), settings)
    weights = np.exp(sharpness * (values - values.max()))
    return dict(zip(logs, (weights / weights.sum()).tolist(), strict=True))


def size_moments(item: Candidate) -> tuple[float, float]:
    """Return mean and variance of a size, in units of the one that was tried."""
    coordinate = item.hypothesis.coordinates[item.which]
    tried = abs(float(item.tried[item.which]))
    variance = 1.0 / ((tried / coordinate.std) ** 2 + item.information)
    mean = variance * math.sqrt(item.gain * item.information)
    return mean, variance


def linear_evidence(item: Candidate) -> float:
    """Return the log probability that an effect gains, over a prior of its size."""
    coordinate = item.hypothesis.coordinates[item.which]
    prior = (coordinate.std / abs(float(item.tried[item.which]))) ** 2
    mean, variance = size_moments(item)
    return 0.5 * (mean**2 / variance - math.log(prior / variance))


def next_choice(
    found: Investigation,
    rivals: Mapping[str, float],
    safe: SafeSet,
    recorded: int,
    settings: ExplorationSettings = EXPLORATION,
    diagnosis_settings: DiagnosisSettings = DEFAULTS,
) -> Choice:
    """Return the experiment of the largest expected divergence per second."""
    ranked = ranked_choices(found, rivals, safe, settings, diagnosis_settings)
    if ranked:
        return ranked[0]
    return choice_in_order(recorded)  # nothing settled: what was not recorded yet may help


def choice_in_order(recorded: int) -> Choice:
    """Return the experiment whose turn it is after so many recordings."""
    items = tuple(experiments())
    item = items[(recorded - 1) % len(items)]
    return Choice(experiment=item, seconds=item.seconds, rate=0.0, divergence={})


def ranked_choices(
    found: Investigation,
    rivals: Mapping[str, float],
    safe: SafeSet,
    settings: ExplorationSettings = EXPLORATION,
    diagnosis_settings: DiagnosisSettings = DEFAULTS,
) -> list[Choice]:
    """Return all experiments with what they are worth, the best first."""
    trial = trial_in_question(found)
    if found.selection is None or trial is None:
        return []
    items = tuple(experiments())
    design = replace(diagnosis_settings.experiment_design, frames=settings.frames)
    refit = trial.refit
    linearization = linearize_experiments(refit, items, safe, design)
    candidates = rival_candidates(found.selection, trial)
    tried = (
        None
        if linearization is None
        else informations(linearization, refit, candidates, diagnosis_settings)
    )
    if tried is None:
        return []
    known, after = tried
    names = [item.name for item in candidates]
    squares = np.array([mean**2 + variance for mean, variance in map(size_moments, candidates)])
    choices = []
    for item, inner in zip(items, after, strict=True):
        gained = np.maximum(separations(inner) - separations(known), 0.0)
        divergence = pair_divergences(names, squares, gained)
        weighted = {
            (one, other): rivals[one] * rivals[other] * value
            for (one, other), value in divergence.items()
        }
        choices.append(
            Choice(
                experiment=item,
                seconds=item.seconds,
                rate=sum(weighted.values()) / item.seconds,
                divergence=weighted,
            )
        )
    return sorted(choices, key=lambda item: -item.rate)


def linearize_experiments(
    refit: Refit,
    items: Sequence[Experiment],
    safe: SafeSet,
    settings: ExperimentDesignSettings,
) -> Linearization | None:
    """Return the training runs and every experiment after them, around a refit."""
    fitted = refit.linearization
    training = fitted.runs[: fitted.training]
    stamp_ns = max(int(run.reading_stamp_ns[-1]) for run in training) + NANOSECONDS_PER_SECOND
    runs = [
        item.recording(
            (safe.low, safe.high), safe.force, stamp_ns, training[0].x.shape[1], settings
        )
        for item in items
    ]
    try:
        return Linearization(
            refit.point, (*training, *runs), len(training), fitted.noise, fitted.settings
        )
    except ModelError:
        return None


def informations(
    linearization: Linearization,
    refit: Refit,
    candidates: Sequence[Candidate],
    settings: DiagnosisSettings,
) -> tuple[Array, list[Array]] | None:
    """Return the inner products of the effects' directions (n, n), all else fitted jointly.

    In the training runs, and in them with each experiment. None where the arm has no shape.
    """
    at_fit = linearize_all_runs(linearization, refit, settings.refit)
    if at_fit is None or not candidates:
        return None
    residuals, gaussian = at_fit[0].residuals, at_fit[1]
    directions = [
        effect_direction(linearization, refit, residuals, item.hypothesis.effect(item.tried))
        for item in candidates
    ]
    none = [np.zeros(values.size) for values in residuals]
    columns = [
        np.column_stack([(none if item is None else item)[run] for item in directions])
        for run in range(len(residuals))
    ]

    def inner(kept: Sequence[int]) -> Array:
        part = GaussianModel.of(
            [gaussian.columns[which] for which in kept],
            [gaussian.residuals[which] for which in kept],
            gaussian.position,
            [gaussian.grams[which] for which in kept],
        )
        some = [columns[which] for which in kept]
        return part.inner(some, some)

    training = list(range(linearization.training))
    further = range(linearization.training, len(residuals))
    return inner(training), [inner([*training, which]) for which in further]


def separations(inner: Array) -> Array:
    """Return chi squared (n, n + 1) of each effect beside each other one, and beside none."""
    own = np.diag(inner)
    explained = inner**2 / np.maximum(own, 1e-300)[None, :]
    beside = np.maximum(own[:, None] - explained, 0.0)
    return np.column_stack([beside, own])


def pair_divergences(
    names: Sequence[str], squares: Array, gained: Array
) -> dict[tuple[str, str], float]:
    """Return the expected divergence of every two rivals, in log probability.

    The sizes of effects are not known: integrated over them, chi squared c that is expected of an
    effect diverges by log(1 + c) / 2 from what lacks it (Lindley, 1956). Of two effects either may
    be the true one.

    squares (n,): expected square of each size; gained (n, n + 1): chi squared per square of size
    that an experiment adds, as of `separations`.
    """
    worth = 0.5 * np.log1p(squares[:, None] * gained)
    found = {(name, NOTHING): float(worth[place, -1]) for place, name in enumerate(names)}
    for one, other in itertools.combinations(range(len(names)), 2):
        both = 0.5 * (worth[one, other] + worth[other, one])
        found[names[one], names[other]] = float(both)
    return found
