"""Arms and loads that many tests use: a plain rod, the paper's arm, Table 1, all effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pneunet_ros.effects.clamp_compliance import ClampCompliance
from pneunet_ros.effects.effect import Effect
from pneunet_ros.effects.extensibility import Extensibility
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.effects.stiffening import Stiffening
from pneunet_ros.files.model_file import load_model
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw, MomentLaw, PiecewiseLinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import SensorNoise

LENGTH = 0.112  # m
STIFFNESS = 1e-3  # N m^2
TIP_MASS = 0.004  # kg
NOISE = SensorNoise(pressure_std=60.0, force_std=1e-3, moment_std=1e-5, target_std=1.2e-4)
PAPER_ARM = Path(__file__).resolve().parents[2] / 'config' / 'paper_arm.yaml'

# Of tests that are not about the domain: loads of 0.6 N and 10 mN m in all directions.
WIDE = Domain(
    pressure=(0.0, 66e3),
    end_load=[
        [f1, f2, m, p]
        for f1 in (-0.6, 0.6)
        for f2 in (-0.6, 0.6)
        for m in (-0.01, 0.01)
        for p in (0.0, 66e3)
    ],
)


class Row(NamedTuple):
    """A row of Table 1: gauge pressure Pa, end force N."""

    pressure: float
    force: tuple[float, float]


TABLE_1 = tuple(
    Row(pressure * 1000, (along, across))
    for pressure, along, across in (
        (0, 0.25, 0),
        (5, 0.25, 0),
        (10.5, 0.225, 0),
        (17.2, 0.2, 0.025),
        (24.2, 0.2, 0.05),
        (31, 0.175, 0.07),
        (37.1, 0.16, 0.1),
        (44.9, 0.15, 0.125),
        (51.5, 0.15, 0.175),
        (53.8, 0.15, 0.2),
        (56.6, 0.15, 0.2),
        (58.2, 0.15, 0.225),
        (61.3, 0.15, 0.25),
        (63.6, 0.15, 0.26),
        (66, 0.15, 0.275),
    )
)

ALL_MECHANICS: tuple[Effect, ...] = (
    Stiffening(coefficient=2e-4),
    Extensibility(axial_stiffness=30.0),
    PressureElongation(strain_per_pascal=1e-6, strain_per_pascal_squared=5e-12),
    Gravity(weight_x=0.4, weight_y=-1.5),
    ClampCompliance(compliance=12.0),
    LoadOffset(offset=0.006),
)


@cache
def paper_arm(effects: tuple[Effect, ...] = ()) -> Arm:
    """Load the shipped model of the paper's arm, with these effects."""
    return with_effects(load_model(PAPER_ARM), effects)


def with_effects(arm: Arm, effects: Sequence[Effect]) -> Arm:
    """Make the same arm with other effects."""
    return rebuilt(arm, effects=tuple(effects))


def heavy(direction: object, tip_mass: float = TIP_MASS, **changes: object) -> Arm:
    """Return the paper's arm with gravity in this direction and a mass at its tip."""
    arm = replace(paper_arm(), gravity=gravity_of(direction), motion=Motion(tip_mass=tip_mass))
    return replace(arm, **changes)  # type: ignore[arg-type]


def rebuilt(arm: Arm, **changes: object) -> Arm:
    """Make the same arm with some of its fields replaced."""
    names = [name for name, item in Arm.__dataclass_fields__.items() if item.init]
    return Arm(**({name: getattr(arm, name) for name in names} | changes))


def plain_arm(
    *,
    curvature: float = 0.0,
    law: MomentLaw | None = None,
    effects: Sequence[Effect] = (),
    clamp_angle: float = 0.0,
    length: float = LENGTH,
) -> Arm:
    """Make a rod of one unloaded curvature (1/m) all along it, at all pressures to 100 kPa."""
    return Arm(
        name='plain',
        length=length,
        weight=0.17,
        clamp_angle=clamp_angle,
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, 100e3], arclength=[0.0, 1.0], curvature=np.full((2, 2), curvature)
        ),
        moment_law=law or LinearLaw(bending_stiffness=STIFFNESS),
        effects=tuple(effects),
        sensors=NOISE,
    )


def two_sections(
    first: float, second: float, split: float = 0.3, offset: tuple[float, float] = (0.0, 0.0)
) -> PiecewiseLinearLaw:
    """Eq 10 at all pressures: rigidities N m^2, split as a share of the length, offsets N m."""
    weight = 0.17
    return PiecewiseLinearLaw(
        pressure=[0.0, 100e3],
        split=[split, split],
        rigidity=[[first / (weight * LENGTH**2), second / (weight * LENGTH**2)]] * 2,
        moment_offset=[[offset[0] / (weight * LENGTH), offset[1] / (weight * LENGTH)]] * 2,
    )


def vacuum_arm() -> Arm:
    """Return the paper's arm as if it bent under vacuum, from -66 kPa to 0."""
    arm = paper_arm()
    law, table = arm.moment_law, arm.intrinsic_curvature
    return replace(
        arm,
        domain=None,
        moment_law=replace(
            law,
            pressure=-law.pressure[::-1],
            split=law.split[::-1],
            rigidity=law.rigidity[::-1],
            moment_offset=law.moment_offset[::-1],
        ),
        intrinsic_curvature=replace(
            table, pressure=-table.pressure[::-1], curvature=table.curvature[::-1]
        ),
    )
