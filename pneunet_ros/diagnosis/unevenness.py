"""How unevenly an arm may bend where the model takes its curvature as constant along it.

With a target at the tip alone a constant curvature is an assumption, and what an arm does beside
it looks like an effect. The departure is linear along the arm, in proportion to the curvature,
with the prior that a calibration considers (`calibration.nonuniformity`).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.calibration.parameters import correlation
from pneunet_ros.calibration.settings import RESOLUTION, ResolutionSettings
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.linearization import Linearization

FIELD = 'curvature 1 x p'  # of `generic_field`: linear along the arm, proportional to pressure
STATIONS, MODES = 41, 4  # along the arm, for the share of a smooth field that is linear


def uneven_columns(
    linearization: Linearization, settings: ResolutionSettings = RESOLUTION
) -> list[Array]:
    """Return what one sigma of unevenness moves, whitened (rows, 1) per training run.

    None of them where the curvature is free along the arm.
    """
    parameters = linearization.point.parameters
    if parameters.arclength.size > 2 and parameters.shapes != 1:
        return []
    arclength = np.linspace(0.0, 1.0, STATIONS)
    linear = np.linalg.pinv(legendre.legvander(2.0 * arclength - 1.0, MODES - 1))[1]
    share = np.sqrt(linear @ correlation(arclength, settings.nonuniform_scale) @ linear)
    table = linearization.point.arm.intrinsic_curvature
    risen = abs(float(np.mean(table.curvature[-1] - table.curvature[0])))
    size = settings.nonuniform * share * risen
    return [
        block.white(size * block.fields.generic[:, :, [block.fields.names.index(FIELD)]])
        for block in linearization.blocks[: linearization.training]
    ]


def log_probability_uneven(gaussian: GaussianModel, columns: list[Array]) -> float:
    """Return the log probability of the training runs where the arm may bend unevenly."""
    return GaussianModel.of(
        [np.concatenate(pair, axis=1) for pair in zip(gaussian.columns, columns, strict=True)],
        gaussian.residuals,
        np.append(gaussian.position, 0.0),
    ).log_probability()
