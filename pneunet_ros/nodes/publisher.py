"""Publishes estimates: topics for controllers first, and only topics with subscribers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Generic

from pneunet_ros.messages.builders import Output, Result
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.nodes.topics import output_qos, publisher

# By the last part of the name. Published first, because a controller may wait for them; the
# centerline is published last, because it is for display.
FOR_CONTROL = ('state', 'shape', 'tip', 'tip_jacobian', 'end_force', 'end_wrench')
FOR_PEOPLE = ('centerline', 'markers', 'joint_states')


def last_name(topic: Output[Any]) -> str:
    """Return the name of a topic without its namespace."""
    return topic.name.rpartition('/')[2]


def in_order(outputs: Iterable[Output[Result]]) -> tuple[Output[Result], ...]:
    """Return outputs in publishing order."""
    return tuple(
        sorted(
            outputs,
            key=lambda topic: (
                last_name(topic) not in FOR_CONTROL,
                last_name(topic) in FOR_PEOPLE,
            ),
        )
    )


class EstimatePublisher(Generic[Result]):
    """Publishes estimates on all topics that have subscribers.

    A message is not even built for a topic without subscribers. `centerline_rate` (Hz) limits the
    topics for displays, because building and reading them is costly; 0 means every estimate.
    """

    def __init__(
        self,
        node: Any,
        serializer: MessageSerializer,
        centerline_rate: float,
        outputs: Iterable[Output[Result]],
    ) -> None:
        self.centerline_rate = centerline_rate
        self._serializer = serializer
        self._due = dict.fromkeys(FOR_PEOPLE, 0.0)
        self._publishers: tuple[tuple[Output[Result], Any], ...] = tuple(
            (topic, publisher(node, topic.type, topic.name, output_qos()))
            for topic in in_order(outputs)
        )

    def publish(self, estimate: Result, now: float) -> None:
        """Publish an estimate; now: seconds of a steady clock."""
        for topic, out in self._publishers:
            if out.get_subscription_count() == 0:
                continue
            name = last_name(topic)
            if name in FOR_PEOPLE and not self._is_due(name, now):
                continue
            out.publish(self._serializer.bytes_of(topic, estimate))

    def _is_due(self, name: str, now: float) -> bool:
        if self.centerline_rate <= 0.0:
            return True
        due = self._due[name]
        if now < due:
            return False
        # Counting from the due time keeps the rate, except after a pause.
        period = 1.0 / self.centerline_rate
        self._due[name] = due + period if now - due < period else now + period
        return True
