"""The verdict of a calibration in three sentences: fit, accuracy, next step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import shlex

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.checks.preconditions import has_one_pressure
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import root_mean_square
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.measurement.linearization import FittedRun
from pneunet_ros.measurement.tip_pose import heading_residual
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.reports.paper_views.moment_curvature import law_view
from pneunet_ros.reports.settings import REPORT_SETTINGS
from pneunet_ros.solver.columns import THETA

BELOW_NOISE = 0.7  # times the noise: residuals show that it was overestimated

SECTIONS = ('near the clamp', 'beyond l1')


@dataclass(frozen=True, slots=True, kw_only=True)
class Files:
    """Files of a calibration for the next command: the model, and the given arm file."""

    model: str = 'MODEL.yaml'
    arm: str = 'ARM.yaml'


UNKNOWN_FILES = Files()


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Quality of the fit, accuracy of its parameters, and the next step.

    fits: False if there is no model, or if it misses more than noise. command: of the next step,
    with placeholders in capitals.
    """

    fits: bool
    fit: Note
    certainty: str
    next_step: str
    command: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingStiffness:
    """EI (N m^2) of a section ('': the whole arm) at a pressure (Pa), with its std.

    pressure: None if one number stands for all pressures.
    """

    section: str
    value: float
    std: float
    pressure: float | None


def verdict_of(calibration: Calibration, *, files: Files = UNKNOWN_FILES) -> Verdict:
    """Return the verdict on a calibration."""
    joint = calibration.joint
    stiffness = bending_stiffness(joint)
    certainty = 'The bending stiffness was not measured: no recording is under load.'
    if stiffness:
        certainty = f'Bending stiffness EI {stiffness_text(stiffness)}.'
    next_step, command = next_steps(calibration, bool(stiffness), files)
    return Verdict(
        fits=joint.converged and not exceeds_noise(calibration),
        fit=fit_sentence(calibration),
        certainty=certainty,
        next_step=next_step,
        command=command,
    )


def exceeds_noise(calibration: Calibration) -> bool:
    """Whether the residuals exceed the noise or are correlated along the arm."""
    return not calibration.joint.as_noise or varies(calibration)


def fit_sentence(calibration: Calibration) -> Note:
    """Describe the error of the model in mm, relative to the length and to the noise."""
    fit = calibration.joint
    if not fit.converged:
        return Note(f'No model: the fit did not converge ({fit.status}).', reason='not_settled')
    rms = residual_rms(fit)
    share = 100.0 * rms / fit.arm.length
    size = (
        f'{millimeters(rms):.2g} mm rms per coordinate of all targets, {share:.2g} % of the length'
        f'{tip_text(fit)}'
    )
    if math.isnan(rms):
        size = f'{math.degrees(heading_rms(fit.runs)):.2g} degrees rms of the heading of the tip'
    times = fit.noise_ratio
    if fit.as_noise and varies(calibration):
        return Note(
            f'The model does not fit: {size}, no more than the noise of single targets, but the '
            'errors of neighboring targets are correlated: the stiffness seems to vary along the '
            'arm in a way that the moment law does not allow.',
            reason='uneven_stiffness',
        )
    if fit.as_noise:
        larger = loaded_residual_ratio(fit)
        if larger <= REPORT_SETTINGS.hidden_under_load and times < BELOW_NOISE:
            return Note(
                f'The model fits: {size}, better than the assumed noise ({times:.2g} times it). '
                'Standard errors that rest on that noise are too large.',
                reason='better_than_noise',
            )
        if larger <= REPORT_SETTINGS.hidden_under_load:
            return Note(f'The model fits: {size}, as good as the noise.', reason='fits')
        return Note(
            f'Not sure: {size}. The residuals of loaded recordings are {larger:.2g} times those '
            'of unloaded ones. Noise of force and pressure could explain this for such a soft '
            'arm, but the stiffness may also be far too small, or its law may be wrong.',
            reason='unsure',
        )
    return Note(
        f'The model does not fit: {size}, worse than the noise ({times:.2g} times it). An effect '
        'is missing, or the noise is correlated from frame to frame (smoothed tracks).',
        reason='misfit',
    )


def tip_text(fit: Fit) -> str:
    """Describe the error of the last target (rms distance)."""
    rms = last_target_rms(fit.runs)
    return '' if math.isnan(rms) else f', the last target {millimeters(rms):.2g} mm'


def heading_rms(runs: Sequence[FittedRun]) -> float:
    """Return the rms (rad) of the tip heading in these runs; NaN if unknown."""
    residuals = [
        heading_residual(item.run.heading, item.fields[:, THETA, -1])[item.solved]
        for item in runs
        if item.run.heading is not None
    ]
    return root_mean_square(np.concatenate([*residuals, np.zeros(0)]))


