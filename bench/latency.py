"""Latency of the node, from a published pressure to the shape received, over DDS.

The node is started here as a user would, and this process plays the sensors and listens as a
controller would. What is measured includes both ways through DDS and reading the message in Python
here. How much of it is not the node's is measured in the same way with a node that answers a
pressure with a constant message (`bare`): a machine that is busy or slow shows there. Both nodes
run all the time, and get readings in turn, round by round; of each number the median of the rounds
is told, and that of the differences within a round.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import json
import math
import os
import sys
import time

import numpy as np
from over_dds import bench_options, cpu_seconds, own_domain, running_node

TARGETS_MS = {'p50_ms': 0.6, 'p99_ms': 1.0}  # above those of the bare node
WARM_UP = 0.5  # s at the beginning of a round that are not counted
NODES = {'bare': [__file__, '--bare-node'], 'estimator': ['-m', 'pneunet_ros.nodes.estimator']}
STATIONS, POINT_BYTES = 57, 72  # size of the message `shape`


@contextlib.contextmanager
def connected_node(name: str) -> Iterator[Controller]:
    """Start a node in a namespace of its name, and connect to it."""
    with running_node(NODES[name], f'/{name}') as process:
        controller = Controller(f'/{name}', process.pid)
        controller.connect()
        yield controller
        controller.close()


def bare_node():
    """Make a node that answers every pressure with a message as large as a shape."""
    from array import array

    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import FluidPressure, PointCloud2

    node = rclpy.create_node('estimator')
    shapes = node.create_publisher(PointCloud2, 'shape', 10)
    shape = PointCloud2(data=array('B', bytes(STATIONS * POINT_BYTES)))

    def answer(message: FluidPressure) -> None:
        shape.header = message.header
        shapes.publish(shape)

    qos = qos_profile_sensor_data
    node.create_subscription(WrenchStamped, 'end_wrench', lambda message: None, qos)
    node.create_subscription(FluidPressure, 'pressure', answer, qos)
    return node


class Controller:
    """Publishes pressure and wrench at a steady rate and notes when the shapes come."""

    def __init__(self, namespace: str, pid: int) -> None:
        """Begin; pid: of the process with the node."""
        from geometry_msgs.msg import WrenchStamped
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import FluidPressure, PointCloud2

        self.pid = pid
        self.node = rclpy.create_node('controller', namespace=namespace)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.pressure_message, self.wrench_message = FluidPressure(), WrenchStamped()
        self.wrench_message.header.frame_id = 'pneunet_base'
        qos = qos_profile_sensor_data
        self.pressure = self.node.create_publisher(FluidPressure, 'pressure', qos)
        self.wrench = self.node.create_publisher(WrenchStamped, 'end_wrench', qos)
        self.node.create_subscription(PointCloud2, 'shape', self.take_shape, 10)
        self.sent: dict[tuple[int, int], int] = {}
        self.latency: dict[tuple[int, int], float] = {}
        self.stamp = 1000.0  # s, anywhere but at 0

    def take_shape(self, message) -> None:
        now = time.perf_counter_ns()
        stamp = message.header.stamp.sec, message.header.stamp.nanosec
        if stamp in self.sent:
            self.latency[stamp] = 1e-6 * (now - self.sent[stamp])

    def send(self, period: float) -> None:
        """Publish a wrench and a pressure of a smooth motion, a period after the last ones."""
        self.stamp += period
        seconds = self.stamp
        key = divmod(round(seconds * 1e9), 1_000_000_000)
        for message in (self.wrench_message, self.pressure_message):
            message.header.stamp.sec, message.header.stamp.nanosec = key
        self.wrench_message.wrench.force.x = 0.1 + 0.05 * math.sin(3.0 * seconds)
        self.wrench_message.wrench.force.y = 0.05 * math.cos(2.0 * seconds)
        self.pressure_message.fluid_pressure = 30e3 + 20e3 * math.sin(seconds)
        self.wrench.publish(self.wrench_message)
        self.sent[key] = time.perf_counter_ns()
        self.pressure.publish(self.pressure_message)

    def connect(self, timeout: float = 120.0) -> None:
        """Wait for the node: until a first shape has come."""
        begin = time.monotonic()
        while not self.latency:
            if time.monotonic() - begin > timeout:
                raise SystemExit('the node gave no shape')
            self.send(0.05)
            self.executor.spin_once(timeout_sec=0.05)

    def run(self, seconds: float, rate: float) -> None:
        """Publish at the rate and listen in between."""
        begin = time.perf_counter()
        for index in range(round(seconds * rate)):
            due = begin + index / rate
            while (left := due - time.perf_counter()) > 0.0:
                self.executor.spin_once(timeout_sec=left)
            self.send(1.0 / rate)
        end = time.perf_counter() + 0.2
        while time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def measure(self, seconds: float, rate: float) -> dict[str, float]:
        """Give the node so many readings a second for so long."""
        self.run(WARM_UP, rate)
        self.sent.clear()
        self.latency.clear()
        cpu = cpu_seconds(self.pid)
        self.run(seconds, rate)
        cpu = cpu_seconds(self.pid) - cpu
        latency = np.array(list(self.latency.values()))
        p50, p99 = np.percentile(latency, [50, 99])
        return {
            'lost': len(self.sent) - latency.size,
            'p50_ms': float(p50),
            'p99_ms': float(p99),
            'max_ms': float(latency.max()),
            'cpu_ms': 1e3 * cpu / len(self.sent),
        }

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()


def medians(rounds: list[dict[str, float]]) -> dict[str, float]:
    """Return the median of each number of several rounds."""
    return {name: float(np.median([one[name] for one in rounds])) for name in rounds[0]}


def differences(one: dict[str, float], other: dict[str, float]) -> dict[str, float]:
    """Return by how much each number is larger than another."""
    return {name: one[name] - other[name] for name in one}


def compare(rounds: int, seconds: float, rate: float) -> dict[str, dict[str, float]]:
    """Let the nodes have readings in turn, and sum up."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in NODES}
    with contextlib.ExitStack() as stack:
        controllers = {name: stack.enter_context(connected_node(name)) for name in NODES}
        for _ in range(rounds):
            for name, controller in controllers.items():
                found[name].append(controller.measure(seconds, rate))
    more = [differences(*pair) for pair in zip(found['estimator'], found['bare'], strict=True)]
    return {**{name: medians(of_node) for name, of_node in found.items()}, 'more': medians(more)}


def main() -> int:
    import rclpy

    parser = bench_options(__doc__.splitlines()[0], bare_node)
    parser.add_argument('--rounds', type=int, default=6, help='of each node (default: 6)')
    parser.add_argument('--seconds', type=float, default=4.0, help='of a round (default: 4)')
    parser.add_argument('--rate', type=float, default=100.0, help='readings per s (default: 100)')
    options = parser.parse_args()
    with own_domain():
        rclpy.init()
        results = compare(options.rounds, options.seconds, options.rate)
        rclpy.shutdown()
    load = os.getloadavg()[0]
    if options.json:
        settings = {key: getattr(options, key) for key in ('rounds', 'seconds', 'rate')}
        print(json.dumps(settings | results | {'targets_ms': TARGETS_MS, 'load': load}))
        return 0
    print(f'{"":8}' + ''.join(f'{name:>12}' for name in results) + f'{"target":>12}')
    for name in results['bare']:
        numbers = ''.join(f'{result[name]:12.3g}' for result in results.values())
        target = f'{TARGETS_MS[name]:12.3g}' if name in TARGETS_MS else ''
        print(f'{name:8}{numbers}{target}')
    print(f'cpu_ms: of the process, per reading; load of the machine meanwhile: {load:.2g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
