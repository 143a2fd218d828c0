"""Influence of pressure noise on a fit through effects with a history.

The noise of a frame's own reading is in the covariance of this frame. The noise of earlier
readings acts through memory, for example at the turning points of a play operator or in the state
of a pressure line. It is common to many frames, and is estimated by adding the same amount of
noise once more.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import KnownInputs, Linearization
from pneunet_ros.diagnosis.fit.refit import Refit
from pneunet_ros.diagnosis.settings import READING_NOISE


def with_reading_noise(refit: Refit, seed: int) -> Refit:
    """Return a fit whose covariance includes the reading noise in the memory of its effects."""
    if not any(item.has_memory for item in refit.hypotheses):
        return refit
    linearization = refit.linearization
    residuals = residuals_of(refit, linearization)
    random = np.random.default_rng([seed, READING_NOISE.draws])
    covariance = np.zeros_like(refit.covariance)
    for _ in range(READING_NOISE.draws):
        moved = residuals_of(refit, double_reading_noise(linearization, random))
        if residuals is None or moved is None:
            return refit
        columns = refit.gaussian.columns
        pairs = zip(columns, residuals, moved, strict=True)
        vector = sum(item.T @ (after - before) for item, before, after in pairs)
        scaled = refit.gaussian.solved(np.asarray(vector))[-refit.numbers.size :]
        change = scaled * np.concatenate([item.std for item in refit.hypotheses])
        covariance += np.outer(change, change) / READING_NOISE.draws
    return replace(refit, covariance=refit.covariance + covariance)


def residuals_of(refit: Refit, linearization: Linearization) -> list[Array] | None:
    """Return whitened residuals (rows,) per training run of a fit."""
    return linearization.residual(refit.point.values, refit.effects, range(linearization.training))


def double_reading_noise(
    linearization: Linearization, random: np.random.Generator
) -> Linearization:
    """Return the linearization with twice the reading noise in effects with memory."""
    std = linearization.noise.pressure_std
    noisy = [
        replace(run, pressure=run.pressure + std * random.standard_normal(run.pressure.size))
        for run in linearization.runs
    ]
    louder = replace(linearization.noise, pressure_std=float(np.sqrt(2.0)) * std)
    known = KnownInputs(noisy, louder)
    known.filtered = [
        # The noise of a frame's own reading is unchanged.
        replace(after, noise=after.noise + run.frame_pressure - more.frame_pressure)
        for after, run, more in zip(known.filtered, linearization.runs, noisy, strict=True)
    ]
    moved = copy.copy(linearization)
    moved.known_inputs = known
    return moved
