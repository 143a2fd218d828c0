"""Replay of the fusion: recording -> `Fusion.step` -> recording, with messages as live."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from pneunet_ros.core.outcome import Refusal
from pneunet_ros.estimation.base_gravity import GravitySource
from pneunet_ros.fusion.belief_estimate import SETUP_PROBLEMS
from pneunet_ros.fusion.estimate import FusedEstimate, FusionOutcome, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.health import FusionHealth
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.builders import Input
from pneunet_ros.messages.fusion import fuse_message, FUSION_OUTPUTS
from pneunet_ros.messages.readings import END_WRENCH, gravity_inputs, OF_FUSION, PRESSURE, TARGETS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.offline.diagnostics import Diagnostics, namespace_of
from pneunet_ros.offline.replay import estimate_topic, messages_in_order
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recorded_series import find_series
from pneunet_ros.recordings.recording import RecordedMessage, Recording
from pneunet_ros.recordings.recording_writer import RecordingWriter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionStep:
    """One recorded message with its outcome and the state of the fusion after it."""

    message: RecordedMessage
    outcome: FusionOutcome
    state: FusionState


def fusion_topics(
    recording: Recording,
    overrides: Mapping[str, str],
    *,
    wrench: bool,
    gravity: GravitySource | None = None,
) -> dict[str, Input[Any]]:
    """Return the topics of a recording to fuse: targets and pressure, and a wrench if requested.

    The pressure is last, because of simultaneous readings it triggers the estimate. overrides:
    full topic name by last name. Raises RecordingError if pressure or targets are missing, or if
    there are two candidates. gravity: source of its direction; None: unknown.
    """
    topics: dict[str, Input[Any]] = {}
    for one in () if gravity is None else gravity_inputs(gravity):
        name = find_series(recording, one, overrides, required=False)
        topics |= {} if name is None else {name: one}
    if wrench:
        name = find_series(recording, END_WRENCH, overrides, required=False)
        topics |= {} if name is None else {name: END_WRENCH}
    for sensor in (TARGETS, PRESSURE):
        name = find_series(recording, sensor, overrides)
        topics |= {} if name is None else {name: sensor}
    return topics


def fusion_steps(
    recording: Recording, fusion: Fusion, topics: Mapping[str, Input[Any]]
) -> Iterator[FusionStep]:
    """Feed recorded readings and frames to the fusion in the order of its node."""
    state = FusionState()
    for message in messages_in_order(recording, topics, OF_FUSION):
        state, outcome = fuse_message(fusion, state, topics[message.topic], message.message)
        yield FusionStep(message=message, outcome=outcome, state=state)


class FusionDiagnostics:
    """Diagnostics of a replay, as the node `fusion` would report them."""

    def __init__(
        self, writer: RecordingWriter, fusion: Fusion, topics: Mapping[str, Input[Any]]
    ) -> None:
        """Start without messages; topics: sensors by the names of their topics."""
        names = {sensor.name: name for name, sensor in topics.items()}
        space = namespace_of(names[PRESSURE.name])
        self._topic = Diagnostics(writer, fusion.arm, f'{space}fusion: shape and force')
        self._fusion, self._topics = fusion, topics
        self._health = FusionHealth(names[PRESSURE.name], names[TARGETS.name], 0.0)

    def take(self, step: FusionStep) -> None:
        """Process a step, and report if due."""
        clock, sensor = self._topic.clock, self._topics[step.message.topic]
        due = clock.advance(step.message.log_time_ns)
        self._health.took(sensor.name, step.outcome, clock.now, None)
        if due:
            self.report(step.state)

    def end(self, state: FusionState) -> None:
        """Report on the time since the last report."""
        if self._topic.clock.ends:
            self.report(state)

    def report(self, state: FusionState) -> None:
        """Report on the time since the last report, with the current state."""
        now, left_out = self._topic.clock.now, self._topic.left_out
        self._topic.write(self._health.report(state, self._fusion, now, left_out=left_out))


def record_fusion(
    writer: RecordingWriter,
    recording: Recording,
    fusion: Fusion,
    topics: Mapping[str, Input[Any]],
    on_progress: Callable[[FusionStep], None],
) -> None:
    """Write the unchanged inputs and all outputs of the fusion; `on_progress` sees each step.

    `/diagnostics` is written once per second, as by the node, and at the end.
    """
    copies = {name: writer.add_copy(recording.topic(name)) for name in topics}
    pressure = next(name for name, sensor in topics.items() if sensor is PRESSURE)
    outputs = [
        (output, writer.add(estimate_topic(pressure, output.name), output.type))
        for output in FUSION_OUTPUTS
    ]
    serializer = MessageSerializer(
        types=ROSBAGS_TYPES, serialize=serialize, frame_id=fusion.sensors.frame_id
    )
    diagnostics, state = FusionDiagnostics(writer, fusion, topics), FusionState()
    for step in fusion_steps(recording, fusion, topics):
        on_progress(step)
        diagnostics.take(step)
        state = step.state
        message = step.message
        writer.write_raw(copies[message.topic], message.log_time_ns, message.raw)
        if isinstance(step.outcome, FusedEstimate):
            for output, connection in outputs:
                raw = serializer.bytes_of(output, step.outcome)
                writer.write_raw(connection, message.log_time_ns, raw)
    diagnostics.end(state)


@dataclass(slots=True)
class FusionTally:
    """Counts of a replay of the fusion.

    modes: number of estimates by mode; determined: those with F1, and with F2; contacts: those
    with a contact, and those whose contact cannot be distinguished from a tip force; beyond: those
    while the running NIS exceeded its noise limit; said: those per warning about the setup.
    """

    messages: int = 0
    state: FusionState = field(default_factory=FusionState)
    last: FusedEstimate | None = None
    refusal: Refusal | None = None
    modes: dict[str, int] = field(default_factory=lambda: {mode.name.lower(): 0 for mode in Mode})
    determined: list[int] = field(default_factory=lambda: [0, 0])
    ambiguous: int = 0
    contacts: list[int] = field(default_factory=lambda: [0, 0])
    beyond: int = 0
    said: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SETUP_PROBLEMS, 0))

    def count(self, step: FusionStep) -> None:
        """Count one step."""
        self.messages += 1
        self.state = step.state
        outcome = step.outcome
        if isinstance(outcome, Refusal):
            self.refusal = outcome
        elif outcome is not None:
            self.last = outcome
            self.modes[outcome.mode.name.lower()] += 1
            self.ambiguous += outcome.ambiguous
            if outcome.contact is not None:
                self.contacts[outcome.contact.ambiguous] += 1
            self.beyond += outcome.nis > outcome.nis_limit
            for sentence in self.said:
                self.said[sentence] += sentence in outcome.estimate.warnings
            for which, value in enumerate(outcome.force.tolist()):
                self.determined[which] += not math.isnan(value)
