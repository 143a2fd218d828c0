"""No absolute size decides: an arm of any size, force and pressure gives the same answer."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Event, Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.readings import decode_targets, END_WRENCH, PRESSURE, TARGETS
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.scaled import Size
from support.small_calibration import ARM, NOISE, runs_of

SIZES = [
    Size(length=0.125, force=0.0625, pressure=8.0),  # a finger of 14 mm
    Size(length=8.0, force=64.0, pressure=0.125),
]


@cache
def calibration(size: Size) -> Calibration:
    free, loaded = ([size.run(run) for run in runs] for runs in runs_of(ARM))
    return calibrate(free, loaded, size.arm(replace(ARM, sensors=NOISE)), compare=False)


@pytest.mark.lengthy
@pytest.mark.parametrize('size', SIZES)
def test_a_calibration_of_an_arm_of_another_size_is_the_same(size):
    expected, found = calibration(Size()), calibration(size)
    assert found.joint.converged
    assert found.notes == expected.notes
    back = Size(length=1.0 / size.length, force=1.0 / size.force, pressure=1.0 / size.pressure)
    arm = back.arm(found.arm)
    law, curvature = expected.arm.moment_law, expected.arm.intrinsic_curvature
    np.testing.assert_allclose(arm.intrinsic_curvature.pressure, curvature.pressure)
    # Both searches end within a twentieth of a sigma: `MapEstimationSettings.small_step`.
    std = np.sqrt(np.diag(expected.joint.covariance)[: curvature.curvature.size])
    difference = (arm.intrinsic_curvature.curvature - curvature.curvature).ravel()
    assert np.abs(difference / std).max() < 0.1
    np.testing.assert_allclose(arm.moment_law.rigidity, law.rigidity, rtol=1e-3)
    np.testing.assert_allclose(arm.moment_law.split, law.split, rtol=1e-2)
    for name in ('pressure_std', 'force_std', 'target_std', 'registration_std', 'drift_std'):
        assert getattr(arm.sensors, name) == pytest.approx(
            getattr(expected.arm.sensors, name),
            rel=5e-3,  # rounded to some digits
        )


MODEL = load_model(share_path('config/lab_arm.yaml'))
SENSORS = {
    '/pneunet/end_wrench': END_WRENCH,
    '/pneunet/targets': TARGETS,
    '/pneunet/pressure': PRESSURE,
}


@cache
def events() -> tuple[Event, ...]:
    recording = open_recording(share_path('bags/lab_day/heldout.mcap'))
    messages = islice(recording.messages(list(SENSORS)), 240)
    return tuple(
        decode_targets(one.message, 'pneunet_base')
        if SENSORS[one.topic] is TARGETS
        else SENSORS[one.topic].decode(one.message)
        for one in messages
    )


def scaled(size: Size, event: Event) -> Event:
    if isinstance(event, PressureReading):
        return replace(event, pressure=event.pressure * size.pressure)
    if isinstance(event, WrenchReading):
        forces = {name: getattr(event, name) * size.force for name in ('force_x', 'force_y')}
        return replace(event, **forces, moment=event.moment * size.of('N m'))
    places = {name: getattr(event, name) * size.length for name in ('x', 'y', 'std')}
    return replace(event, **places)


@cache
def fused(size: Size, with_wrench: bool) -> np.ndarray:
    """Return tip (length), force and its std (weight), mode and force determined per estimate."""
    arm = size.arm(MODEL)
    fusion, state, rows = Fusion(arm=arm), FusionState(), []
    for event in events():
        if with_wrench or not isinstance(event, WrenchReading):
            state, outcome = fusion.step(state, scaled(size, event))
            if isinstance(outcome, FusedEstimate):
                x, y, heading = outcome.estimate.shape.tip
                std = np.sqrt(np.diag(outcome.force_covariance))
                row = [x / arm.length, y / arm.length, heading]
                row += [*(outcome.force / arm.weight), *(std / arm.weight), outcome.mode]
                rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize('with_wrench', [False, True])
@pytest.mark.parametrize('size', SIZES)
def test_a_fusion_of_an_arm_of_another_size_is_the_same(size, with_wrench):
    expected, found = fused(Size(), with_wrench), fused(size, with_wrench)
    assert len(expected) > 50
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6, equal_nan=True)
