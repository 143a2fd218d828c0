"""A bank of hypotheses, each with its own belief.

A hypothesis is a set of causes, and the belief given exactly these causes. All hypotheses use the
same frames, and the evidence of each frame is added to their log weights. A hypothesis that is far
less likely than the best is dropped together with its belief, so that nothing has to be undone in
the others.

Source: multiple models with common measurements: Magill, IEEE Trans. Automatic Control 10 (1965);
evidence: MacKay, Neural Computation 4 (1992).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
import math
from typing import Generic, TypeVar

from pneunet_ros.measurement.inference.gaussian import Gaussian

Believed = TypeVar('Believed', bound=Gaussian)
ALIKE = 4.0  # nats within which hypotheses are reported together: odds of 50 to 1, by convention


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis(Generic[Believed]):
    """The belief under a set of causes.

    log_weight: log odds relative to the most likely hypothesis of its bank, which has 0.
    """

    belief: Believed
    log_weight: float = 0.0

    @property
    def is_about_as_likely(self) -> bool:
        """Whether the hypothesis is about as likely as the best one."""
        return self.log_weight > -ALIKE


def ranked(
    hypotheses: Iterable[Hypothesis[Believed]],
    bound: float,
    most: int,
    is_same: Callable[[Believed, Believed], bool],
) -> tuple[Hypothesis[Believed], ...]:
    """Return the likely hypotheses, best first.

    Args:
        hypotheses: in any order; a constant may be common to all weights.
        bound: log odds against the best hypothesis, above which a hypothesis is dropped.
        most: largest number kept.
        is_same: whether two beliefs are equivalent; the less likely of them is dropped.
    """
    kept: list[Hypothesis[Believed]] = []
    for one in sorted(hypotheses, key=lambda item: -item.log_weight):
        if len(kept) == most or not one.log_weight > -math.inf:
            break
        if kept and one.log_weight < kept[0].log_weight - bound:
            break
        if not any(is_same(one.belief, other.belief) for other in kept):
            kept.append(one)
    return tuple(replace(one, log_weight=one.log_weight - kept[0].log_weight) for one in kept)


def odds_relative_to_first(hypotheses: tuple[Hypothesis[Believed], ...]) -> list[float]:
    """Return the odds of every other hypothesis against the first one, at most 1.

    Used as weights when the errors of the first hypothesis are widened by the distances to the
    others. The result is at least the second moment of the mixture, because evidence is only as
    good as its models.
    """
    return [
        math.exp(min(one.log_weight - hypotheses[0].log_weight, 0.0)) for one in hypotheses[1:]
    ]
