"""A small calibration to look at: few frames of an arm whose truth is the arm of the paper."""

from __future__ import annotations

from dataclasses import fields, replace
import functools

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.checks.held_out import score
from pneunet_ros.calibration.experiments import LawScore
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.moment_law_parameters import MOMENT_LAW_PARAMETERS
from pneunet_ros.calibration.noise_estimate import NoiseEstimate
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.share import share_path
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import THETA

NOISE = SensorNoise(
    pressure_std=60.0,
    force_std=1e-3,
    moment_std=1e-5,
    target_std=5e-5,
    placement_std=5e-5,
    registration_std=1e-4,
    drift_std=5e-5,
)
FRAMES = 24
TOP = 60e3  # Pa
ARM = load_model(share_path('config/paper_arm.yaml'))


def measured(
    arm: Arm, name: str, pressure: Array, force: Array | None, placement: Array, seed: int
) -> RecordingData:
    """Return a run of an arm with honest noise; force (frames, 2) N, None: nothing attached."""
    rng, frames = np.random.default_rng(seed), pressure.size
    loads = np.zeros((frames, 3))
    if force is not None:
        loads[:, :2] = force
    painted = np.clip(arm.target_arclength + placement[0], 0.0, arm.length)
    series = ForwardModel(painted)
    assert series.solve(arm, Inputs(pressure=pressure, loads=loads)).all()
    cosine, sine = np.cos(series.fields[:, THETA]), np.sin(series.fields[:, THETA])
    along = arm.target_arclength + placement[0] - painted  # beyond the ends of the arm
    place = rng.normal(0.0, NOISE.registration_std, 2)
    points = series.points + place[:, None]
    points[:, 0] += cosine * along - sine * placement[1]
    points[:, 1] += sine * along + cosine * placement[1]
    points += rng.normal(0.0, NOISE.target_std, points.shape)
    points[rng.random((frames, 1, placement.shape[1])).repeat(2, axis=1) < 0.02] = np.nan
    stamps = 1 + 100_000_000 * np.arange(frames)
    read = np.zeros((frames, 2))
    if force is not None:
        read = force + rng.normal(0.0, NOISE.force_std, (frames, 2))
    return RecordingData(
        name=name,
        reading_stamp_ns=stamps,
        pressure=pressure + rng.normal(0.0, NOISE.pressure_std, frames),
        stamp_ns=stamps,
        reading=np.arange(frames),
        loaded=force is not None,
        force=read,
        moment=np.zeros(frames),
        x=points[:, 0],
        y=points[:, 1],
    )


def runs_of(arm: Arm) -> tuple[list[RecordingData], list[RecordingData]]:
    """Return unloaded and loaded runs."""
    size = arm.target_arclength.size
    placement = np.random.default_rng(7).normal(0.0, NOISE.placement_std, (2, size))
    up = np.linspace(0.0, 1.0, FRAMES)
    stairs = np.repeat(np.linspace(0.0, TOP, FRAMES // 4), 4)
    strings = np.column_stack([0.25 - 0.1 * up, 0.25 * up])
    sweep = np.column_stack([0.1 + 0.1 * up, 0.05 + 0.1 * up])
    free = [
        measured(arm, 'bags/ramp.mcap', TOP * up, None, placement, 1),
        measured(arm, 'bags/stairs.mcap', stairs, None, placement, 2),
    ]
    loaded = [
        measured(arm, 'bags/strings.mcap', TOP * up, strings, placement, 3),
        measured(arm, 'bags/sweep.mcap', np.full(FRAMES, 40e3), sweep, placement, 4),
    ]
    return free, loaded


@functools.cache
def calibration(with_load: bool = True) -> Calibration:
    """Return the calibration, made once: fits with few unknowns, begun near the truth."""
    free, loaded = runs_of(ARM)
    frame = replace(ARM, sensors=NOISE)
    rows, knots = np.linspace(-300.0, TOP + 300.0, 4), np.linspace(0.0, 1.0, 7)
    hyperparameters = Hyperparameters(amplitude=50.0, std=5.0, length_scale=0.3)
    law = MOMENT_LAW_PARAMETERS['piecewise_linear'](
        stiffness=1.3e-4,
        low=float(rows[0]),
        high=float(rows[-1]),
        length=ARM.length,
        weight=ARM.weight,
    )
    parts = {
        'frame': frame, 'pressure': rows, 'arclength': knots, 'hyperparameters': hyperparameters
    }  # fmt: skip
    table = np.array([ARM.intrinsic_curvature.at(float(row), knots) for row in rows]).ravel()
    first = fit(Parameters(**parts, law=None), free, NOISE, ARM.target_arclength, table)
    joint, laws = first, ()
    if with_load:
        start = np.concatenate([first.values, law.mean])
        parameters = Parameters(**parts, law=law)
        joint = fit(parameters, [*free, *loaded], NOISE, ARM.target_arclength, start)
        scores = tuple(score(joint.arm, run) for run in loaded)
        laws = tuple(LawScore(kind=kind, scores=scores) for kind in MOMENT_LAW_PARAMETERS)
    covariance, explained_variance = low_rank(joint)
    return Calibration(
        arm=replace(joint.arm, covariance=covariance),
        noise=NoiseEstimate(
            noise=NOISE, sources={item.name: f'source of {item.name}' for item in fields(NOISE)}
        ),
        posterior=joint.posterior(law.low, law.high),
        free=first,
        joint=joint,
        laws=laws,
        explained_variance=explained_variance,
        notes=('a note that says <what> could not be told',),
    )
