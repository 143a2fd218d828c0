"""An arm without pressure: its stiffness from loads alone, against a beam by shooting."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pneunet_ros import load_model, save_model, solve
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.uncertainty import SensorNoise
import pytest
from support.cantilever import Cantilever
from support.refusals import reasons, refused

NOISE = SensorNoise(pressure_std=0.0, force_std=1e-3, moment_std=0.0, target_std=2e-4)
STRIP = Cantilever(length=0.3, stiffness=0.02, curvature=0.4, weight=0.5)
WEIGHTS = -9.81 * np.array([0.01, 0.02, 0.05, 0.1])  # N


def bench(truth: Cantilever = STRIP, places=(0.0, 0.3), weight: float = 1.0) -> Arm:
    """Return what is known of a beam before: its size, its own weight, and a wrong stiffness."""
    return Arm(
        name='beam',
        length=truth.length,
        weight=weight,
        target_arclength=np.array(places),
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0], arclength=[0.0, 1.0], curvature=[[0.0, 0.0]]
        ),
        moment_law=LinearLaw(bending_stiffness=1.0),
        effects=(Gravity(weight_y=-truth.weight),),
        sensors=NOISE,
    )


def recorded(
    truth: Cantilever = STRIP, forces=WEIGHTS, places=(0.0, 0.3), seed: int = 0, start: int = 0
) -> RecordingData:
    """Return a frame per weight, without a pressure."""
    points = np.array([truth.shape((0.0, force), places=places)[:2] for force in forces])
    points += np.random.default_rng(seed).normal(0.0, NOISE.target_std, points.shape)
    stamps = 1_000_000_000 * (1 + start + np.arange(len(points)))
    load = np.column_stack([np.zeros(len(points)), forces])
    return RecordingData(
        name='weights.mcap',
        reading_stamp_ns=stamps,
        pressure=np.zeros(len(points)),
        stamp_ns=stamps,
        reading=np.arange(len(points)),
        loaded=bool(np.any(load)),
        force=load,
        moment=np.zeros(len(points)),
        x=points[:, 0],
        y=points[:, 1],
        static=True,
        pressurized=False,
    )


@pytest.mark.parametrize('stiffness', [1e-3, 0.02, 3.0])
def test_stiffness_and_rest_shape_come_from_loads_alone(stiffness, tmp_path):
    truth = replace(STRIP, stiffness=stiffness, weight=25.0 * stiffness)
    forces = WEIGHTS * stiffness / STRIP.stiffness
    noise = replace(NOISE, force_std=0.01 * float(abs(forces[0])))
    frame = replace(bench(truth, weight=10.0), sensors=noise)
    found = calibrate([], [recorded(truth, forces)], frame)
    assert found.joint.converged
    law = found.arm.moment_law
    std = np.sqrt(found.joint.covariance[-1, -1])
    assert law.bending_stiffness == pytest.approx(stiffness, abs=max(4.0 * std, 1e-3 * stiffness))
    assert std < 0.05 * stiffness
    table = found.arm.intrinsic_curvature
    assert table.pressure.tolist() == [0.0]
    assert table.at(0.0, 0.5) == pytest.approx(0.4, abs=0.15)
    save_model(found.arm, tmp_path / 'beam.yaml')
    again = load_model(tmp_path / 'beam.yaml')
    assert again.domain.pressure == (0.0, 0.0)
    force = 0.7 * forces[-1]
    shape, wanted = solve(again, 0.0, (0.0, force)), truth.shape((0.0, force))
    assert not shape.extrapolated
    assert shape.x[-1] == pytest.approx(wanted[0, 0], abs=6e-4)
    assert shape.y[-1] == pytest.approx(wanted[1, 0], abs=6e-4)
    assert 'one_pressure' in reasons(found.notes)


def test_a_frame_without_a_load_and_a_recording_per_weight_are_as_good():
    rest = recorded(forces=[0.0], seed=1)
    loaded = [
        recorded(forces=[force], seed=2 + place, start=1 + place)
        for place, force in enumerate(WEIGHTS)
    ]
    found = calibrate([rest], loaded, bench())
    assert found.joint.converged
    assert found.arm.moment_law.bending_stiffness == pytest.approx(0.02, rel=0.03)


def test_the_error_bars_of_the_stiffness_are_honest():
    off = []
    for seed in range(12):
        found = calibrate([], [recorded(seed=seed)], bench())
        error = found.arm.moment_law.bending_stiffness - STRIP.stiffness
        off.append(error / np.sqrt(found.joint.covariance[-1, -1]))
    # A strip that is even in itself: what it might not be is in the error bars, too.
    assert 0.2 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_a_table_of_weights_becomes_a_model_on_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = recorded()
    lines = ['time_s,force_y_mn,x0_mm,y0_mm,tip_x_mm,tip_y_mm,tip_heading_deg']
    for row, force in enumerate(WEIGHTS.tolist()):
        heading = np.degrees(STRIP.shape((0.0, force))[2, 0])
        points = 1e3 * np.array([run.x[row], run.y[row]]).T.ravel()
        lines.append(','.join(str(value) for value in (row, 1e3 * force, *points, heading)))
    Path('weights.csv').write_text('\n'.join(lines))
    save_model(bench(places=(0.0,)), 'beam.yaml')
    assert main(['import', 'weights.csv', '--output', 'weights.mcap']) == 0
    arguments = ['--loaded', 'weights.mcap', '--arm', 'beam.yaml', '--output', 'strip.yaml']
    assert main(['calibrate', *arguments, '--static', '--report', 'report']) == 0
    capsys.readouterr()
    model = load_model('strip.yaml')
    assert model.moment_law.bending_stiffness == pytest.approx(STRIP.stiffness, rel=0.03)
    assert model.sources['sensors.heading_std'].startswith('assumed')
    assert model.target_arclength.tolist() == [0.0]
    assert (
        main(['predict', '--model', 'strip.yaml', '--pressure', '0', '--force', '0', '-0.5']) == 0
    )
    assert main(['predict', '--model', 'strip.yaml', '--pressure', '5000']) == 1
    assert Path('report/index.html').stat().st_size > 10_000


def test_what_tells_no_stiffness_is_refused():
    with refused(RecordingError, 'one_load'):
        calibrate([], [recorded(forces=[WEIGHTS[1]] * 3)], bench())
    with refused(RecordingError, 'no_pressure'):
        calibrate([recorded(forces=[0.0] * 3)], [], bench())
    with refused(RequestError, 'one_pressure'):
        calibrate([], [recorded()], bench(), kind='piecewise_linear')
    with refused(RecordingError, 'no_pressure'):
        calibrate([replace(recorded(forces=[0.0]), pressurized=True)], [recorded()], bench())
    with refused(RecordingError, 'too_few_frames'):
        calibrate([], [recorded(forces=WEIGHTS[:2])], bench())
