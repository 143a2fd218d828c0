"""Sparse Bayesian learning: column variances that maximize a single marginal likelihood.

Everything is known from score z (n,) and information G (n, n) of the columns, in which the base,
placement, camera and readings are integrated out. A column that is not in the model has variance
zero. Sequential updates of Tipping and Faul (2003).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.arrays import Array

MOST_UPDATES = 200
SETTLED = 1e-3  # nats that an update must gain
LEAST_INFORMATION = 1e-9  # of a column of one prior deviation, to be seen at all


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dictionary:
    """Score and information of columns, the cause that each belongs to, and what adding it costs.

    costs (n,): nats, minus the log prior probability that this column is in the model.
    """

    score: Array
    information: Array
    causes: tuple[str, ...]
    costs: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation:
    """Columns with variances above zero, and their log evidence over none, costs taken off."""

    causes: tuple[str, ...] = ()
    columns: tuple[int, ...] = ()
    variances: tuple[float, ...] = ()
    evidence: float = 0.0
    weights: dict[str, float] = field(default_factory=dict)

    @property
    def strongest(self) -> str | None:
        """The cause without which the evidence falls most."""
        return max(self.weights, key=self.weights.__getitem__, default=None)


def log_evidence(items: Dictionary, columns: Sequence[int], variances: Sequence[float]) -> float:
    """Return the log evidence of columns with variances over none, costs taken off."""
    if not columns:
        return 0.0
    chosen, root = list(columns), np.sqrt(np.array(variances))
    inner = np.eye(len(chosen)) + root[:, None] * items.information[np.ix_(chosen, chosen)] * root
    lower = np.linalg.cholesky(inner)
    half = np.linalg.solve(lower, root * items.score[chosen])
    volume = float(np.log(np.diag(lower)).sum())
    return 0.5 * float(half @ half) - volume - float(items.costs[chosen].sum())


def explain(items: Dictionary, without: Iterable[str] = ()) -> Explanation:
    """Return the most probable columns, none of some causes, and the weight of each cause."""
    banned = {*without}
    free = np.array([cause not in banned for cause in items.causes])
    free &= np.diag(items.information) > LEAST_INFORMATION
    columns, variances = updated(items, free)
    evidence = log_evidence(items, columns, variances)
    weights = {}
    for cause in dict.fromkeys(items.causes[place] for place in columns):
        rest = [place for place, item in enumerate(columns) if items.causes[item] != cause]
        left = log_evidence(items, [columns[i] for i in rest], [variances[i] for i in rest])
        weights[cause] = evidence - left
    return Explanation(
        causes=tuple(weights),
        columns=tuple(columns),
        variances=tuple(variances),
        evidence=evidence,
        weights=weights,
    )


def updated(items: Dictionary, free: np.ndarray) -> tuple[list[int], list[float]]:
    """Add, change and prune one column after the other, the most useful update first."""
    precision: dict[int, float] = {}
    for _ in range(MOST_UPDATES):
        active = list(precision)
        alpha = np.array([precision[item] for item in active])
        inner = items.information[np.ix_(active, active)]
        covariance = np.linalg.inv(inner + np.diag(alpha)) if active else np.zeros((0, 0))
        cross = items.information[:, active]
        spread = np.diag(items.information) - np.einsum('ij,jk,ik->i', cross, covariance, cross)
        pull = items.score - cross @ (covariance @ items.score[active])
        own_s, own_q = spread.copy(), pull.copy()
        if active:
            share = alpha / np.maximum(alpha - spread[active], 1e-12)
            own_s[active], own_q[active] = share * spread[active], share * pull[active]
        own_s = np.maximum(own_s, LEAST_INFORMATION)
        theta = own_q**2 - own_s
        over = theta > 1e-12 * own_s
        best = np.where(over, own_s**2 / np.where(over, theta, 1.0), np.inf)

        def likelihood(at: np.ndarray, s: np.ndarray = own_s, q: np.ndarray = own_q) -> np.ndarray:
            return 0.5 * (-np.log1p(s / at) + q**2 / (at + s))

        gain = np.where(np.isfinite(best) & free, likelihood(best) - items.costs, -np.inf)
        if active:
            now = likelihood(alpha, own_s[active], own_q[active]) - items.costs[active]
            gain[active] = np.maximum(gain[active], 0.0) - now  # changed, or pruned
        chosen = int(np.argmax(gain))
        if not gain[chosen] > SETTLED:
            break
        if np.isfinite(best[chosen]) and likelihood(best)[chosen] > items.costs[chosen]:
            precision[chosen] = float(best[chosen])
        else:
            precision.pop(chosen, None)
    active = list(precision)
    return active, [1.0 / precision[item] for item in active]
