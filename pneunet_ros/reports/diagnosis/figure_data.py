"""Data of the figures of a diagnosis: its recordings, and their errors under both models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.discovery.result import Discovery, NOTHING_SEARCHED
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import coordinate_stds
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.reports.diagnosis.tables import added_effects
from pneunet_ros.reports.style import FIRST, SECOND, THIRD

BEFORE, AFTER = SECOND, FIRST  # colors
DISCOVERED = 'discovered', THIRD  # name and color of the model with a discovered law


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingErrors:
    """Errors of both models on a recording, (frames, 2, targets) m, registration removed.

    noise (frames, 2, targets) m: one sigma of each coordinate by noise alone, including that of
    pressure and force readings.
    """

    run: RecordingData
    before: Array
    after: Array
    noise: Array

    def of(self, model: str) -> Array:
        """Return the errors of the model `before` or `after`."""
        return self.before if model == 'before' else self.after

    @property
    def misfit(self) -> Array:
        """Rms error before the effect over that of noise, in every frame; 0 if unknown."""
        known = np.isfinite(self.before) & np.isfinite(self.noise)
        error, noise = (
            np.sqrt(np.sum(np.where(known, values, 0.0) ** 2, axis=(1, 2)))
            for values in (self.before, self.noise)
        )
        return np.asarray(error / np.where(noise > 0.0, noise, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FigureData:
    """A diagnosis with its recordings and discoveries."""

    diagnosis: Diagnosis
    training: Sequence[RecordingData]
    held_out: Sequence[RecordingData]
    discovery: Discovery = NOTHING_SEARCHED

    @property
    def tested_on(self) -> str:
        """Recordings on which the models are compared: held-out ones, if any."""
        return 'training' if self.diagnosis.before.held_out is None else 'held-out'

    @property
    def models(self) -> tuple[tuple[str, str], ...]:
        """Names and colors of the compared models; one if nothing was added."""
        every = ('before', BEFORE), ('after', AFTER)
        return every if added_effects(self.diagnosis) else every[:1]

    def errors(self) -> tuple[RecordingErrors, ...]:
        """Return the errors of both models on the compared recordings."""
        before, after = self.diagnosis.before, self.diagnosis.after
        runs, scores = self.held_out, (before.held_out_scores, after.held_out_scores)
        if before.held_out is None:
            runs, scores = self.training, (before.training_scores, after.training_scores)
        arm = after.arm
        noise = [
            coordinate_stds(arm, run, inputs, arm.sensors)
            for run, inputs in zip(runs, inputs_of(arm, runs), strict=True)
        ]
        return tuple(
            RecordingErrors(run=run, before=first.error, after=last.error, noise=std)
            for run, first, last, std in zip(runs, *scores, noise, strict=True)
        )
