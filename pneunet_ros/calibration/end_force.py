"""The end force behind measured targets, with its standard deviation (result (b) of the paper).

All targets of a frame, or the last one alone, the pressure known: the force is what brings the
model there. From the tip alone it is badly conditioned; `sigma` says how badly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.arm import Arm
from pneunet_ros.calibration.response import drive_of, Series
from pneunet_ros.estimator import neighbors
from pneunet_ros.run import Run
from pneunet_ros.shape import Array

MOST_STEPS = 30
SMALL_STEP = 1e-4  # of a standard deviation of the force
LARGEST_STEP = 0.1  # N
PRESSURE_STEP = 20.0  # Pa
NO_COLUMNS = np.zeros((0, 2), dtype=np.int64)
SPREAD_STEPS = (0, 3)  # when what the model leaves open is computed: it changes little


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndForces:
    """F1 and F2 (N) of frames, (frames, 2), and their covariance (frames, 2, 2); NaN: not found."""

    force: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation of F1 and F2, (frames, 2) N."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def end_forces(arm: Arm, run: Run, *, tip_only: bool = False) -> EndForces:
    """Find the end force of every frame of a run, without looking at its force readings.

    The errors: targets, their placement, the camera's place, pressure, and the model's covariance.
    The search begins with the force that was read where there is one.
    """
    noise, targets = arm.sensors, arm.target_arclength
    used = np.zeros(targets.size, dtype=bool)
    used[-1 if tip_only else slice(None)] = True
    drive = drive_of(arm, run)
    loads, frames = drive.loads.copy(), len(drive.pressure)
    series = Series(targets)
    measured = np.stack([run.x, run.y], axis=1)
    seen = np.isfinite(measured) & used
    # Covariance of the points (frames, 2 T, 2 T) less what the model adds.
    variance = noise.target_std**2 + noise.placement_std**2
    base = variance * np.eye(2 * targets.size)
    common = np.kron(np.eye(2), np.ones((targets.size, targets.size)))
    base += (noise.registration_std**2 + noise.drift_std**2) * common
    found = np.zeros(frames, dtype=bool)
    covariance = np.full((frames, 2, 2), np.nan)
    for count in range(MOST_STEPS):
        solved = series.solve(arm, drive.pressure, loads)
        fields = series.fields[:, :2].copy()
        answer = series.answer(arm, drive.pressure, loads, NO_COLUMNS).values
        slopes = answer[:, :2, :2].reshape(frames, 2, -1).transpose(0, 2, 1)
        if count in SPREAD_STEPS:
            spread = model_spread(arm, drive.pressure, loads)
        residual = np.where(seen, measured - fields, 0.0).reshape(frames, -1)
        largest = 0.0
        for frame in np.flatnonzero(solved):
            which = seen[frame].ravel()
            if which.sum() < 2:
                continue
            errors = base[np.ix_(which, which)] + spread[frame][which] @ spread[frame][which].T
            j = slopes[frame][which]
            weighted = np.linalg.solve(errors, np.column_stack([j, residual[frame][which]]))
            normal = j.T @ weighted[:, :2]
            covariance[frame] = np.linalg.inv(normal)
            step = covariance[frame] @ (j.T @ weighted[:, 2])
            size = float(np.sqrt(step @ normal @ step))
            share = min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
            loads[frame, :2] += share * step
            found[frame] = size < SMALL_STEP
            largest = max(largest, size)
        if largest < SMALL_STEP:
            break
    force = np.where((found & solved)[:, None], loads[:, :2], np.nan)
    covariance[~(found & solved)] = np.nan
    return EndForces(force=force, covariance=covariance)


def model_spread(arm: Arm, pressure: Array, loads: Array) -> Array:
    """What one sigma of the pressure and of each column of the covariance does to the points.

    (frames, 2 targets, 1 + columns) m; NaN-free, zero where a neighbor has no equilibrium.
    """

    def points(arm: Arm, pressure: Array) -> Array:
        series = Series(arm.target_arclength)
        solved = series.solve(arm, pressure, loads)
        return np.where(solved[:, None, None], series.fields[:, :2], np.nan)

    ends = [points(arm, pressure + sign * PRESSURE_STEP) for sign in (-1.0, 1.0)]
    moved = [arm.sensors.pressure_std * (ends[1] - ends[0]) / (2.0 * PRESSURE_STEP)]
    for column in () if arm.covariance is None else arm.covariance.columns():
        before, after, distance = neighbors(arm, column)
        moved.append((points(after, pressure) - points(before, pressure)) / distance)
    spread = np.stack([change.reshape(len(pressure), -1) for change in moved], axis=2)
    return np.where(np.isfinite(spread), spread, 0.0)
