"""`/diagnostics` of a replay, as a node would publish it: once per second of log time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pneunet_ros.core.health import hardware_id, Report, REPORT_PERIOD
from pneunet_ros.core.stamps import LATEST_STAMP
from pneunet_ros.core.units import seconds_since
from pneunet_ros.files.model_file import model_label
from pneunet_ros.messages.builders import header
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import error_left_out
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import RecordingWriter

TOPIC, TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'


class Clock:
    """Seconds of log time since the first message, and the time of the next report."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._reported: float | None = None
        self.now_ns = 0

    def advance(self, log_time_ns: int) -> bool:
        """Advance to a log time (ns); return whether a report is due."""
        self._start_ns = log_time_ns if self._start_ns is None else self._start_ns
        self.now_ns = log_time_ns
        due = self.now - (self._reported or 0.0) >= REPORT_PERIOD
        self._reported = self.now if due else self._reported
        return due

    @property
    def ends(self) -> bool:
        """Whether a final report is due, because there was a message after the last report."""
        return self._reported is None or self.now > self._reported

    @property
    def now(self) -> float:
        """Seconds since the first message."""
        return 0.0 if self._start_ns is None else seconds_since(self._start_ns, self.now_ns)


class Diagnostics(ABC):
    """The topic `/diagnostics` of a replay, under the default name of the node."""

    def __init__(self, arm: Arm, pressure: str, name: str) -> None:
        """Initialize; pressure: its topic; name: of the status, e.g. 'fusion: shape and force'."""
        namespace = namespace_of(pressure)
        self._name, self._label = f'{namespace}{name}', model_label(arm)
        self._hardware = hardware_id(namespace, name.partition(':')[0])
        self.left_out = error_left_out(arm.covariance, arm.sources)
        self.clock = Clock()

    @abstractmethod
    def note(self, step: Any) -> None:
        """Record the outcome of a step of the replay."""

    @abstractmethod
    def report(self, last: Any) -> Report:
        """Report on the time since the last report; last: the last step."""

    def open(self, writer: RecordingWriter) -> None:
        """Add the topic to a recording."""
        self._writer, self._connection = writer, writer.add(TOPIC, TYPE)

    def take(self, step: Any) -> None:
        """Process a step, and report if due."""
        due = self.clock.advance(step.message.log_time_ns)
        self.note(step)
        if due:
            self.write(self.report(step))

    def end(self, last: Any) -> None:
        """Report on the time since the last report; last: the last step."""
        if self.clock.ends:
            self.write(self.report(last))

    def write(self, report: Report) -> None:
        """Write a report at the current time of the clock."""
        types = ROSBAGS_TYPES
        values: Mapping[str, str] = {'model': self._label, **report.values}
        pair = types('diagnostic_msgs/msg/KeyValue')
        status: Any = types('diagnostic_msgs/msg/DiagnosticStatus')(
            level=int(report.level),
            name=self._name,
            message=report.message,
            hardware_id=self._hardware,
            values=[pair(key=key, value=value) for key, value in values.items()],
        )
        stamp = header(min(self.clock.now_ns, LATEST_STAMP - 1), '', types)
        array = types(TYPE)(header=stamp, status=[status])
        self._writer.write(self._connection, self.clock.now_ns, array)


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic as used in a status: 'pneunet/', or '' for none."""
    space = topic.rpartition('/')[0].strip('/')
    return f'{space}/' if space else ''
