"""Make config/lab_arm.yaml, the model that knows the truth about scenarios/lab_arm.yaml.

With it the estimator predicts the virtual arm, as far as no hidden effect is given to that:

    python config/make_lab_arm.py
"""

from __future__ import annotations

from dataclasses import replace
import itertools
from pathlib import Path
import sys

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import save_model
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain

# What the tests share knows the truth of the virtual lab as a model.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from support.lab_run import true_model

SOURCE = 'the truth about scenarios/lab_arm.yaml, an arm invented for the virtual lab; not fitted'
LARGEST = (0.3, 0.3, 0.01)  # N, N, N m: chosen, as the model is the truth under any load
KEYS = ('arm', 'intrinsic_curvature', 'moment_law', 'sensors')


def box(pressure: tuple[float, float]) -> list[tuple[float, ...]]:
    """Return the corners F1, F2, M, p of a box of loads, SI."""
    return list(itertools.product(*((-size, size) for size in LARGEST), pressure))


def lab_model() -> Arm:
    """Return the model of the shipped lab arm."""
    arm = true_model(load_lab(share_path('scenarios/lab_arm.yaml')))
    table = arm.intrinsic_curvature
    rounded = {name: np.round(getattr(table, name), 6) for name in ('arclength', 'curvature')}
    return replace(
        arm,
        intrinsic_curvature=replace(table, **rounded),
        name='lab-arm',
        domain=Domain(pressure=arm.pressure_range, end_load=box(arm.pressure_range)),
        sources=dict.fromkeys(KEYS, SOURCE) | {'domain': 'chosen; the model is the truth'},
        provenance={'source': 'made by config/make_lab_arm.py', 'recordings': []},
    )


if __name__ == '__main__':
    save_model(lab_model(), Path(__file__).with_name('lab_arm.yaml'), overwrite=True)
