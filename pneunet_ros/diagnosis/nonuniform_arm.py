"""Whether an arm that bends unevenly, where no target shows it, explains what an effect does.

With a target at the tip alone a constant curvature is an assumption, and what an arm does beside
it looks like an effect. `calibration.nonuniformity` puts the departure into the covariance of a
fit; here its linear part, with the same prior, is one more unknown beside the effects.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.nonuniformity import linear_departure
from pneunet_ros.calibration.settings import RESOLUTION, ResolutionSettings
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.linearization import Linearization

FIELD = 'curvature 1 x p'  # of `generic_field`: linear along the arm, proportional to pressure


def nonuniform_columns(
    linearization: Linearization, settings: ResolutionSettings = RESOLUTION
) -> list[Array]:
    """Return what one sigma of the departure moves, whitened (rows, 1) per training run.

    None of them where the curvature is free along the arm.
    """
    parameters = linearization.point.parameters
    if parameters.arclength.size > 2 and parameters.shapes != 1:
        return []
    table = linearization.point.arm.intrinsic_curvature
    risen = abs(float(np.mean(table.curvature[-1] - table.curvature[0])))
    size = linear_departure(settings) * risen
    return [
        block.white(size * block.fields.generic[:, :, [block.fields.names.index(FIELD)]])
        for block in linearization.blocks[: linearization.training]
    ]


def log_probability_nonuniform(gaussian: GaussianModel, columns: list[Array]) -> float:
    """Return the log probability of the training runs where the arm may bend unevenly."""
    return GaussianModel.of(
        [np.concatenate(pair, axis=1) for pair in zip(gaussian.columns, columns, strict=True)],
        gaussian.residuals,
        np.append(gaussian.position, 0.0),
        log_volumes=gaussian.log_volumes,
    ).log_probability()
