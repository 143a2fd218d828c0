"""Test of nonuniform bending between targets as the explanation of an effect.

With a target only at the tip, constant curvature is an assumption, and a departure from it
resembles an effect. `calibration.checks.nonuniformity` adds the departure to the covariance of a
fit; here its linear part, with the same prior, is an additional unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.nonuniformity import linear_departure
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel

LEAST_INFORMATION = 1e-300  # of an effect without any remaining part
FIELD = 'curvature 1 x p'  # of `generic_field`: linear along the arm, proportional to pressure


def nonuniform_columns(linearization: Linearization) -> list[Array]:
    """Return the whitened response to one sigma of departure, (rows, 1) per training run.

    There are none if the curvature is free along the arm.
    """
    parameters = linearization.point.parameters
    if parameters.arclength.size > 2 and parameters.shapes != 1:
        return []
    table = linearization.point.arm.intrinsic_curvature
    risen = abs(float(np.mean(table.curvature[-1] - table.curvature[0])))
    size = linear_departure() * risen
    return [
        block.white(size * block.fields.generic[:, :, [block.fields.names.index(FIELD)]])
        for block in linearization.blocks[: linearization.training]
    ]


def reduce_by_nonuniformity(
    candidates: Sequence[Candidate], gaussian: GaussianModel, columns: list[Array]
) -> list[Candidate]:
    """Reduce the information on effects by nonuniform bending.

    gaussian: of the training runs without these effects; columns: `nonuniform_columns`, possibly
    none.
    """
    if not columns:
        return list(candidates)
    uneven = with_columns(gaussian, columns)
    left = []
    for item in candidates:
        direction = [run[:, None] for run in item.direction]
        information = float(uneven.inner(direction, direction)[0, 0])
        left.append(replace(item, information=max(information, LEAST_INFORMATION)))
    return left


def with_columns(gaussian: GaussianModel, columns: list[Array]) -> GaussianModel:
    """Return the linear problem with one more unknown, with unit prior."""
    return GaussianModel.of(
        [np.concatenate(pair, axis=1) for pair in zip(gaussian.columns, columns, strict=True)],
        gaussian.residuals,
        np.append(gaussian.position, 0.0),
        log_volumes=gaussian.log_volumes,
    )
