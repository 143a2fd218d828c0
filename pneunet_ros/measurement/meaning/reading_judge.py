"""Common parts of the pressure and wrench judges: comparison of the meanings of readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from pneunet_ros.core.settings import tuning


class Convention(Protocol):
    """Possible meaning of the numbers of a sensor."""

    @property
    def words(self) -> str:
        """Describe the convention for a user."""

    def changes_from(self, other: Self) -> dict[str, str]:
        """Return the settings that change another convention into this one."""


Meaning = TypeVar('Meaning', bound=Convention)
RARER = 4.0  # times less likely than another unit: MPa, mmHg, and axes rotated by any angle


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgeSettings:
    """Priors that all judges share, and the required odds."""

    other_unit: float = tuning(
        0.02,
        'prior of each other unit that drivers and data sheets often use, of axes rotated by a '
        'right angle, and of a zero that was never set',
        source='convention: messages are defined in SI',
    )
    log_odds: float = tuning(
        3.0,
        'log odds at which another meaning is accepted',
        source='literature: Kass and Raftery (1995), strong evidence: 20 to 1',
    )
    uncommon: float = tuning(
        0.05,
        'prior of the other reference (gauge or absolute), of swapped ports, of the reaction read '
        'instead of the load, and share of recordings beyond the calibrated pressures or loads',
        source='convention: one of twenty',
    )
    rare: float = tuning(
        0.001,
        'share of recordings with pressures of the sign opposite to the calibration, with '
        'pressure noise of any size, or with loads of any size',
        source='convention: one of a thousand',
    )
    beyond: float = tuning(
        0.3,
        'sigma of the distance beyond them',
        unit='of the calibrated range, or of the size of the loads',
        source='convention: the load margin of the domain is of this order',
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingVerdict(Generic[Meaning]):
    """The declared convention of readings, the most likely other one, and its log odds.

    limit: threshold for log_odds.
    """

    declared: Meaning
    other: Meaning
    log_odds: float
    limit: float

    @property
    def contradicted(self) -> bool:
        """Whether the declared convention is almost certainly wrong."""
        return self.log_odds > self.limit

    @property
    def confirmed(self) -> bool:
        """Whether the declared convention is almost certainly right."""
        return self.log_odds < -self.limit

    @property
    def changes(self) -> dict[str, str]:
        """Settings that select the other meaning of the readings."""
        return self.other.changes_from(self.declared)

    @property
    def options(self) -> str:
        """Return the options of a command that select the other meaning."""
        return ' '.join(
            f'--{name.replace("_", "-")} {value}' for name, value in self.changes.items()
        )

    @property
    def parameters(self) -> str:
        """Return the parameters of a node that select the other meaning."""
        return ', '.join(f'{name} to {value}' for name, value in self.changes.items())


def ranked(weights: Mapping[Meaning, float], declared: Meaning) -> list[Meaning]:
    """Return all meanings except the declared one, most likely first; weights: log probability."""
    alternatives = (meaning for meaning in weights if meaning != declared)
    return sorted(alternatives, key=weights.__getitem__, reverse=True)
