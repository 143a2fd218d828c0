"""Choice of the next experiment: the largest expected divergence between rivals per second.

Method: Box and Hill (1967), with the covariance of all recordings so far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import itertools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.settings import BASE_FIT
from pneunet_ros.exploration.experiment_design import Experiment, informations
from pneunet_ros.exploration.experiments import BEGINNING, experiments
from pneunet_ros.exploration.rivals import NOTHING, rival_candidates, size_moments, trial_to_extend
from pneunet_ros.exploration.safe_set import SafeSet


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """An experiment with its value: expected divergence per second between rivals.

    divergence: by pair of rivals, in log probability.
    """

    experiment: Experiment
    seconds: float
    rate: float
    divergence: Mapping[tuple[str, str], float]

    @property
    def words(self) -> str:
        """The rivals that the experiment separates best, in words."""
        if not self.divergence:
            return 'to start with' if self.experiment == BEGINNING else 'the next in order'
        pair = max(self.divergence, key=self.divergence.__getitem__)
        if pair[1] == NOTHING:
            return f'it would show {pair[0]} best'
        return f'it would best distinguish {pair[0]} from {pair[1]}'


def next_choice(
    investigation: Investigation | UnsettledInvestigation,
    rivals: Mapping[str, float],
    safe: SafeSet,
    recorded: Sequence[Experiment],
) -> Choice:
    """Return the experiment of the largest expected divergence per second."""
    ranked = ranked_choices(investigation, rivals, safe)
    if ranked:
        return ranked[0]
    return choice_in_order(safe, recorded)  # undecided: those not yet recorded may help


def choice_in_order(safe: SafeSet, recorded: Sequence[Experiment]) -> Choice:
    """Return the first of the experiments that were recorded the fewest times."""
    item = min(allowed_experiments(safe), key=recorded.count)
    return Choice(experiment=item, seconds=item.seconds, rate=0.0, divergence={})


def allowed_experiments(safe: SafeSet) -> tuple[Experiment, ...]:
    """Return the experiments within the limits, each in one of two opposite directions."""
    kept: dict[tuple[tuple[float, ...], ...], Experiment] = {}
    for item in experiments(safe.loaded):
        opposite = tuple((time, share, -x, -y) for time, share, x, y in item.corners)
        if opposite not in kept and safe.allows(item):
            kept[item.corners] = item
    return tuple(kept.values())


def ranked_choices(
    investigation: Investigation | UnsettledInvestigation,
    rivals: Mapping[str, float],
    safe: SafeSet,
) -> list[Choice]:
    """Return all experiments with their values, best first."""
    if isinstance(investigation, UnsettledInvestigation):
        return []
    trial = trial_to_extend(investigation)
    items = allowed_experiments(safe)
    candidates = rival_candidates(investigation.selection, trial)
    span = safe.low, safe.high
    limited = [safe.within(item) for item in items]
    tried = informations(trial.refit, limited, candidates, span, safe.force, BASE_FIT.first_frames)
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


def separations(inner: Array) -> Array:
    """Return chi squared (n, n + 1) between each pair of effects, and between each and none."""
    diagonal = np.diag(inner)
    explained = inner**2 / np.maximum(diagonal, 1e-300)[None, :]
    separation = np.maximum(diagonal[:, None] - explained, 0.0)
    return np.column_stack([separation, diagonal])


def pair_divergences(
    names: Sequence[str], squares: Array, gained: Array
) -> dict[tuple[str, str], float]:
    """Return the expected divergence of every two rivals, in log probability.

    The sizes of effects are unknown. Integrated over the size, the divergence between an effect
    with expected chi squared c and the model without it is log(1 + c) / 2 (Lindley, 1956). Of two
    effects, either may be the true one.

    squares (n,): expected square of each size; gained (n, n + 1): chi squared per squared size
    added by an experiment, as in `separations`.
    """
    gains = 0.5 * np.log1p(squares[:, None] * gained)
    divergence = {(name, NOTHING): float(gains[index, -1]) for index, name in enumerate(names)}
    for first, second in itertools.combinations(range(len(names)), 2):
        mean = 0.5 * (gains[first, second] + gains[second, first])
        divergence[names[first], names[second]] = float(mean)
    return divergence
