"""Arms, pressures and end loads at random, over all that the solver has to take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.stiffening import Stiffening
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from pneunet_ros.model.uncertainty import SensorNoise

NOISE = SensorNoise(pressure_std=60.0, force_std=1e-3, moment_std=1e-5, target_std=1e-4)


@dataclass(frozen=True, kw_only=True)
class Case:
    """An arm with what acts on it: gauge pressure Pa, end force N, end moment N m."""

    arm: Arm
    pressure: float
    force: tuple[float, float]
    moment: float


def random_case(seed: int, *, negative: bool = True, strongest: float = 0.5) -> Case:
    """Draw a case: every mechanical effect on or off, rigidities 1e-5 to 1e-2 N m^2."""
    draw = np.random.default_rng(seed)
    length = 0.112
    weight = 0.17
    rigidity = 10 ** draw.uniform(-5, -2, 2)
    if negative:
        rigidity *= draw.choice([-1.0, 1.0], 2)
    columns = 7
    bent = draw.uniform(0, 30) * (1 + draw.uniform(-0.5, 0.5, columns))
    law = PiecewiseLinearLaw(
        pressure=[0.0, 66e3],
        split=draw.uniform(0.05, 0.9, 2),
        rigidity=np.outer([1.0, draw.uniform(1.0, 1.3)], rigidity / (weight * length**2)),
        moment_offset=draw.choice([0.0, 1.0]) * draw.normal(0, 0.005, (2, 2)),
    )
    possible = [
        Stiffening(coefficient=float(draw.uniform(0, 1e-3))),
        Extensibility(axial_stiffness=float(10 ** draw.uniform(0.7, 2.7))),
        PressureElongation(
            strain_per_pascal=float(draw.uniform(-1e-6, 5e-6)),
            strain_per_pascal_squared=float(draw.uniform(-1e-11, 1e-11)),
        ),
        Gravity(weight_x=float(draw.uniform(-3, 3)), weight_y=float(draw.uniform(-3, 3))),
        ClampCompliance(compliance=float(draw.uniform(0, 20))),
        LoadOffset(offset=float(draw.uniform(-0.012, 0.012))),
    ]
    arm = Arm(
        name='random',
        length=length,
        weight=weight,
        clamp_angle=float(draw.uniform(-1, 1)),
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, 66e3],
            arclength=np.linspace(0, 1, columns),
            curvature=[np.zeros(columns), bent],
        ),
        moment_law=law,
        effects=tuple(effect for effect in possible if draw.random() < 0.5),
        sensors=NOISE,
    )
    size, angle = draw.uniform(0, strongest), draw.uniform(-np.pi, np.pi)
    return Case(
        arm=arm,
        pressure=float(draw.uniform(0, 66e3)),
        force=(float(size * np.cos(angle)), float(size * np.sin(angle))),
        moment=float(draw.choice([0.0, 1.0]) * draw.uniform(-5e-3, 5e-3)),
    )
