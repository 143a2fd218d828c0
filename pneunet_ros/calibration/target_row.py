"""Position of the row of targets: offset from the neutral line, and spacing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.disturbances import placement_prior, row_shifts


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetRow:
    """The row of targets, with standard errors.

    offset (m): from the neutral line, positive on the side of E2; spacing: relative error of the
    spacing in the arm file, positive if targets are farther apart.
    """

    offset: float
    offset_std: float
    spacing: float
    spacing_std: float

    @property
    def sentence(self) -> str:
        """Describe the row for users."""
        offset, offset_std = (millimeters(value) for value in (self.offset, self.offset_std))
        text = f'Targets {offset:.3f} ± {offset_std:.3f} mm off the neutral line'
        if self.spacing_std == 0.0:
            return f'{text}.'
        return (
            f'{text}, spacing {100.0 * self.spacing:+.2f} ± {100.0 * self.spacing_std:.2f} % '
            'against the arm file (a wrong scale of the camera looks the same).'
        )


def target_row(fit: Fit) -> TargetRow:
    """Estimate the common offset of the row of targets from the placement of each target.

    Placement is the sum of an error of the row and independent errors of the targets; both have
    normal priors.
    """
    arclength, noise = fit.arm.target_arclength, fit.arm.sensors
    shifts = row_shifts(arclength)
    variance = np.diag([noise.row_spacing_std**2, noise.row_offset_std**2])
    gain = variance @ np.linalg.solve(placement_prior(noise, arclength), shifts).T
    painted = slice(fit.values.size, fit.values.size + 2 * arclength.size)
    known = fit.shared_covariance[painted, painted]
    covariance = variance - gain @ shifts @ variance + gain @ known @ gain.T
    spacing, offset = (gain @ fit.placement.ravel()).tolist()
    spacing_std, offset_std = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    length = float(arclength[-1])
    return TargetRow(
        offset=length * offset,
        offset_std=length * offset_std,
        spacing=spacing,
        spacing_std=spacing_std,
    )
