"""Test that live estimates equal the replay bit for bit when messages arrive in bursts.

    python acceptance/bursts.py [--readings 1000] [--json]

Nodes run in processes of their own over real DDS. Bursts of one to six pressures, each with its
wrenches and frames, are sent back to back while a node is busy with those before. Compared are all
numbers of all topics with a replay of the same messages. Also told: how far apart
messages arrive that are published back to back, which `core/arrivals.py` waits for.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
import json
from multiprocessing import get_context
import os
from pathlib import Path
import sys
import tempfile
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
DOMAIN = int(os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 101 + 1)))


class ArrivalSpread:
    """Listens to pressure and wrench, and notes how far apart (ms) those of one stamp arrive."""

    def __init__(self, peer: Any) -> None:
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import FluidPressure

        self.at: dict[tuple[int, int], int] = {}
        self.apart: list[float] = []
        for kind, topic in ((WrenchStamped, 'end_wrench'), (FluidPressure, 'pressure')):
            peer.node.create_subscription(kind, topic, self.take, 1000)

    def take(self, message: Any, info: dict[str, int]) -> None:
        stamp = message.header.stamp.sec, message.header.stamp.nanosec
        at_ns = info['received_timestamp']
        if stamp in self.at:
            self.apart.append(1e-6 * abs(at_ns - self.at.pop(stamp)))
        else:
            self.at[stamp] = at_ns


def run(name: str, folder: Path, readings: int) -> Iterator[dict[str, Any]]:
    """Yield what became of the readings of every rate at one node."""
    import numpy as np
    from pneunet_ros.messages.estimate import OUTPUTS
    from pneunet_ros.messages.fusion import FUSION_OUTPUTS
    from support.bursts import played_live, RATES, RELIABLE, REPLAYS, write_bursts
    from support.dds_peer import running_node, SensorsPeer

    outputs = {'estimator': OUTPUTS, 'fusion': FUSION_OUTPUTS}[name]
    with running_node(folder / name, DOMAIN, *RELIABLE, node=name) as process:
        process.wait_for('ready')
        peer = SensorsPeer(DOMAIN, name, outputs)
        first = write_bursts(folder / f'{name}.mcap', RATES['two frames'], 2)
        peer.connect([message for burst in first for message in burst])
        # Plain Python gives the same numbers to ten digits only.
        assert peer.spin_until(lambda: peer.report()[2]['kernels'] == 'compiled')
        spread = ArrivalSpread(peer)
        for label, rates in RATES.items():
            path = folder / f'{name} {label}.mcap'
            bursts = write_bursts(path, rates, readings)
            with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
                expected = pool.submit(REPLAYS[name], path).result()
            peer.start_anew()
            spread.at.clear()
            spread.apart.clear()
            live = played_live(peer, bursts)
            pairs = list(zip(live, expected, strict=True))
            lost = peer.report()[2]['lost']
            yield {
                'node': name,
                'rates': label,
                'readings': readings,
                'equal': sum(one == other for one, other in pairs),
                'first_other': next(
                    (at for at, (one, other) in enumerate(pairs) if one != other), None
                ),
                'lost': int(lost),
                'apart_p50_ms': float(np.median(spread.apart)),
                'apart_p99_ms': float(np.percentile(spread.apart, 99.0)),
            }
        peer.close()
        assert process.end() == 0, process.text


def said(one: dict[str, Any]) -> str:
    """Return a result as a line."""
    return (
        f'{one["node"]}, {one["rates"]}: {one["equal"]} of {one["readings"]} equal; back to back '
        f'{one["apart_p50_ms"]:.2f} ms apart, p99 {one["apart_p99_ms"]:.2f} ms; first other one '
        f'{one["first_other"]}, lost {one["lost"]}'
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare; returns 1 where a reading differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--readings', type=int, default=1000, help='of each rate')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        os.environ['ROS_LOG_DIR'] = folder
        found = []
        for name in ('estimator', 'fusion'):
            for one in run(name, Path(folder), options.readings):
                found.append(one)
                if not options.json:
                    print(said(one), flush=True)
    if options.json:
        print(json.dumps(found, indent=2))
    return int(any(one['equal'] < one['readings'] for one in found))


if __name__ == '__main__':
    sys.exit(main())
