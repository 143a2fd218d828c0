"""Whether all nodes of an arm take its sensors for the same: they compare their `model_info`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
import dataclasses
import json
from typing import Any

from pneunet_ros.estimation.settings import EstimatorSettings
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

PREFIXES = ('pressure_', 'ambient_', 'wrench_', 'force_offset', 'imu_')
NOT_OF_SENSORS = ('wrench_required', 'wrench_timeout')
# The nodes of an arm. What is latched comes from all of them at once, and a queue of one would
# hold that of the last alone.
MOST_NODES = 10


def sensor_description(settings: EstimatorSettings) -> dict[str, Any]:
    """Return the settings that define the sensor readings, by parameter."""
    return {
        name: value
        for name, value in dataclasses.asdict(settings).items()
        if name.startswith(PREFIXES) and name not in NOT_OF_SENSORS
    }


def all_latched_qos() -> QoSProfile:
    """Return the QoS that receives the latched message of every publisher."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=MOST_NODES,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


class OtherDescriptions:
    """Sensor settings of the other nodes of an arm, by node name."""

    def __init__(self) -> None:
        self._said: dict[str, Mapping[str, Any]] = {}

    def take(self, words: str) -> None:
        """Record the `model_info` of a node."""
        try:
            about = json.loads(words)
            self._said[about['node']] = dict(about['sensors'])
        except (ValueError, TypeError, KeyError):
            return  # of a node without sensors, or of another program

    def differences(
        self, own: str, sensors: Mapping[str, Any], running: Collection[str]
    ) -> Iterator[str]:
        """Describe in what others differ from this node.

        own: its full name; sensors: its description; running: full names of nodes that are there.
        """
        for node, described in sorted(self._said.items()):
            if node == own or node not in running:
                continue
            other = [
                f'{name} {described[name]} (here {value})'
                for name, value in sensors.items()
                if described.get(name, value) != value
            ]
            if other:
                yield f'{node} has {", ".join(other)}: use the same values for both nodes'
