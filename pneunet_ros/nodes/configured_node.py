"""Base of all nodes: parameters, services, diagnostics and the log."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
import json
import math
import time
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.health import count_texts, hardware_id, Level, Report, REPORT_PERIOD
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.messages.readings import PRESSURE
from pneunet_ros.nodes.callback_errors import CallbackErrors, refuse_call
from pneunet_ros.nodes.connections import mismatch_sentences, rival_sentences
from pneunet_ros.nodes.load_shedding import LoadShedding
from pneunet_ros.nodes.log import Log
from pneunet_ros.nodes.losses import Losses
from pneunet_ros.nodes.node_options import DEFAULT_OPTIONS, NodeOptions
from pneunet_ros.nodes.parameters import ParameterTable, undeclared_overrides
from pneunet_ros.nodes.sensor_description import MOST_NODES, OtherDescriptions
from pneunet_ros.nodes.topics import latched_qos, output_qos, publisher, subscription
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger


class Configuration(Protocol):
    """Everything that the parameters of a node define."""

    @property
    def model(self) -> str:
        """Name and short hash of the model in use."""

    def info(self) -> str:
        """Return the content of the topic model_info."""


C = TypeVar('C', bound=Configuration)


class ConfiguredNode(Node, ABC, Generic[C]):
    """Parameters, their services, model_info, diagnostics and log of a node.

    configured: builds the configuration of all parameter values, reusing unchanged parts of the
    current configuration, or raises PneunetError; `~/reload_model` passes no current
    configuration, so that all files are read again.
    """

    INFO_TOPIC: ClassVar[str] = 'model_info'
    # s: messages of other nodes that arrive up to this much later are processed first.
    PATIENCE: ClassVar[float] = 0.0
    SHARED_INPUTS: ClassVar[tuple[str, ...]] = ()  # topics with several publishers

    def __init__(
        self,
        name: str,
        table: ParameterTable,
        configured: Callable[[Mapping[str, Any], C | None], C],
        node_options: NodeOptions = DEFAULT_OPTIONS,
    ) -> None:
        """Declare and apply all parameters; no topic is open yet."""
        self.errors = CallbackErrors(self.log_internal_error)
        super().__init__(name, **node_options.arguments(name))
        self.table, self.configured, self.node_options = table, configured, node_options
        self.configuration: C = configured(table.declare(self), node_options.sibling)
        self.candidate = self.configuration
        self.log = Log(self.get_logger())
        self.ready_at = math.inf  # s of a steady clock
        self.losses, self.shedding = Losses(), LoadShedding()
        self.other_descriptions = OtherDescriptions()
        # Times of the settings of another node, while they are being applied here.
        self.adopted_times: dict[str, int] = {}
        # Of the nodes in one process only the owner reports a jump of the clock.
        self.jumps = None if node_options.namespace else watch_clock(self, self.log_jump)
        self.open_diagnostics()

    def open_diagnostics(self) -> None:
        """Publish that the node is running but not ready yet."""
        self.diagnostics = publisher(
            self, 'diagnostic_msgs/msg/DiagnosticArray', '/diagnostics', output_qos()
        )
        kernels = jit.state_of_kernels()
        self.get_logger().info(f'preparing; kernels: {kernels}')
        self.publish_status('start', Level.OK, 'preparing', {'kernels': kernels})

    def open_services(self) -> None:
        """Open the services and outputs that do not depend on the inputs."""
        self.info = publisher(self, 'std_msgs/msg/String', self.INFO_TOPIC, latched_qos())
        self.create_service(Trigger, '~/reset', self.reset)
        self.create_service(Trigger, '~/reload_model', self.reload_model)
        self.add_on_set_parameters_callback(self.validate)
        self.add_post_set_parameters_callback(self.apply_candidate)
        if self.sensors is not None:
            qos, kind = latched_qos(MOST_NODES), 'std_msgs/msg/String'
            subscription(self, kind, self.INFO_TOPIC, self.take_info, qos)
        self.publish_model_info()
        self.call_every(REPORT_PERIOD, self.diagnose)

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[..., None], *arguments: Any, **named: Any
    ) -> Any:
        """Subscribe with a callback whose errors do not end the node."""
        guarded = self.errors.guarded(callback)
        return super().create_subscription(kind, topic, guarded, *arguments, **named)

    def create_timer(
        self, seconds: float, callback: Callable[..., None], *arguments: Any, **named: Any
    ) -> Any:
        """Make a timer with a callback whose errors do not end the node."""
        return super().create_timer(seconds, self.errors.guarded(callback), *arguments, **named)

    def create_service(
        self, kind: Any, name: str, callback: Callable[..., Any], *arguments: Any, **named: Any
    ) -> Any:
        """Make a service with a callback whose errors do not end the node."""
        guarded = self.errors.guarded(callback, refuse_call)
        return super().create_service(kind, name, guarded, *arguments, **named)

    def log_internal_error(self, kind: str, sentence: str) -> None:
        """Log the first internal error of a kind, with its traceback."""
        self.get_logger().error(sentence)

    def log_jump(self, sentence: str) -> None:
        """Log a jump of ROS time."""
        self.log.warn('jump', sentence, time.monotonic())

    @abstractmethod
    def forget(self) -> str:
        """Discard all readings; return a description for the user."""

    @abstractmethod
    def reconfigure(self, configuration: C) -> None:
        """Prepare the node for `configuration`, while the old configuration is still in use."""

    @abstractmethod
    def diagnose(self) -> None:
        """Publish the diagnostics of the node."""

    def call_every(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back periodically by the steady clock, even if simulated time stands still."""
        self.create_timer(seconds, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def log_ready(self) -> None:
        """Log that the node is ready, and any unknown parameters."""
        unknown = self.unknown_parameters()
        if unknown:
            self.get_logger().warning(f'unknown parameters: {", ".join(unknown)}')
        frame_id = self.get_parameter('frame_id').value
        self.get_logger().info(f'ready: {self.configuration.model}, frame {frame_id}')
        self.ready_at = time.monotonic()

    def unknown_parameters(self) -> list[str]:
        """Return the names of given parameters that have no effect."""
        return [
            name
            for name in undeclared_overrides(self)
            if name not in self.node_options.foreign_parameters
        ]

    def reset(self, request: Any, response: Any) -> Any:
        """Serve ~/reset."""
        response.success, response.message = True, self.forget()
        return response

    def check_inputs(self, new: C) -> None:
        """Raise PneunetError if a configuration needs topics that this node does not read."""

    def reload_model(self, request: Any, response: Any) -> Any:
        """Serve ~/reload_model: read all files again; after an error, nothing changes."""
        try:
            found = self.configured(self.table.values(self), None)
            self.check_inputs(found)
            self.use(found)
        except PneunetError as error:
            response.message = f'{error}; the old model stays in use'
        else:
            response.success = True
            response.message = f'now in use: {self.configuration.model}'
        return response

    def validate(self, changes: list[Parameter]) -> SetParametersResult:
        """Accept or reject parameters by building their configuration."""
        self.candidate = self.configuration
        values = self.table.values(self)
        changed = {item.name: item.value for item in changes if item.name in values}
        if not changed:  # rclpy declares parameters of its own, such as those of QoS
            return SetParametersResult(successful=True)
        try:
            found = self.configured(self.table.completed(values | changed), self.configuration)
            self.check_inputs(found)
            self.candidate = found
        except PneunetError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:
            self.errors.note(error)
            reason = 'internal error: see the log of the node'
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def apply_candidate(self, changes: list[Parameter]) -> None:
        """Use the validated configuration, now that the parameters are set."""
        if self.candidate is not self.configuration:
            self.errors.guarded(self.use)(self.candidate)

    def use(self, configuration: C) -> None:
        """Switch to another model or other settings."""
        before = self.sensors
        self.reconfigure(configuration)
        self.configuration = configuration
        if before is not None and self.sensors is not None:
            self.other_descriptions.note_set(before, self.sensors, self.adopted_times)
        self.publish_model_info()

    def publish_model_info(self) -> None:
        """Publish the model in use, for current and later subscribers."""
        content = {'node': self.get_fully_qualified_name()} | json.loads(self.configuration.info())
        if self.sensors is not None:
            content['sensors_set_ns'] = self.other_descriptions.set_ns
            content['pressure'] = self.resolve_topic_name(PRESSURE.topic)
        self.info.publish(String(data=json.dumps(content)))

    @property
    def sensors(self) -> dict[str, Any] | None:
        """Sensor settings of the node, by parameter; None if it has none."""
        return getattr(self.configuration, 'sensors', None)

    def take_info(self, message: String) -> None:
        """Process the model_info of another node of this arm, and adopt its newer settings."""
        pressure = self.resolve_topic_name(PRESSURE.topic)
        newer, times = self.other_descriptions.take(message.data, pressure)
        sensors = self.sensors or {}
        changes = [
            Parameter(name, value=value)
            for name, value in newer.items()
            if name in sensors and sensors[name] != value and name not in self.table.read_only
        ]
        if not changes:
            return
        self.adopted_times = times
        result = self.set_parameters_atomically(changes)
        self.adopted_times = {}
        if result.successful:
            names = ', '.join(f'{one.name} {one.value}' for one in changes)
            self.get_logger().info(f'copied from another node of this arm: {names}')

    def differing_sensors(self) -> str:
        """Describe differences to the sensor settings of other nodes of the arm."""
        if self.sensors is None:
            return ''
        running = {
            f'{namespace.rstrip("/")}/{name}'
            for name, namespace in self.get_node_names_and_namespaces()
        }
        own_name = self.get_fully_qualified_name()
        own = self.sensors | {'model': json.loads(self.configuration.info()).get('hash')}
        return '; '.join(self.other_descriptions.differences(own_name, own, running))

    def log_refusal(self, refusal: Refusal) -> None:
        """Log a kind of refusal when it first occurs, and again after a while."""
        now = time.monotonic()
        self.log.refusal(refusal, now - self.ready_at, now)

    def note_message(self, topic: str, info: Mapping[str, int | None]) -> None:
        """Count the messages of a topic that were lost before this one."""
        self.losses.take(topic, info, self.count_publishers)

    def publish_report(self, what: str, report: Report) -> None:
        """Publish a report as diagnostics; what: the subject of the report."""
        shared = map(self.resolve_topic_name, (self.INFO_TOPIC, *self.SHARED_INPUTS))
        rivals = '; '.join(rival_sentences(self, list(shared)))
        mismatched = '; '.join(mismatch_sentences(self))
        differing = self.differing_sensors()
        level, message = report.level, report.message
        losses, shed = self.losses.sentence(), self.shedding.sentence()
        for warning in filter(None, (losses, shed, rivals, mismatched, differing)):
            message = warning if level is Level.OK else f'{message}; {warning}'
            level = max(level, Level.WARN)
        internal = self.errors.sentence()
        if internal:
            message = internal if level is Level.OK else f'{internal}; {message}'
            level = Level.ERROR
        kernels = jit.state_of_kernels()
        total = {topic[1:]: count for topic, count in self.losses.total.items()}
        lost = count_texts('lost', total) | {'frames_shed': str(self.shedding.total)}
        errors = count_texts('internal_errors', self.errors.total)
        values = {'kernels': kernels, **report.values, **lost, **errors, 'rivals': rivals}
        values |= {'mismatched': mismatched, 'other_descriptions': differing}
        self.publish_status(what, level, message, values)

    def publish_status(
        self, what: str, level: Level, message: str, values: Mapping[str, str]
    ) -> None:
        """Publish one status, stamped with the current time."""
        model = self.configuration.model
        values = {'model': model, **values}
        status = DiagnosticStatus(
            level=bytes([level]),
            name=f'{self.get_fully_qualified_name()[1:]}: {what}',
            message=message,
            hardware_id=hardware_id(self.get_namespace(), self.get_name()),
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(array)


def watch_clock(node: Any, log: Callable[[str], None]) -> Any:
    """Report a jump of the node's clock, back or forward by more than a report period.

    Caused by a restarted simulator or a looping bag. Only messages stamped with the current time
    use this clock: readings have their own stamps, and timers use the steady clock. The clock is
    watched for the lifetime of the returned object.
    """
    threshold = JumpThreshold(
        min_forward=Duration(seconds=REPORT_PERIOD),
        min_backward=Duration(nanoseconds=-1),
        on_clock_change=False,
    )
    clock = node.get_clock()

    def report(jump: Any) -> None:
        seconds = 1e-9 * jump.delta.nanoseconds
        log(
            f'/clock jumped by {seconds:+.3f} s to {1e-09 * clock.now().nanoseconds:.3f} s; the '
            'node continues, because readings have their own stamps'
        )

    return clock.create_jump_callback(threshold, post_callback=report)
