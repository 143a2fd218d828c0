"""Replay: from a recording through `Estimator.step` to a recording, with the live messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any, Generic, TypeVar

from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.health import Report
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.estimation.consistency import (
    Agreement,
    agreement_of,
    ConsistencyState,
    Disagreement,
    FrameInnovation,
    take_estimate,
)
from pneunet_ros.estimation.estimate import Outcome, ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.health import EstimatorHealth
from pneunet_ros.estimation.persistent_errors import KeptFrames, persistent_errors
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.messages.builders import header_stamp, Input, Output, UNREADABLE
from pneunet_ros.messages.consistency import take_targets_message
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import (
    arrival_order,
    END_WRENCH,
    gravity_inputs,
    OF_ESTIMATOR,
    PRESSURE,
    TARGETS,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.diagnostics import Diagnostics
from pneunet_ros.recordings.recorded_series import find_series
from pneunet_ros.recordings.recording import RecordedMessage, Recording
from pneunet_ros.recordings.recording_writer import OutputTopics, RecordingWriter

Made = TypeVar('Made')
State = TypeVar('State')
AnyStep = TypeVar('AnyStep', bound='ReplayStep[Any, Any]')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayStep(Generic[Made, State]):
    """One recorded message, its outcome, and the state of the estimator or fusion after it."""

    message: RecordedMessage
    outcome: Made
    state: State


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step(ReplayStep[Outcome, EstimatorState]):
    """A step of the estimator; consistency: state of the comparison with measured targets."""

    consistency: ConsistencyState = field(default_factory=ConsistencyState)


def input_topics(
    recording: Recording, estimator: Estimator, overrides: Mapping[str, str]
) -> dict[str, Input[Any]]:
    """Return the topics of a recording that the estimator reads, the pressure last.

    overrides: full topic name by last name, as given by `--topic pressure=/my/name`. Raises
    RecordingError if a topic is missing or there are two candidates.
    """
    gravity = gravity_inputs(estimator.gravity)
    needed = [one for one in (END_WRENCH, PRESSURE) if one.needed(estimator.settings)]
    found = (
        (find_series(recording, one, overrides, required=one not in gravity), one)
        for one in (*gravity, *needed)
    )
    return {topic: sensor for topic, sensor in found if topic is not None}


def targets_topic(
    recording: Recording, estimator: Estimator, overrides: Mapping[str, str]
) -> str | None:
    """Return the topic of targets to compare with; None if there is none or it was not requested.

    Raises RecordingError if there are two candidates.
    """
    if not (TARGETS.needed(estimator.settings) and estimator.arm.target_arclength.size):
        return None
    return find_series(recording, TARGETS, overrides, required=False)


def messages_in_order(
    recording: Recording, topics: Mapping[str, Input[Any]], ties: Iterable[Input[Any]]
) -> Iterator[RecordedMessage]:
    """Yield the messages of these topics in the order of a node, which receives them at log time.

    ties: sensors in the order for simultaneous messages.
    """
    order = arrival_order(sensor for sensor in ties if sensor in topics.values())
    try:
        for message in recording.messages(list(topics)):
            yield from order.take(message.log_time_ns - 1)
            stamp_ns = header_stamp(message.message)
            order.add(topics[message.topic].name, message.log_time_ns, stamp_ns, message)
    except RecordingError:  # process all messages before the damage
        yield from order.take(math.inf)
        raise
    yield from order.take(math.inf)


def steps(
    recording: Recording,
    estimator: Estimator,
    topics: Mapping[str, Input[Any]],
    targets: str | None = None,
) -> Iterator[Step]:
    """Pass the recorded readings to the estimator in the order of its node.

    targets: a topic of targets to compare with the estimates.
    """
    state, consistency = EstimatorState(), ConsistencyState()
    for message in messages_in_order(recording, with_targets(topics, targets), OF_ESTIMATOR):
        outcome: Outcome
        if message.topic == targets:
            consistency, outcome = take_targets_message(consistency, estimator, message.message)
            yield Step(message=message, outcome=outcome, state=state, consistency=consistency)
            continue
        try:
            reading = topics[message.topic].decode(message.message)
        except MessageError as error:
            outcome = drop(message.log_time_ns, UNREADABLE, str(error))
            state = state.count_rejected(UNREADABLE)
        else:
            state, outcome = estimator.step(state, reading)
            if targets is not None and isinstance(reading, PressureReading):
                consistency = take_estimate(consistency, estimator, outcome)
        yield Step(message=message, outcome=outcome, state=state, consistency=consistency)


def estimate_topic(pressure_topic: str, name: str) -> str:
    """Return the full name of an output: in the namespace of the pressure, unless absolute."""
    if name.startswith('/'):
        return name
    return f'{pressure_topic.rsplit("/", 1)[0]}/{name}'


class EstimatorDiagnostics(Diagnostics):
    """Diagnostics of a replay, as the node `estimator` would report them."""

    def __init__(self, estimator: Estimator, inputs: Mapping[str, Input[Any]]) -> None:
        """Initialize; inputs: sensors by the names of their topics."""
        pressure = topic_of_pressure(inputs)
        super().__init__(estimator.arm, pressure, 'estimator: shape')
        self._estimator, self._inputs = estimator, inputs
        self._health = EstimatorHealth(pressure, 0.0)
        self._consistency = ConsistencyState()

    def note(self, step: Step) -> None:
        """Record the outcome of a step."""
        now, outcome = self.clock.now, step.outcome
        if step.consistency.running is not self._consistency.running:
            self._health.note_comparison(now)
        self._consistency = step.consistency
        sensor = self._inputs[step.message.topic]
        if sensor is PRESSURE and outcome is not None:
            self._health.record_pressure(outcome, now, None)
        elif not isinstance(outcome, ShapeEstimate):
            if sensor is END_WRENCH:
                self._health.record_wrench(outcome, now)
            elif outcome is not None:
                self._health.note_refusal(outcome)

    def report(self, last: Step) -> Report:
        """Report on the time since the last report; last: the last step."""
        settings, now = self._estimator.settings, self.clock.now
        return self._health.report(last.state, settings, now, last.consistency, self.left_out)


def record_steps(
    writer: RecordingWriter | None,
    recording: Recording,
    estimator: Estimator,
    topics: Mapping[str, Input[Any]],
    on_progress: Callable[[Step], None],
    markers: Sequence[Output[ShapeEstimate]] = (),
    targets: str | None = None,
) -> None:
    """Write the unchanged inputs, all outputs, and `markers`; `on_progress` is called per step.

    targets: a topic of targets to compare with the estimates; it is copied as well.
    """
    inputs = with_targets(topics, targets)
    diagnostics = EstimatorDiagnostics(estimator, inputs)
    played = steps(recording, estimator, topics, targets)
    frame_id, outputs = estimator.settings.frame_id, (*OUTPUTS, *markers)
    record_replay(writer, recording, inputs, outputs, frame_id, diagnostics, played, on_progress)


def with_targets(topics: Mapping[str, Input[Any]], targets: str | None) -> dict[str, Input[Any]]:
    """Return sensors by topic, including the targets topic if there is one."""
    return {**topics, **({} if targets is None else {targets: TARGETS})}


def topic_of_pressure(inputs: Mapping[str, Input[Any]]) -> str:
    """Return the topic of the pressure; inputs: sensors by the names of their topics."""
    return next(name for name, sensor in inputs.items() if sensor is PRESSURE)


def record_replay(
    writer: RecordingWriter | None,
    recording: Recording,
    inputs: Mapping[str, Input[Any]],
    outputs: Sequence[Output[Any]],
    frame_id: str,
    diagnostics: Diagnostics,
    played: Iterable[AnyStep],
    on_progress: Callable[[AnyStep], None],
) -> None:
    """Write the unchanged inputs and all outputs of a replay; `on_progress` is called per step.

    writer: None to write nothing. inputs: sensors by the names of their topics. `/diagnostics` is
    written as by the node, once per second and at the end.
    """
    if writer is None:
        for step in played:
            on_progress(step)
        return
    copies = {name: writer.add_copy(recording.topic(name)) for name in inputs}
    pressure = topic_of_pressure(inputs)
    names = {estimate_topic(pressure, output.name): output for output in outputs}
    topics = OutputTopics(writer, names, frame_id)
    diagnostics.open(writer)
    last: AnyStep | None = None
    for step in played:
        on_progress(step)
        diagnostics.take(step)
        message = step.message
        writer.write_raw(copies[message.topic], message.log_time_ns, message.raw)
        if step.outcome is not None and not isinstance(step.outcome, Refusal):
            for topic, raw in topics.messages((output, step.outcome) for output in outputs):
                writer.write_raw(topic, message.log_time_ns, raw)
        last = step
    if last is not None:
        diagnostics.end(last)


@dataclass(slots=True)
class Tally:
    """Counts of a replay.

    warned: number of estimates by warning; settled: number with the arm at rest; kept: frames for
    the test of persistent errors.
    """

    messages: int = 0
    pressures: int = 0
    state: EstimatorState | None = None
    last: ShapeEstimate | None = None
    worst_residual: float = 0.0
    settled: int = 0
    refusal: Refusal | None = None
    consistency: ConsistencyState = field(default_factory=ConsistencyState)
    disagreement: Disagreement | None = None
    compared: list[FrameInnovation] = field(default_factory=list)
    kept: KeptFrames = field(default_factory=KeptFrames)
    warned: dict[str, int] = field(default_factory=dict)

    def count(self, step: Step, pressure_topic: str) -> None:
        """Count one step."""
        self.messages += 1
        self.state = step.state
        self.pressures += step.message.topic == pressure_topic
        self.compare(step.consistency)
        if isinstance(step.outcome, Refusal):
            self.refusal = step.outcome
        elif step.outcome is not None:
            self.last = step.outcome
            self.worst_residual = max(self.worst_residual, step.outcome.shape.residual)
            motion = step.outcome.motion
            self.settled += motion is not None and motion.settled
            for warning in step.outcome.warnings:
                self.warned[warning] = self.warned.get(warning, 0) + 1

    def compare(self, consistency: ConsistencyState) -> None:
        """Store a frame, and the largest disagreement; a significant one takes precedence."""
        if consistency.compared is not self.consistency.compared:
            for frame in consistency.compared:
                if frame.evidence is not None:
                    self.kept = self.kept.after(frame.evidence)
                self.compared.append(replace(frame, evidence=None))
        if consistency.running is not self.consistency.running:
            found = consistency.disagreement()
            if found is not None and (
                self.disagreement is None or found.exceeds(self.disagreement)
            ):
                self.disagreement = found
        self.consistency = consistency

    def agreement(self, arm: Arm) -> Agreement | None:
        """Return the agreement of measured and estimated targets; None if none were compared."""
        if not self.compared:
            return None
        return agreement_of(self.compared, persistent_errors(self.kept.frames, arm))
