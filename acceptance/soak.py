"""Soak test of estimator, tracker and fusion over real DDS, with injected faults of all kinds.

    python acceptance/soak.py [--minutes N | --readings N] [--json]

The nodes run in processes of their own, as a user starts them; this one plays sensors and camera,
at 200 and 10 Hz, and listens. Round after round it injects every fault of FAULTS; at the end of a
round the readings rejected, by reason, must be those that were sent to be rejected, and every
other one must have brought one estimate with its stamp, or be counted as lost; the fusion also
withholds a tip that is too uncertain, where it was late and shed frames. All have the time
of a /clock that jumps. In between a recorder runs into a full disk, and sensors and nodes are
interrupted, terminated and killed. Exit code 1 if anything else happens, or if the memory of a
node grows. Run without --minutes it takes 100 000 readings.
"""

from __future__ import annotations

import abc
import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import dataclasses
import json
import math
import os
from pathlib import Path
import resource
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from typing import Any

CHECKOUT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(CHECKOUT), str(CHECKOUT / 'test')]

RATE, IMAGE_RATE = 200.0, 10.0  # Hz
PERIOD_NS, IMAGE_PERIOD_NS = round(1e9 / RATE), round(1e9 / IMAGE_RATE)
CLEAN = 1200  # good readings between the faults of a round, and as many after them
GROWTH_MB = 12.0  # of a node after its first rounds, at most
WARM_ROUNDS = 2  # that are not looked at for memory: caches fill, other models are read
ROOM = 300_000  # bytes that the recorder may write
IMAGES_AT_ONCE = 12
PATIENCE = 20.0  # s; what has not come by then does not come
QOS = [
    option
    for topic in ('pressure', 'end_wrench')
    for policy, value in (('reliability', 'reliable'), ('depth', '5000'))
    for option in ('-p', f'qos_overrides./pneunet/{topic}.subscription.{policy}:={value}')
]


def stamp_of(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 1_000_000_000)


def resident_mb(pid: int) -> float:
    """Memory of a process that is its own and in use."""
    lines = Path(f'/proc/{pid}/status').read_text().splitlines()
    (kilobytes,) = (line.split()[1] for line in lines if line.startswith('RssAnon'))
    return int(kilobytes) / 1024.0


def pressure_message(stamp_ns: int, value: float) -> Any:
    from sensor_msgs.msg import FluidPressure

    message = FluidPressure(fluid_pressure=float(value))
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_of(stamp_ns)
    return message


def wrench_message(stamp_ns: int, force: float = 0.1, frame_id: str = 'pneunet_base') -> Any:
    from geometry_msgs.msg import WrenchStamped

    message = WrenchStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_of(stamp_ns)
    message.header.frame_id = frame_id
    message.wrench.force.x, message.wrench.force.y = force, 0.05
    return message


def reliable() -> Any:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    return QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)


# ---- the nodes under test -----------------------------------------------------------------------


