"""Neighboring arms along each column of the covariance of an arm."""

from __future__ import annotations

from collections.abc import Mapping

from pneunet_ros.core.errors import ModelError
from pneunet_ros.model.arm import Arm

COLUMN_STEP = 0.01  # sigma; step of a central difference along a column of the covariance


def neighbors(arm: Arm, column: Mapping[str, float]) -> tuple[Arm, Arm, float]:
    """Return the arms displaced to both sides along a covariance column, and the step.

    column: change of each quantity by one sigma; the distance is in sigma. A side on which a
    quantity would leave its bounds is replaced by the arm itself. Raises ModelError if this
    happens on both sides.
    """
    sides, distance = [arm, arm], 0.0
    for side, sign in enumerate((-1.0, 1.0)):
        try:
            step = {name: sign * COLUMN_STEP * std for name, std in column.items()}
            sides[side] = arm.with_changes(step)
            distance += COLUMN_STEP
        except ModelError as error:
            reason = error
    if distance == 0.0:
        raise ModelError(
            f'covariance: a column leads out of bounds in both directions: {reason}',
            reason='out_of_bounds',
        )
    return sides[0], sides[1], distance
