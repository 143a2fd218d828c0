"""The service `~/zero_pressure`, which sets the zero of the pressure sensor of a vented arm."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import time
from typing import Any

from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.pressure_tare import pressure_zero
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.model.arm import Arm
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

SPAN = 1.0  # s of pressure readings that are averaged
MOST_READINGS = 1000  # largest number of readings that are kept


class PressureZero:
    """Keeps the last pressure readings of a node, and sets its `pressure_offset` from them.

    in_use: returns the arm and its sensor settings in use.
    """

    def __init__(self, node: Any, in_use: Callable[[], tuple[Arm, EstimatorSettings]]) -> None:
        self._node, self._in_use = node, in_use
        self._recent: deque[PressureReading] = deque(maxlen=MOST_READINGS)
        self._received_at = -math.inf  # s of a steady clock
        node.create_service(Trigger, '~/zero_pressure', self.serve)

    def take(self, reading: PressureReading) -> None:
        """Store a reading."""
        self._recent.append(reading)
        self._received_at = time.monotonic()

    def forget(self) -> None:
        """Forget all readings."""
        self._recent.clear()

    def serve(self, request: Any, response: Any) -> Any:
        """Serve ~/zero_pressure."""
        arm, settings = self._in_use()
        readings: tuple[PressureReading, ...] = ()
        if self._recent and time.monotonic() - self._received_at <= settings.input_timeout:
            last = self._recent[-1].stamp_ns
            readings = tuple(
                reading
                for reading in self._recent
                if seconds_between(reading.stamp_ns, last) <= SPAN
            )
        offset, response.message = pressure_zero(arm, settings.pressure, readings)
        if offset is not None:
            (result,) = self._node.set_parameters([Parameter('pressure_offset', value=offset)])
            response.success = result.successful
            response.message = response.message if result.successful else result.reason
        return response
