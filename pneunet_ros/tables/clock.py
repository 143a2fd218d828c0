"""Dates and times of day in the cells of a table, as seconds."""

from __future__ import annotations

from datetime import date
from decimal import Decimal
from functools import lru_cache
import math
from pathlib import Path
import re

from pneunet_ros.core.errors import RecordingError
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

    __slots__ = ('_clear', '_days', '_midnights', '_orders', '_shifts', 'latest')

    def __init__(self) -> None:
        """Start on the first day."""
        self.latest: Decimal | None = None
        self._midnights: list[int] = []
        self._days = 0
        self._clear = False
        self._orders = _Order(), _Order()  # the day before the month, the month before the day
        self._shifts: dict[int, int] = {}  # s from the first order to the second, by line

    def seconds(self, text: str, line: int) -> str:
        """Return seconds (since 1970 if there is a date), or the text if it is not a time.

        A date that is valid in both orders is read with the day first; see `shifts`.
        """
        match = _TIME_OF_DAY.fullmatch(text)
        if match is None:
            return text
        seconds = _clock_seconds(match)
        self._clear |= any(match[part] for part in ('date', 'second', 'half'))
        if match['date']:
            both = [None if day is None else _DAY * day for day in _days(match['date'])]
            for order, start in zip(self._orders, both, strict=True):
                order.take(None if start is None else start + seconds)
            if not any(order.possible for order in self._orders):
                return text
            day_first, month_first = both
            if day_first is not None and month_first is not None and day_first != month_first:
                self._shifts[line] = month_first - day_first
            seconds += (day_first if day_first is not None else month_first) or 0
        else:
            seconds += _DAY * self._days
            if self.latest is not None and self.latest - seconds > _HALF_A_DAY:
                self._midnights.append(line)
                self._days += 1
                seconds += _DAY
        self.latest = seconds
        return str(seconds)

    def check(self, path: Path) -> None:
        """Reject times that may be of a stopwatch: no date, no seconds, neither AM nor PM."""
        if self.latest is not None and not self._clear:
            raise RecordingError(
                f'{path}: the times have two numbers, which may be hours and minutes, or minutes '
                'and seconds: write both as hh:mm:ss, e.g. 00:01:30 for a minute and a half',
                reason='no_unit',
            )

    def shifts(self) -> dict[int, int]:
        """Return seconds to add to the times of these lines, because the month comes first.

        One order holds for all dates: the only possible order, or else the order in which the
        dates increase over the shorter time; day first if all are of one day.
        """
        day_first, month_first = (order.rank() for order in self._orders)
        return self._shifts if month_first < day_first else {}

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


class _Order:
    """An order of day and month: whether all dates are valid in it, and whether they increase."""

    __slots__ = ('_decreases', '_highest', '_latest', '_lowest', 'possible')

    def __init__(self) -> None:
        self.possible, self._decreases = True, False
        self._lowest, self._highest, self._latest = math.inf, -math.inf, -math.inf

    def take(self, seconds: Decimal | None) -> None:
        """Add the next time; None: its date is invalid."""
        if seconds is None:
            self.possible = False
            return
        time = float(seconds)
        self._decreases |= time < self._latest
        self._lowest, self._highest = min(self._lowest, time), max(self._highest, time)
        self._latest = time

    def rank(self) -> tuple[bool, bool, float]:
        """Return a sort key, lowest for the most plausible order."""
        return not self.possible, self._decreases, self._highest - self._lowest


def _clock_seconds(match: re.Match[str]) -> Decimal:
    """Return the time of day in UTC (s)."""
    hour, minute = int(match['hour']), int(match['minute'])
    if match['half']:
        hour = hour % 12 + (12 if match['half'].lower() == 'pm' else 0)
    seconds = Decimal((match['second'] or '0').replace(',', '.'))
    return 3600 * hour + 60 * minute + seconds - _zone(match['zone'])


def _zone(text: str | None) -> int:
    """Return the offset (s) from UTC of a text such as +01:00."""
    if not text:
        return 0
    digits = text[1:].replace(':', '').ljust(4, '0')
    return (-1 if text[0] == '-' else 1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))


@lru_cache(maxsize=1)  # mostly that of the row before
def _days(text: str) -> tuple[int | None, int | None]:
    """Return days since 1970 of 2026-11-22, 2026/11/22, 22.11.2026, 11/22/2026 or 22-Nov-2026.

    Two numbers: with the day before the month, and with the month before the day, which differ
    only for dates such as 3/4/2026. None for an invalid date.
    """
    parts = re.split(r'[-./]', text)
    first, second, third = (
        _MONTHS.index(part) + 1 if part.isalpha() else int(part) for part in parts
    )
    if first > 31:
        return (_days_since_1970(first, second, third),) * 2
    day_first = _days_since_1970(third, second, first)
    return day_first, _days_since_1970(third, first, second) if '/' in text else day_first


def _days_since_1970(year: int, month: int, day: int) -> int | None:
    try:
        return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()
    except ValueError:
        return None
