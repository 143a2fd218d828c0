"""What a calibration is good for, in three sentences: how well, how sure, what next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import shlex

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.reports.paper_views.moment_curvature import law_view
from pneunet_ros.reports.settings import REPORT_SETTINGS, ReportSettings

SECTIONS = ('near the clamp', 'beyond l1')


@dataclass(frozen=True, slots=True, kw_only=True)
class Files:
    """The files of a calibration that a command may name: its model, and the arm it was given."""

    model: str = 'MODEL.yaml'
    arm: str = 'ARM.yaml'


UNKNOWN_FILES = Files()


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """How well the model fits, how sure its numbers are, and what to do next.

    command: to type for it, with capitals for what the user has to fill in.
    """

    fit: str
    certainty: str
    next_step: str
    command: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingStiffness:
    """EI (N m^2) of a section of the arm, '' for all of it, with its std, at a pressure (Pa)."""

    section: str
    value: float
    std: float
    pressure: float


def verdict_of(
    calibration: Calibration,
    settings: ReportSettings = REPORT_SETTINGS,
    *,
    files: Files = UNKNOWN_FILES,
) -> Verdict:
    """Return the verdict on a calibration."""
    joint = calibration.joint
    stiffness = bending_stiffness(joint)
    certainty = 'The bending stiffness was not measured: no recording is under load.'
    if stiffness:
        certainty = f'Bending stiffness EI {stiffness_text(stiffness)}.'
    next_step, command = next_steps(calibration, bool(stiffness), settings, files)
    return Verdict(
        fit=fit_sentence(calibration, settings),
        certainty=certainty,
        next_step=next_step,
        command=command,
    )


def fit_sentence(calibration: Calibration, settings: ReportSettings) -> str:
    """Say how far the model is from what was measured, in mm, in the length, and in its noise."""
    fit = calibration.joint
    if not fit.converged:
        return f'No model: the fit did not settle ({fit.status}).'
    rms = residual_rms(fit)
    share = 100.0 * rms / fit.arm.length
    size = f'{millimeters(rms):.2g} mm rms per coordinate, {share:.2g} % of the length'
    times = noise_ratio(fit)
    if times <= settings.as_noise and varies(calibration):
        return (
            f'The model does not fit: {size}, no more than the noise of single targets, but they '
            'are off together: the stiffness seems to vary along the arm as the moment law cannot.'
        )
    if times <= settings.as_noise:
        larger = larger_under_load(fit)
        if larger <= settings.hidden_under_load and times < settings.below_noise:
            return (
                f'The model fits: {size}, better than the noise that was assumed: {times:.2g} '
                'times it. Standard errors that rest on that noise are too large.'
            )
        if larger <= settings.hidden_under_load:
            return f'The model fits: {size}, as good as the noise.'
        return (
            f'Not sure: {size}. Loaded recordings are left {larger:.2g} times what unloaded ones '
            'are. The noise of force and pressure would make that of an arm that is so soft; the '
            'stiffness may be far too small, or its law another one.'
        )
    return (
        f'The model does not fit: {size}, worse than the noise: {times:.2g} times it. '
        'Something is missing.'
    )


def varies(calibration: Calibration) -> bool:
    """Whether the stiffness varies along the arm, beside the law, so that it matters."""
    return calibration.variation is not None and calibration.variation.matters


def larger_under_load(fit: Fit) -> float:
    """Return the rms that loaded recordings leave, over that of unloaded ones; 0 where unknown."""
    squares: dict[bool, list[float]] = {True: [], False: []}
    for item in fit.runs:
        values = item.residual[item.solved]
        squares[item.run.loaded] += np.square(values[np.isfinite(values)]).tolist()
    if not squares[True] or not any(squares[False]):
        return 0.0
    return math.sqrt(float(np.mean(squares[True])) / float(np.mean(squares[False])))


def residual_rms(fit: Fit) -> float:
    """Return the rms (m) per coordinate that the fit leaves, NaN where no frame was solved."""
    values = np.concatenate([item.residual[item.solved].ravel() for item in fit.runs])
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def noise_ratio(fit: Fit) -> float:
    """Return the rms of the whitened residual, 1 where it is all noise."""
    return math.sqrt(fit.chi_squared / max(fit.dof, 1))


def bending_stiffness(fit: Fit) -> list[BendingStiffness]:
    """Return EI of each section in the middle of the pressures; none without loaded recordings."""
    if not any(item.run.loaded for item in fit.runs):
        return []
    middle = 0.5 * sum(fit.arm.pressure_range)
    view, scale = law_view(fit, np.array([middle])), fit.arm.weight * fit.arm.length**2
    values, stds = (scale * item[0] for item in (view.rigidity, view.rigidity_std))
    names = SECTIONS if values.size > 1 else ('',)
    return [
        BendingStiffness(section=name, value=value, std=std, pressure=middle)
        for value, std, name in zip(values.tolist(), stds.tolist(), names, strict=True)
    ]


def stiffness_text(stiffness: Sequence[BendingStiffness]) -> str:
    """Say EI of each section, at least one, with its standard error."""
    texts = [
        f'{stiffness_with_error(item.value, item.std)} {item.section}'.rstrip()
        for item in stiffness
    ]
    return f'{" and ".join(texts)}, at {kilopascals(stiffness[0].pressure):z.0f} kPa'


def stiffness_with_error(value: float, std: float) -> str:
    """Write a stiffness (N m^2) with its standard error, both in the same power of ten."""
    power = math.floor(math.log10(abs(value))) if value else 0
    scaled, error = value / 10.0**power, std / 10.0**power
    places = 1 if error <= 0.0 else min(max(1 - math.floor(math.log10(error)), 0), 4)
    return f'({scaled:.{places}f} ± {error:.{places}f})e{power} N m^2'


def next_steps(
    calibration: Calibration, loaded: bool, settings: ReportSettings, files: Files
) -> tuple[str, str]:
    """Return what to do next, and the command to type."""
    joint = calibration.joint
    names = shlex.join(item.run.name for item in joint.runs)
    model, arm = shlex.quote(files.model), shlex.quote(files.arm)
    if not joint.converged:
        force = (
            ' and the force is that on the arm, in the base frame (--wrench-sign, --wrench-yaw)'
        )
        return (
            'Look for what these recordings lack, and whether readings and frames have one clock'
            f'{force if loaded else ""}.',
            f'pneunet check {names} --model {arm}',
        )
    if noise_ratio(joint) > settings.as_noise or varies(calibration):
        return (
            'Ask what is missing; hold one recording out.',
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