class Subject(abc.ABC):
    """A node in its process, what was sent to it, and what must have come of that."""

    name, answers = '', ''  # of the node, and of the topic that answers every good input

    def __init__(self, folder: Path, domain: int, arguments: list[str]) -> None:
        from sensor_msgs.msg import PointCloud2
        from support.dds_peer import Peer

        self.folder, self.domain, self.arguments = folder, domain, arguments
        self.peer = Peer(domain, self.name, ())
        node = self.peer.node
        node.create_subscription(PointCloud2, self.answers, self.hear, reliable(), raw=True)
        self.faults: list[str] = []  # sentences of what went wrong
        self.memory: list[float] = []  # MB, at the end of every round of this life
        self.growth: list[float] = []  # MB, by life
        self.sent = self.answered = self.lives = 0
        self.rejected: Counter[str] = Counter()  # in all lives
        self.stamp_ns = 1_000_000_000_000
        self.begin()

    def begin(self) -> None:
        """Start the process, and count anew."""
        from support.dds_peer import NodeProcess

        self.lives += 1
        output = self.folder / f'{self.name}_{self.lives}'
        sim_time = '-p', 'use_sim_time:=true'
        self.process = NodeProcess(output, self.domain, *sim_time, *self.arguments, node=self.name)
        self.process.wait_for('ready')
        self.begun = time.monotonic()
        self.expected: Counter[str] = Counter()  # rejections of this life by reason
        self.memory = []
        self.heard: Counter[tuple[int, int]] = Counter()
        self.due: set[tuple[int, int]] = set()  # stamps that must be answered
        self.possible: set[tuple[int, int]] = set()  # those that may be
        self.connect()
        self.values()
        self.expected = self.counted()  # what was rejected while the two sides found each other
        self.lost, self.given_up = self.lost_so_far(), 0

    def hear(self, raw: bytes) -> None:
        """Take a message as bytes: its stamp stands behind the four of the encapsulation."""
        stamp = struct.unpack_from('<iI', raw, 4)
        self.heard[stamp] += 1
        self.answered += 1
        if stamp not in self.due and stamp not in self.possible:
            self.faults.append(f'{self.name} gave an answer with the stamp {stamp}: not to be had')

    def say(self, sentence: str) -> None:
        self.faults.append(f'{self.name}: {sentence}')
        print(self.faults[-1], file=sys.stderr, flush=True)

    @abc.abstractmethod
    def good(self) -> None:
        """Send a good input, which must be answered."""

    @abc.abstractmethod
    def introduce(self) -> None:
        """Send what must be known before a good input is one."""

    def connect(self) -> None:
        """Send good inputs until one is answered: those before may have been lost."""
        end = time.monotonic() + 60.0
        answered = self.answered
        while self.answered == answered:
            if time.monotonic() > end:
                raise SystemExit(f'{self.name} gives no answer: {self.process.text}')
            self.introduce()
            self.good()
            self.possible |= self.due
            self.due.clear()
            self.peer.spin_for(0.05)
        self.peer.barrier()
        self.peer.spin_for(0.1)

    def values(self) -> dict[str, str]:
        """Wait for diagnostics of this node and return their values."""
        self.peer.statuses.clear()

        def of_it() -> list:
            return [s for s in self.peer.statuses if f'/{self.name}:' in s.name]

        assert self.peer.spin_until(of_it), 'no diagnostics'
        self.level = of_it()[-1].level[0]
        return {item.key: item.value for item in of_it()[-1].values}

    def counted(self) -> Counter[str]:
        """Wait for diagnostics and return how many inputs were rejected, by reason."""
        counts: Counter[str] = Counter()
        for key, value in self.values().items():
            kind, _, reason = key.partition('/')
            if kind in ('rejected', 'frames_unused') and reason:
                counts[reason] += int(value)
        return counts

    def lost_so_far(self) -> int:
        """Wait for diagnostics and return how many inputs of this process were never taken."""
        values = self.values()
        topics = [out.topic_name for out in self.publishers.values()]
        return sum(int(values.get(f'lost{topic}', 0)) for topic in topics)

    def give_up(self) -> None:
        """Wait no longer for what was not answered: it was too much at once."""
        gone = self.due - self.heard.keys()
        self.given_up += len(gone)
        self.due -= gone

    def all_counted(self) -> Counter[str]:
        """Wait until all that was sent to be rejected is counted; returns what is."""
        end = time.monotonic() + PATIENCE
        while (found := self.counted()) != self.expected and time.monotonic() < end:
            pass
        return found

    def drain(self) -> None:
        """Wait until all that was sent has been taken: a last good input is answered."""
        self.good()
        self.peer.spin_until(lambda: self.due <= self.heard.keys(), PATIENCE)
        self.peer.barrier()

    def reconcile(self) -> None:
        """Compare what came, and what was counted, with what was sent."""
        self.drain()
        missing, lost = len(self.due - self.heard.keys()), self.lost_so_far() - self.lost
        if missing > self.withheld():
            shed = self.values().get('frames_shed', '0')
            self.say(
                f'{missing} of {len(self.due)} good inputs were not answered; '
                f'{shed} frames were shed so far'
            )
        if lost != self.given_up:
            self.say(f'{lost} counted as lost, but {self.given_up} were')
        self.lost, self.given_up = self.lost + lost, 0
        twice = [stamp for stamp, count in self.heard.items() if count > 1]
        if twice:
            self.say(f'{len(twice)} answered more than once')
        found = self.all_counted()
        if found != self.expected:
            self.say(f'rejected {dict(found)}, but sent to be were {dict(self.expected)}')
            self.expected = found
        # Only the last ones can still come: the others need not be remembered.
        self.possible = {max(self.due | self.possible)}
        self.heard.clear()
        self.due.clear()
        self.memory.append(resident_mb(self.process.process.pid))

    def withheld(self) -> int:
        """Return how many good inputs were rightly not answered since the last comparison."""
        return 0

    def expect(self, reason: str, count: int = 1) -> None:
        """Note that so many were sent to be rejected."""
        self.expected[reason] += count
        self.rejected[reason] += count

    def send_pressure(self, stamp_ns: int, value: float, reason: str) -> None:
        """Send a pressure; reason: why it is rejected, empty where it must be answered."""
        self.sent += 1
        if reason:
            self.expect(reason)
        else:
            self.due.add(stamp_of(stamp_ns))
        self.publishers['pressure'].publish(pressure_message(stamp_ns, value))

    def end(self, number: int) -> None:
        """End its process by a signal, in the middle of things."""
        kept = self.memory[WARM_ROUNDS:]
        if len(kept) > 1:
            half = max(len(kept) // 4, 1)
            self.growth.append(statistics.median(kept[-half:]) - statistics.median(kept[:half]))
            if self.growth[-1] > GROWTH_MB:
                self.say(f'its memory grew by {self.growth[-1]:.1f} MB')
        code = self.process.end(number)
        if code != (-number if number == signal.SIGKILL else 0):
            self.say(f'ended with {code} at signal {number}')
        self.peer.spin_for(0.3)
        if 'Traceback' in self.process.text:
            self.say(f'traceback: {self.process.text[-2000:]}')

    def process_minutes(self) -> float:
        """Return for how long its process has been ready."""
        return (time.monotonic() - self.begun) / 60.0

    def check_alive(self) -> None:
        if self.process.process.poll() is not None:
            raise SystemExit(f'{self.name} has crashed: {self.process.text}')


class Estimator(Subject):
    """The estimator, its pressure and its end wrench."""

    name, answers = 'estimator', 'shape'

    def __init__(self, folder: Path, domain: int) -> None:
        from pneunet_ros.core.share import share_path
        from pneunet_ros.files.model_file import load_model, save_model

        self.model = folder / 'model.yaml'
        self.arm = load_model(share_path('config/paper_arm.yaml'))
        save_model(self.arm, self.model)
        self.publishers: dict[str, Any] = {}
        self.clock: Any = None  # publisher
        super().__init__(folder, domain, [*QOS, '-p', f'model_file:={self.model}'])

    def begin(self) -> None:
        if not self.publishers:
            self.advertise('pressure')
            self.advertise('end_wrench')
        super().begin()

    def advertise(self, topic: str) -> None:
        """Create a publisher, in place of the one there may be."""
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import FluidPressure

        if topic in self.publishers:
            self.peer.node.destroy_publisher(self.publishers[topic])
        kind = FluidPressure if topic == 'pressure' else WrenchStamped
        self.publishers[topic] = self.peer.node.create_publisher(kind, topic, reliable())

    def wrench(self, stamp_ns: int, force: float = 0.1, frame_id: str = 'pneunet_base') -> None:
        self.publishers['end_wrench'].publish(wrench_message(stamp_ns, force, frame_id))

    def pressure(self, stamp_ns: int, value: float | None = None, reason: str = '') -> None:
        """Send a pressure that must be answered, or is rejected for a reason."""
        self.send_pressure(
            stamp_ns, 30e3 + 20e3 * math.sin(1e-9 * stamp_ns) if value is None else value, reason
        )

    def introduce(self) -> None:
        """Nothing: a reading stands for itself."""

    def good(self) -> None:
        self.stamp_ns += PERIOD_NS
        self.wrench(self.stamp_ns, 0.1 + 0.05 * math.sin(3e-9 * self.stamp_ns))
        self.pressure(self.stamp_ns)

    def feed(self, count: int, each: Callable[[int], None] = lambda index: None) -> None:
        """Send good readings at the rate."""
        begin = time.perf_counter()
        for index in range(count):
            while (left := begin + index / RATE - time.perf_counter()) > 0.0:
                self.peer.executor.spin_once(timeout_sec=left)
            self.good()
            each(index)

    def settled(self) -> None:
        """Send a wrench and, when all is taken, a pressure: the order no longer matters."""
        self.stamp_ns += PERIOD_NS
        self.peer.barrier()
        self.wrench(self.stamp_ns)
        self.peer.barrier()
        self.pressure(self.stamp_ns)


class Tracker(Subject):
    """The tracker and its camera, which looks at a drawn arm."""

    name, answers = 'tracker', 'targets'

    def __init__(self, folder: Path, domain: int) -> None:
        from pneunet_ros.core.share import share_path
        from pneunet_ros.files.camera_file import load_camera
        from pneunet_ros.files.model_file import load_model
        from pneunet_ros.nodes.tracker.warm_up import drawn_arm

        arm = load_model(share_path('config/paper_arm.yaml'))
        settings = load_camera(share_path('config/camera.yaml'))
        self.image, self.lens = drawn_arm(arm.target_arclength, settings)
        self.publishers: dict[str, Any] = {}
        super().__init__(folder, domain, [])

    def begin(self) -> None:
        from sensor_msgs.msg import CameraInfo, Image

        if not self.publishers:
            for topic, kind in (('image_raw', Image), ('camera_info', CameraInfo)):
                self.publishers[topic] = self.peer.node.create_publisher(kind, topic, 10)
        super().begin()

    def picture(self, stamp_ns: int, reason: str = '', **changes: Any) -> None:
        """Send an image that must be answered, or is rejected for a reason."""
        from array import array

        from sensor_msgs.msg import Image

        self.sent += 1
        if reason:
            self.expect(reason)
        else:
            self.due.add(stamp_of(stamp_ns))
        fields = {
            name: getattr(self.image, name) for name in ('width', 'height', 'step', 'encoding')
        }
        fields['data'] = array('B', self.image.data.tobytes())
        message = Image(**fields | changes)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp_of(stamp_ns)
        message.header.frame_id = 'camera'
        self.publishers['image_raw'].publish(message)

    def introduce(self) -> None:
        from sensor_msgs.msg import CameraInfo

        info = CameraInfo(
            width=self.lens.width,
            height=self.lens.height,
            distortion_model=self.lens.model,
            k=self.lens.matrix.ravel(),
            d=self.lens.distortion.tolist(),
        )
        self.publishers['camera_info'].publish(info)
        self.peer.barrier()

    def good(self) -> None:
        self.stamp_ns += IMAGE_PERIOD_NS
        self.picture(self.stamp_ns)


class Fusion(Subject):
    """The fusion, its pressure and its targets; nothing pushes at the arm, and nothing is read."""

    name, answers = 'fusion', 'fused/shape'
    inputs = 'fusion_sensors'  # the namespace of its own ones

    def __init__(self, folder: Path, domain: int) -> None:
        import numpy as np
        from pneunet_ros import solve
        from pneunet_ros.core.share import share_path
        from pneunet_ros.files.model_file import load_model

        model = share_path('config/lab_arm.yaml')
        arm = load_model(model)
        shape = solve(arm, 30e3)
        self.x, self.y = (
            np.interp(arm.target_arclength, shape.arclength, side) for side in (shape.x, shape.y)
        )
        self.publishers: dict[str, Any] = {}
        arguments = ['-p', f'model_file:={model}', '-p', 'use_wrench:=false']
        for topic in ('pressure', 'targets'):
            own = f'/pneunet/{self.inputs}/{topic}'
            arguments += ['-r', f'{topic}:={own}']
            for policy, value in (('reliability', 'reliable'), ('depth', '5000')):
                arguments += ['-p', f'qos_overrides.{own}.subscription.{policy}:={value}']
        super().__init__(folder, domain, arguments)

    def begin(self) -> None:
        from sensor_msgs.msg import FluidPressure, PointCloud2

        if not self.publishers:
            for topic, kind in (('pressure', FluidPressure), ('targets', PointCloud2)):
                self.publishers[topic] = self.peer.node.create_publisher(
                    kind, f'{self.inputs}/{topic}', reliable()
                )
        self.uncertain, self.blind = 0, (0, 0)  # readings; and frames shed, when last compared
        super().begin()

    def frame(
        self, stamp_ns: int, x: Any = None, y: Any = None, reason: str = '', frame_id: str = ''
    ) -> None:
        """Send a frame of targets, which is used, or is not for a reason."""
        from pneunet_ros.messages.readings import targets_message
        from pneunet_ros.nodes.ros_types import RCLPY_TYPES

        if reason:
            self.expect(reason)
        x, y = self.x if x is None else x, self.y if y is None else y
        frame_id = frame_id or 'pneunet_base'
        self.publishers['targets'].publish(targets_message(stamp_ns, x, y, frame_id, RCLPY_TYPES))

    def pressure(self, stamp_ns: int, value: float = 30e3, reason: str = '') -> None:
        """Send a pressure that must be answered, or is rejected for a reason."""
        self.send_pressure(stamp_ns, value, reason)

    def counted(self) -> Counter[str]:
        """Return how many inputs were rejected, but for readings of a tip that is not known."""
        counts = super().counted()
        self.uncertain = counts.pop('too_uncertain', 0)
        return counts

    def withheld(self) -> int:
        """Return the readings since the last comparison whose frames were shed by a late node."""
        self.counted()
        shed, before = int(self.values()['frames_shed']), self.blind
        self.blind = self.uncertain, shed
        return self.uncertain - before[0] if shed > before[1] else 0

    def introduce(self) -> None:
        """Show a frame, and wait until it is there: without one the tip is not known."""
        self.stamp_ns += IMAGE_PERIOD_NS
        self.frame(self.stamp_ns)
        self.peer.barrier()

    def good(self) -> None:
        self.stamp_ns += IMAGE_PERIOD_NS
        self.frame(self.stamp_ns)
        self.pressure(self.stamp_ns)


# ---- faults -------------------------------------------------------------------------------------


def not_a_number(one: Estimator) -> None:
    for value in (math.nan, math.inf, -math.inf):
        one.pressure(one.stamp_ns + PERIOD_NS // 2, value, 'not_finite')
        one.wrench(one.stamp_ns + PERIOD_NS // 2, value)
        one.expect('not_finite')


def bad_stamps(one: Estimator) -> None:
    one.pressure(one.stamp_ns, reason='duplicate')
    one.pressure(one.stamp_ns - 300_000_000, reason='older')
    one.pressure(0, reason='no_stamp')
    message = pressure_message(one.stamp_ns, 30e3)
    message.header.stamp.nanosec = 4_000_000_000
    one.publishers['pressure'].publish(message)
    one.expect('unreadable')
    one.wrench(one.stamp_ns)
    one.expect('duplicate')


def out_of_range(one: Estimator) -> None:
    one.drain()
    for value in (-40e3, 80e3, 131e3):
        one.stamp_ns += PERIOD_NS
        one.pressure(one.stamp_ns, value, 'out_of_range')
    one.stamp_ns += PERIOD_NS
    one.pressure(one.stamp_ns, 1e300, 'not_finite')  # its square is not


def burst(one: Estimator) -> None:
    one.drain()
    for _ in range(90):  # of less than wrench_timeout: the wrenches are taken first
        one.good()


def gap(one: Estimator) -> None:
    one.drain()
    one.peer.spin_for(0.8)
    one.stamp_ns += 800_000_000
    one.settled()


def stale_wrench(one: Estimator) -> None:
    one.drain()
    one.stamp_ns += 700_000_000
    for _ in range(5):
        one.stamp_ns += PERIOD_NS
        one.pressure(one.stamp_ns, reason='stale_wrench')
    one.all_counted()  # before there is a wrench with which they could be used
    one.settled()


def wrong_frame(one: Estimator) -> None:
    one.wrench(one.stamp_ns + PERIOD_NS // 2, frame_id='tool0')
    one.expect('wrong_frame')


def clock_back(one: Estimator) -> None:
    one.drain()
    one.stamp_ns -= 3_000_000_000
    one.heard.clear()
    one.possible |= one.due
    one.due.clear()
    one.settled()


def parameters(one: Estimator) -> None:
    one.drain()
    for changes in (
        {'centerline_rate': 10.0},
        {'wrench_timeout': 0.4},
        {'wrench_timeout': 0.5, 'centerline_rate': 30.0},
        {'pressure_offset': 50.0},
        {'pressure_offset': 0.0},
        {'wrench_sign': -1},
        {'wrench_sign': 1},
    ):
        if not one.peer.set(**changes).successful:
            one.say(f'{changes} was refused')
        one.settled()
    for unfit in ({'wrench_timeout': -1.0}, {'model_file': '/nowhere.yaml'}, {'stations': 3}):
        if one.peer.set(**unfit).successful:
            one.say(f'{unfit} was taken')
    one.settled()


def model_reload(one: Estimator) -> None:
    from pneunet_ros.files.model_file import save_model

    one.drain()
    one.model.write_text('name: [half a mod')
    if one.peer.trigger('reload_model').success:
        one.say('a broken model was taken')
    save_model(dataclasses.replace(one.arm, length=0.113), one.model, overwrite=True)
    if not one.peer.trigger('reload_model').success:
        one.say('a good model was refused')
    one.settled()


def reset(one: Estimator) -> None:
    one.drain()
    one.peer.trigger('reset')
    one.settled()


def publisher_restart(one: Estimator) -> None:
    for topic in ('pressure', 'end_wrench'):
        one.drain()
        one.advertise(topic)
        one.connect()
    one.peer.spin_for(0.2)


def full_disk(one: Estimator) -> None:
    """Let a recorder of the shapes run out of room: one sentence, and nothing is left."""
    folder = one.folder / 'recorder'
    folder.mkdir(exist_ok=True)
    with child('--recorder', folder, domain=one.domain) as recorder:
        end = time.monotonic() + 90.0
        while recorder.poll() is None and time.monotonic() < end:
            one.feed(20)
        said = recorder.communicate(timeout=30)[0]
    if 'cannot be written: File too large' not in said:
        one.say(f'the recorder said {said!r}')
    if list(folder.iterdir()):
        one.say('the recorder left something behind')


def sensors_killed(one: Estimator) -> None:
    """Sensors of another process die in the middle of a word: no more estimates, and an error."""
    one.drain()
    start = one.stamp_ns + 10 * PERIOD_NS
    one.possible |= {stamp_of(start + index * PERIOD_NS) for index in range(200 * 120)}
    answered = one.answered
    with child('--sensors', str(start), domain=one.domain) as sensors:
        if not one.peer.spin_until(lambda: one.answered > answered + 200, 90.0):
            one.say('sensors in another process were not heard')
        sensors.kill()
    one.peer.spin_for(0.5)
    answered = one.answered
    one.peer.spin_for(1.0)
    one.values()
    if one.answered > answered:
        one.say('estimates without sensors')
    if one.level != 2:
        one.say(f'level {one.level} without sensors')
    one.stamp_ns = start + 200 * 120 * PERIOD_NS
    one.settled()
    one.possible.clear()


def rivals(one: Estimator) -> None:
    """Add two more publishers of the pressure: they are named as long as they are there."""
    from sensor_msgs.msg import FluidPressure

    one.drain()
    others = [one.peer.node.create_publisher(FluidPressure, 'pressure', 10) for _ in range(2)]
    if not seen_in(one, 'rivals', '/pneunet/pressure has 3 publishers'):
        one.say('rivals were not named')
    for other in others:
        one.peer.node.destroy_publisher(other)
    if not seen_in(one, 'rivals', ''):
        one.say('rivals are still named')
    one.settled()


def mismatched(one: Estimator) -> None:
    """Add a publisher that offers less than is wanted: it is named as long as it is there."""
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import FluidPressure

    one.drain()
    other = one.peer.node.create_publisher(FluidPressure, 'pressure', qos_profile_sensor_data)
    if not seen_in(one, 'mismatched', 'cannot be received'):
        one.say('a publisher that cannot be heard was not named')
    one.peer.node.destroy_publisher(other)
    if not seen_in(one, 'mismatched', ''):
        one.say('a publisher that is gone is still named')
    one.settled()


def clock_jumps(one: Estimator) -> None:
    """Let the time of ROS jump forward, back and to zero: one sentence, and all goes on."""
    from rosgraph_msgs.msg import Clock

    one.drain()
    if one.clock is None:
        one.clock = one.peer.node.create_publisher(Clock, '/clock', 10)
    for seconds in (5000, 5001, 9000, 1400, 0, 2, 5000):
        for _ in range(3):
            message = Clock()
            message.clock.sec = seconds
            one.clock.publish(message)
            one.peer.spin_for(0.05)
        one.settled()
    one.drain()
    sentences = one.process.text.count('/clock jumped')
    if not 1 <= sentences <= 2 + one.process_minutes():
        one.say(f'{sentences} sentences on /clock')


def seen_in(one: Estimator, key: str, words: str) -> bool:
    """Wait until a value of the diagnostics has these words, or is empty for none."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        value = one.values()[key]
        if words in value and bool(words) == bool(value):
            return True
    return False


FAULTS: tuple[Callable[[Estimator], None], ...] = (
    not_a_number,
    bad_stamps,
    out_of_range,
    burst,
    gap,
    stale_wrench,
    wrong_frame,
    clock_back,
    parameters,
    model_reload,
    reset,
    rivals,
    mismatched,
    clock_jumps,
    publisher_restart,
)
RARE = (full_disk, sensors_killed)  # take long: not in every round


def bad_pictures(one: Tracker) -> None:
    """Images that are cut off, of no known kind, without stamp, twice, late, and dark."""
    from array import array

    one.drain()  # fewer at once than wait for their turn: none is lost
    one.picture(one.stamp_ns, 'unreadable', data=array('B', [1, 2, 3]))
    one.picture(one.stamp_ns, 'unreadable', encoding='16UC1')
    one.picture(one.stamp_ns, 'unreadable', width=0)
    one.picture(one.stamp_ns, 'unreadable', step=1)
    one.drain()
    one.picture(0, 'no_stamp')
    one.picture(one.stamp_ns, 'duplicate')
    one.picture(one.stamp_ns - 300_000_000, 'older')
    one.drain()
    one.stamp_ns += IMAGE_PERIOD_NS
    one.picture(one.stamp_ns, data=array('B', bytes(one.image.data.size)))
    if not one.peer.trigger('reload_model').success:
        one.say('its files could not be read again')
    one.good()


def burst_of_pictures(one: Tracker) -> None:
    """More images at once than wait for their turn: the oldest are left out, and are counted."""
    one.drain()
    for _ in range(IMAGES_AT_ONCE):
        one.good()
    one.peer.barrier()
    one.peer.spin_for(0.2)
    one.give_up()


def bad_frames(one: Fusion) -> None:
    """Frames that are empty, of another number, in another frame, twice, late, and swapped."""
    one.drain()
    nothing = one.x * math.nan
    two = one.x.copy()
    two[2:] = math.nan
    for x, reason in ((nothing, 'not_seen'), (two, 'too_few_targets')):
        one.stamp_ns += IMAGE_PERIOD_NS
        one.frame(one.stamp_ns, x, x + one.y, reason)
        one.peer.barrier()
        one.pressure(one.stamp_ns)
    one.frame(one.stamp_ns + 1, one.x[1:], one.y[1:], 'unreadable')
    one.frame(one.stamp_ns + 1, frame_id='camera', reason='unreadable')
    one.frame(one.stamp_ns, reason='duplicate')
    one.frame(one.stamp_ns - 300_000_000, reason='older')
    one.frame(0, reason='no_stamp')
    one.pressure(one.stamp_ns + 1, math.nan, 'not_finite')
    one.drain()
    one.stamp_ns += IMAGE_PERIOD_NS
    one.pressure(one.stamp_ns, 131e3, 'out_of_range')
    one.stamp_ns += IMAGE_PERIOD_NS
    swapped = slice(11, 9, -1)
    x, y = one.x.copy(), one.y.copy()
    x[10:12], y[10:12] = x[swapped], y[swapped]
    one.frame(one.stamp_ns, x, y)
    one.pressure(one.stamp_ns)
    if not one.peer.trigger('reload_model').success:
        one.say('its model could not be read again')
    one.introduce()
    one.good()


# ---- processes beside the nodes -----------------------------------------------------------------


@contextmanager
def child(*arguments: Any, domain: int) -> Iterator[subprocess.Popen[str]]:
    """Run this file in another role, which is gone afterwards in any case."""
    process = subprocess.Popen(
        [sys.executable, __file__, *map(str, arguments)],
        env=os.environ | {'ROS_DOMAIN_ID': str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def recorder(folder: Path) -> None:
    """Record the shapes where there is room for few of them, until an error ends it."""
    from pneunet_ros.core.errors import RecordingError
    from pneunet_ros.recordings.recording_writer import write_recording
    import rclpy
    from sensor_msgs.msg import PointCloud2

    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))
    rclpy.init()
    node = rclpy.create_node('recorder', namespace='/pneunet')
    heard: list[bytes] = []
    node.create_subscription(PointCloud2, 'shape', heard.append, reliable(), raw=True)
    try:
        with write_recording(folder / 'shapes.mcap') as writer:
            topic = writer.add('/pneunet/shape', 'sensor_msgs/msg/PointCloud2')
            while True:
                rclpy.spin_once(node, timeout_sec=0.1)
                while heard:
                    writer.write_raw(topic, time.time_ns(), bytes(heard.pop()))
    except RecordingError as error:
        print(error)
    rclpy.shutdown()


def sensors(start_ns: int) -> None:
    """Send good readings at the rate, for ever."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from sensor_msgs.msg import FluidPressure

    rclpy.init()
    node = rclpy.create_node('sensors', namespace='/pneunet')
    wrenches = node.create_publisher(WrenchStamped, 'end_wrench', reliable())
    pressures = node.create_publisher(FluidPressure, 'pressure', reliable())
    begin = time.perf_counter()
    for index in range(200 * 120):
        time.sleep(max(begin + index / RATE - time.perf_counter(), 0.0))
        stamp_ns = start_ns + index * PERIOD_NS
        wrenches.publish(wrench_message(stamp_ns))
        pressures.publish(pressure_message(stamp_ns, 30e3))


# ---- the run ------------------------------------------------------------------------------------


def soak(folder: Path, seconds: float, readings: float) -> dict[str, Any]:
    """Run until the time is over or enough was sent; returns what there is to say."""
    domain = int(os.environ['ROS_DOMAIN_ID'])
    one, camera, fused = (kind(folder, domain) for kind in (Estimator, Tracker, Fusion))
    subjects = one, camera, fused
    begin = time.monotonic()
    injected: Counter[str] = Counter()

    def enough(share: float = 1.0) -> bool:
        return time.monotonic() - begin > share * seconds or one.sent >= share * readings

    def attempt(fault: Callable[[Any], None], subject: Subject) -> None:
        injected[fault.__name__] += 1
        fault(subject)

    def show(index: int) -> None:
        if index % round(RATE / IMAGE_RATE) == 0:
            camera.good()
            fused.good()

    rounds = 0
    ending = iter((signal.SIGINT, signal.SIGTERM, signal.SIGKILL))
    try:
        while True:
            for fault in FAULTS:
                one.feed(CLEAN // len(FAULTS))
                attempt(fault, one)
                one.check_alive()
            attempt(bad_pictures, camera)
            attempt(burst_of_pictures, camera)
            attempt(bad_frames, fused)
            one.feed(CLEAN, show)
            if rounds % 10 == 1:
                for fault in RARE:
                    attempt(fault, one)
            for subject in subjects:
                subject.check_alive()
                subject.reconcile()
            rounds += 1
            wrong = sum(len(subject.faults) for subject in subjects)
            print(f'round {rounds}: {one.sent} sent, {wrong} wrong', file=sys.stderr, flush=True)
            if enough(0.7) and rounds > WARM_ROUNDS:
                number = next(ending, None)
                if number is None:
                    if enough():
                        break
                    continue
                for subject in subjects:
                    subject.good()
                    subject.end(number)
                    subject.begin()
                    injected[f'{subject.name} {signal.Signals(number).name}'] += 1
        for subject in subjects:
            subject.end(signal.SIGINT)
    except KeyboardInterrupt:
        one.faults.append('interrupted: what was in the air is not counted')
    finally:
        for subject in subjects:
            if subject.process.process.poll() is None:
                subject.process.process.kill()
            subject.peer.close()
    return {
        'minutes': (time.monotonic() - begin) / 60.0,
        'rounds': rounds,
        'injected': dict(injected),
        **{
            subject.name: {
                'sent': subject.sent,
                'answered': subject.answered,
                'rejected': dict(subject.rejected),
                'lives': subject.lives,
                'growth_mb': [round(growth, 2) for growth in subject.growth],
            }
            for subject in subjects
        },
        'faults': [fault for subject in subjects for fault in subject.faults],
    }


def show_table(found: dict[str, Any]) -> None:
    print(f'{found["minutes"]:.1f} minutes, {found["rounds"]} rounds')
    for name in ('estimator', 'tracker', 'fusion'):
        of_it = found[name]
        print(
            f'{name}: {of_it["sent"]} sent, {of_it["answered"]} answered, {of_it["lives"]} lives, '
            f'memory grew by {of_it["growth_mb"]} MB'
        )
        for reason, count in sorted(of_it['rejected'].items()):
            print(f'    rejected, as was to be: {reason:16}{count:8}')
    for name, count in found['injected'].items():
        print(f'    injected: {name:30}{count:8}')
    for sentence in found['faults'] or ['nothing went wrong']:
        print(sentence)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=float, help='duration')
    parser.add_argument('--readings', type=int, help='or number of pressures to send')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    parser.add_argument('--recorder', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('--sensors', type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 101 + 1))
    if options.recorder:
        recorder(options.recorder)
        return 0
    if options.sensors is not None:
        sensors(options.sensors)
        return 0
    readings = options.readings or (math.inf if options.minutes else 100_000)
    with tempfile.TemporaryDirectory() as folder:
        os.environ['ROS_LOG_DIR'] = folder
        found = soak(Path(folder), 60.0 * (options.minutes or math.inf), readings)
    if options.json:
        print(json.dumps(found))
    else:
        show_table(found)
    return 1 if found['faults'] else 0


if __name__ == '__main__':
    sys.exit(main())
