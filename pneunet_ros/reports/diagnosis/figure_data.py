"""What the figures of a diagnosis show: it, its recordings, and their errors under both models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.reports.settings import REPORT_SETTINGS, ReportSettings
from pneunet_ros.reports.style import FIRST, SECOND

BEFORE, AFTER = SECOND, FIRST  # colors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingErrors:
    """Errors of both models on a recording, (frames, 2, targets) m, registration removed."""

    run: RecordingData
    before: Array
    after: Array

    @property
    def measured(self) -> Array:
        """Targets as measured, (frames, 2, targets) m."""
        return np.stack([self.run.x, self.run.y], axis=1)

    @property
    def rms_before(self) -> Array:
        """Root mean square error before, per coordinate of every frame (m); 0 without any."""
        count = np.isfinite(self.before).sum(axis=(1, 2))
        total = np.nansum(self.before**2, axis=(1, 2))
        return np.asarray(np.sqrt(total / np.maximum(count, 1)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FigureData:
    """A diagnosis with the recordings that were given to it."""

    diagnosis: Diagnosis
    training: Sequence[RecordingData]
    held_out: Sequence[RecordingData]
    settings: ReportSettings = REPORT_SETTINGS

    @property
    def tested_on(self) -> str:
        """Which recordings the models are compared on: those held out, where there are any."""
        return 'training' if self.diagnosis.before.held_out is None else 'held-out'

    def errors(self) -> tuple[RecordingErrors, ...]:
        """Return the errors of both models on the recordings they are compared on."""
        before, after = self.diagnosis.before, self.diagnosis.after
        runs, scores = self.held_out, (before.held_out_scores, after.held_out_scores)
        if before.held_out is None:
            runs, scores = self.training, (before.training_scores, after.training_scores)
        return tuple(
            RecordingErrors(run=run, before=first.error, after=last.error)
            for run, first, last in zip(runs, *scores, strict=True)
        )
