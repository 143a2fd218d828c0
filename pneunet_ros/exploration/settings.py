"""Tuning constants of the search for the next recording."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorationSettings:
    """Settings of the search for the next recording."""

    recordings: int = tuning(
        8, 'recordings at most', source='convention: the fixed protocol of the lab has as many'
    )


EXPLORATION = ExplorationSettings()
