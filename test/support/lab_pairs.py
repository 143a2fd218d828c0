"""Arms of the virtual lab beside models, for tests that hold the two against each other."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.sensors import LabNoise
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.arm import Arm

NOTHING = dict.fromkeys(
    (
        'pressure_std', 'force_std', 'moment_std', 'target_std', 'placement_std',
        'registration_std', 'drift_std', 'jitter_std', 'dropout', 'occlusions',
    ),
    0.0,
)  # fmt: skip
NOISELESS = LabNoise(**NOTHING)
DEGREE = 60  # of the polynomials that stand for a cubic spline of 11 knots: 1e-7 m at the tip


@cache
def lab_arm_of(arm: Arm) -> LabArm:
    """Return the arm of a model as the lab describes it."""
    table, law = arm.intrinsic_curvature, arm.moment_law
    nodes, weights = legendre.leggauss(200)
    values = np.array([table.at(pressure, 0.5 * (nodes + 1)) for pressure in table.pressure])
    modes = (values * weights) @ legendre.legvander(nodes, DEGREE) * (np.arange(DEGREE + 1) + 0.5)
    return LabArm(
        name=arm.name,
        length=arm.length,
        weight=arm.weight,
        clamp_angle=arm.clamp_angle,
        targets=arm.target_arclength,
        curvature_pressure=table.pressure,
        modes=modes,
        law_pressure=law.pressure,
        split=law.split,
        rigidity=law.rigidity,
    )


@cache
def recorded(name: str) -> LabRecording:
    """Return the recording of a shipped scenario."""
    return simulate(load_scenario(share_path(f'scenarios/{name}.yaml')))
