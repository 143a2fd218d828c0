"""Files of the blind trials: one line per trial, answers and sealed truth in separate files.

Both are appended to as trials end, so that a bench that was stopped goes on where it was.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.json_text import json_text

Row = dict[str, Any]


class Record:
    """Answers in FILE.jsonl and the truth in FILE.sealed.jsonl; rows are told apart by `key`."""

    def __init__(self, file: Path) -> None:
        self.answers, self.sealed = file, file.with_suffix(f'.sealed{file.suffix}')
        for path in (self.sealed, self.answers):
            drop_half_line(path)

    def done(self) -> set[str]:
        """Return the keys of the trials that need not be done again."""
        return {row['key'] for row in read(self.answers)} & {
            row['key'] for row in read(self.sealed)
        }

    def add(self, answer: Row, truth: Row) -> None:
        """Write a finished trial: the truth first, so that no answer is without it."""
        for path, row in ((self.sealed, truth), (self.answers, answer)):
            with path.open('a', encoding='utf-8') as file:
                file.write(json_text(row))

    def opened(self) -> list[tuple[Row, Row]]:
        """Return (truth, answer) of all trials, for the scorer alone."""
        truths = {row['key']: row for row in read(self.sealed)}
        answers = {row['key']: row for row in read(self.answers)}
        return [(truths[key], answers[key]) for key in answers if key in truths]


def drop_half_line(path: Path) -> None:
    """Cut off a last line that was not written to its end."""
    if path.exists():
        whole = path.read_bytes()
        if whole and not whole.endswith(b'\n'):
            path.write_bytes(whole[: whole.rfind(b'\n') + 1])


def read(path: Path) -> list[Row]:
    """Return the rows of a file, none if there is no file."""
    if not path.exists():
        return []
    try:
        return [json.loads(line) for line in path.read_text(encoding='utf-8').splitlines()]
    except ValueError as error:
        raise RecordingError(f'{path} is no file of this bench: {error}') from error
