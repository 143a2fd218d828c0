"""The same arm and recordings in other sizes: every length, force and pressure times a factor.

Factors that are powers of two keep every digit, so that an algorithm without an absolute size
gives the same numbers to the last bit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pneunet_ros.core.units import quantities
from pneunet_ros.effects.arm_size import ArmSize
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.uncertainty import ModelCovariance, PlacementKnown


class Size(ArmSize):
    """How many times as long, as strong and as pressed an arm is."""

    __slots__ = ()

    def scaled(self, owner: Any, **others: Any) -> Any:
        """Return a dataclass with every quantity in the other size, and other fields as given."""
        sizes = {
            item.name: getattr(owner, item.name) * self.of(item.metadata['unit'])
            for item in quantities(owner)
        }
        return replace(owner, **sizes, **others)

    def arm(self, arm: Arm) -> Any:
        """Return the arm in the other size."""
        curvature = arm.intrinsic_curvature
        law = self.scaled(arm.moment_law)
        if hasattr(law, 'pressure'):
            law = replace(law, pressure=np.asarray(law.pressure) * self.pressure)
        return self.scaled(
            arm,
            target_arclength=arm.target_arclength * self.length,
            intrinsic_curvature=IntrinsicCurvature(
                pressure=np.asarray(curvature.pressure) * self.pressure,
                arclength=curvature.arclength,
                curvature=np.asarray(curvature.curvature) / self.length,
            ),
            moment_law=law,
            effects=tuple(self.scaled(effect) for effect in arm.effects),
            sensors=self.scaled(arm.sensors),
            covariance=None if arm.covariance is None else self.covariance(arm),
            domain=None if arm.domain is None else self.domain(arm.domain),
        )

    def domain(self, domain: Domain) -> Domain:
        """Return the domain in the other size."""
        units = [self.of(unit) for unit in ('N', 'N', 'N m', 'Pa')]
        low, high = domain.pressure
        return Domain(
            pressure=(low * self.pressure, high * self.pressure),
            end_load=domain.end_load * np.array(units),
        )

    def covariance(self, arm: Arm) -> ModelCovariance:
        """Return the covariance of the model in the other size."""
        known = arm.covariance
        assert known is not None
        factors = [self.of(unit_of(arm, name)) for name in known.quantities]
        placement = known.placement
        if placement is not None:
            placement = PlacementKnown(
                mean=placement.mean * self.length,
                std=placement.std * self.length,
                factor=placement.factor * self.length,
            )
        return replace(
            known, factor=known.factor * np.array(factors)[:, None], placement=placement
        )

    def run(self, run: RecordingData) -> RecordingData:
        """Return what the same experiment on the arm of the other size would have recorded."""
        tip, wrench = run.tip_pose, run.wrench
        moment = self.of('N m')
        return replace(
            run,
            pressure=run.pressure * self.pressure,
            force=run.force * self.force,
            moment=run.moment * moment,
            x=run.x * self.length,
            y=run.y * self.length,
            tip_pose=None if tip is None else tip * np.array([self.length, self.length, 1.0]),
            wrench=None if wrench is None else wrench * np.array([self.force] * 2 + [moment]),
        )


def unit_of(arm: Arm, name: str) -> str:
    """Return the unit of a quantity of the model by its dotted name."""
    room, *rest = name.split('.')
    if room == 'intrinsic_curvature':
        return '1/m'
    if room == 'effects':
        effect = next(one for one in arm.effects if one.name == rest[0])
        return next(item.metadata['unit'] for item in quantities(effect) if item.name == rest[1])
    owner = arm.moment_law if room == 'moment_law' else arm
    units = {item.name: item.metadata['unit'] for item in quantities(owner)}
    return str(units.get(rest[0], '-'))