def last_target_rms(runs: Sequence[FittedRun]) -> float:
    """Return the rms distance (m) of the last target in these runs; NaN if not seen."""
    distances = [np.hypot(*item.residual[item.solved][:, :, -1].T) for item in runs]
    return root_mean_square(np.concatenate(distances))


def varies(calibration: Calibration) -> bool:
    """Whether the variation of stiffness along the arm is relevant."""
    return calibration.variation is not None and calibration.variation.matters


def loaded_residual_ratio(fit: Fit) -> float:
    """Return the residual rms of loaded over that of unloaded recordings; 0 if unknown."""
    squares: dict[bool, list[float]] = {True: [], False: []}
    for item in fit.runs:
        values = item.residual[item.solved]
        squares[item.run.loaded] += np.square(values[np.isfinite(values)]).tolist()
    if not squares[True] or not any(squares[False]):
        return 0.0
    return math.sqrt(float(np.mean(squares[True])) / float(np.mean(squares[False])))


def residual_rms(fit: Fit) -> float:
    """Return the residual rms (m) per coordinate, NaN where no frame was solved."""
    return root_mean_square(
        np.concatenate([item.residual[item.solved].ravel() for item in fit.runs])
    )


def bending_stiffness(fit: Fit) -> list[BendingStiffness]:
    """Return EI of each section in the middle of the pressures; none without loaded recordings.

    A single stiffness fitted at several pressures belongs to none of them.
    """
    if not any(item.run.loaded for item in fit.runs):
        return []
    middle = 0.5 * sum(fit.arm.pressure_range)
    single = isinstance(fit.arm.moment_law, LinearLaw)
    of_all = single and not has_one_pressure([item.run for item in fit.runs], fit.arm)
    view, scale = law_view(fit, np.array([middle])), fit.arm.weight * fit.arm.length**2
    values, stds = (scale * item[0] for item in (view.rigidity, view.rigidity_std))
    names = SECTIONS if values.size > 1 else ('',)
    return [
        BendingStiffness(section=name, value=value, std=std, pressure=None if of_all else middle)
        for value, std, name in zip(values.tolist(), stds.tolist(), names, strict=True)
    ]


def stiffness_text(stiffness: Sequence[BendingStiffness]) -> str:
    """Describe EI of each section with its standard error."""
    texts = [f'{one_stiffness(item)} {item.section}'.rstrip() for item in stiffness]
    pressure = stiffness[0].pressure
    if pressure is None:
        return (
            f'{texts[0]}, one number for all pressures (near that where the loads bend the arm '
            'most; the error leaves out its change with pressure)'
        )
    return f'{" and ".join(texts)}, at {kilopascals(pressure):z.0f} kPa'


def one_stiffness(item: BendingStiffness) -> str:
    """Return a stiffness with its error as text, or an upper bound if the error is larger."""
    if item.std < abs(item.value):
        return stiffness_with_error(item.value, item.std)
    most = abs(item.value) + 2.0 * item.std
    return f'not determined by these recordings (below {most:.2g} N m^2)'


def stiffness_with_error(value: float, std: float) -> str:
    """Write a stiffness (N m^2) with its standard error, both in the same power of ten."""
    power = math.floor(math.log10(abs(value))) if value else 0
    scaled, error = value / 10.0**power, std / 10.0**power
    places = 1 if error <= 0.0 else min(max(1 - math.floor(math.log10(error)), 0), 4)
    return f'({scaled:.{places}f} ± {error:.{places}f})e{power} N m^2'


def next_steps(calibration: Calibration, loaded: bool, files: Files) -> tuple[str, str]:
    """Return the next step and its command."""
    joint = calibration.joint
    names = shlex.join(item.run.name for item in joint.runs)
    model, arm = shlex.quote(files.model), shlex.quote(files.arm)
    if not joint.converged:
        force = (
            ' and whether the readings are the force on the arm, in the base frame '
            '(--wrench-sign, --wrench-yaw)'
        )
        return (
            'Check these recordings for gaps, and whether readings and frames share a '
            f'clock{force if loaded else ""}.',
            f'pneunet check {names} --model {arm}',
        )
    if exceeds_noise(calibration):
        return (
            'Look for a missing effect; hold one recording out.',
            f'pneunet diagnose --model {model} --train {names} --heldout FRESH.mcap --output DIR',
        )
    if not loaded:
        return (
            'Record the arm under end loads, and calibrate again with both.',
            f'pneunet calibrate --unloaded {names} --loaded LOADED.mcap --arm {arm} '
            '--output NEW.yaml',
        )
    return (
        'Test the model on a recording that it has not seen.',
        f'pneunet replay FRESH.mcap --model {model}',
    )
