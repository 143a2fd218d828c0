"""What a reading means by the settings: gauge pressure, end load in the base frame."""

from __future__ import annotations

from pneunet_ros.core.frames import rotate
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.estimation.settings import EstimatorSettings


def gauge_pressure(settings: EstimatorSettings, pressure: float) -> float:
    """Return the gauge pressure (Pa) behind what a sensor reports."""
    gauge = pressure + settings.pressure_offset
    if settings.pressure_reference == 'absolute':
        gauge -= settings.ambient_pressure
    return gauge


def base_wrench(settings: EstimatorSettings, reading: WrenchReading) -> WrenchReading:
    """Return the end load in the base frame behind what a sensor reports."""
    sign = float(settings.wrench_sign)
    force = rotate(settings.wrench_yaw, sign * reading.force_x, sign * reading.force_y)
    return WrenchReading(
        stamp_ns=reading.stamp_ns,
        force_x=force[0],
        force_y=force[1],
        moment=sign * reading.moment,
        frame_id=settings.frame_id,
    )


def wrong_frame(settings: EstimatorSettings, reading: WrenchReading) -> str:
    """Return why a wrench in its frame cannot be used, as a sentence; empty where it can."""
    known = [settings.frame_id, settings.wrench_frame]
    if reading.frame_id in known:
        return ''
    named = ' nor '.join(frame for frame in known if frame)
    return (
        f'end wrench in frame {reading.frame_id!r}, which is not {named}; set '
        'wrench_frame (and wrench_yaw, wrench_sign) to what the sensor reports'
    )
