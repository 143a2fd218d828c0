"""The settings of an estimator: sensors, units, frames and timeouts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import math
import re

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME, is_rotation, Quaternion, quaternion_of_angles
from pneunet_ros.core.settings import check_settings, setting
from pneunet_ros.core.units import PRESSURE_UNITS, quantity, STANDARD_ATMOSPHERE
from pneunet_ros.measurement.meaning.pressure_convention import ABSOLUTE, GAUGE, PressureConvention
from pneunet_ros.measurement.meaning.wrench_judge import FORCE_UNITS, WrenchConvention
from pneunet_ros.model.equilibrium import DEFAULT_STATIONS


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorSettings:
    """Settings of the estimator for sensors and ROS, not for the physics of the arm."""

    frame_id: str = setting(BASE_FRAME, 'frame of all outputs, at the clamp')
    stations: int = setting(DEFAULT_STATIONS, 'number of stations along the arm', bounds=(2, 2000))
    wrench_required: bool = setting(
        True, 'estimate only with a fresh end wrench; false: no wrench topic, the arm is unloaded'
    )
    wrench_timeout: float = quantity(
        0.5, unit='s', meaning='largest age of the end wrench that is used', bounds=(1e-3, 3600.0)
    )
    input_timeout: float = quantity(
        0.5,
        unit='s',
        meaning=(
            'time without pressure readings that counts as an error; an overloaded node loses '
            'readings that would wait longer'
        ),
        bounds=(1e-3, 3600.0),
    )
    pressure_unit: str = setting('Pa', 'unit of the pressure readings', tuple(PRESSURE_UNITS))
    pressure_reference: str = setting(
        GAUGE, ('reference of the pressure readings'), (GAUGE, ABSOLUTE)
    )
    pressure_sign: int = setting(
        1, '-1 if the ports of a differential pressure sensor are swapped', (1, -1)
    )
    ambient_pressure: float = quantity(
        STANDARD_ATMOSPHERE,
        unit='Pa',
        meaning='subtracted from absolute pressure readings',
        bounds=(3e4, 1.2e5),
    )
    pressure_offset: float = quantity(
        0.0, unit='Pa', meaning='added to every pressure reading', bounds=(-1e6, 1e6)
    )
    wrench_unit: str = setting('N', 'unit of the force readings', FORCE_UNITS)
    wrench_sign: int = setting(
        1, '-1 if the sensor reports the force that the arm exerts on it', (1, -1)
    )
    wrench_yaw: float = quantity(
        0.0,
        unit='rad',
        meaning='angle of the wrench axes in the base frame, counter-clockwise',
        bounds=(-7.0, 7.0),
    )
    force_offset_x: float = quantity(
        0.0, unit='N', meaning='added to every end force along x', bounds=(-1e3, 1e3)
    )
    force_offset_y: float = quantity(
        0.0, unit='N', meaning='added to every end force along y', bounds=(-1e3, 1e3)
    )
    wrench_frame: str = setting('', 'frame id that wrench messages may have, other than frame_id')
    imu_from_base: str = setting(
        '',
        'orientation of the IMU of base_imu in the base frame: roll, pitch and yaw (rad), e.g. '
        '"0, 0, 1.57", or x, y, z, w of a quaternion; empty: from /tf_static, by its frame_id',
    )
    gravity_frame: str = setting(
        '',
        ('tf frame whose z axis points up, used for the direction of gravity instead of base_imu'),
    )
    gravity_timeout: float = quantity(
        0.5,
        unit='s',
        meaning='largest age of base_imu, or of the transform to gravity_frame, that is used',
        bounds=(1e-3, 3600.0),
    )
    out_of_plane_limit: float = quantity(
        0.1,
        unit='-',
        meaning='out-of-plane force and moments of the end wrench that raise a warning, as a '
        'share of the calibrated force and its moment; three times as much is an error',
        bounds=(1e-3, 1e6),
    )
    judge_readings: bool = setting(
        True,
        'reject readings that almost surely have another unit, reference or sign; false: trust '
        'the settings',
    )
    watch_targets: bool = setting(
        True, 'compare measured targets, if there are any, with the estimate'
    )
    watch_time: float = quantity(
        2.0,
        unit='s',
        meaning='time over which the disagreement of targets and estimate is averaged',
        bounds=(0.1, 3600.0),
    )

    def __post_init__(self) -> None:
        """Reject values outside their declared range."""
        check_settings(self)
        if not self.frame_id:
            raise RequestError('frame_id must not be empty', reason='empty')
        turn_of(self.imu_from_base)

    @property
    def wrench(self) -> WrenchConvention:
        """Meaning of the force readings."""
        return wrench_convention(
            unit=self.wrench_unit,
            sign=self.wrench_sign,
            yaw=self.wrench_yaw,
            offset_x=self.force_offset_x,
            offset_y=self.force_offset_y,
            frame=self.wrench_frame,
        )

    @property
    def pressure(self) -> PressureConvention:
        """Meaning of the pressure readings."""
        return pressure_convention(
            unit=self.pressure_unit,
            reference=self.pressure_reference,
            sign=self.pressure_sign,
            ambient=self.ambient_pressure,
            offset=self.pressure_offset,
        )

    @property
    def judged_pressure(self) -> PressureConvention | None:
        """Declared meaning of the pressure readings, to be checked; None: assumed to be right."""
        return self.pressure if self.judge_readings else None


# Evaluated at every reading, but always the same.
wrench_convention = lru_cache(maxsize=64, typed=True)(WrenchConvention)
pressure_convention = lru_cache(maxsize=64, typed=True)(PressureConvention)


def turn_of(text: str) -> Quaternion | None:
    """Return the quaternion of a rotation given as text; None for an empty text.

    Raises RequestError for anything but three angles (rad) or a unit quaternion.
    """
    words = [word for word in re.split(r'[,\s]+', text.strip('[] ')) if word]
    if not words:
        return None
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and all(map(math.isfinite, numbers)):
        return quaternion_of_angles(*numbers)
    if len(numbers) == 4:
        x, y, z, w = numbers
        if is_rotation((x, y, z, w)):
            return x, y, z, w
    raise RequestError(
        'imu_from_base must be roll, pitch and yaw in rad (e.g. "0, 0, 1.57") or x, y, z, w of a '
        f'unit quaternion, not {text!r}',
        reason='wrong_form',
    )
