"""Cross-validation of a calibration with few parameters, by leaving out pressures.

Two baselines without a rod model predict the same points: an arc of the length of the arm whose
curvature is interpolated over the pressure, and plain interpolation of the tip. A note is given if
a baseline predicts at least as well as the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.checks.left_out_recordings import jackknife_excess
from pneunet_ros.calibration.first_curvature import arc_curvature, tip_turns
from pneunet_ros.calibration.low_rank import jacobian_at
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.painted_targets import paint, PaintedTargets
from pneunet_ros.measurement.tip_pose import heading_residual
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.columns import CURVATURE, THETA
import scipy

Places = npt.NDArray[np.complex128]
SAME_LEVEL = 0.003  # of the pressure range: closer readings are averaged
# By convention. No figure of acceptance/sweep.py moves when one of these is halved or doubled.
LEVELS = 10  # largest number of groups of pressures: tenfold cross-validation
FEWEST_LEVELS = 4  # the first, the last and two in between
FRAMES = 300  # in all runs, to limit the CPU time to seconds
AS_WELL = 1.1  # ratio of errors up to which two predictions count as equally good
Refit = Callable[[Sequence[RecordingData]], Fit]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutLevels:
    """Prediction errors at left-out pressures, of the tip (m) or of its heading (rad).

    levels: number of pressures; model, arc, interpolation: rms errors of these predictions;
    changed: change of the prediction when a pressure is left out, relative to its standard error;
    excess (parameters, levels): columns added to the covariance of the fit if it is too small.
    """

    levels: int
    model: float
    arc: float
    interpolation: float
    changed: float
    excess: Array
    is_angle: bool

    @property
    def better(self) -> str:
        """Name the baseline that predicts at least as well as the model; empty if none does."""
        least = min(self.arc, self.interpolation)
        if self.model <= least:
            return ''
        return 'a constant curvature' if least == self.arc else 'interpolation'

    @property
    def sentence(self) -> Note:
        """Describe the errors for users."""
        what = 'heading of the tip' if self.is_angle else 'tip'
        text = (
            f'{self.levels} pressures were left out of the fit in turn. At these, the model '
            f'misses the {what} by {self.shown(self.model)} rms, a constant curvature '
            f'interpolated over the pressure by {self.shown(self.arc)}, and plain interpolation '
            f'of the {what} by '
            f'{self.shown(self.interpolation)}'
        )
        if not self.better:
            return Note(text, reason='left_out_levels')
        if self.model <= AS_WELL * min(self.arc, self.interpolation):
            text = f'{text}: between these pressures, {self.better} does as well'
            return Note(text, reason='as_good_without_model')
        return Note(
            f'{text}: between these pressures, {self.better} does better; run pneunet diagnose to '
            'find the model error',
            reason='better_without_model',
        )

    def shown(self, value: float) -> str:
        """Write an error in mm or degrees."""
        if self.is_angle:
            return f'{math.degrees(value):.2g} degrees'
        return f'{millimeters(value):.2g} mm'


def leave_levels_out(
    runs: Sequence[RecordingData], full: Fit, refit: Refit
) -> LeftOutLevels | None:
    """Refit without each inner part of the pressures, and predict that part.

    runs: unloaded; full: the fit to all runs; refit: fits other runs. None if there are too few
    pressures, or if the tip is not seen.
    """
    share = max(FRAMES // len(runs), 1)
    runs = [run.thin(share) for run in runs]
    pressure = np.concatenate([run.frame_pressure for run in runs])
    part = parts_of(pressure, LEVELS)
    arm, count = full.parameters.frame, int(part.max()) + 1
    tip = np.concatenate([run.x[:, -1] + 1j * run.y[:, -1] for run in runs])
    turn, with_turn = tip_turns(runs, arm)
    is_angle = not np.isfinite(tip).any()
    measured, known = (turn, with_turn) if is_angle else (tip, np.isfinite(tip))
    inner = [index for index in range(1, count - 1) if known[part == index].any()]
    if len(inner) < FEWEST_LEVELS - 2:
        return None
    curvature = turn / arm.reach
    if not is_angle:
        points = np.concatenate([run.x + 1j * run.y for run in runs])
        curvature = arc_curvature(points * np.exp(-1j * arm.clamp_angle), arm.target_arclength)
    errors: dict[str, list[Array]] = {'model': [], 'arc': [], 'interpolation': []}
    squared_change, expected, changes = 0.0, 0.0, list[Array]()
    for index in inner:
        is_left_out, kept = known & (part == index), known & (part != index)
        fitted = refit(without_frames(runs, part == index))
        pressure_out, measured_out = pressure[is_left_out], measured[is_left_out]
        changes.append(fitted.values - full.values)
        predicted, full_prediction = (
            tip_of(fit, pressure_out)[is_angle] for fit in (fitted, full)
        )
        arc = monotone_interpolation(pressure[kept], curvature[kept], pressure_out)
        if is_angle:
            heading_error = heading_residual(turn[is_left_out], predicted.real - arm.clamp_angle)
            predicted_errors = heading_error, measured_out - arc * arm.reach
        else:
            predicted_errors = measured_out - predicted, measured_out - arc_tip(arm, arc)
        interpolation_error = measured_out - monotone_interpolation(
            pressure[kept], measured[kept], pressure_out
        )
        for name, error in zip(errors, (*predicted_errors, interpolation_error), strict=True):
            errors[name].append(np.abs(error))
        squared_change += float(np.sum(np.abs(predicted - full_prediction) ** 2))
        expected += tip_variance(full, pressure_out, is_angle=is_angle)
    rms = {name: float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for name, e in errors.items()}
    if not all(math.isfinite(value) for value in rms.values()):
        return None
    changed = math.sqrt(squared_change / expected) if expected > 0.0 else 1.0
    return LeftOutLevels(
        levels=len(inner),
        changed=changed,
        excess=jackknife_excess(changed, changes),
        is_angle=is_angle,
        **rms,
    )


def parts_of(pressure: Array, most: int) -> Array:
    """Return the index of the pressure part of every frame, (frames,).

    The parts are distinct levels, or equal spans if there are more than `most` levels.
    """
    low, span = float(pressure.min()), float(np.ptp(pressure)) or 1.0
    order = np.sort(pressure)
    borders = order[1:][np.diff(order) > span / (5.0 * most)]
    if 2 <= borders.size < most:
        return np.asarray(np.searchsorted(borders, pressure, side='right'))
    return np.minimum(((pressure - low) / span * most).astype(np.int64), most - 1)


def without_frames(runs: Sequence[RecordingData], left_out: Array) -> list[RecordingData]:
    """Return the runs without the marked frames; the mask covers the frames of all runs."""
    kept, start = list[RecordingData](), 0
    for run in runs:
        frames = len(run.stamp_ns)
        stay = np.flatnonzero(~np.asarray(left_out[start : start + frames], dtype=np.bool_))
        kept += [run.subset(stay)] * bool(stay.size)
        start += frames
    return kept


def monotone_interpolation(pressure: Array, values: Array, at: Array) -> Array:
    """Interpolate the means of values between pressures by a monotone cubic."""
    if np.iscomplexobj(values):
        x, y = (monotone_interpolation(pressure, part, at) for part in (values.real, values.imag))
        return x + 1j * y
    step = SAME_LEVEL * float(np.ptp(pressure)) or 1.0
    levels, level_of = np.unique(np.round(pressure / step), return_inverse=True)
    mean = np.bincount(level_of, values) / np.bincount(level_of)
    mean_pressures = np.bincount(level_of, pressure) / np.bincount(level_of)
    if levels.size == 1:
        return np.full(at.shape, mean[0])
    return np.asarray(
        scipy.interpolate.PchipInterpolator(mean_pressures, mean)(
            np.clip(at, mean_pressures[0], mean_pressures[-1])
        )
    )


def arc_tip(arm: Arm, curvature: Array) -> Places:
    """Return the last target of arcs from the clamp, x + i y (m)."""
    length = float(arm.target_arclength[-1])
    half = 0.5 * length * curvature
    chord = length * np.sinc(half / np.pi)
    return np.array(chord * np.exp(1j * (half + arm.clamp_angle)))


def tip_of(fit: Fit, pressure: Array) -> tuple[Places, Array]:
    """Return the position of the last target, x + i y (m), and the heading there (rad).

    The arm is unloaded. Without an equilibrium, the position is NaN but the heading is not. Target
    placement and camera position are those of the fit.
    """
    model = ForwardModel(fit.arm.target_arclength[[0, -1]])
    inputs = Inputs(pressure=pressure, loads=np.zeros((pressure.size, 3)))
    solved = model.solve(fit.arm, inputs)
    points = np.where(solved[:, None, None], model.points, np.nan)
    heading = np.asarray(model.fields[:, THETA, -1])
    placed = painted_tip(fit, model).displacement[:, 0] + complex(*fit.origin)
    return np.array(points[:, 0, -1] + 1j * points[:, 1, -1] + placed), heading


def painted_tip(fit: Fit, model: ForwardModel) -> PaintedTargets:
    """Return the painted position of the last target in the solved frames of a model."""
    last = model.fields[:, :, -1:]
    return paint(last[:, THETA], last[:, CURVATURE], fit.placement[:, -1:])


def tip_variance(fit: Fit, pressure: Array, *, is_angle: bool) -> float:
    """Return the sum over frames of the variance of `tip_of` (m^2, or rad^2 of the heading)."""
    arm, size, targets = fit.arm, fit.values.size, fit.placement.shape[1]
    inputs = Inputs(pressure=pressure, loads=np.zeros((pressure.size, 3)))
    jacobian = jacobian_at(fit, inputs, arm.target_arclength[[0, -1]]).reshape(-1, 2, 2, size)
    if is_angle:
        variance = np.einsum('fij,jk,fik->', jacobian[:, :, 1], fit.covariance, jacobian[:, :, 1])
        return float(variance) / (0.5 * arm.reach) ** 2
    model = ForwardModel(arm.target_arclength[[0, -1]])
    solved = model.solve(arm, inputs)
    placed = painted_tip(fit, model).jacobian()[solved, :, 0]  # (frames, 2, along and across)
    tip_jacobian = np.concatenate([jacobian[:, :, 1], placed], axis=2)
    rows = [*range(size), size + targets - 1, size + 2 * targets - 1]
    covariance = fit.shared_covariance[np.ix_(rows, rows)]
    return float(np.einsum('fij,jk,fik->', tip_jacobian, covariance, tip_jacobian))
