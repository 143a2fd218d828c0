"""A node in a process of its own, and a peer that plays its sensors and hears all it says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from pneunet_ros.messages.builders import IMAGE_TYPE, nanoseconds, Output
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, TARGETS
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE, TRACKER_OUTPUTS
from pneunet_ros.nodes.ros_types import message_class
from pneunet_ros.nodes.tracker.health import IMAGE_TIMEOUT
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import FluidPressure, Imu
from std_msgs.msg import String
from std_srvs.srv import Trigger

NAMESPACE = '/pneunet'
START_TIMEOUT = 240.0  # s; the kernels may have to be compiled
TIMEOUT = 180.0  # s; nothing takes that long, but a machine may be busy
ASK_AGAIN = 10.0  # s; longer than a node is busy with a request
IDLE_SPINS = 5  # looks around that find nothing, until all that has come was taken
MOST_SPINS = 200
DEPTH = 1000  # of what is heard: nothing is lost while this process waits for its turn
NANOSECONDS = 1_000_000_000
END_FORCE = 'fused/end_force'


class NodeProcess:
    """A node started as by a user; what it writes goes to a file."""

    def __init__(
        self,
        output: Path,
        domain: int,
        *arguments: str,
        node: str,
        positional: Sequence[str] = (),
        code: str = '',
    ) -> None:
        self.output = output
        environment = os.environ | {'ROS_DOMAIN_ID': str(domain), 'PYTHONFAULTHANDLER': '1'}
        program = ['-c', code] if code else ['-m', f'pneunet_ros.nodes.{node}']
        command = [sys.executable, *program, *positional, '--ros-args']
        with output.open('w') as stream:
            self.process = subprocess.Popen(
                [*command, '-r', f'__ns:={NAMESPACE}', *arguments],
                env=environment,
                stdout=stream,
                stderr=stream,
            )

    @property
    def text(self) -> str:
        """All it has written so far."""
        return self.output.read_text()

    def wait_for(self, words: str) -> None:
        """Wait until it has written something."""
        end = time.monotonic() + START_TIMEOUT
        while words not in self.text:
            assert self.process.poll() is None, self.text
            assert time.monotonic() < end, self.text
            time.sleep(0.02)

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(TIMEOUT)


@contextmanager
def running_node(
    output: Path,
    domain: int,
    *arguments: str,
    node: str = 'estimator',
    positional: Sequence[str] = (),
    code: str = '',
) -> Iterator[NodeProcess]:
    """Run a node that is gone afterwards in any case; code: of Python, instead of its module."""
    started = NodeProcess(output, domain, *arguments, node=node, positional=positional, code=code)
    try:
        yield started
    finally:
        if started.process.poll() is None:
            started.process.kill()
            started.process.wait()


class Peer:
    """Listener and operator at the other end of DDS; sensors are added by those who derive."""

    def __init__(self, domain: int, name: str, outputs: tuple[Output[Any], ...]) -> None:
        self.name = name
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('peer', namespace=NAMESPACE, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.received: dict[str, list[Any]] = {output.name: [] for output in outputs}
        self.statuses: list[DiagnosticStatus] = []
        self.reported: int | None = None  # statuses told of by `report` since the start anew
        self.clients: dict[str, Any] = {}
        for output in outputs:
            take = self.received[output.name].append
            self.node.create_subscription(message_class(output.type), output.name, take, DEPTH)
        self.node.create_subscription(
            DiagnosticArray,
            '/diagnostics',
            lambda array: self.statuses.extend(array.status),
            DEPTH,
        )

    def close(self) -> None:
        """Leave DDS."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin_until(self, condition: Callable[[], Any], timeout: float = TIMEOUT) -> bool:
        """Let callbacks run until a condition holds; whether it does."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def spin_for(self, seconds: float) -> None:
        """Let callbacks run for some time."""
        self.spin_until(lambda: False, seconds)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service of the node and return its answer.

        A request that is sent before DDS has found a node that was started anew is lost, and one
        that was killed is taken to be there for a while: it is sent again.
        """
        if name not in self.clients:
            self.clients[name] = self.node.create_client(kind, f'{self.name}/{name}')
            assert self.clients[name].wait_for_service(START_TIMEOUT), name
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            future = self.clients[name].call_async(request)
            if self.spin_until(future.done, ASK_AGAIN):
                return future.result()
            self.clients[name].remove_pending_request(future)
        raise AssertionError(name)

    def trigger(self, name: str) -> Trigger.Response:
        """Call a Trigger service."""
        return self.call(Trigger, name, Trigger.Request())

    def barrier(self) -> None:
        """Wait until the node has taken all that was published.

        It serves readings before requests, but one that arrives while it looks around may slip
        through: not past two requests.
        """
        for _ in range(2):
            self.call(GetParameters, 'get_parameters', GetParameters.Request())

    def set(self, **values: Any) -> Any:
        """Set parameters of the node, all or none."""
        items = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=items)
        return self.call(SetParametersAtomically, 'set_parameters_atomically', request).result

    def get(self, name: str) -> Any:
        """Value of a parameter of the node."""
        request = GetParameters.Request(names=[name])
        (value,) = self.call(GetParameters, 'get_parameters', request).values
        return parameter_value_to_python(value)

    def outputs(self) -> dict[str, int]:
        """How many messages of each output have come."""
        return {name: len(messages) for name, messages in self.received.items()}

    def start_anew(self) -> None:
        """Make the node and this peer forget all that came before."""
        self.barrier()
        assert self.trigger('reset').success
        self.take_all()
        self.reported = None
        for messages in self.received.values():
            messages.clear()

    def take_all(self) -> None:
        """Take what the node sent before its last answer: that is here, but one takes one a time.

        However slow the machine is: not time counts, but that there is nothing to take. A node
        that sends without being asked has always more.
        """
        idle = 0
        for _ in range(MOST_SPINS):
            if idle == IDLE_SPINS:
                break
            before = self.outputs(), len(self.statuses)
            self.executor.spin_once(timeout_sec=0.01)
            idle = idle + 1 if (self.outputs(), len(self.statuses)) == before else 0

    def report(self) -> tuple[int, str, dict[str, str]]:
        """Wait for the next diagnostics and return the worst level, all messages, last values.

        All are those since the last report of this test: what happened in between may have been
        told of in two of them. The first report of a test is of the last diagnostics alone.
        """
        self.take_all()
        known = len(self.statuses)
        assert self.spin_until(lambda: len(self.statuses) > known)
        new = (
            self.statuses[-1:]
            if self.reported is None
            else self.statuses[min(self.reported, known) :]
        )
        self.reported = len(self.statuses)
        new = self.asked_about(new)
        values = {item.key: item.value for item in new[-1].values}
        level = max(status.level[0] for status in new)
        return level, '; '.join(status.message for status in new), values

    def asked_about(self, statuses: list[Any]) -> list[Any]:
        """Return the statuses that a test is about, at least one."""
        return statuses

    def model_info(self) -> str:
        """Subscribe late to model_info and return what comes."""
        said: list[str] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        late = self.node.create_subscription(
            String, 'model_info', lambda message: said.append(message.data), latched
        )
        assert self.spin_until(lambda: said)
        self.node.destroy_subscription(late)
        return said[-1]


