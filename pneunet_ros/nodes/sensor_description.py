"""Synchronizes the sensor settings of all nodes of an arm by comparing their `model_info`.

A setting changed at run time, for example by `~/zero_pressure`, is adopted by the other nodes.
Other differences, such as between parameter files, are reported.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
import dataclasses
import json
import time
from typing import Any

from pneunet_ros.estimation.settings import EstimatorSettings

PREFIXES = ('pressure_', 'ambient_', 'wrench_', 'force_offset', 'imu_')
NOT_OF_SENSORS = ('wrench_required', 'wrench_timeout')
# The nodes of an arm. All of them publish latched messages at once, and a queue of one would keep
# the last message only.
MOST_NODES = 10


def sensor_description(settings: EstimatorSettings) -> dict[str, Any]:
    """Return the settings that define the sensor readings, by parameter."""
    return {
        name: value
        for name, value in dataclasses.asdict(settings).items()
        if name.startswith(PREFIXES) and name not in NOT_OF_SENSORS
    }


class OtherDescriptions:
    """Sensor settings of the other nodes of an arm, by node name.

    set_ns: time at which each setting of this node was changed at run time; an adopted setting
    keeps the time of its change.
    """

    def __init__(self) -> None:
        self._descriptions: dict[str, Mapping[str, Any]] = {}
        self.set_ns: dict[str, int] = {}

    def note_set(
        self, before: Mapping[str, Any], after: Mapping[str, Any], times: Mapping[str, int]
    ) -> None:
        """Record the changed settings of this node; times: of adopted settings."""
        now_ns = time.time_ns()
        new = (name for name, value in after.items() if before.get(name) != value)
        # After the clock is set back, a change must not be older than the previous one.
        self.set_ns |= {
            name: times.get(name, max(now_ns, self.set_ns.get(name, 0) + 1)) for name in new
        }

    def take(self, text: str, pressure: str) -> tuple[dict[str, Any], dict[str, int]]:
        """Process the `model_info` of another node; return its newer settings, with their times.

        text: the `model_info`, as JSON; pressure: topic of this node; a node that reads a
        different topic belongs to another arm.
        """
        try:
            content = json.loads(text)
            if content.get('pressure', pressure) != pressure:
                return {}, {}
            described = dict(content['sensors']) | {'model': content.get('hash')}
            self._descriptions[content['node']] = described
            times = {
                name: int(at_ns)
                for name, at_ns in content.get('sensors_set_ns', {}).items()
                if int(at_ns) > self.set_ns.get(name, 0)
            }
            return {name: described[name] for name in times}, times
        except (AttributeError, ValueError, TypeError, KeyError):
            return {}, {}  # from a node without sensors, or from another program

    def differences(
        self, own_name: str, sensors: Mapping[str, Any], running: Collection[str]
    ) -> Iterator[str]:
        """Describe how the settings of other nodes differ.

        own_name: full name of this node; sensors: its description, with the hash of its `model`;
        running: full names of running nodes.
        """
        for node, described in sorted(self._descriptions.items()):
            if node == own_name or node not in running:
                continue
            differing = [
                f'{name} {described[name]} (here {value})'
                for name, value in sensors.items()
                if described.get(name, value) != value
            ]
            if differing:
                yield f'{node} has {", ".join(differing)}: use the same values for both nodes'
