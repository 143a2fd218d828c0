"""The zero of a pressure sensor, from readings of the vented arm."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.estimation.estimator import Estimator


def pressure_zero(
    estimator: Estimator, readings: tuple[PressureReading, ...]
) -> tuple[float | None, str]:
    """Return the offset (Pa) that makes readings of the vented arm zero, and a sentence.

    No offset where there are fewer than 5 readings, where they move by more than 5 sigma or 1 % of
    the range, or where the offset would exceed a tenth of the calibrated range.
    """
    if len(readings) < 5:
        return None, f'only {len(readings)} recent pressure readings; at least 5 are needed'
    values = np.array([reading.pressure for reading in readings])
    if estimator.settings.pressure_reference == 'absolute':
        values = values - estimator.settings.ambient_pressure
    low, high = estimator.arm.pressure_range
    spread, mean = float(np.ptp(values)), float(values.mean())
    allowed = max(10.0 * estimator.arm.sensors.pressure_std, 0.01 * (high - low))
    if not spread <= allowed:
        return None, f'the pressure moves by {spread:.4g} Pa; hold the vented arm still'
    if abs(mean) > 0.1 * (high - low):
        return None, f'the pressure is {mean:.4g} Pa, too far from zero for a vented arm'
    return -mean, f'pressure offset {-mean:.4g} Pa from {len(readings)} readings'