class EstimatorPeer(Peer):
    """The sensors of the estimator."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'estimator', OUTPUTS)
        self.pressures = self.node.create_publisher(FluidPressure, 'pressure', 10)
        self.wrenches = self.node.create_publisher(WrenchStamped, 'end_wrench', 10)
        self.imus = self.node.create_publisher(Imu, 'base_imu', 10)

    def wrench(self, seconds: float, force_x: float = 0.1, frame_id: str = 'pneunet_base') -> None:
        """Publish an end wrench stamped so."""
        message = WrenchStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp(seconds)
        message.header.frame_id = frame_id
        message.wrench.force.x, message.wrench.force.y = force_x, 0.05
        self.wrenches.publish(message)

    def pressure(self, seconds: float, value: float = 30e3) -> None:
        """Publish a pressure stamped so."""
        message = FluidPressure(fluid_pressure=value)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp(seconds)
        self.pressures.publish(message)

    def send(self, seconds: float, value: float = 30e3) -> None:
        """Publish a wrench and, when it is taken, a pressure."""
        self.wrench(seconds)
        self.barrier()
        self.pressure(seconds, value)

    def connect(self) -> None:
        """Wait until every reading sent brings every output.

        A publisher that has its subscriber may still not be heard by it, so readings are sent
        until all is heard; then the node starts anew.
        """
        self.barrier()
        begin = time.monotonic()
        while not all(self.outputs().values()):
            assert time.monotonic() - begin < START_TIMEOUT, self.outputs()
            self.send(10_000.0 + time.monotonic() - begin)
            self.spin_for(0.05)
        self.start_anew()


class SensorsPeer(Peer):
    """All sensors; messages are given as bytes, so that they are those of a file."""

    def __init__(self, domain: int, name: str, outputs: tuple[Output[Any], ...]) -> None:
        super().__init__(domain, name, outputs)
        self.sensors = {
            sensor.name: self.node.create_publisher(message_class(sensor.type), sensor.name, DEPTH)
            for sensor in (PRESSURE, TARGETS, END_WRENCH)
        }

    def connect(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Play messages, (sensor, bytes), until every output is heard; then start anew."""
        self.barrier()
        begin = time.monotonic()
        while not all(self.outputs().values()):
            assert time.monotonic() - begin < START_TIMEOUT, self.outputs()
            self.trigger('reset')
            for name, raw in messages:
                self.sensors[name].publish(raw)
                self.barrier()
        self.start_anew()


