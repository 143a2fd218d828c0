"""Record, diagnose, and choose the next recording until an effect is named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from pneunet_ros.calibration.checks.held_out import score
from pneunet_ros.core.progress import ignore_progress, OnProgress
from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings
from pneunet_ros.exploration.choice import Choice, choice_in_order, next_choice
from pneunet_ros.exploration.experiment_design import Experiment
from pneunet_ros.exploration.experiments import BEGINNING
from pneunet_ros.exploration.rivals import named_effects, rival_probabilities
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.exploration.settings import EXPLORATION, ExplorationSettings
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm

Record = Callable[[Experiment, SafeSet, int], RecordingData]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Round:
    """One recording, and the results after it.

    choice: the recorded experiment and its reason; rivals: probabilities of the remaining effects
    by name; predicted: rms (m) of the prediction of this recording by the model of the previous
    round; None in the first round.
    """

    choice: Choice
    run: RecordingData
    investigation: Investigation | UnsettledInvestigation
    rivals: Mapping[str, float]
    predicted: float | None

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis of all recordings so far; None if it did not converge."""
        diagnosis = self.investigation.diagnosis
        return diagnosis if isinstance(diagnosis, Diagnosis) else None

    @property
    def undetectable(self) -> tuple[str, ...]:
        """Rivals that are undetectable in the recordings so far at any plausible size."""
        detectable = {} if self.diagnosis is None else self.diagnosis.detectable
        return tuple(
            name
            for name, item in detectable.items()
            if name in self.rivals and not item.observable
        )

    def overruled(self, diagnosis: Diagnosis) -> Round:
        """Return the round with its name withdrawn."""
        revised = self.investigation.overruled(diagnosis)
        return replace(self, investigation=revised, rivals=rival_probabilities(revised))


def explore(
    model: Arm,
    record: Record,
    safe: SafeSet,
    *,
    seed: int = 0,
    in_order: bool = False,
    on_progress: OnProgress = ignore_progress,
    settings: ExplorationSettings = EXPLORATION,
) -> Iterator[Round]:
    """Record, diagnose and choose, until an effect is named or the budget is used up.

    Args:
        model: the arm, with the effects that are already known.
        record: makes a recording, given an experiment, the safe set and the number of the
            recording, starting at 0. Its stamps must come after those of earlier recordings.
        safe: limits for the arm.
        seed: of the simulated clean data behind the thresholds of the diagnosis.
        in_order: use the experiments in order instead of choosing, for comparison.
        on_progress: called with the task, its progress, and its total (0 = unknown).
        settings: thresholds and priors.

    Yields:
        Every round, the last one with the answer. The exploration ends when a new
        recording confirms a name, or when the budget is used up.
    """
    runs: list[RecordingData] = []
    choice = Choice(experiment=BEGINNING, seconds=BEGINNING.seconds, rate=0.0, divergence={})
    before: Diagnosis | None = None
    rounds: list[Round] = []
    while len(runs) < settings.recordings:
        on_progress(f'recording {len(runs) + 1}: {choice.experiment.words}', 0, 0)
        run = record(choice.experiment, safe, len(runs))
        runs.append(run)
        predicted = None if before is None else rms_of_last(before.after.arm, runs)
        investigation = investigate(
            model,
            runs,
            [],
            seed=seed,
            on_progress=on_progress,
            settings=diagnosis_settings(len(runs)),
        )
        rivals = rival_probabilities(investigation)
        item = Round(
            choice=choice, run=run, investigation=investigation, rivals=rivals, predicted=predicted
        )
        rounds.append(item)
        yield item
        before = item.diagnosis or before
        if is_name_confirmed(rounds):
            return
        on_progress('the next recording', 0, 0)
        recorded = [one.choice.experiment for one in rounds]
        if in_order:
            choice = choice_in_order(safe, recorded)
        else:
            choice = next_choice(investigation, rivals, safe, recorded)


def rms_of_last(arm: Arm, runs: Sequence[RecordingData]) -> float:
    """Return the rms (m) of the prediction of the last run, with the history of all runs."""
    return score(arm, runs[-1], inputs_of(arm, runs)[-1]).rms


def is_name_confirmed(rounds: Sequence[Round]) -> bool:
    """Whether the round before gave the same name, so that the last recording tested it."""
    before, last = [(), (), *(named_effects(one.investigation) for one in rounds)][-2:]
    return bool(last) and last == before


def is_clear(rounds: Sequence[Round]) -> bool:
    """Whether the last answer is final: a confirmed name, or `none` with nothing undetectable."""
    last = rounds[-1]
    nothing_missing = last.investigation.diagnosis.answer == 'none' and not last.undetectable
    return nothing_missing or is_name_confirmed(rounds)


def diagnosis_settings(count: int) -> DiagnosisSettings:
    """Return the settings of a diagnosis of this many recordings.

    With only the first recording, a name cannot be tested, but is allowed, because the next
    recording will test it.
    """
    return replace(DEFAULTS, tested=count > 1)
