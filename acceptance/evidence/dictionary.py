"""Dictionary of columns around a fit: starts of every effect, terms of every kind of discovery.

The laws of the effects that are in the fit are open (`diagnosis.law_errors`): what they may miss
is their slack, integrated out before any other column is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis
from pneunet_ros.diagnosis.fit.law_errors import OpenLaws
from pneunet_ros.diagnosis.fit.refit import effect_direction, Refit
from pneunet_ros.discovery.amplitude import Projection, Runs
from pneunet_ros.discovery.law import Cause
from pneunet_ros.discovery.search import Search

from evidence.sparse import Dictionary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meaning:
    """What a column is: the start of an effect (which size, all numbers), or a term of a kind."""

    hypothesis: Hypothesis | None = None
    which: int = 0
    numbers: Array | None = None
    cause: Cause | None = None
    term: str = ''


class Columns:
    """Whitened columns of all causes around a fit, ready for evidence in any of its runs."""

    def __init__(
        self, fit: Refit, problem: OpenLaws, hypotheses: Sequence[Hypothesis], search: Search
    ) -> None:
        self.meanings: list[Meaning] = []
        self.causes: list[str] = []
        parts: list[list[Array]] = [[] for _ in range(fit.linearization.training)]
        self.add_effects(fit, hypotheses, parts)
        library = len(self.causes)
        self.add_kinds(search, parts)
        kinds = len(self.causes) - library
        # Either language is as likely, and within it every column.
        self.costs = np.concatenate(
            [np.full(library, np.log(2.0 * max(library, 1))), np.full(kinds, np.log(2.0 * kinds))]
        )
        self.projection = Projection(problem.gaussian)
        white = [problem.columns(which, np.column_stack(part)) for which, part in enumerate(parts)]
        gaussian = problem.gaussian
        self.parts = [
            (item.T @ item, columns.T @ item, item.T @ residuals)
            for item, columns, residuals in zip(
                white, gaussian.columns, gaussian.residuals, strict=True
            )
        ]

    def add_effects(
        self, fit: Refit, hypotheses: Sequence[Hypothesis], parts: list[list[Array]]
    ) -> None:
        """Add every start of every effect that is not in the fit, one prior deviation each."""
        linearization = fit.linearization
        runs = range(linearization.training)
        residuals = linearization.residual(fit.point.values, fit.effects, runs)
        if residuals is None:
            return
        for item in hypotheses:
            if item.name in fit.names:
                continue
            for which, numbers in item.starts():
                direction = effect_direction(linearization, fit, residuals, item.effect(numbers))
                if direction is None:
                    continue
                unit = item.std[which] / numbers[which]
                for part, column in zip(parts, direction, strict=True):
                    part.append(unit * column)
                self.meanings.append(Meaning(hypothesis=item, which=which, numbers=numbers))
                self.causes.append(item.name)

    def add_kinds(self, search: Search, parts: list[list[Array]]) -> None:
        """Add every term of every kind at every place that is tried."""
        for kind in search.kinds:
            for position in search.positions(kind):
                cause = search.cause(kind, position)
                if cause is None:
                    continue
                for part, white in zip(parts, cause.columns.white, strict=True):
                    part.extend(white.T)
                self.meanings += [Meaning(cause=cause, term=term) for term in cause.terms]
                self.causes += [f'kind {kind.name}'] * len(cause.terms)

    def dictionary(self, runs: Runs) -> Dictionary:
        """Return score and information in some of the runs."""
        base = self.projection.in_runs(runs)
        gram, cross, score = (sum(self.parts[w][i] for w in runs) for i in range(3))
        return Dictionary(
            score=score - cross.T @ base.step,
            information=gram - cross.T @ base.solved(cross),
            causes=tuple(self.causes),
            costs=self.costs,
        )
