"""Notes on a result: a sentence for users, with a reason code for programs."""

from __future__ import annotations

from typing import Any, Self


class Note(str):
    """A sentence for users; `reason` is its code, as in an error or a `Refusal`."""

    __slots__ = ('reason',)
    reason: str

    def __new__(cls, sentence: str, *, reason: str) -> Self:
        """Make a note from a sentence and its reason code."""
        note = super().__new__(cls, sentence)
        note.reason = reason
        return note

    def __getnewargs_ex__(self) -> tuple[tuple[str], dict[str, Any]]:
        """Return the arguments of a copy in another process."""
        return (str(self),), {'reason': self.reason}
