"""Conversion of an end wrench to the end load in the base frame, by the settings."""

from __future__ import annotations

import math

from pneunet_ros.core.frames import rotate
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.estimation.settings import EstimatorSettings


def base_wrench(settings: EstimatorSettings, reading: WrenchReading) -> WrenchReading:
    """Return the end load in the base frame from a sensor reading.

    Unmeasured out-of-plane components are set to zero.
    """
    sign = settings.wrench_sign * settings.wrench.size
    force = rotate(settings.wrench_yaw, sign * reading.force_x, sign * reading.force_y)
    force_z, moment_x, moment_y = (
        0.0 if math.isnan(part) else sign * part
        for part in (reading.force_z, reading.moment_x, reading.moment_y)
    )
    bending = rotate(settings.wrench_yaw, moment_x, moment_y)
    return WrenchReading(
        stamp_ns=reading.stamp_ns,
        force_x=force[0] + settings.force_offset_x,
        force_y=force[1] + settings.force_offset_y,
        moment=sign * reading.moment,
        frame_id=settings.frame_id,
        force_z=force_z,
        moment_x=bending[0],
        moment_y=bending[1],
    )


def wrong_frame(settings: EstimatorSettings, reading: WrenchReading) -> str:
    """Return why the frame of a wrench rules out its use; empty if it does not."""
    known = [frame for frame in (settings.frame_id, settings.wrench_frame) if frame]
    if reading.frame_id in known:
        return ''
    if not reading.frame_id:
        return (
            'end wrench without a frame: header.frame_id is empty, so the axes of the force are '
            f'unknown; it must be {" or ".join(known)}'
        )
    named = ' nor '.join(known)
    return (
        f'end wrench in frame {reading.frame_id!r}, which is not {named}; set wrench_frame (and '
        'wrench_yaw, wrench_sign) to match the sensor'
    )
