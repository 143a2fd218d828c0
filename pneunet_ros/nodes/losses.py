"""Lost messages, counted from the DDS sequence numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

NUMBER = 'publication_sequence_number'  # in the info of a message; None if the middleware has none


class Losses:
    """Counts the gaps between the numbers of the messages of each topic.

    These messages were lost in transit, or dropped from the queue while the node was busy.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._several: set[str] = set()  # topics whose last number may belong to another publisher
        self._unreported: Counter[str] = Counter()
        self.total: Counter[str] = Counter()

    def take(
        self, topic: str, info: Mapping[str, int | None], publishers: Callable[[str], int]
    ) -> None:
        """Count a received message.

        info: its message info from rclpy; publishers: returns the number of publishers of a topic.
        Each publisher has its own numbering, and a message does not identify its publisher, so
        nothing is counted if there are several publishers.
        """
        number = info.get(NUMBER)
        if number is None:
            return
        missing = number - self._last.get(topic, number - 1) - 1
        self._last[topic] = number
        if missing <= 0:
            return
        if publishers(topic) != 1:
            self._several.add(topic)
        elif topic in self._several:
            self._several.remove(topic)
        else:
            self._unreported[topic] += missing
            self.total[topic] += missing

    def sentence(self) -> str:
        """Describe the messages lost since the last call; empty if none."""
        lost, self._unreported = self._unreported, Counter()
        return '; '.join(
            f'{count} message{"s" if count > 1 else ""} on {topic} lost'
            for topic, count in sorted(lost.items())
        )
