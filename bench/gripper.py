"""Four fingers in one process: share of answered readings, latency and CPU load.

Recordings of the virtual lab, one of its own for each finger, are played over DDS: pressures and
end wrenches at 100 Hz, frames of targets at 30 Hz. Each finger has an estimator and a fusion in
the process `gripper`, and this process listens to their `state` and `fused/state`, as a controller
would. Times count from a published pressure to the state at it, and of those with a frame sent
just before them (`from_frame`) as well. Fingers are read one after the other (`spread`) or all at
one instant (`together`). As in `latency.py` a node that answers every pressure with two constant
messages (`bare`) tells how much of it is the machine's, and of DDS and Python.
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
from over_dds import bench_options, CHECKOUT, cpu_seconds, own_domain, running_node
from ruamel.yaml import YAML

MODEL = CHECKOUT / 'config' / 'lab_arm.yaml'  # of the arm that is simulated
SCENARIO = CHECKOUT / 'scenarios' / 'random_mix.yaml'
RATES = {'pressure': 100.0, 'wrench': 100.0, 'frames': 30.0}  # Hz
HAND = '/hand'
STATES = ('state', 'fused/state')
WARM_UP = 4.0  # s at the beginning that are not counted
TARGETS = {'answered': 1.0, 'cores': 1.0, 'memory_mb': 400.0}
STAMP = slice(4, 12)  # of the header, in a serialized message
Stamp = bytes


def bare_node():
    """Make a node that answers every pressure of all fingers with two constant messages."""
    from array import array
    from functools import partial

    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.qos import qos_profile_sensor_data as qos
    from sensor_msgs.msg import FluidPressure, PointCloud2

    node = rclpy.create_node('bare')
    answer = PointCloud2(data=array('B', bytes(300)))

    def take(publishers, message: FluidPressure) -> None:
        answer.header = message.header
        for publisher in publishers:
            publisher.publish(answer)

    for finger in os.environ['FINGERS'].split():
        outs = [node.create_publisher(PointCloud2, f'{finger}/{name}', 10) for name in STATES]
        for kind, topic in ((WrenchStamped, 'end_wrench'), (PointCloud2, 'targets')):
            node.create_subscription(kind, f'{finger}/{topic}', lambda message: None, qos)
        node.create_subscription(FluidPressure, f'{finger}/pressure', partial(take, outs), qos)
    return node


def simulated(folder: Path, finger: str, seed: int, seconds: float) -> Path:
    """Simulate what the sensors of a finger say."""
    yaml = YAML(typ='safe')
    scenario = yaml.load(SCENARIO)
    arm = yaml.load(SCENARIO.parent / scenario['arm'])
    scenario |= {'arm': arm, 'seed': seed, 'rates': RATES}
    scenario['protocol'] |= {'seed': seed, 'duration': seconds}
    file, output = folder / f'{finger}.yaml', folder / f'{finger}.mcap'
    yaml.dump(scenario, file)
    simulate = [sys.executable, '-m', 'pneunet_ros.cli', 'simulate', str(file)]
    done = subprocess.run([*simulate, '--output', str(output)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return output


def turns(path: Path, offset: float) -> Iterator[tuple[float, list[tuple[str, bytes]], bool]]:
    """Yield when (s) what is published together: wrenches, maybe a frame, and a pressure last.

    offset: s by which all is later.
    """
    from pneunet_ros.recordings.recording import open_recording

    recording = open_recording(path)
    group: list[tuple[str, bytes]] = []
    begin = None
    for message in recording.raw_messages([topic.name for topic in recording.topics]):
        topic = message.topic.rpartition('/')[2]
        begin = message.log_time_ns if begin is None else begin
        group.append((topic, bytes(message.raw)))
        if topic == 'pressure':
            seen = any(name == 'targets' for name, _ in group)
            yield offset + 1e-9 * (message.log_time_ns - begin), group, seen
            group = []


class Player:
    """Plays the sensors of all fingers, and notes when their states come."""

    def __init__(self, fingers: list[str]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import WrenchStamped
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data as qos
        from sensor_msgs.msg import FluidPressure, PointCloud2

        self.node = rclpy.create_node('player', namespace=HAND)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        kinds = {'end_wrench': WrenchStamped, 'targets': PointCloud2, 'pressure': FluidPressure}
        self.out = {
            (finger, topic): self.node.create_publisher(kind, f'{finger}/{topic}', qos)
            for finger in fingers
            for topic, kind in kinds.items()
        }
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.take_diagnostics, 50)
        self.shed: dict[str, int] = {}
        self.sent: dict[tuple[str, Stamp], tuple[int, bool]] = {}
        self.came: dict[str, dict[tuple[str, Stamp], float]] = {name: {} for name in STATES}
        self.heard = [
            self.node.create_subscription(
                PointCloud2, f'{finger}/{name}', self.taker(finger, name), 100, raw=True
            )
            for finger in fingers
            for name in STATES
        ]

    def taker(self, finger: str, name: str):
        came = self.came[name]

        def take(raw: bytes) -> None:
            now = time.perf_counter_ns()
            key = finger, raw[STAMP]
            if key in self.sent:
                came[key] = 1e-6 * (now - self.sent[key][0])

        return take

    def take_diagnostics(self, message) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.shed[status.name] = int(values.get('frames_shed', 0))

    def listen(self, seconds: float) -> None:
        """Take what comes within a time; all that is there, as rclpy takes one message a turn."""
        if seconds > 0.0:
            self.executor.spin_once(timeout_sec=seconds)
        for subscription in self.heard:
            while taken := subscription.handle.take_message(subscription.msg_type, True):
                subscription.callback(taken[0])

    def connect(self) -> None:
        """Wait until all sensors are heard."""
        end = time.monotonic() + 120.0
        while any(out.get_subscription_count() < 1 for out in self.out.values()) or any(
            self.node.count_publishers(f'{HAND}/{finger}/{name}') < 1
            for finger, _ in self.out
            for name in STATES
        ):
            if time.monotonic() > end:
                raise SystemExit('the gripper did not come')
            self.executor.spin_once(timeout_sec=0.05)

    def play(self, schedule: list, pid: int, pace: float) -> float:
        """Send a schedule, and listen in between; returns cores used after the warm-up.

        pace: 1, or less where the machine is too busy: the cores are those for pace 1.
        """
        begin, cpu, counted = time.perf_counter(), 0.0, 0.0
        for since, finger, group, seen in schedule:
            while (left := begin + since / pace - time.perf_counter()) > 0.0:
                self.listen(left)
            self.listen(0.0)
            if since > WARM_UP and not counted:
                cpu, counted = cpu_seconds(pid), time.perf_counter()
            for topic, raw in group:
                if topic == 'pressure' and since > WARM_UP:
                    self.sent[finger, raw[STAMP]] = time.perf_counter_ns(), seen
                self.out[finger, topic].publish(raw)
        cores = (cpu_seconds(pid) - cpu) / pace / (time.perf_counter() - counted)
        end = time.perf_counter() + 1.0
        while time.perf_counter() < end:
            self.listen(0.05)
        return cores

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    lines = Path(f'/proc/{pid}/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith('VmRSS'))


def times(latency: list[float]) -> dict[str, float]:
    """Return percentiles of times (ms)."""
    p50, p99 = np.percentile(latency, [50, 99]) if latency else (np.nan, np.nan)
    return {'p50_ms': float(p50), 'p99_ms': float(p99), 'max_ms': max(latency, default=np.nan)}


def measure(what: list[str], fingers: list[str], schedule: list, pace: float) -> dict[str, float]:
    """Play a schedule to a process."""
    with running_node(what, HAND) as process:
        player = Player(fingers)
        player.connect()
        cores = player.play(schedule, process.pid, pace)
        memory = memory_mb(process.pid)
        player.close()
    found = {
        'answered': min(len(came) for came in player.came.values()) / len(player.sent),
        'cores': cores,
        'cpu_ms': 1e3 * cores / (RATES['pressure'] * len(fingers)),
        'memory_mb': memory,
        'frames_shed': sum(player.shed.values()),
    }
    framed = {key for key, (_, seen) in player.sent.items() if seen}
    of_frames = [late for key, late in player.came['fused/state'].items() if key in framed]
    kinds = {name: list(came.values()) for name, came in player.came.items()}
    for name, latency in {**kinds, 'from_frame': of_frames}.items():
        found |= {f'{name} {key}': value for key, value in times(latency).items()}
    return found


def schedules(paths: dict[str, Path], seconds: float) -> dict[str, list]:
    """Return what is sent when, for fingers read one after the other and all at once."""
    return {
        name: sorted(
            (
                (since, finger, group, seen)
                for place, (finger, path) in enumerate(paths.items())
                for since, group, seen in turns(path, place * apart)
                if since < WARM_UP + seconds
            ),
            key=lambda turn: turn[0],
        )
        for name, apart in {
            'spread': 1.0 / RATES['pressure'] / len(paths),
            'together': 0.0,
        }.items()
    }


def main() -> int:
    import rclpy

    parser = bench_options(__doc__.splitlines()[0], bare_node)
    parser.add_argument('--seconds', type=float, default=20.0, help='duration (default: 20)')
    parser.add_argument('--fingers', type=int, default=4, help='number of fingers (default: 4)')
    parser.add_argument('--pace', type=float, default=1.0, help='less than 1: slower (default: 1)')
    parser.add_argument('--ways', nargs='+', default=['spread', 'together'], help='in which')
    options = parser.parse_args()
    fingers = [f'finger_{number}' for number in range(1, options.fingers + 1)]
    os.environ['FINGERS'] = ' '.join(fingers)
    models = [word for one in fingers for word in ('-p', f'{one}.model_file:={MODEL}')]
    arms = ['-p', f'arms:=[{", ".join(fingers)}]']
    gripper = ['-m', 'pneunet_ros.nodes.gripper', '--ros-args', *arms, *models]
    with own_domain() as folder:
        paths = {
            finger: simulated(folder, finger, seed, WARM_UP + options.seconds + 1.0)
            for seed, finger in enumerate(fingers, 1)
        }
        rclpy.init()
        results = {
            f'{name} {way}': measure(what, fingers, schedule, options.pace)
            for way, schedule in schedules(paths, options.seconds).items()
            if way in options.ways
            for name, what in (('bare', [__file__, '--bare-node']), ('gripper', gripper))
        }
        rclpy.shutdown()
    load = os.getloadavg()[0]
    if options.json:
        print(json.dumps(results | {'targets': TARGETS, 'load': load}))
        return 0
    print(f'{"":20}' + ''.join(f'{name:>18}' for name in results) + f'{"target":>10}')
    for name in next(iter(results.values())):
        numbers = ''.join(f'{result[name]:18.4g}' for result in results.values())
        print(f'{name:20}{numbers}' + (f'{TARGETS[name]:10.4g}' if name in TARGETS else ''))
    print(f'cpu_ms: of the process, per reading; load of the machine meanwhile: {load:.2g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