class FusionPeer(SensorsPeer):
    """The sensors of the fusion."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'fusion', FUSION_OUTPUTS)

    def modes(self) -> list[tuple[int, int]]:
        """Return mode and stamp (ns) of every fused estimate that was heard."""
        return [
            (int(cloud_points(cloud)['mode'][0]), nanoseconds(cloud.header.stamp))
            for cloud in self.received[END_FORCE]
        ]


class CameraPeer(Peer):
    """The camera of the tracker; messages are given as bytes, so that they are those of a file."""

    def __init__(self, domain: int, kind: str) -> None:
        super().__init__(domain, 'tracker', TRACKER_OUTPUTS)
        self.kind = kind
        self.topic = 'image_raw' if kind == IMAGE_TYPE else 'image_raw/compressed'
        self.images = self.advertise(10)
        self.infos = self.node.create_publisher(message_class(CAMERA_INFO_TYPE), 'camera_info', 10)

    def advertise(self, qos: QoSProfile | int) -> Any:
        """Create a publisher of images of some quality of service."""
        return self.node.create_publisher(message_class(self.kind), self.topic, qos)

    def taken_as(self) -> list[tuple[ReliabilityPolicy, DurabilityPolicy]]:
        """Return how the images are subscribed to."""
        name = self.node.resolve_topic_name(self.topic)
        profiles = [found.qos_profile for found in self.node.get_subscriptions_info_by_topic(name)]
        return [(profile.reliability, profile.durability) for profile in profiles]

    def asked_about(self, statuses: list[Any]) -> list[Any]:
        """Leave out statuses of a silence: on a busy machine an image may take that long."""

        def is_silent(status: Any) -> bool:
            age = next((one.value for one in status.values if one.key == 'image_age_s'), '')
            return bool(age) and float(age) > IMAGE_TIMEOUT

        return [status for status in statuses if not is_silent(status)] or statuses


def stamp(seconds: float) -> tuple[int, int]:
    """Seconds and nanoseconds of a header stamp."""
    return divmod(round(seconds * NANOSECONDS), NANOSECONDS)
