"""The arms beside an arm, along each column of its covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.settings import tuning
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferenceSettings:
    """The steps of central differences of the record of a rod."""

    column_step: float = tuning(
        0.01, 'step along a column of the covariance of the model', unit='sigma'
    )
    pressure_step: float = tuning(
        1e-5, 'step of the chamber pressure', unit='of the calibrated range'
    )
    load_step: float = tuning(
        1e-4, 'step of the end load, for what effects make of it', unit='of weight and length'
    )


DEFAULTS = DifferenceSettings()


def neighbors(
    arm: Arm, column: Mapping[str, float], settings: DifferenceSettings = DEFAULTS
) -> tuple[Arm, Arm, float]:
    """Return the arm before and after along a column of its covariance, and how far apart.

    column: by how much each quantity moves in one sigma; the distance is in sigma. A side on which
    a quantity would leave its bounds is the arm itself. Raises ModelError where both would.
    """
    sides, distance = [arm, arm], 0.0
    for side, sign in enumerate((-1.0, 1.0)):
        try:
            step = {name: sign * settings.column_step * std for name, std in column.items()}
            sides[side] = arm.with_changes(step)
            distance += settings.column_step
        except ModelError as error:
            reason = error
    if distance == 0.0:
        raise ModelError(f'covariance: a column leads out of bounds either way: {reason}')
    return sides[0], sides[1], distance
