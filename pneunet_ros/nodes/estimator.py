"""The node `estimator`: pressure and end wrench -> shape of the arm, with its uncertainty.

All that is made of a reading is made by `pneunet_ros.estimator`; here are topics, parameters,
services, diagnostics and the log.
"""

from __future__ import annotations

from collections import deque
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from pneunet_ros.cdr_template import EstimateSerializer
from pneunet_ros.errors import MessageError, PneunetError
from pneunet_ros.estimator_state import EstimatorState
from pneunet_ros.message_parts import UNREADABLE
from pneunet_ros.messages import decode_pressure, decode_wrench, PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.model_file import model_hash
from pneunet_ros.nodes import parameters, process
from pneunet_ros.nodes.configuration import Configuration, configured
from pneunet_ros.nodes.health import Health
from pneunet_ros.nodes.log import Log
from pneunet_ros.nodes.model_info import model_info
from pneunet_ros.nodes.ros_types import RCLPY_TYPES, serialize
from pneunet_ros.nodes.topics import (
    EstimatePublisher,
    input_qos,
    latched_qos,
    output_qos,
    publisher,
    subscription,
)
from pneunet_ros.nodes.warm_up import warm_up
from pneunet_ros.readings import PressureReading
from pneunet_ros.shape import Refusal, ShapeEstimate
from pneunet_ros.units import seconds_between
from pneunet_ros.zero import pressure_zero
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

USAGE = """usage: estimator [--ros-args ...]

Estimates the shape of a pneu-net arm from the topics pressure and end_wrench. All settings are
ROS parameters, as in

  estimator --ros-args -p model_file:=/path/to/model.yaml
  estimator --ros-args --params-file config/estimator.yaml
"""
DEFAULT_NAMESPACE = '/pneunet'  # where no other is given with `-r __ns:=/other`
REPORT_PERIOD = 1.0  # s
ZERO_SPAN = 1.0  # s of pressure readings that ~/zero_pressure looks at
ZERO_READINGS = 1000  # of which it keeps no more than the last so many


