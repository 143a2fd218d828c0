"""The order of messages: as they arrived, then by stamp and topic, whenever somebody looks."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from pneunet_ros.core.arrivals import ArrivalOrder, LONGEST_WAIT_NS
import pytest

TOPICS = ('end_wrench', 'targets', 'pressure')
PERIOD = 10_000_000  # ns
KINDS = dict(zip('wfp', TOPICS, strict=True))


def order():
    return ArrivalOrder(TOPICS, 'pressure')


def taken_at_once(arrivals):
    """Give messages, (at, stamp, kind), that were all there before somebody looked."""
    waiting = order()
    for arrival in arrivals:
        at, stamp, kind = arrival
        waiting.add(KINDS[kind], at, stamp, arrival)
    return list(waiting.take(math.inf))


def taken_when_looking(arrivals, looks):
    """Give them to who looks at these times, and whenever a message has waited long enough."""
    waiting, taken, left = order(), [], sorted(arrivals, key=lambda one: one[0])
    for look in [*sorted(looks), math.inf]:
        while True:
            due = waiting.due_ns
            until = look if due is None else min(look, due)
            while left and left[0][0] <= until:
                at, stamp, kind = arrival = left.pop(0)
                waiting.add(KINDS[kind], at, stamp, arrival)
            before = len(taken)
            taken += waiting.take(until)
            if until == look and (due is None or len(taken) == before):
                break
    return taken


ARRIVALS = st.lists(
    st.tuples(
        st.integers(0, 20_000_000), st.sampled_from([0, *range(1, 9)]), st.sampled_from('wfp')
    ),
    max_size=25,
)


@given(ARRIVALS, st.lists(st.integers(0, 25_000_000), max_size=8))
def test_the_order_does_not_depend_on_when_somebody_looks(arrivals, looks):
    arrivals = sorted(arrivals, key=lambda one: one[0])
    arrivals = [  # of one instant in the order of ties: who looks does not see them apart
        (at + index, stamp * PERIOD, kind) for index, (at, stamp, kind) in enumerate(arrivals)
    ]
    assert taken_when_looking(arrivals, looks) == taken_at_once(arrivals)


@given(st.lists(st.tuples(st.integers(0, 9), st.sampled_from('wfp')), max_size=20), st.randoms())
def test_without_common_stamps_it_is_that_of_arrival_and_stamps(messages, random):
    arrivals = [(at, number + 1, kind) for number, (at, kind) in enumerate(messages)]
    shuffled = random.sample(arrivals, len(arrivals))
    expected = sorted(shuffled, key=lambda one: one[:2])
    assert taken_at_once(shuffled) == expected


@given(
    st.data(),
    st.sampled_from([1, 3]),
    st.sampled_from([1, 2, 10]),
    st.sampled_from([5_000_000, PERIOD, 100_000_000]),
)
def test_messages_of_one_stamp_are_taken_alike_in_whatever_order_they_arrive(
    data, every, wrenches, period
):
    """A driver that stamps all topics alike, at three rates: frames with every first or third."""
    recorded, arrived = [], []
    for number in range(1, 13):
        stamp = number * period
        group = [(stamp, stamp - k * period // wrenches, 'w') for k in reversed(range(wrenches))]
        group += [(stamp, stamp, 'f')] * (number % every == 0)
        group += [(stamp, stamp, 'p')]
        recorded += group
        kinds = [one[2] for one in group]
        if number > 2 * every:  # until then it shows how often there are frames
            kinds = data.draw(st.permutations(kinds))
        left = {kind: [one for one in group if one[2] == kind] for kind in 'wfp'}
        for place, kind in enumerate(kinds):  # each topic comes in its own order
            at = stamp + place * LONGEST_WAIT_NS // len(kinds)
            arrived.append((at, *left[kind].pop(0)[1:]))
    looks = data.draw(st.lists(st.integers(0, 13 * period), max_size=6))
    expected = [one[1:] for one in taken_at_once(recorded)]
    assert expected == [one[1:] for one in recorded]
    assert [one[1:] for one in taken_when_looking(arrived, looks)] == expected


def waits(arrivals):
    """Give for how many pressures something was waited for."""
    waiting, count = order(), 0
    for at, stamp, kind in arrivals:
        list(waiting.take(at - 1))
        waiting.add(KINDS[kind], at, stamp, kind)
        list(waiting.take(at))
        count += kind == 'p' and waiting.due_ns is not None
    return count


@pytest.mark.parametrize(
    ('wrench', 'frame', 'most'),
    [
        (0, 0, 4),  # until two messages of each have shown it
        (-300_000, -300_000, 4),
        (300_000, -4_000_000, 4),
    ],
)
def test_nothing_waits_for_sensors_with_stamps_of_their_own(wrench, frame, most):
    arrivals = []
    for number in range(1, 200):
        stamp = number * PERIOD
        arrivals += [
            (stamp + wrench, stamp + wrench + 7, 'w'),
            *[(stamp + frame, stamp + frame - 20_000_001, 'f')] * (number % 3 == 0),
            (stamp + 1, stamp, 'p'),
        ]
    assert waits(sorted(arrivals)) <= most


def test_a_companion_that_is_lost_is_waited_for_twice():
    arrivals = []
    for number in range(1, 100):
        stamp = number * PERIOD
        arrivals += [(stamp, stamp, 'w')] * (number < 50)
        arrivals += [(stamp + 1, stamp, 'f'), (stamp + 2, stamp, 'p')]
    assert waits(arrivals) == 2
