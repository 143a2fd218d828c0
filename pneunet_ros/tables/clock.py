"""Dates and times of day in the cells of a table, as seconds."""

from __future__ import annotations

from datetime import date
from decimal import Decimal
from pathlib import Path
import re

from pneunet_ros.core.notes import Note

_LINES_SHOWN = 30
# As MATLAB writes them.
_MONTHS = ['Jan', 'Feb', 'Mar', 'Apr', 'May', 'Jun', 'Jul', 'Aug', 'Sep', 'Oct', 'Nov', 'Dec']
_HALF_A_DAY, _DAY = 43_200, 86_400  # s
_TIME_OF_DAY = re.compile(
    r'(?:(?P<date>\d{4}(?:-\d\d?-|/\d\d?/)\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4}'
    r'|\d\d?-[A-Z][a-z][a-z]-\d{4})[T ]+)?'
    r'(?P<hour>[01]?\d|2[0-3]):(?P<minute>[0-5]\d)(?::(?P<second>[0-5]\d(?:[.,]\d{1,9})?))?'
    r' ?(?:Z|UTC|(?P<zone>[+-](?:0\d|1[0-4])(?::?[0-5]\d)?)|(?P<half>[AaPp][Mm]))?',
    re.ASCII,
)


def is_time(text: str) -> bool:
    """Whether a text is a time of day, with or without a date."""
    return _TIME_OF_DAY.fullmatch(text) is not None


class Clock:
    """Parses successive dates and times of day; times without a date may cross midnight."""

    __slots__ = ('_days', '_midnights', 'latest')

    def __init__(self) -> None:
        """Start on the first day."""
        self.latest: Decimal | None = None
        self._midnights: list[int] = []
        self._days = 0

    def seconds(self, text: str, line: int) -> str:
        """Return seconds (since 1970 if there is a date), or the text if it is not a time."""
        match = _TIME_OF_DAY.fullmatch(text)
        seconds = None if match is None else _clock_seconds(match)
        if match is None or seconds is None:
            return text
        if not match['date']:
            seconds += _DAY * self._days
            if self.latest is not None and self.latest - seconds > _HALF_A_DAY:
                self._midnights.append(line)
                self._days += 1
                seconds += _DAY
        self.latest = seconds
        return str(seconds)

    def sentences(self, path: Path) -> tuple[Note, ...]:
        """Report the lines at which a day was added."""
        if not self._midnights:
            return ()
        lines = ', '.join(str(line) for line in self._midnights[:_LINES_SHOWN])
        return (
            Note(
                f'{path}: the time of day passes midnight in line {lines}: one day was added',
                reason='midnight',
            ),
        )


def _clock_seconds(match: re.Match[str]) -> Decimal | None:
    """Return the time of day in UTC (s); after a date, the seconds since 1970."""
    hour, minute = int(match['hour']), int(match['minute'])
    if match['half']:
        hour = hour % 12 + (12 if match['half'].lower() == 'pm' else 0)
    seconds = Decimal((match['second'] or '0').replace(',', '.'))
    try:
        days = _days(match['date']) if match['date'] else 0
    except ValueError:
        return None
    return _DAY * days + 3600 * hour + 60 * minute + seconds - _zone(match['zone'])


def _zone(text: str | None) -> int:
    """Return the offset (s) from UTC of a text such as +01:00."""
    if not text:
        return 0
    digits = text[1:].replace(':', '').ljust(4, '0')
    return (-1 if text[0] == '-' else 1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))


def _days(text: str) -> int:
    """Return days since 1970 of 2026-11-22, 2026/11/22, 22.11.2026, 11/22/2026 or 22-Nov-2026.

    Raises ValueError if the text is not a date.
    """
    parts = re.split(r'[-./]', text)
    first, second, third = (
        _MONTHS.index(part) + 1 if part.isalpha() else int(part) for part in parts
    )
    year_first = first > 31
    year, month, day = (first, second, third) if year_first else (third, second, first)
    # The American order; both orders last for one day.
    if '/' in text and not year_first and second > 12:
        month, day = day, month
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()
