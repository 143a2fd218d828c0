"""Jackknife: fits that leave out one loaded recording each, compared with the fit to all.

Leaving out a recording should change the fit by as much as the recording reduces the covariance. A
model error or a wrongly stated load causes a larger change; the excess is added to the covariance.

Source: Efron and Stein, Ann. Statist. 9 (1981).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.calibration.low_rank import COVARIANCE_FRAMES, jacobian_at, run_inputs
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.measurement.forward_model import ForwardModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutRecordings:
    """Changes of a fit when each of some recordings is left out.

    changed: tip displacement in the recording left out, relative to its standard error; excess
    (parameters, recordings): columns added to the covariance if changed is larger than 1.
    """

    recordings: int
    changed: float
    excess: Array

    @property
    def sentences(self) -> list[str]:
        """Describe the changes for users if they exceed the stated errors."""
        if not self.excess.any():
            return []
        return [
            Note(
                f'{self.recordings} loaded recordings were left out of the fit in turn. This '
                f'moves the tip by {self.changed:.2g} times its standard error, so the standard '
                'errors were widened. Check the loads (--end-load, --wrench-sign), then run '
                'pneunet diagnose to find a model error',
                reason='left_out_recordings',
            )
        ]


def leave_recordings_out(full: Fit, without: Sequence[Fit]) -> LeftOutRecordings | None:
    """Compare a fit with fits that leave out one recording each; None if impossible."""
    squared_change, expected, changes = 0.0, 0.0, list[Array]()
    tip = np.array([0.0, full.arm.reach])
    for left_out, fitted in zip(full.runs[-len(without) :], without, strict=True):
        inputs = run_inputs(left_out, COVARIANCE_FRAMES)
        points, solved_by_both = [], np.ones(len(inputs.pressure), dtype=np.bool_)
        for fit in (full, fitted):
            model = ForwardModel(tip)
            solved_by_both &= model.solve(fit.arm, inputs)
            points.append(model.points[:, :, -1])
        squared_change += float(np.sum((points[1] - points[0])[solved_by_both] ** 2))
        jacobian = jacobian_at(full, inputs.subset(np.flatnonzero(solved_by_both)), tip)
        covariance_change = fitted.covariance - full.covariance
        expected += max(float(np.einsum('ij,jk,ik->', jacobian, covariance_change, jacobian)), 0.0)
        changes.append(fitted.values - full.values)
    if not expected > 0.0:
        return None
    changed = math.sqrt(squared_change / expected)
    excess = jackknife_excess(changed, changes)
    return LeftOutRecordings(recordings=len(without), changed=changed, excess=excess)


def jackknife_excess(changed: float, changes: Sequence[Array]) -> Array:
    """Return columns (parameters, parts) to add to the covariance of a fit.

    changed: change of the prediction relative to its standard error; changes: change of the
    parameters (parameters,) when each part is left out.
    """
    count = len(changes)
    weight = max(1.0 - 1.0 / max(changed, 1.0) ** 2, 0.0) * (count - 1) / count
    return math.sqrt(weight) * np.column_stack(changes)
