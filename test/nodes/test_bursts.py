"""Live is replay, bit for bit, when messages come in bursts while the node is busy."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import os
import signal

from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
import pytest
from support.bursts import played_live, RATES, RELIABLE, REPLAYS, write_bursts

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from support.dds_peer import running_node, SensorsPeer  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
OUTPUTS_OF = {'estimator': OUTPUTS, 'fusion': FUSION_OUTPUTS}
READINGS = 30
# Two frames before each pressure: to each arm of a gripper, test_gripper.
ASKED = ('ten wrenches', 'one stamp')


@pytest.fixture(scope='module', params=OUTPUTS_OF)
def peer(request, tmp_path_factory):
    """Run a node; gives the peer that plays its sensors."""
    output = tmp_path_factory.mktemp(request.param) / 'output'
    with running_node(output, DOMAIN, *RELIABLE, node=request.param) as process:
        process.wait_for('ready')
        peer = SensorsPeer(DOMAIN, request.param, OUTPUTS_OF[request.param])
        bursts = write_bursts(output.parent / 'first.mcap', RATES['two frames'], 2)
        peer.connect([message for burst in bursts for message in burst])
        # In a process of its own, as the node is one: what is compiled in another order may differ
        # in the last digit.
        with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
            peer.replay = lambda path: pool.submit(REPLAYS[peer.name], path).result()
            yield peer
        peer.close()
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


@pytest.mark.parametrize('rates', ASKED)
def test_a_burst_is_taken_in_the_order_of_its_replay(peer, rates, tmp_path):
    path = tmp_path / 'bursts.mcap'
    bursts = write_bursts(path, RATES[rates], READINGS)
    expected = peer.replay(path)
    peer.start_anew()
    live = played_live(peer, bursts)
    assert len(live) == len(expected) == READINGS
    assert [number for number in range(READINGS) if live[number] != expected[number]] == []
