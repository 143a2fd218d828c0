"""Readings in bursts, as a recording and as what a node hears, and what comes of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import random
from typing import Any

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, TARGETS
from pneunet_ros.offline.fuse import fusion_steps, fusion_topics
from pneunet_ros.offline.replay import input_topics, steps, targets_topic
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording

from support.random_estimates import plain

RECORDING = share_path('bags/lab_day/heldout.mcap')
MODEL = share_path('config/paper_arm.yaml')
BETWEEN_NS = 50_000  # between messages that are sent back to back
LONGEST_BURST = 6  # pressures


# Arguments of a node that takes every message sent, and publishes every estimate on all topics.
RELIABLE = (
    *('-p', 'centerline_rate:=0.0'),
    *(
        word
        for name in ('pressure', 'targets', 'end_wrench')
        for word in ('-p', f'qos_overrides./pneunet/{name}.subscription.reliability:=reliable')
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """So many wrenches and frames before each of the pressures, which come at a rate (Hz).

    late_ns: by which frames are stamped before their pressure; together: all that belongs to a
    pressure has its stamp and arrives at one instant.
    """

    pressure: float
    wrenches: int
    frames: int
    late_ns: int = 0
    together: bool = False


RATES = {
    'ten wrenches': Rates(pressure=100.0, wrenches=10, frames=1, late_ns=23_000_000),
    'two frames': Rates(pressure=20.0, wrenches=3, frames=2, late_ns=1_000_000),
    'one stamp': Rates(pressure=50.0, wrenches=1, frames=1, together=True),
}


def write_bursts(path: Path, rates: Rates, readings: int) -> list[list[tuple[str, bytes]]]:
    """Write a recording, and return its messages burst by burst, (sensor, bytes), as sent."""
    values = recorded_values()
    period_ns = round(1e9 / rates.pressure)
    draw = random.Random(7)
    sent: list[list[tuple[str, bytes]]] = [[]]
    left, log_ns = draw.randint(1, LONGEST_BURST), 0
    with write_recording(path) as writer:
        topics = {
            sensor.name: writer.add(f'/pneunet/{sensor.name}', sensor.type)
            for sensor in (PRESSURE, END_WRENCH, TARGETS)
        }
        for number in range(readings):
            stamp_ns = 1_000_000_000_000 + number * period_ns
            if not left:
                left = draw.randint(1, LONGEST_BURST)
                sent.append([])
                log_ns = stamp_ns
            left -= 1
            log_ns = max(log_ns, stamp_ns)
            group = messages_of(values[number % len(values)], rates, stamp_ns, period_ns)
            for sensor, message in group:
                writer.write(topics[sensor], log_ns, message)
                log_ns += 0 if rates.together else BETWEEN_NS
            log_ns += BETWEEN_NS
            sent[-1].extend((name, message) for name, message in group)
    recording = open_recording(path)
    kept: dict[str, list[bytes]] = {sensor: [] for sensor in topics}
    for message in recording.raw_messages([topic.name for topic in recording.topics]):
        kept[message.topic.rpartition('/')[2]].append(bytes(message.raw))
    raw = {sensor: iter(messages) for sensor, messages in kept.items()}
    return [[(name, next(raw[name])) for name, _ in burst] for burst in sent]


def recorded_values() -> list[tuple[float, Any, Any]]:
    """Give pressure, wrench and targets of the moments of the recording that have all three."""
    last: dict[str, Any] = {}
    values = []
    recording = open_recording(RECORDING)
    for message in recording.messages([topic.name for topic in recording.topics]):
        last[message.topic.rpartition('/')[2]] = message.message
        if message.topic.endswith('pressure') and len(last) == 3:
            load = END_WRENCH.decode(last['end_wrench'])
            seen = TARGETS.decode(last['targets'])
            pressure = PRESSURE.decode(message.message).pressure
            values.append((pressure, np.array([load.force_x, load.force_y, load.moment]), seen))
    return [*values, *reversed(values)]


def messages_of(
    values: tuple[float, Any, Any], rates: Rates, stamp_ns: int, period_ns: int
) -> list[tuple[str, Any]]:
    """Give what is sent for one pressure: wrenches, frames and, last, the pressure."""
    pressure, load, seen = values
    base, group = 'pneunet_base', []
    for left in reversed(range(rates.wrenches)):
        at_ns = stamp_ns - left * period_ns // rates.wrenches
        row = load * (1.0 + 1e-3 * left)
        group.append((END_WRENCH.name, END_WRENCH.message(at_ns, row, base, ROSBAGS_TYPES)))
    for left in reversed(range(rates.frames)):
        at_ns = stamp_ns - rates.late_ns - left * period_ns // rates.frames
        row = np.array([seen.x, seen.y]) + 1e-6 * left
        group.append((TARGETS.name, TARGETS.message(at_ns, row, base, ROSBAGS_TYPES)))
    row = np.array([pressure])
    return [*group, (PRESSURE.name, PRESSURE.message(stamp_ns, row, base, ROSBAGS_TYPES))]


def text(message: Any) -> str:
    """Give a message of either binding as text that tells the last bit of every number."""
    return repr(plain(message))


def replayed_by_estimator(path: Path) -> list[dict[str, str]]:
    """Give all outputs of each estimate of a replay, as text."""
    recording, estimator = open_recording(path), Estimator(arm=load_model(MODEL))
    topics = input_topics(recording, estimator, {})
    targets = targets_topic(recording, estimator, {})
    return [
        {
            output.name: text(output.encode(step.outcome, 'pneunet_base', ROSBAGS_TYPES))
            for output in OUTPUTS
        }
        for step in steps(recording, estimator, topics, targets)
        if isinstance(step.outcome, ShapeEstimate)
    ]


def replayed_by_fusion(path: Path) -> list[dict[str, str]]:
    """Give all outputs of each estimate of a replay, as text."""
    recording, fusion = open_recording(path), Fusion(arm=load_model(MODEL))
    topics = fusion_topics(recording, {}, wrench=True)
    return [
        {
            output.name: text(output.encode(step.outcome, 'pneunet_base', ROSBAGS_TYPES))
            for output in FUSION_OUTPUTS
        }
        for step in fusion_steps(recording, fusion, topics)
        if isinstance(step.outcome, FusedEstimate)
    ]


REPLAYS = {'estimator': replayed_by_estimator, 'fusion': replayed_by_fusion}


def played_live(peer: Any, bursts: Sequence[Sequence[tuple[str, bytes]]]) -> list[dict[str, str]]:
    """Give what a node makes of them; the next burst is sent when all of the last is answered."""
    for number, burst in enumerate(bursts, 1):
        wanted = sum(name == PRESSURE.name for one in bursts[:number] for name, _ in one)
        for name, raw in burst:
            peer.sensors[name].publish(raw)
        answered = partial(has_answered, peer, wanted)
        assert peer.spin_until(answered), (wanted, peer.outputs(), peer.report())
    names = list(peer.received)
    return [
        dict(zip(names, map(text, messages), strict=True))
        for messages in zip(*peer.received.values(), strict=True)
    ]


def has_answered(peer: Any, wanted: int) -> bool:
    """Whether so many estimates have come on every topic."""
    return min(peer.outputs().values()) >= wanted
