"""Latency of the node, from a published pressure to the shape received, over DDS.

Two processes: the node, started here as a user would, and this one, which plays the sensors and
listens as a controller would. What is measured includes both ways through DDS and reading the
message in Python here.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

CHECKOUT = Path(__file__).resolve().parent.parent
NAMESPACE = '/pneunet'
TARGET_P99_MS = 2.0
WARM_UP = 1.0  # s at the beginning that are not counted


@contextmanager
def running_node(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start the node and end it by SIGINT."""
    command = [sys.executable, '-m', 'pneunet_ros.nodes.estimator', '--ros-args']
    process = subprocess.Popen(
        [*command, '-r', f'__ns:={NAMESPACE}', *arguments],
        cwd=CHECKOUT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10)


def cpu_seconds(pid: int) -> float:
    """Processor time a process has used, all its threads."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


class Controller:
    """Publishes pressure and wrench at a steady rate and notes when the shapes come."""

    def __init__(self) -> None:
        from geometry_msgs.msg import WrenchStamped
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import FluidPressure, PointCloud2

        rclpy.init()
        self.node = rclpy.create_node('controller', namespace=NAMESPACE)
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
        end = time.perf_counter() + 0.5
        while time.perf_counter() < end:
            self.executor.spin_once(timeout_sec=0.05)


def measure(seconds: float, rate: float, arguments: list[str]) -> dict[str, float]:
    """Run the node for so long at so many readings a second."""
    with running_node(arguments) as process:
        controller = Controller()
        controller.connect()
        controller.run(WARM_UP, rate)
        controller.sent.clear()
        controller.latency.clear()
        cpu, begin = cpu_seconds(process.pid), time.perf_counter()
        controller.run(seconds, rate)
        share = (cpu_seconds(process.pid) - cpu) / (time.perf_counter() - begin)
    latency = np.array(list(controller.latency.values()))
    p50, p99 = np.percentile(latency, [50, 99])
    return {
        'rate_hz': rate,
        'seconds': seconds,
        'sent': len(controller.sent),
        'received': latency.size,
        'lost': len(controller.sent) - latency.size,
        'p50_ms': float(p50),
        'p99_ms': float(p99),
        'max_ms': float(latency.max()),
        'node_cpu_percent': 100.0 * share,
        'load_of_machine': os.getloadavg()[0],
        'target_p99_ms': TARGET_P99_MS,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0, help='how long (default: 20)')
    parser.add_argument('--rate', type=float, default=100.0, help='readings per s (default: 100)')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    options, node_arguments = parser.parse_known_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 101 + 1))
    with tempfile.TemporaryDirectory() as log:
        os.environ['ROS_LOG_DIR'] = log
        result = measure(options.seconds, options.rate, node_arguments)
    if options.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f'{name:18} {value:.4g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
