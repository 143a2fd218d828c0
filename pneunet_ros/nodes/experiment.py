"""One experiment on a live arm: commands pressure and force, and records the readings.

    python -m pneunet_ros.nodes.experiment RECORDING.mcap < corners.json [--ros-args ...]

The corners are rows of time (s), pressure (Pa), F1 and F2 (N), joined by straight lines. Commands
are published on `pressure_command` and `force_command`, as for the virtual arm; `pressure`,
`end_wrench` and `targets` are recorded. If no node subscribes to `force_command`, a prompt asks
the user to hang a load on the arm and to press Enter. At the end, or when interrupted, the
experiment vents the arm and removes the load.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import PneunetError, RecordingError, RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.printable import printable
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, SENSORS, TARGETS
from pneunet_ros.nodes.ros_types import RCLPY_TYPES
from pneunet_ros.nodes.signals import end_at_signal
from pneunet_ros.nodes.topics import input_qos, output_qos, publisher
from pneunet_ros.offline.live_arm import NAMESPACE
from pneunet_ros.recordings.recording_writer import RecordingWriter, write_recording
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

PERIOD = 0.02  # s, between commands
PATIENCE = 30.0  # s, to wait for readings and for a subscriber to the commands
SILENCE = 2.0  # s without messages at the end, after which a sensor counts as dead
REST = 3.0  # s at the first corner, before the recording begins
DEPTH = 200  # depth of the queues
DONE, WRONG_REQUEST = 0, 2


class ExperimentNode(Node):
    """Commands a live arm along corners (k, 4): time s, pressure Pa, F1 and F2 N."""

    def __init__(self, corners: Array) -> None:
        """Open the topics."""
        super().__init__('experiment', namespace=NAMESPACE)
        self.corners = corners
        self.executor_alone = SingleThreadedExecutor()
        self.executor_alone.add_node(self)
        self.writer: RecordingWriter | None = None
        self.topics: dict[str, Any] = {}
        self.counts = dict.fromkeys((PRESSURE.name, END_WRENCH.name, TARGETS.name), 0)
        self.heard_at = dict.fromkeys(self.counts, 0.0)
        self.pressures = publisher(self, PRESSURE.type, 'pressure_command', output_qos())
        self.forces = publisher(self, END_WRENCH.type, 'force_command', output_qos())
        qos = input_qos()
        qos.depth = DEPTH
        for sensor in SENSORS:
            if sensor.name in self.counts:
                kind = RCLPY_TYPES(sensor.type)
                self.create_subscription(kind, sensor.name, self.take(sensor.name), qos, raw=True)

    def take(self, name: str) -> Callable[[bytes], None]:
        """Return a callback that records the messages of a topic."""

        def keep(raw: bytes) -> None:
            self.counts[name] += 1
            self.heard_at[name] = time.monotonic()
            if self.writer is not None:
                stamp_ns = self.get_clock().now().nanoseconds
                self.writer.write_raw(self.topics[name], stamp_ns, bytes(raw))

        return keep

    def command(self, seconds: float) -> None:
        """Publish the pressure and force commanded for a time (s)."""
        time_s, *columns = self.corners.T
        pressure, x, y = (float(np.interp(seconds, time_s, values)) for values in columns)
        self.send(pressure, x, y)

    def send(self, pressure: float, force_x: float, force_y: float) -> None:
        """Command a pressure (Pa) and a force (N)."""
        stamp_ns = self.get_clock().now().nanoseconds
        values = np.array([force_x, force_y, 0.0])
        self.forces.publish(END_WRENCH.message(stamp_ns, values, BASE_FRAME, RCLPY_TYPES))
        row = np.array([pressure])
        self.pressures.publish(PRESSURE.message(stamp_ns, row, BASE_FRAME, RCLPY_TYPES))

    def record_into(self, writer: RecordingWriter | None) -> None:
        """Start recording messages; None: stop."""
        if writer is not None:
            types = {sensor.name: sensor.type for sensor in SENSORS}
            self.topics = {
                name: writer.add(self.resolve_topic_name(name), types[name])
                for name in self.counts
            }
            self.counts = dict.fromkeys(self.counts, 0)
        self.writer = writer

    def spin(self, seconds: float, step: Callable[[float], None] = lambda _: None) -> None:
        """Process messages for some time; step: called in every period with the time (s)."""
        begun = time.monotonic()
        due = begun
        while (now := time.monotonic()) < begun + seconds:
            if now >= due:
                step(now - begun)
                due += PERIOD
            self.executor_alone.spin_once(timeout_sec=max(due - time.monotonic(), 0.0))

    def waited(self, ready: Callable[[], bool]) -> bool:
        """Wait for a condition; return whether it was met."""
        end = time.monotonic() + PATIENCE
        while not ready() and time.monotonic() < end:
            self.spin(PERIOD)
        return ready()

    def vent(self) -> None:
        """Command zero pressure and force briefly, without recording."""
        self.record_into(None)
        self.spin(5 * PERIOD, lambda _: self.send(0.0, 0.0, 0.0))


def run_experiment(node: ExperimentNode, path: Path) -> None:
    """Wait for the arm, run the experiment, and write the recording."""
    pressure, targets = (node.resolve_topic_name(item.name) for item in (PRESSURE, TARGETS))
    if not node.waited(lambda: min(node.counts[PRESSURE.name], node.counts[TARGETS.name]) > 0):
        raise RequestError(
            f'no messages on {pressure} or {targets}: are the arm and the tracker running?',
            reason='silence',
        )
    loaded = bool(np.any(node.corners[:, 2:]))
    if not node.waited(lambda: node.pressures.get_subscription_count() > 0):
        raise RequestError(
            f'no node subscribes to {node.pressures.topic_name}: is the valve driver running?',
            reason='silence',
        )
    if loaded and node.forces.get_subscription_count() == 0:
        ask_for_load(node.corners, node.forces.topic_name)
    node.spin(REST, lambda _: node.command(0.0))
    with write_recording(path) as writer:
        node.record_into(writer)
        node.spin(float(node.corners[-1, 0]), node.command)
        node.record_into(None)
        end = time.monotonic()
        for name, count in node.counts.items():
            topic, silence = node.resolve_topic_name(name), end - node.heard_at[name]
            if name == END_WRENCH.name and not loaded:
                continue
            if not count:
                raise RecordingError(
                    f'no messages on {topic} during the experiment', reason='silence'
                )
            if silence > max(SILENCE, 2.0 * float(node.corners[-1, 0]) / count):
                raise RecordingError(
                    f'no messages on {topic} in the last {silence:.1f} s of the experiment',
                    reason='silence',
                )


def ask_for_load(corners: Array, topic: str) -> None:
    """Ask the user to attach the load, and wait."""
    print(f'No node subscribes to {topic}. Pull at the free end by hand or with weights:')
    print('  s      F1 (N)  F2 (N)')
    for seconds, _, x, y in corners.tolist():
        print(f'  {seconds:5.1f}  {x:6.3f}  {y:6.3f}')
    print(f'The clock starts {REST:g} s after Enter: ', end='', flush=True)
    with open('/dev/tty', encoding='utf-8') as terminal:
        terminal.readline()


def main() -> int:
    """Run the experiment read from stdin; returns the exit code."""
    end_at_signal()
    try:
        corners = np.array(json.load(sys.stdin), dtype=np.float64)
        # Handlers of rclpy would shut ROS down at the first signal, and the arm could not be
        # vented.
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        (path,) = remove_ros_args(sys.argv)[1:]
        node = ExperimentNode(corners)
        try:
            run_experiment(node, Path(path))
        finally:
            node.vent()  # even after an error or Ctrl-C
            node.destroy_node()
    except KeyboardInterrupt:
        return 130
    except (PneunetError, ValueError, OSError) as error:
        print(printable(str(error)), file=sys.stderr)
        return WRONG_REQUEST
    finally:
        rclpy.try_shutdown()
    return DONE


if __name__ == '__main__':
    sys.exit(main())
