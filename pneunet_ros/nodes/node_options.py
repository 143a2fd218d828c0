"""Options of nodes that share a process."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.parameter import Parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeOptions:
    """Namespace, parameters and topics of a node in a shared process.

    namespace: full name; empty: that of the command line. parameters: override those of the
    command line. topics: remapping of the topics of the node. sibling: the configuration of
    another node, whose model is shared if the files are the same. foreign_parameters: names of
    parameters on the command line that belong to other nodes. cameras: the cameras of the trackers
    of this process, by topic.
    """

    namespace: str = ''
    parameters: Mapping[str, Any] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    sibling: Any = None
    foreign_parameters: Collection[str] = ()
    cameras: dict[tuple[str, str], Any] = field(default_factory=dict)

    def arguments(self, name: str) -> dict[str, Any]:
        """Return the rclpy arguments for a node of this name."""
        if not self.namespace:
            return {}
        rules = {'__ns': self.namespace, '__node': name, **self.topics}
        words = [word for own, other in rules.items() for word in ('-r', f'{own}:={other}')]
        return {
            'cli_args': ['--ros-args', *words],
            'parameter_overrides': [
                Parameter(name, value=value) for name, value in self.parameters.items()
            ],
        }


DEFAULT_OPTIONS = NodeOptions()
