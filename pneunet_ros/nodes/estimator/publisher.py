"""Publishing of estimates: what controllers need first, and only what is wanted."""

from __future__ import annotations

from typing import Any

from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.builders import Output
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.nodes.topics import output_qos, publisher

# Published first, as a controller may wait for them; the centerline last, as it is for people.
FOR_CONTROL = ('shape', 'tip', 'tip_jacobian')
FOR_PEOPLE = ('centerline', 'markers', 'joint_states')
PUBLISHED = tuple(
    sorted(OUTPUTS, key=lambda topic: (topic.name not in FOR_CONTROL, topic.name in FOR_PEOPLE))
)


class EstimatePublisher:
    """Publishes estimates on all their topics, as far as somebody listens.

    A message is not even built for a topic without subscribers. `centerline_rate` (Hz) limits the
    topics for people, as building and reading them is costly; 0 means every estimate.
    `markers` are published beside the topics that are always there.
    """

    def __init__(
        self,
        node: Any,
        serializer: MessageSerializer,
        centerline_rate: float,
        markers: tuple[Output[ShapeEstimate], ...] = (),
    ) -> None:
        self.centerline_rate = centerline_rate
        self._serializer = serializer
        self._due = dict.fromkeys(FOR_PEOPLE, 0.0)
        self._publishers: tuple[tuple[Output[ShapeEstimate], Any], ...] = tuple(
            (topic, publisher(node, topic.type, topic.name, output_qos()))
            for topic in (*PUBLISHED, *markers)
        )

    def publish(self, estimate: ShapeEstimate, now: float) -> None:
        """Publish an estimate; now: seconds of a steady clock."""
        for topic, out in self._publishers:
            if out.get_subscription_count() == 0:
                continue
            if topic.name in FOR_PEOPLE and not self._is_due(topic.name, now):
                continue
            out.publish(self._serializer.bytes_of(topic, estimate))

    def _is_due(self, name: str, now: float) -> bool:
        if self.centerline_rate <= 0.0:
            return True
        due = self._due[name]
        if now < due:
            return False
        # A step from when it was due keeps the rate, unless nothing was wanted for a while.
        period = 1.0 / self.centerline_rate
        self._due[name] = due + period if now - due < period else now + period
        return True
