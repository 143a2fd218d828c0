"""Elongation under pressure, fitted together with kappa_p0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantities
from pneunet_ros.effects.arm_size import ArmSize, PAPER_PRESSURE, scaled_prior
from pneunet_ros.effects.pressure_elongation import PressureElongation
from pneunet_ros.model.arm import Arm

FITTED = 'fitted by calibrate together with kappa_p0: it makes the recordings more probable'
KEY = f'effects.{PressureElongation.name}'
PARAMETERS = quantities(PressureElongation)
NAMES = tuple(f'{KEY}.{item.name}' for item in PARAMETERS)
SIZE = len(NAMES)


def prior_std(most: float) -> Array:
    """Return one sigma of the parameters (SIZE,), SI: half of the prior range of the effect.

    most: largest pressure (Pa) of the arm, either sign.
    """
    size = ArmSize(pressure=most / PAPER_PRESSURE)
    return np.array([0.5 * max(map(abs, scaled_prior(item, size))) for item in PARAMETERS])


def limits() -> tuple[Array, Array]:
    """Return the lowest and the highest parameters (SIZE,), SI."""
    bounds = np.array([item.metadata['bounds'] for item in PARAMETERS])
    return bounds[:, 0], bounds[:, 1]


def slopes(pressure: Array) -> Array:
    """Return the rest strain per parameter at pressures (n,) Pa, (n, SIZE)."""
    return np.column_stack([pressure, pressure**2])


def with_elongation(arm: Arm, values: Array) -> Arm:
    """Return the arm with this elongation (SIZE,), SI."""
    numbers = {item.name: float(value) for item, value in zip(PARAMETERS, values, strict=True)}
    return replace(
        arm,
        effects=(*arm.effects, PressureElongation(**numbers)),
        sources={**arm.sources, KEY: FITTED},
    )


def has_given_elongation(arm: Arm) -> bool:
    """Whether the model file has an elongation, which a calibration does not fit."""
    return any(isinstance(effect, PressureElongation) for effect in arm.effects)


def remove_fitted_elongation(arm: Arm) -> Arm:
    """Remove an elongation fitted by an earlier calibration.

    The covariance is removed as well, because it is valid only for the elongating arm.
    """
    if arm.sources.get(KEY) != FITTED:
        return arm
    return replace(
        arm,
        effects=tuple(one for one in arm.effects if not isinstance(one, PressureElongation)),
        sources={key: text for key, text in arm.sources.items() if key != KEY},
        covariance=None,
    )
