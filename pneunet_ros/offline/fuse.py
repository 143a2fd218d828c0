"""Replay of the fusion: from a recording through `Fusion.step` to a recording, as live."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from pneunet_ros.core.health import Report
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
from pneunet_ros.offline.diagnostics import Diagnostics
from pneunet_ros.offline.replay import messages_in_order, record_replay, ReplayStep
from pneunet_ros.recordings.recorded_series import find_series
from pneunet_ros.recordings.recording import Recording
from pneunet_ros.recordings.recording_writer import RecordingWriter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionStep(ReplayStep[FusionOutcome, FusionState]):
    """One recorded message with its outcome and the state of the fusion after it."""


def fusion_topics(
    recording: Recording,
    overrides: Mapping[str, str],
    *,
    wrench: bool,
    gravity: GravitySource | None = None,
) -> dict[str, Input[Any]]:
    """Return the topics of a recording to fuse: targets and pressure, and a wrench if requested.

    The pressure is last, because it triggers the estimate from simultaneous readings. overrides:
    full topic name by last name. Raises RecordingError if pressure or targets are missing, or if
    there are two candidates. gravity: source of the direction of gravity; None: unknown.
    """
    optional = [*(() if gravity is None else gravity_inputs(gravity)), *[END_WRENCH] * wrench]
    sensors: list[Input[Any]] = [*optional, TARGETS, PRESSURE]
    found = (
        (find_series(recording, one, overrides, required=one not in optional), one)
        for one in sensors
    )
    return {topic: sensor for topic, sensor in found if topic is not None}


def fusion_steps(
    recording: Recording, fusion: Fusion, topics: Mapping[str, Input[Any]]
) -> Iterator[FusionStep]:
    """Pass recorded readings and frames to the fusion in the order of its node."""
    state = FusionState()
    for message in messages_in_order(recording, topics, OF_FUSION):
        state, outcome = fuse_message(fusion, state, topics[message.topic], message.message)
        yield FusionStep(message=message, outcome=outcome, state=state)


class FusionDiagnostics(Diagnostics):
    """Diagnostics of a replay, as the node `fusion` would report them."""

    def __init__(self, fusion: Fusion, topics: Mapping[str, Input[Any]]) -> None:
        """Start without messages; topics: sensors by the names of their topics."""
        names = {sensor.name: name for name, sensor in topics.items()}
        super().__init__(fusion.arm, names[PRESSURE.name], 'fusion: shape and force')
        self._fusion, self._topics = fusion, topics
        self._health = FusionHealth(names[PRESSURE.name], names[TARGETS.name], 0.0)

    def note(self, step: FusionStep) -> None:
        """Record the outcome of a step."""
        sensor = self._topics[step.message.topic]
        self._health.record(sensor.name, step.outcome, self.clock.now, None)

    def report(self, last: FusionStep) -> Report:
        """Report on the time since the last report; last: the last step."""
        now, left_out = self.clock.now, self.left_out
        return self._health.report(last.state, self._fusion, now, left_out=left_out)


def record_fusion(
    writer: RecordingWriter | None,
    recording: Recording,
    fusion: Fusion,
    topics: Mapping[str, Input[Any]],
    on_progress: Callable[[FusionStep], None],
) -> None:
    """Write the unchanged inputs and all fusion outputs; `on_progress` is called per step."""
    frame_id, diagnostics = fusion.sensors.frame_id, FusionDiagnostics(fusion, topics)
    played = fusion_steps(recording, fusion, topics)
    record_replay(
        writer, recording, topics, FUSION_OUTPUTS, frame_id, diagnostics, played, on_progress
    )


@dataclass(slots=True)
class FusionTally:
    """Counts of a replay of the fusion.

    modes: number of estimates by mode; determined: number with F1, and with F2; contacts: number
    with a contact, and with a contact that cannot be distinguished from a tip force; inconsistent:
    number with a running NIS above its noise limit; warnings: number per warning about the setup.
    """

    messages: int = 0
    state: FusionState = field(default_factory=FusionState)
    last: FusedEstimate | None = None
    refusal: Refusal | None = None
    modes: dict[str, int] = field(default_factory=lambda: {mode.name.lower(): 0 for mode in Mode})
    determined: list[int] = field(default_factory=lambda: [0, 0])
    ambiguous: int = 0
    contacts: list[int] = field(default_factory=lambda: [0, 0])
    inconsistent: int = 0
    warnings: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SETUP_PROBLEMS, 0))

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
            self.inconsistent += outcome.nis > outcome.nis_limit
            for sentence in self.warnings:
                self.warnings[sentence] += sentence in outcome.estimate.warnings
            for which, value in enumerate(outcome.force.tolist()):
                self.determined[which] += not math.isnan(value)
