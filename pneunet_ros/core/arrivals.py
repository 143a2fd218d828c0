"""Processing order of messages, identical for nodes and recordings.

Messages are processed in order of arrival (for a recording: of log time); simultaneous messages in
order of their stamps, and messages with equal stamps in the order of ties: inputs of an estimate
before the pressure, which triggers it.

A driver that stamps several topics with the same time publishes them one after the other, in any
order. As long as the messages of a topic have the same stamps as the pressures, each pressure
waits for the message with its stamp, for at most `LONGEST_WAIT_NS`. No other message waits.

The order depends only on arrivals, stamps and topics, not on the time of processing: a busy node
processes a burst in the order in which its recording is replayed.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Generic, NamedTuple, TypeVar

Item = TypeVar('Item')
LONGEST_WAIT_NS = 2_000_000  # ten times the gap of consecutive messages, acceptance/bursts.py
MOST_MISSED = 2  # missed messages of a topic after which pressures no longer wait
EARLIEST = 0.75  # share of the last interval of a topic before which no message is expected


class Arrival(NamedTuple, Generic[Item]):
    """A message that has arrived; tie, number: its rank among messages of one stamp."""

    at_ns: int
    stamp_ns: int
    tie: int
    number: int
    item: Item


@dataclass(slots=True)
class Companion:
    """A topic whose messages may share the stamps of the pressure readings.

    missed: number of successive pressures without a message of this topic; after two, pressures
    stop waiting until a message has the stamp of a pressure again.
    """

    last_ns: int = 0
    interval_ns: int = 0
    missed: int = 1

    @property
    def joins(self) -> bool:
        """Whether the messages of this topic have shared the stamps of the pressure so far."""
        return self.missed < MOST_MISSED

    def is_due(self, stamp_ns: int) -> bool:
        """Whether a message with this stamp is still expected."""
        since = stamp_ns - self.last_ns
        return self.joins and since > 0 and since >= EARLIEST * self.interval_ns

    def take(self, stamp_ns: int) -> None:
        """Register a message."""
        self.interval_ns = stamp_ns - self.last_ns if self.last_ns else 0
        self.last_ns = stamp_ns


@dataclass(slots=True)
class ArrivalOrder(Generic[Item]):
    """Orders messages: `add` arrivals, then `take` the messages that are due.

    topics: names in the order of ties; pressure: the topic that triggers estimates from the topics
    before it. Without a pressure topic, messages are processed in order of arrival.
    """

    topics: Sequence[str]
    pressure: str | None = None
    _waiting: list[Arrival[Item]] = field(default_factory=list)
    _companions: dict[int, Companion] = field(init=False)
    _last: Arrival[Item] | None = None  # pressure
    _count: int = 0

    def __post_init__(self) -> None:
        """Expect every topic before the pressure to share its stamps."""
        end = 0 if self.pressure is None else self.topics.index(self.pressure)
        self._companions = {tie: Companion() for tie in range(end)}

    def add(self, topic: str, at_ns: int, stamp_ns: int, item: Item) -> None:
        """Add a message that arrived at `at_ns`; stamp_ns of its header, 0 if it has none."""
        arrival = Arrival(at_ns, stamp_ns, self.topics.index(topic), self._count, item)
        self._count += 1
        insort(self._waiting, arrival, key=lambda one: one[:4])

    def take(self, until_ns: float) -> Iterator[Item]:
        """Yield the due messages in order; all arrivals up to `until_ns` have been added."""
        while self._waiting and self._waiting[0].at_ns <= until_ns:
            place = self._next(until_ns)
            if place is None:
                return
            arrival = self._waiting.pop(place)
            self._note(arrival)
            yield arrival.item

    def backlog(self, topic: str) -> tuple[int, int]:
        """Return the number of queued messages of a topic, and the span (ns) of their arrivals."""
        tie = self.topics.index(topic)
        arrivals = [one.at_ns for one in self._waiting if one.tie == tie]
        return len(arrivals), arrivals[-1] - arrivals[0] if arrivals else 0

    @property
    def span_ns(self) -> int:
        """Time from the arrival of the first waiting message to that of the last."""
        return self._waiting[-1].at_ns - self._waiting[0].at_ns if self._waiting else 0

    @property
    def first_ns(self) -> int | None:
        """Arrival time of the first waiting message; None if none waits."""
        return self._waiting[0].at_ns if self._waiting else None

    @property
    def due_ns(self) -> int | None:
        """Deadline of the waiting message; None if none waits."""
        return self._waiting[0].at_ns + LONGEST_WAIT_NS if self._waiting else None

    def _next(self, until_ns: float) -> int | None:
        """Return the position of the next message; None if it has not arrived yet."""
        first = self._waiting[0]
        end_ns = first.at_ns + LONGEST_WAIT_NS
        ties = self._due_before(first)
        if not ties:
            return 0
        near_ns = min(end_ns, until_ns)
        candidates = list(takewhile(lambda one: one.at_ns <= near_ns, self._waiting))
        for tie in ties:
            of_topic = [place for place, one in enumerate(candidates) if one.tie == tie]
            if any(candidates[place].stamp_ns == first.stamp_ns for place in of_topic):
                return of_topic[0]
            if until_ns < end_ns:
                return None
        return 0

    def _due_before(self, arrival: Arrival[Item]) -> list[int]:
        """Return the topics whose message with this stamp is due first but has not arrived."""
        companion = self._companions.get(arrival.tie)
        if arrival.tie > len(self._companions) or (companion is not None and not companion.joins):
            return []
        return [
            tie
            for tie, one in self._companions.items()
            if tie < arrival.tie and one.is_due(arrival.stamp_ns)
        ]

    def _note(self, arrival: Arrival[Item]) -> None:
        """Update the topics that share the stamps of pressures with one message."""
        companion, last = self._companions.get(arrival.tie), self._last
        if companion is not None:
            companion.take(arrival.stamp_ns)
            is_close = last is not None and arrival.at_ns <= last.at_ns + LONGEST_WAIT_NS
            if last is not None and last.stamp_ns == arrival.stamp_ns and is_close:
                companion.missed = 0
        elif arrival.tie == len(self._companions):
            for tie in self._due_before(arrival):  # the message did not arrive in time
                one = self._companions[tie]
                one.missed += (
                    one.interval_ns > 0 or not one.last_ns
                )  # its time is unknown without a stamp
            for one in self._companions.values():
                if one.last_ns == arrival.stamp_ns:
                    one.missed = 0
            self._last = arrival
