"""Runs that a model itself makes, exactly or with noise of every kind, to calibrate from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import THETA

from support.example_arms import paper_arm
from support.lab_run import run_of

PERIOD = 100_000_000  # ns between frames
FRAMES = 60
# So small that it hardly matters, and yet of a size that a fit can weigh by.
HARDLY_ANY = SensorNoise(
    pressure_std=0.01, force_std=1e-7, moment_std=1e-9, target_std=1e-6
)  # fmt: skip
USUAL = SensorNoise(
    pressure_std=60.0,
    force_std=1e-3,
    moment_std=1e-5,
    target_std=5e-5,
    placement_std=5e-5,
    registration_std=1e-4,
    drift_std=5e-5,
)


def made(
    arm: Arm,
    pressure: Array,
    force: Array | None = None,
    *,
    noise: SensorNoise | None = None,
    seed: int = 0,
    painted: int = 0,
    name: str = 'made',
    start: int = 0,
) -> RecordingData:
    """Return what is read and seen of an arm at these pressures (frames,) and forces (frames, 2).

    noise: None for none at all; painted: seed of the places of the targets. start: frames that
    were before.
    """
    frames, targets = len(pressure), arm.target_arclength.size
    loaded = force is not None
    force = np.zeros((frames, 2)) if force is None else force
    stamp = (1 + start + np.arange(frames)) * PERIOD
    run = RecordingData(
        name=name,
        reading_stamp_ns=stamp,
        pressure=pressure,
        stamp_ns=stamp,
        reading=np.arange(frames),
        loaded=loaded,
        force=force,
        moment=np.zeros(frames),
        x=np.zeros((frames, targets)),
        y=np.zeros((frames, targets)),
    )
    series, (inputs,) = ForwardModel(arm.target_arclength), inputs_of(arm, [run])
    assert series.solve(arm, inputs).all()
    points = series.points.copy()
    if noise is None:
        return replace(run, x=points[:, 0], y=points[:, 1])
    place = noise.placement_std * np.random.default_rng([painted, 1]).standard_normal((2, targets))
    random = np.random.default_rng([seed, 2])
    theta = series.fields[:, THETA]
    points[:, 0] += np.cos(theta) * place[0] - np.sin(theta) * place[1]
    points[:, 1] += np.sin(theta) * place[0] + np.cos(theta) * place[1]
    walk = np.cumsum(random.standard_normal((frames, 2)), axis=0) / np.sqrt(frames)
    camera = noise.registration_std * random.standard_normal(2) + noise.drift_std * walk
    points += camera[:, :, None] + noise.target_std * random.standard_normal(points.shape)
    points[np.broadcast_to(random.random((frames, 1, targets)) < 0.02, points.shape)] = np.nan
    return replace(
        run,
        pressure=pressure + noise.pressure_std * random.standard_normal(frames),
        force=force + noise.force_std * random.standard_normal((frames, 2)) * loaded,
        x=points[:, 0],
        y=points[:, 1],
    )


def in_two(run: RecordingData) -> tuple[RecordingData, RecordingData]:
    """Return the halves of a made recording, of an even number of frames."""
    half = len(run.stamp_ns) // 2
    first, second = (run.subset(np.arange(half) + start) for start in (0, half))
    return tuple(
        replace(
            one,
            name=name,
            reading_stamp_ns=one.stamp_ns,
            pressure=one.frame_pressure,
            reading=np.arange(half),
        )
        for name, one in (('first', first), ('second', second))
    )


def experiments(
    arm: Arm, noise: SensorNoise | None = None, seed: int = 0, frames: int = FRAMES
) -> tuple[list[RecordingData], list[RecordingData]]:
    """Return unloaded and loaded runs over 0 to 60 kPa: two ramps; weights, two sweeps."""
    up = np.linspace(0.0, 60e3, frames)
    turn = np.linspace(0.0, 1.0, frames)
    weights = np.stack([0.25 - 0.1 * turn, 0.25 * turn**2], axis=1)
    sweep = np.stack([0.05 + 0.2 * turn, 0.02 + 0.1 * turn], axis=1)
    todo: Sequence[tuple[str, Array, Array | None]] = (
        ('up', up, None),
        ('down', up[::-1], None),
        ('weights', up, weights),
        ('low sweep', np.full(frames, 20e3), sweep),
        ('high sweep', np.full(frames, 50e3), sweep[:, ::-1]),
    )
    runs = [
        made(
            arm, pressure, force, noise=noise, name=name, seed=1000 * seed + which, painted=seed,
            start=2 * which * frames,
        )
        for which, (name, pressure, force) in enumerate(todo)
    ]  # fmt: skip
    return runs[:2], runs[2:]


@cache
def exact() -> tuple[list[RecordingData], list[RecordingData]]:
    """Return the experiments of the paper's arm without any noise."""
    return experiments(paper_arm(), frames=24)


@cache
def noisy() -> tuple[list[RecordingData], list[RecordingData]]:
    """Return the experiments of the paper's arm with noise of the usual size."""
    return experiments(paper_arm(), USUAL, frames=30)


@cache
def lab_run(name: str, frames: int = 60) -> RecordingData:
    """Return a thinned recording of a shipped scenario of the virtual lab."""
    return run_of(simulate(load_scenario(share_path(f'scenarios/{name}.yaml')))).thin(frames)