class EstimatorNode(Node):
    """Feeds readings to an `Estimator` and publishes what it gives in the same callback."""

    def __init__(self) -> None:
        """Declare all parameters, get everything warm, and only then open the topics."""
        super().__init__('estimator', namespace=DEFAULT_NAMESPACE)
        self.configuration = self.candidate = configured(parameters.declare(self), None)
        self.state = EstimatorState()
        self.recent: deque[PressureReading] = deque(maxlen=ZERO_READINGS)
        self.log = Log(self.get_logger())

        settings = self.configuration.estimator.settings
        serializer = EstimateSerializer(
            types=RCLPY_TYPES, serialize=serialize, frame_id=settings.frame_id
        )
        self.get_logger().info('preparing the solver; the very first time it is compiled')
        trouble = warm_up(self.configuration.estimator, serializer)
        if trouble:
            self.get_logger().warning(f'the model gave no shape to begin with: {trouble}')

        self.outputs = EstimatePublisher(self, serializer, self.configuration.node.centerline_rate)
        self.info = publisher(self, 'std_msgs/msg/String', 'model_info', latched_qos())
        self.diagnostics = publisher(
            self, 'diagnostic_msgs/msg/DiagnosticArray', '/diagnostics', output_qos()
        )
        self.create_service(Trigger, '~/reset', self.reset)
        self.create_service(Trigger, '~/zero_pressure', self.zero_pressure)
        self.create_service(Trigger, '~/reload_model', self.reload_model)
        self.add_on_set_parameters_callback(self.validate)
        self.add_post_set_parameters_callback(self.apply_candidate)
        self.tell_model()
        # A timer of the steady clock: diagnostics go on where simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(REPORT_PERIOD, self.diagnose, clock=steady)

        self.health = Health(self.resolve_topic_name('pressure'), time.monotonic())
        # Of two readings that are both there, the executor takes that of the first subscription.
        if settings.wrench_required:
            subscription(self, WRENCH_TYPE, 'end_wrench', self.take_wrench, input_qos())
        subscription(self, PRESSURE_TYPE, 'pressure', self.take_pressure, input_qos())
        unknown = parameters.without_effect(self)
        if unknown:
            self.get_logger().warning(f'parameters that do not exist here: {", ".join(unknown)}')
        self.get_logger().info(f'ready: {self.model}, frame {settings.frame_id}')

    def take_wrench(self, message: Any) -> None:
        """Take a wrench message."""
        try:
            reading = decode_wrench(message)
        except MessageError as error:
            self.refuse_message(error)
            return
        resets = self.state.resets
        self.state, refusal = self.configuration.estimator.step(self.state, reading)
        self.note_reset(resets)
        assert not isinstance(refusal, ShapeEstimate)
        self.health.took_wrench(refusal, time.monotonic())
        if refusal is not None:
            self.log_refusal(refusal)

    def take_pressure(self, message: Any, info: dict[str, int]) -> None:
        """Take a pressure message and publish the shape at it."""
        try:
            reading = decode_pressure(message)
        except MessageError as error:
            self.refuse_message(error)
            return
        resets = self.state.resets
        begin = time.monotonic()
        self.state, outcome = self.configuration.estimator.step(self.state, reading)
        end = time.monotonic()
        assert outcome is not None
        if isinstance(outcome, ShapeEstimate):
            self.outputs.publish(outcome, end)
            self.health.published(1e-9 * (time.time_ns() - info['received_timestamp']))
        self.health.took_pressure(outcome, end, end - begin)
        self.note_reset(resets)
        if isinstance(outcome, Refusal):
            self.log_refusal(outcome)
            if not outcome.error:
                return
        self.recent.append(reading)

    def refuse_message(self, error: MessageError) -> None:
        """Count a message that could not be decoded."""
        refusal = Refusal(stamp_ns=0, reason=UNREADABLE, sentence=str(error), error=False)
        self.state = self.state.counting(UNREADABLE)
        self.health.refused(refusal)
        self.log_refusal(refusal)

    def note_reset(self, resets: int) -> None:
        """Say in the log when the estimator started anew because time jumped back."""
        if self.state.resets > resets:
            self.recent.clear()
            sentence = 'time jumped back: the estimator has started anew'
            self.log.warn('reset', sentence, time.monotonic())

    def log_refusal(self, refusal: Refusal) -> None:
        """Log a kind of refusal when it is new, and again when it goes on for long."""
        say = self.log.error if refusal.error else self.log.warn
        say(refusal.reason, refusal.sentence, time.monotonic())

    def diagnose(self) -> None:
        """Publish how the estimator is doing; the stamp is now, as that is what it tells of."""
        now = time.monotonic()
        settings = self.configuration.estimator.settings
        report = self.health.report(self.state, settings.input_timeout, now)
        values = {'model': self.model, 'pressure_offset_pa': f'{settings.pressure_offset:.6g}'}
        values |= report.values
        status = DiagnosticStatus(
            level=bytes([report.level]),
            name=f'{self.get_fully_qualified_name()[1:]}: shape',
            message=report.message,
            hardware_id=self.model,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(array)
        if self.health.silence(now) > settings.input_timeout:
            self.log.warn('silence', report.message, now)

    def reset(self, request: Any, response: Any) -> Any:
        """Serve ~/reset: forget all readings."""
        self.state = self.state.fresh()
        self.recent.clear()
        response.success, response.message = True, 'the estimator starts anew'
        return response

    def zero_pressure(self, request: Any, response: Any) -> Any:
        """Serve ~/zero_pressure: the arm is vented, so what the sensor reads now is zero."""
        estimator = self.configuration.estimator
        readings: tuple[PressureReading, ...] = ()
        if self.health.silence(time.monotonic()) <= estimator.settings.input_timeout:
            last = self.recent[-1].stamp_ns if self.recent else 0
            readings = tuple(
                reading
                for reading in self.recent
                if seconds_between(reading.stamp_ns, last) <= ZERO_SPAN
            )
        offset, response.message = pressure_zero(estimator, readings)
        if offset is not None:
            (result,) = self.set_parameters([Parameter('pressure_offset', value=offset)])
            response.success = result.successful
            response.message = response.message if result.successful else result.reason
        return response

    def reload_model(self, request: Any, response: Any) -> Any:
        """Serve ~/reload_model: read the model file again; a bad one changes nothing."""
        try:
            self.use(configured(parameters.values(self), None))
        except PneunetError as error:
            response.message = f'{error}; the old model stays in use'
        else:
            response.success, response.message = True, f'now in use: {self.model}'
        return response

    def validate(self, changes: list[Parameter]) -> SetParametersResult:
        """Say whether parameters can be set, by making ready what they ask for."""
        known = {item.name: item.value for item in changes if item.name in parameters.NAMES}
        try:
            self.candidate = configured(parameters.values(self) | known, self.configuration)
        except PneunetError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply_candidate(self, changes: list[Parameter]) -> None:
        """Use what was made ready, now that the parameters are set."""
        self.use(self.candidate)

    def use(self, configuration: Configuration) -> None:
        """Go on with another model or other settings."""
        self.state = configuration.take_over(self.state, self.configuration)
        self.configuration = configuration
        self.outputs.centerline_rate = configuration.node.centerline_rate
        self.tell_model()

    def tell_model(self) -> None:
        """Publish which model is in use, for subscribers of now and of later."""
        arm = self.configuration.estimator.arm
        self.model = f'{arm.name} {model_hash(arm)[:12]}'
        text = model_info(self.configuration.estimator, self.configuration.node.model_path)
        self.info.publish(String(data=text))


def main() -> int:
    """Run the node until a signal comes; the console script `estimator`."""
    return process.run(EstimatorNode, USAGE)


if __name__ == '__main__':
    sys.exit(main())
