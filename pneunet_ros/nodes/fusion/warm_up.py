"""Warm-up before the first reading: kernels and message templates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, unseen_targets, WrenchReading
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.frame_update import RESTART_FRAMES
from pneunet_ros.fusion.fusion import Event, Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.equilibrium import solve

FRAME_PERIOD_NS = NANOSECONDS_PER_SECOND // 10


def warm_up(fusion: Fusion, serializer: MessageSerializer) -> str:
    """Run every kernel and every encoder once; return why there was no estimate, or ''.

    Frames of the unloaded arm are processed without and with its wrench, until a search from cold
    starts, the slowest operation, has been run. Plain Python needs no warm-up.
    """
    arm, sensors = fusion.arm, fusion.sensors
    pressure = 0.5 * sum(arm.pressure_range)
    shape = solve(arm, pressure)
    x, y = (
        np.interp(arm.target_arclength, shape.arclength, values) for values in (shape.x, shape.y)
    )
    reading = sensors.pressure.reading(pressure)
    state, outcome = FusionState(), None
    frames = RESTART_FRAMES + 2 if jit.is_compiled() else 2
    for index in range(frames):
        stamp_ns = 1 + index * FRAME_PERIOD_NS
        events: list[Event] = [
            PressureReading(stamp_ns=stamp_ns, pressure=reading),
            replace(unseen_targets(stamp_ns, x.size), x=x, y=y),
            PressureReading(stamp_ns=stamp_ns + FRAME_PERIOD_NS // 2, pressure=reading),
        ]
        if index == frames - 1:
            events.insert(0, unloaded_wrench(stamp_ns, sensors.frame_id))
        for event in events:
            state, made = fusion.step(state, event)
            outcome = made or outcome
    if isinstance(outcome, Refusal):
        return outcome.sentence
    assert isinstance(outcome, FusedEstimate)
    for topic in FUSION_OUTPUTS:
        serializer.bytes_of(topic, outcome)
    return ''


def unloaded_wrench(stamp_ns: int, frame_id: str) -> WrenchReading:
    """Return the wrench of an arm without contact."""
    return WrenchReading(
        stamp_ns=stamp_ns, force_x=0.0, force_y=0.0, moment=0.0, frame_id=frame_id
    )
