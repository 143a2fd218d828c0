"""Uncertainty of sensors and model: a sigma per sensor and a low-rank covariance of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.arrays import Array, table_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.units import check_quantities, quantity

MOST_COLUMNS = 12
STIFFNESS = ('rigidity', 'bending_stiffness', 'modulus')  # of the moment laws
NOT_MEASURED = ('representative', 'not fitted', 'estimated', 'assumed')  # words of `sources`
_POSITIVE = (0.0, 1e9)  # finite: an unmeasured quantity has no sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """One standard deviation of every sensor, SI."""

    pressure_std: float = quantity(unit='Pa', meaning='pressure reading', bounds=_POSITIVE)
    force_std: float = quantity(unit='N', meaning='each force component', bounds=_POSITIVE)
    moment_std: float = quantity(unit='N m', meaning='end moment', bounds=_POSITIVE)
    target_std: float = quantity(unit='m', meaning='target position, white', bounds=_POSITIVE)
    placement_std: float = quantity(
        0.0,
        unit='m',
        meaning=('position of a painted target, rotates with the arm'),
        bounds=_POSITIVE,
    )
    registration_std: float = quantity(
        0.0, unit='m', meaning='position of the camera, per recording', bounds=_POSITIVE
    )
    drift_std: float = quantity(
        0.0, unit='m', meaning='slow drift of the camera', bounds=_POSITIVE
    )
    row_offset_std: float = quantity(
        0.045,
        unit='-',
        meaning='offset of the row of targets from the neutral line, relative to its length',
        bounds=_POSITIVE,
        source="5 of 110 mm: the side wall of the paper's arm is 6 mm from its middle",
    )
    row_spacing_std: float = quantity(
        0.05,
        unit='-',
        meaning='error of the spacing of the targets, relative to the spacing in the arm file',
        bounds=_POSITIVE,
        source='convention: one dot more or less in 20, if dots are painted by hand',
    )
    heading_std: float = quantity(
        0.0, unit='rad', meaning='measured heading of the tip; 0: unknown', bounds=_POSITIVE
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_quantities(self, 'sensors')


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacementKnown:
    """The calibrated placement of the targets.

    mean, std (2 targets,) m: along the arm, then across it, of all targets; factor (2 targets,
    columns) m: change by one sigma of each column of the model's covariance; std: of the remaining
    error. Model and placement are estimated from the same images, so their errors are correlated.
    origin (2,) m: offset of the base frame of these images from the neutral line at the clamp.
    """

    mean: Array
    std: Array
    factor: Array
    origin: Array = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        """Check that the shapes of the arrays agree."""
        for name, dimensions in (('mean', 1), ('std', 1), ('factor', 2), ('origin', 1)):
            where = f'covariance.placement.{name}'
            object.__setattr__(self, name, table_array(getattr(self, name), where, dimensions))
        if self.mean.size % 2 or not self.mean.size == self.std.size == len(self.factor):
            raise ModelError(
                'covariance.placement must have mean, std and rows of factor for every target, '
                f'along and across the arm, not {self.mean.size}, {self.std.size} and '
                f'{len(self.factor)}',
                reason='wrong_shape',
            )
        if self.origin.size != 2:
            raise ModelError(
                'covariance.placement.origin must be two numbers, x and y (m)',
                reason='wrong_shape',
            )
        if np.any(self.std < 0.0):
            raise ModelError(
                'covariance.placement.std must not be negative', reason='out_of_bounds'
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelCovariance:
    """Covariance C = factor factor^T of model quantities, named by dotted paths.

    quantities: names such as `moment_law.rigidity.0.1` or `effects.extensibility.axial_stiffness`;
    factor (quantities, columns), SI, at most 12 columns; placement of the calibrated targets, None
    if unknown. guessed: number of trailing columns that are not constants but model error of a
    size assumed by the calibration.
    """

    quantities: tuple[str, ...]
    factor: Array
    placement: PlacementKnown | None = None
    guessed: int = 0

    def __post_init__(self) -> None:
        """Check the sizes."""
        factor = table_array(self.factor, 'covariance.factor', 2)
        if factor.shape[0] != len(self.quantities) or not 1 <= factor.shape[1] <= MOST_COLUMNS:
            raise ModelError(
                f'covariance.factor must have one row for each of {len(self.quantities)} '
                f'quantities and 1 to {MOST_COLUMNS} columns, not {factor.shape[0]} x '
                f'{factor.shape[1]}',
                reason='wrong_shape',
            )
        if len(set(self.quantities)) != len(self.quantities):
            raise ModelError('covariance.quantities names a quantity twice', reason='given_twice')
        object.__setattr__(self, 'factor', factor)
        if not 0 <= self.guessed <= factor.shape[1]:
            raise ModelError(
                f'covariance.guessed must be 0 to {factor.shape[1]}, the number of columns of '
                f'covariance.factor, not {self.guessed}',
                reason='out_of_bounds',
            )
        if self.placement is not None and self.placement.factor.shape[1] != factor.shape[1]:
            raise ModelError(
                f'covariance.placement.factor must have {factor.shape[1]} columns like '
                f'covariance.factor, not {self.placement.factor.shape[1]}',
                reason='wrong_shape',
            )

    def columns(self) -> tuple[dict[str, float], ...]:
        """Per column, the change of every quantity by one standard deviation."""
        return tuple(
            dict(zip(self.quantities, column.tolist(), strict=True))
            for column in np.asarray(self.factor).T
        )


def error_left_out(covariance: ModelCovariance | None, sources: Mapping[str, str]) -> str:
    """Name the model error that the standard deviations do not include; empty if none.

    covariance, sources: those of the model. The stiffness counts as measured if the covariance
    includes it and no source says otherwise.
    """
    if covariance is None:
        return (
            'the standard deviations do not include the model error, because the model has no '
            'covariance'
        )
    stiffness = tuple(f'moment_law.{name}' for name in STIFFNESS)
    known = any(name.startswith(stiffness) for name in covariance.quantities)
    used = [sources[key] for key in ('moment_law', *stiffness) if key in sources][:1]
    if known and not any(word in text for text in used for word in NOT_MEASURED):
        return ''
    return (
        'the standard deviations do not include the model error under load, because the '
        'stiffness was not measured'
    )
