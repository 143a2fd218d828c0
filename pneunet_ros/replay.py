"""Replay: recording -> `Estimator.step` -> recording, through the messages and step of live."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from pneunet_ros.cdr_template import ClaimSerializer
from pneunet_ros.errors import MessageError
from pneunet_ros.estimator import Estimator, Outcome
from pneunet_ros.estimator_state import EstimatorState
from pneunet_ros.message_parts import Input, Output, UNREADABLE
from pneunet_ros.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.messages import INPUTS, OUTPUTS
from pneunet_ros.readings import Reading
from pneunet_ros.recording import RecordedMessage, Recording
from pneunet_ros.recording_writer import RecordingWriter
from pneunet_ros.shape import Refusal, ShapeEstimate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """One recorded message with what the estimator made of it and remembers afterwards."""

    message: RecordedMessage
    outcome: Outcome
    state: EstimatorState


def input_topics(
    recording: Recording, estimator: Estimator, overrides: Mapping[str, str]
) -> dict[str, Input[Reading]]:
    """Return the topics of a recording that the estimator reads, the wrench first.

    overrides: full topic name by last name, as `--topic pressure=/my/name` gives them. Raises
    RecordingError where a topic is missing or there are two candidates.
    """
    needed = [
        item
        for item in sorted(INPUTS, key=lambda item: item.name)
        if item.name != 'end_wrench' or estimator.settings.wrench_required
    ]
    return {
        recording.find(item.name, item.type, overrides.get(item.name)): item for item in needed
    }


def steps(
    recording: Recording, estimator: Estimator, topics: Mapping[str, Input[Reading]]
) -> Iterator[Step]:
    """Feed the recorded readings to the estimator in the order of their log time."""
    state = EstimatorState()
    for message in recording.messages(tuple(topics)):
        outcome: Outcome
        try:
            reading = topics[message.topic].decode(message.message)
        except MessageError as error:
            outcome = Refusal(
                stamp_ns=message.log_time_ns, reason=UNREADABLE, sentence=str(error), error=False
            )
            state = state.counting(UNREADABLE)
        else:
            state, outcome = estimator.step(state, reading)
        yield Step(message=message, outcome=outcome, state=state)


def estimate_topic(pressure_topic: str, name: str) -> str:
    """Full name of an output topic: in the namespace of the pressure topic, unless absolute."""
    if name.startswith('/'):
        return name
    return f'{pressure_topic.rsplit("/", 1)[0]}/{name}'


def record_steps(
    writer: RecordingWriter,
    recording: Recording,
    estimator: Estimator,
    topics: Mapping[str, Input[Reading]],
    each: Callable[[Step], None],
    views: Sequence[Output[ShapeEstimate]] = (),
) -> None:
    """Write the inputs, unchanged, all outputs, and `views`; `each` sees every step."""
    copies = {name: writer.add_copy(recording.topic(name)) for name in topics}
    pressure_topic = next(name for name, item in topics.items() if item.name == 'pressure')
    outputs = [
        (output, writer.add(estimate_topic(pressure_topic, output.name), output.type))
        for output in (*OUTPUTS, *views)
    ]
    serializer = ClaimSerializer(
        types=ROSBAGS_TYPES, serialize=serialize, frame_id=estimator.settings.frame_id
    )
    for step in steps(recording, estimator, topics):
        each(step)
        message = step.message
        writer.write_raw(copies[message.topic], message.log_time_ns, message.raw)
        if isinstance(step.outcome, ShapeEstimate):
            for output, connection in outputs:
                raw = serializer.bytes_of(output, step.outcome)
                writer.write_raw(connection, message.log_time_ns, raw)


@dataclass(slots=True)
class Tally:
    """What a replay came to, counted step by step."""

    messages: int = 0
    pressures: int = 0
    state: EstimatorState | None = None
    last: ShapeEstimate | None = None
    worst_residual: float = 0.0
    refusal: Refusal | None = None

    def count(self, step: Step, pressure_topic: str) -> None:
        """Take one step into account."""
        self.messages += 1
        self.state = step.state
        self.pressures += step.message.topic == pressure_topic
        if isinstance(step.outcome, Refusal):
            self.refusal = step.outcome
        elif step.outcome is not None:
            self.last = step.outcome
            self.worst_residual = max(self.worst_residual, step.outcome.shape.residual)
