"""A refusal with its reason, returned instead of a result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A reading without an estimate: `reason` is a key for counting, `sentence` for users.

    error: whether estimates have stopped (True), or only one reading was dropped. `awaits_others`:
    the missing input comes from another node, which may still be starting.
    """

    stamp_ns: int
    reason: str
    sentence: str
    error: bool
    awaits_others: bool = False


def refuse(stamp_ns: int, reason: str, sentence: str, *, awaits_others: bool = False) -> Refusal:
    """Return a refusal that stops the estimates."""
    return Refusal(
        stamp_ns=stamp_ns,
        reason=reason,
        sentence=sentence,
        error=True,
        awaits_others=awaits_others,
    )


def drop(stamp_ns: int, reason: str, sentence: str) -> Refusal:
    """Return a refusal that drops one reading."""
    return Refusal(stamp_ns=stamp_ns, reason=reason, sentence=sentence, error=False)
