"""Zero offset of a pressure sensor, from readings of the vented arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.measurement.meaning.pressure_convention import ABSOLUTE, PressureConvention
from pneunet_ros.measurement.meaning.pressure_judge import expected_of, JUDGE, ZERO_ERROR
from pneunet_ros.model.arm import Arm

# The pressure of a vented arm varies far less than this, that of one in use far more.
FEWEST = 5  # readings of the vented arm
NOISE_BAND = 10.0  # sigma: the largest range of readings that noise explains
LARGEST_CHANGE = 0.01  # of the calibrated range: the range of readings, for any noise


def pressure_zero(
    arm: Arm, convention: PressureConvention, readings: tuple[PressureReading, ...]
) -> tuple[float | None, str]:
    """Return the offset (Pa) that zeroes the readings of the vented arm, and a sentence.

    convention: meaning of the sensor readings; its offset is ignored.

    The offset is None if there are too few readings, if they vary by more than the noise and by
    more than a fraction of the range, or if the offset is too large for a zero error.
    """
    if len(readings) < FEWEST:
        return None, f'only {len(readings)} recent pressure readings; at least {FEWEST} are needed'
    untared = replace(convention, offset=0.0)
    values = np.array([untared.gauge(reading.pressure) for reading in readings])
    low, high = arm.pressure_range
    change, mean = float(np.ptp(values)), float(values.mean())
    noise = NOISE_BAND * arm.sensors.pressure_std
    if not change <= max(noise, LARGEST_CHANGE * (high - low)):
        return None, f'the pressure varies by {change:.4g} Pa; keep the vented arm still'
    largest = min(ZERO_ERROR, JUDGE.zero_span * expected_of(arm).reach)
    if abs(mean) > largest:
        name, value = 'pressure_offset', -mean
        if untared.reference == ABSOLUTE:
            name, value = 'ambient_pressure', untared.ambient + untared.sign * mean
        return None, (
            f'the pressure is {mean:.4g} Pa, more than a zero error can be (at most '
            f'{largest:.4g} Pa): the arm is probably not vented. Vent it and call again; if it '
            f'is vented, set the parameter {name} to {value:.6g}'
        )
    return -mean, f'pressure offset {-mean:.4g} Pa from {len(readings)} readings'
