"""Tuning constants of reports."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSettings:
    """Tuning constants of figures and tables: agreement."""

    hidden_under_load: float = tuning(
        6.0,
        'largest ratio of the residuals of loaded recordings to those of unloaded ones that '
        'counts as agreement; 1.5 to 4 for arms of the virtual lab',
        source='sweep',
    )


REPORT_SETTINGS = ReportSettings()
