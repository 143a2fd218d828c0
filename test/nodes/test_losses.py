"""Messages that were lost are counted by the numbers that DDS gives them."""

from __future__ import annotations

from pneunet_ros.nodes.losses import Losses, NUMBER
import pytest

TOPIC = '/pneunet/pressure'


def after(*numbers, publishers=1, losses=None):
    losses = losses or Losses()
    for number in numbers:
        losses.take(TOPIC, {NUMBER: number}, lambda topic: publishers)
    return losses


@pytest.mark.parametrize(
    ('numbers', 'lost'),
    [
        ((1, 2, 3), 0),
        ((7, 8, 9), 0),  # who comes late has lost nothing
        ((1, 2, 5, 6), 2),
        ((1, 4, 8), 5),
        ((100, 101, 1, 2, 3), 0),  # a publisher that was started anew
        ((100, 101, 1, 2, 4), 1),
        ((None, None), 0),  # a middleware that gives no numbers
    ],
)
def test_gaps_are_counted(numbers, lost):
    assert after(*numbers).total[TOPIC] == lost


def test_of_several_publishers_nothing_is_known():
    assert after(1, 500, 2, 501, publishers=2).total[TOPIC] == 0


def test_of_several_publishers_that_became_one_nothing_is_said():
    losses = after(5000, 10, 5001, 11, publishers=2)
    after(5002, 5003, losses=losses)
    assert losses.total[TOPIC] == 0
    after(5006, losses=losses)
    assert losses.total[TOPIC] == 2


def test_a_loss_is_said_once():
    losses = after(1, 2, 5)
    assert losses.sentence()[:2] == '2 '
    assert losses.sentence() == ''
    after(6, 8, losses=losses)
    assert losses.sentence()[:2] == '1 '
    assert losses.total[TOPIC] == 3
