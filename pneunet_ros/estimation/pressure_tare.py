"""Zero offset of a pressure sensor, from readings of the vented arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.pressure_convention import ABSOLUTE, PressureConvention
from pneunet_ros.measurement.pressure_judge import expected_of, JUDGE
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True)
class TareSettings:
    """Criteria for the zero of a sensor."""

    fewest_readings: int = tuning(5, 'fewest readings of the vented arm')
    noise_band: float = tuning(10.0, 'largest range of readings that noise explains', unit='sigma')
    largest_change: float = tuning(
        0.01, 'largest range of readings, for any noise', unit='of the calibrated range'
    )


DEFAULTS = TareSettings()


def pressure_zero(
    arm: Arm,
    convention: PressureConvention,
    readings: tuple[PressureReading, ...],
    settings: TareSettings = DEFAULTS,
) -> tuple[float | None, str]:
    """Return the offset (Pa) that makes readings of the vented arm zero, and a sentence.

    convention: meaning of the sensor readings; its offset is ignored.

    The offset is None if there are too few readings, if they vary by more than the noise and a
    share of the range, or if the offset is implausible as a zero error of a gauge, or of an unset
    zero for this range.
    """
    fewest = settings.fewest_readings
    if len(readings) < fewest:
        return None, f'only {len(readings)} recent pressure readings; at least {fewest} are needed'
    untared = replace(convention, offset=0.0)
    values = np.array([untared.gauge(reading.pressure) for reading in readings])
    low, high = arm.pressure_range
    change, mean = float(np.ptp(values)), float(values.mean())
    noise = settings.noise_band * arm.sensors.pressure_std
    if not change <= max(noise, settings.largest_change * (high - low)):
        return None, f'the pressure varies by {change:.4g} Pa; keep the vented arm still'
    largest = min(JUDGE.offset, JUDGE.zero_span * expected_of(arm).reach)
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
