"""Latency of the node `fusion`: from a frame of targets to the fused tip, over DDS.

A recording of the virtual lab is played at its own pace: each frame is sent just before the
pressure reading that follows it, and the time counts from the frame to the `fused/tip` of that
reading. As in `latency.py` a node that answers a pressure with a constant pose (`bare`) tells how
much of it is the machine's. There is no force sensor, which is the slower case. The target is for
a machine with nothing else to do.
"""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import subprocess
import sys
import time

import numpy as np
from over_dds import bench_options, CHECKOUT, NAMESPACE, own_domain, running_node

MODEL = CHECKOUT / 'config' / 'lab_arm.yaml'  # of the arm that is simulated
SCENARIO = 'random_mix'
TARGET_ABOVE_MS = 6.0  # p99 above that of a bare node
WARM_UP = 2.0  # s at the beginning that are not counted
NODE = ['-m', 'pneunet_ros.nodes.fusion', '--ros-args', '-p', f'model_file:={MODEL}']
BARE_NODE = [__file__, '--bare-node']


def bare_node():
    """Make a node that answers every pressure with a pose, and takes frames as well."""
    from geometry_msgs.msg import PoseWithCovarianceStamped
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import FluidPressure, PointCloud2

    node = rclpy.create_node('fusion')
    tips = node.create_publisher(PoseWithCovarianceStamped, 'fused/tip', 10)
    tip = PoseWithCovarianceStamped()

    def answer(message: FluidPressure) -> None:
        tip.header = message.header
        tips.publish(tip)

    qos = qos_profile_sensor_data
    node.create_subscription(PointCloud2, 'targets', lambda message: None, qos)
    node.create_subscription(FluidPressure, 'pressure', answer, qos)
    return node


def turns(path: Path) -> Iterator[tuple[float, tuple[int, int], bytes, bytes | None]]:
    """Yield time (s), stamp and bytes of every pressure, and the frame that came before it."""
    from pneunet_ros.recordings.recording import open_recording

    recording = open_recording(path)
    frame, begin = None, None
    for message in recording.messages([f'{NAMESPACE}/pressure', f'{NAMESPACE}/targets']):
        begin = message.log_time_ns if begin is None else begin
        if message.topic.endswith('targets'):
            frame = bytes(message.raw)
            continue
        stamp = message.message.header.stamp
        since = 1e-9 * (message.log_time_ns - begin)
        yield since, (stamp.sec, stamp.nanosec), bytes(message.raw), frame
        frame = None


class Player:
    """Plays the sensors and notes when the tips come."""

    def __init__(self) -> None:
        from geometry_msgs.msg import PoseWithCovarianceStamped
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import FluidPressure, PointCloud2

        rclpy.init()
        self.node = rclpy.create_node('player', namespace=NAMESPACE)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        qos = qos_profile_sensor_data
        self.pressure = self.node.create_publisher(FluidPressure, 'pressure', qos)
        self.targets = self.node.create_publisher(PointCloud2, 'targets', qos)
        self.node.create_subscription(PoseWithCovarianceStamped, 'fused/tip', self.take_tip, 10)
        self.sent: dict[tuple[int, int], int] = {}
        self.latency: dict[tuple[int, int], float] = {}

    def take_tip(self, message) -> None:
        now = time.perf_counter_ns()
        stamp = message.header.stamp.sec, message.header.stamp.nanosec
        if stamp in self.sent:
            self.latency[stamp] = 1e-6 * (now - self.sent[stamp])

    def connect(self) -> None:
        """Wait until the node hears both topics and is heard."""
        end = time.monotonic() + 120.0
        while (
            min(self.pressure.get_subscription_count(), self.targets.get_subscription_count()) < 1
            or self.node.count_publishers('fused/tip') < 1
        ):
            if time.monotonic() > end:
                raise SystemExit('the node did not come')
            self.executor.spin_once(timeout_sec=0.05)

    def play(self, path: Path, seconds: float) -> None:
        """Send the beginning of a recording, and listen in between."""
        begin = time.perf_counter()
        for since, stamp, pressure, frame in turns(path):
            if since > WARM_UP + seconds:
                break
            while (left := begin + since - time.perf_counter()) > 0.0:
                self.executor.spin_once(timeout_sec=left)
            if frame is not None:
                if since > WARM_UP:
                    self.sent[stamp] = time.perf_counter_ns()
                self.targets.publish(frame)
            self.pressure.publish(pressure)
        end = time.perf_counter() + 0.5
        while time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


def measure(what: list[str], path: Path, seconds: float) -> dict[str, float]:
    """Play a recording to a node."""
    with running_node(what):
        player = Player()
        player.connect()
        player.play(path, seconds)
        player.close()
    latency = np.array(list(player.latency.values()))
    p50, p99 = np.percentile(latency, [50, 99])
    return {
        'frames': len(player.sent),
        'lost': len(player.sent) - latency.size,
        'p50_ms': float(p50),
        'p99_ms': float(p99),
        'max_ms': float(latency.max()),
    }


def main() -> int:
    parser = bench_options(__doc__.splitlines()[0], bare_node)
    parser.add_argument('--seconds', type=float, default=20.0, help='duration (default: 20)')
    options = parser.parse_args()
    with own_domain() as folder:
        path = folder / 'played.mcap'
        simulate = [sys.executable, '-m', 'pneunet_ros.cli', 'simulate', SCENARIO]
        subprocess.run([*simulate, '--output', str(path)], check=True, capture_output=True)
        results = {
            name: measure(what, path, options.seconds)
            for name, what in (('bare', BARE_NODE), ('fusion', NODE))
        }
    load = os.getloadavg()[0]
    if options.json:
        print(json.dumps(results | {'target_p99_above_ms': TARGET_ABOVE_MS, 'load': load}))
        return 0
    print(f'{"":12}{"fusion":>10}{"bare":>10}')
    for name in results['bare']:
        print(f'{name:12}{results["fusion"][name]:10.4g}{results["bare"][name]:10.4g}')
    print(
        f'target: p99 < {TARGET_ABOVE_MS:g} ms above the bare node; '
        f'load of the machine meanwhile: {load:.2g}'
    )
    return 0


if __name__ == '__main__':
    sys.exit(main())
