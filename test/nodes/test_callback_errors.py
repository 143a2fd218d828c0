"""An error of the program ends no node: it is counted and said, and the node goes on."""

from __future__ import annotations

import os
import signal

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.nodes.callback_errors import CallbackErrors  # noqa: E402
from support.dds_peer import EstimatorPeer, running_node  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
BROKEN = """
import sys
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.nodes.start import start
step = Estimator.step

def broken(self, state, reading):
    if getattr(reading, 'pressure', 0.0) == 666.0:
        raise OverflowError('no')
    return step(self, state, reading)

Estimator.step = broken
import pneunet_ros.nodes.pressure_zero as zero
import pneunet_ros.nodes.estimator.node as node
zero.pressure_zero = lambda *arguments: 1 / 0
sys.exit(start('estimator'))
"""


def last_values(peer):
    return {item.key: item.value for item in peer.statuses[-1].values}


def test_a_node_survives_errors_of_its_own_in_readings_and_services(tmp_path):
    with running_node(tmp_path / 'output', DOMAIN, code=BROKEN) as process:
        process.wait_for('ready')
        peer = EstimatorPeer(DOMAIN)
        peer.connect()
        peer.report()  # the next one has all messages since this one
        for index in range(3):
            peer.wrench(100.0 + 0.1 * index)
            peer.pressure(100.0 + 0.1 * index, 666.0)
        answer = peer.trigger('zero_pressure')
        assert not answer.success
        assert peer.spin_until(lambda: last_values(peer).get('internal_errors') == '4')
        level, message, values = peer.report()
        assert level == Level.ERROR
        assert 'OverflowError' in message
        assert 'ZeroDivisionError' in message
        peer.pressures.publish(b'\x00\x01\x00\x00\x01')  # the bytes of no message
        peer.send(100.3)
        assert peer.spin_until(lambda: peer.received['shape'])
        assert len(peer.received['shape']) == 1
        assert any(name.startswith('internal_errors/ZeroDivisionError') for name in values)
        peer.close()
        assert process.end(signal.SIGTERM) == 0, process.text
        assert process.text.count('Traceback') <= 3  # once a kind, with that of the bytes
        assert process.text.count('OverflowError: no') == 1


def test_errors_are_counted_by_kind_and_said_once():
    said = []
    errors = CallbackErrors(lambda kind, sentence: said.append(kind))
    fail = errors.guarded(lambda number: 1 / number, lambda number: 'failed')
    assert [fail(number) for number in (1, 0, 0)] == [1.0, 'failed', 'failed']
    assert len(said) == 1
    assert list(errors.total.values()) == [2]
    assert 'test_callback_errors.py' in errors.sentence()
    assert errors.sentence() == ''
