"""Fits without some pressures, or without one loaded recording, compared with the whole fit.

Cross-validation over pressures of a calibration with few numbers uses two baselines without a rod
model: an arc of the length of the arm whose curvature is interpolated over the pressure, and plain
interpolation of the tip. It is reported if these do as well.

Two fits, with and without a part, should differ by as much as that part reduces the covariance. A
model error, or a wrongly stated load, makes them differ by more. This excess is added to the
covariance (jackknife).

Source: Efron and Stein, Ann. Statist. 9 (1981).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.first_curvature import arc_curvature, tip_turns
from pneunet_ros.calibration.low_rank import jacobian_at, run_inputs
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import EXPERIMENTS
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.settings import tuning
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
SAME_LEVEL = 0.003  # of the range of the pressures: of what lies nearer, a mean is taken
Refit = Callable[[Sequence[RecordingData]], Fit]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutSettings:
    """Settings of the cross-validation over pressures, and of the comparison with baselines."""

    levels: int = tuning(
        10, 'most groups of pressures', source='convention: tenfold cross-validation'
    )
    fewest: int = tuning(
        4, 'fewest groups of pressures', source='convention: the first, the last and two between'
    )
    frames: int = tuning(300, 'most frames of all runs', source='convention: seconds of CPU')
    as_well: float = tuning(
        1.1,
        'largest ratio of the error to that of a baseline',
        source='convention: a tenth is negligible',
    )


LEFT_OUT = LeftOutSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutLevels:
    """Prediction errors at left-out pressures: of the tip (m), or its heading (rad).

    levels: number of pressures; model, arc, interpolation: rms errors of these predictions;
    changed: change of the prediction by leaving one out, relative to its standard error; excess
    (parameters, levels): columns added to the covariance of the fit if it is too small.
    """

    levels: int
    model: float
    arc: float
    interpolation: float
    changed: float
    excess: Array
    is_angle: bool
    limit: float = LEFT_OUT.as_well

    @property
    def better(self) -> str:
        """Name the baseline that does as well as the model; empty if none does."""
        least = min(self.arc, self.interpolation)
        if self.model <= least:
            return ''
        return 'a constant curvature' if least == self.arc else 'interpolation'

    @property
    def sentence(self) -> Note:
        """Describe it for users."""
        what = 'heading of the tip' if self.is_angle else 'tip'
        text = (
            f'{self.levels} pressures were left out of the fit in turn. There the model misses '
            f'the {what} by {self.shown(self.model)} rms, a constant curvature interpolated over '
            f'the pressure by {self.shown(self.arc)}, and plain interpolation of the {what} by '
            f'{self.shown(self.interpolation)}'
        )
        if not self.better:
            return Note(text, reason='left_out_levels')
        if self.model <= self.limit * min(self.arc, self.interpolation):
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

    runs: unloaded; full: the fit to all of them; refit: fits other runs. None if there are too few
    pressures, or if the tip is not seen.
    """
    share = max(LEFT_OUT.frames // len(runs), 1)
    runs = [run.thin(share) for run in runs]
    pressure = np.concatenate([run.frame_pressure for run in runs])
    part = parts_of(pressure, LEFT_OUT.levels)
    arm, count = full.parameters.frame, int(part.max()) + 1
    tip = np.concatenate([run.x[:, -1] + 1j * run.y[:, -1] for run in runs])
    turn, with_turn = tip_turns(runs, arm)
    is_angle = not np.isfinite(tip).any()
    measured, known = (turn, with_turn) if is_angle else (tip, np.isfinite(tip))
    inner = [index for index in range(1, count - 1) if known[part == index].any()]
    if len(inner) < LEFT_OUT.fewest - 2:
        return None
    bend = turn / arm.reach
    if not is_angle:
        points = np.concatenate([run.x + 1j * run.y for run in runs])
        bend = arc_curvature(points * np.exp(-1j * arm.clamp_angle), arm.target_arclength)
    errors: dict[str, list[Array]] = {'model': [], 'arc': [], 'interpolation': []}
    moved, expected, changes = 0.0, 0.0, list[Array]()
    for index in inner:
        out, kept = known & (part == index), known & (part != index)
        fitted = refit(without_frames(runs, part == index))
        at, there = pressure[out], measured[out]
        changes.append(fitted.values - full.values)
        predicted, before = (tip_of(fit, at)[is_angle] for fit in (fitted, full))
        arc = interpolated(pressure[kept], bend[kept], at)
        if is_angle:
            off = heading_residual(turn[out], predicted.real - arm.clamp_angle)
            left = off, there - arc * arm.reach
        else:
            left = there - predicted, there - arc_tip(arm, arc)
        plain = there - interpolated(pressure[kept], measured[kept], at)
        for name, error in zip(errors, (*left, plain), strict=True):
            errors[name].append(np.abs(error))
        moved += float(np.sum(np.abs(predicted - before) ** 2))
        expected += tip_variance(full, at, is_angle=is_angle)
    rms = {name: float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for name, e in errors.items()}
    if not all(math.isfinite(value) for value in rms.values()):
        return None
    changed = math.sqrt(moved / expected) if expected > 0.0 else 1.0
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
    gaps = order[1:][np.diff(order) > span / (5.0 * most)]
    if 2 <= gaps.size < most:
        return np.asarray(np.searchsorted(gaps, pressure, side='right'))
    return np.minimum(((pressure - low) / span * most).astype(np.int64), most - 1)


def without_frames(runs: Sequence[RecordingData], left_out: Array) -> list[RecordingData]:
    """Return the runs without the marked frames (all frames of all runs,)."""
    kept, start = list[RecordingData](), 0
    for run in runs:
        frames = len(run.stamp_ns)
        stay = np.flatnonzero(~np.asarray(left_out[start : start + frames], dtype=np.bool_))
        kept += [run.subset(stay)] * bool(stay.size)
        start += frames
    return kept


def interpolated(pressure: Array, values: Array, at: Array) -> Array:
    """Interpolate values between pressures by a monotone cubic through the means."""
    if np.iscomplexobj(values):
        x, y = (interpolated(pressure, part, at) for part in (values.real, values.imag))
        return x + 1j * y
    step = SAME_LEVEL * float(np.ptp(pressure)) or 1.0
    levels, which = np.unique(np.round(pressure / step), return_inverse=True)
    mean = np.bincount(which, values) / np.bincount(which)
    places = np.bincount(which, pressure) / np.bincount(which)
    if levels.size == 1:
        return np.full(at.shape, mean[0])
    return np.asarray(
        scipy.interpolate.PchipInterpolator(places, mean)(np.clip(at, places[0], places[-1]))
    )


def arc_tip(arm: Arm, curvature: Array) -> Places:
    """Return the last target of arcs from the clamp, x + i y (m)."""
    length = float(arm.target_arclength[-1])
    half = 0.5 * length * curvature
    chord = length * np.sinc(half / np.pi)
    return np.array(chord * np.exp(1j * (half + arm.clamp_angle)))


def tip_of(fit: Fit, pressure: Array) -> tuple[Places, Array]:
    """Return the position of the last target, x + i y (m), and the heading there (rad).

    It is for the unloaded arm, NaN without an equilibrium; the target placement is that of the
    fit.
    """
    model = ForwardModel(fit.arm.target_arclength[[0, -1]])
    inputs = Inputs(pressure=pressure, loads=np.zeros((pressure.size, 3)))
    solved = model.solve(fit.arm, inputs)
    points = np.where(solved[:, None, None], model.points, np.nan)
    heading = np.asarray(model.fields[:, THETA, -1])
    placed = painted_tip(fit, model).displacement[:, 0] + complex(*fit.origin)
    return np.array(points[:, 0, -1] + 1j * points[:, 1, -1] + placed), heading


def painted_tip(fit: Fit, model: ForwardModel) -> PaintedTargets:
    """Return the painted position of the last target in the frames solved by a model."""
    last = model.fields[:, :, -1:]
    return paint(last[:, THETA], last[:, CURVATURE], fit.placement[:, -1:])


def tip_variance(fit: Fit, pressure: Array, *, is_angle: bool) -> float:
    """Return the sum over frames of the variance of `tip_of` (m^2, or rad^2 of the heading)."""
    arm, size, targets = fit.arm, fit.values.size, fit.placement.shape[1]
    inputs = Inputs(pressure=pressure, loads=np.zeros((pressure.size, 3)))
    jacobian = jacobian_at(fit, inputs, arm.target_arclength[[0, -1]]).reshape(-1, 2, 2, size)
    if is_angle:
        moved = np.einsum('fij,jk,fik->', jacobian[:, :, 1], fit.covariance, jacobian[:, :, 1])
        return float(moved) / (0.5 * arm.reach) ** 2
    model = ForwardModel(arm.target_arclength[[0, -1]])
    solved = model.solve(arm, inputs)
    placed = painted_tip(fit, model).jacobian()[solved, :, 0]  # (frames, 2, along and across)
    whole = np.concatenate([jacobian[:, :, 1], placed], axis=2)
    rows = [*range(size), size + targets - 1, size + 2 * targets - 1]
    covariance = fit.shared_covariance[np.ix_(rows, rows)]
    return float(np.einsum('fij,jk,fik->', whole, covariance, whole))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutRecordings:
    """Changes of a fit when each of some recordings is left out.

    changed: tip displacement in the recording left out, relative to its standard error; excess
    (parameters, recordings): columns added to the covariance if that is larger than 1.
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
    moved, expected, changes = 0.0, 0.0, list[Array]()
    tip = np.array([0.0, full.arm.reach])
    for left_out, fitted in zip(full.runs[-len(without) :], without, strict=True):
        inputs = run_inputs(left_out, EXPERIMENTS.covariance_frames)
        points, both = [], np.ones(len(inputs.pressure), dtype=np.bool_)
        for fit in (full, fitted):
            model = ForwardModel(tip)
            both &= model.solve(fit.arm, inputs)
            points.append(model.points[:, :, -1])
        moved += float(np.sum((points[1] - points[0])[both] ** 2))
        jacobian = jacobian_at(full, inputs.subset(np.flatnonzero(both)), tip)
        more = fitted.covariance - full.covariance
        expected += max(float(np.einsum('ij,jk,ik->', jacobian, more, jacobian)), 0.0)
        changes.append(fitted.values - full.values)
    if not expected > 0.0:
        return None
    changed = math.sqrt(moved / expected)
    excess = jackknife_excess(changed, changes)
    return LeftOutRecordings(recordings=len(without), changed=changed, excess=excess)


def jackknife_excess(changed: float, changes: Sequence[Array]) -> Array:
    """Return the columns (parameters, parts) to be added to the covariance of a fit.

    changed: change of the prediction relative to its standard error; changes (parameters,): of the
    fit without each part.
    """
    count = len(changes)
    more = max(1.0 - 1.0 / max(changed, 1.0) ** 2, 0.0) * (count - 1) / count
    return math.sqrt(more) * np.column_stack(changes)
