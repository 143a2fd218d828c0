"""The model with the missing effects: refitted base, and joint covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math

import numpy as np
from pneunet_ros.calibration.low_rank import covariance_root, low_rank, round_numbers
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.result import Fit
from pneunet_ros.diagnosis.fit.hypothesis import Coordinate
from pneunet_ros.diagnosis.fit.refit import Refit, split_numbers
from pneunet_ros.diagnosis.result import Estimated, NamedEffect, Shift
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import ModelCovariance, MOST_COLUMNS

STATIONS = (0.2, 0.5, 0.8)  # s / l, at which shifts of kappa_p0 are reported
SURE = 2.0  # standard errors, tolerance for the length of a unit vector


def fit_with_effects(refit: Refit) -> Fit:
    """Fit the base to the training runs, with the effects fixed at their refitted values."""
    linearization, point = refit.linearization, refit.point
    return fit(
        point.with_effects(),
        linearization.runs[: linearization.training],
        linearization.noise,
        point.arm.target_arclength,
        point.values,
    )


def augment_model(refit: Refit, base: Fit) -> Arm:
    """Return the arm, with a covariance of base and effects together."""
    arm, count = base.arm, len(refit.numbers)
    turned = [run.base_turn_std for run in refit.linearization.runs]
    covariance, _ = low_rank(base, MOST_COLUMNS - count, base_turn_std=max(turned))
    if not count:
        return replace(arm, covariance=covariance)
    names, (_, change) = covariance.quantities, base.parameters.quantities()
    size, scale = refit.linearization.size, refit.linearization.scale
    joint = refit.gaussian.covariance
    own = joint[-count:, -count:]
    root = covariance_root(own)
    numbers = free_numbers(refit)
    stds = np.sqrt(np.diag(refit.covariance))
    slopes = np.array([item.slope(number) for _, item, number in numbers])
    factor = np.zeros((len(names) + count, covariance.factor.shape[1] + count))
    factor[: len(names), :-count] = covariance.factor
    moved = scale @ joint[: len(scale), -count:] @ np.linalg.inv(own) @ root
    factor[: len(change), -count:] = change @ moved[:size]
    factor[len(names) :, -count:] = (slopes * stds / np.sqrt(np.diag(own)))[:, None] * root
    quantities = (*names, *(f'effects.{name}.{item.parameter}' for name, item, _ in numbers))
    factor = round_numbers(factor)
    finite = np.flatnonzero(np.isfinite(factor).all(axis=1))
    placement = covariance.placement
    if placement is not None:
        with_effects = round_numbers(np.hstack([placement.factor, moved[size:]]))
        placement = replace(placement, factor=with_effects)
    return replace(
        arm,
        covariance=ModelCovariance(
            quantities=tuple(quantities[place] for place in finite),
            factor=factor[finite],
            placement=placement,
        ),
    )


def free_numbers(refit: Refit) -> list[tuple[str, Coordinate, float]]:
    """Return the name of the effect, the coordinate and the value of all fitted numbers."""
    parts = split_numbers(refit.hypotheses, refit.numbers)
    return [
        (item.name, coordinate, float(number))
        for item, numbers in zip(refit.hypotheses, parts, strict=True)
        for coordinate, number in zip(item.coordinates, numbers, strict=True)
    ]


def describe_effects(refit: Refit, probability: Mapping[str, float]) -> tuple[NamedEffect, ...]:
    """Return the effects with their parameters and errors, sorted by probability.

    The error of a parameter includes the error of its law, relative to its distance from neutral.
    With several effects, each may also absorb the law errors of the others, which are therefore
    added in full.
    """
    together = math.sqrt(len(refit.hypotheses))
    law_errors = {item.name: together * item.kind.law_error for item in refit.hypotheses}
    parameters: dict[str, dict[str, Estimated]] = {}
    stds = np.sqrt(np.diag(refit.covariance))
    for (name, item, number), std in zip(free_numbers(refit), stds, strict=True):
        value = item.value(number)
        size = value - (0.0 if item.reciprocal or item.shape else item.neutral)
        error = np.hypot(std * abs(item.slope(number)), law_errors[name] * size)
        estimated = Estimated(value=value, std=float(error), unit=item.unit)
        parameters.setdefault(name, {})[item.parameter] = estimated
    effects = [
        NamedEffect(name=name, parameters=values, probability=probability.get(name, 0.0))
        for name, values in parameters.items()
    ]
    return tuple(sorted(effects, key=lambda effect: -effect.probability))


def parameter_shifts(before: Fit, after: Fit) -> dict[str, Shift]:
    """Return the changes of the base: rigidities, split and kappa_p0 at STATIONS."""
    names, change = after.parameters.quantities()
    errors = np.sqrt(np.einsum('ij,jk,ik->i', change, after.covariance, change))
    _, change_before = before.parameters.quantities()
    old = np.full(len(names), np.nan)
    if change_before.shape == change.shape:
        old = change_before @ before.values
    new = change @ after.values
    shown = shown_quantities(after, names)
    return {
        name: Shift(
            before=float(old[place]),
            after=float(new[place]),
            std=float(errors[place]),
            unit='1/m' if name.startswith('intrinsic') else '-',
        )
        for name, place in sorted(zip(names, range(len(names)), strict=True))
        if name in shown
    }


def shown_quantities(fit: Fit, names: tuple[str, ...]) -> set[str]:
    """Return the names of the moment law (first, middle, last row) and kappa_p0 (last row)."""
    law = [name.split('.') for name in names if name.startswith('moment_law.')]
    rows = sorted({int(parts[2]) for parts in law if len(parts) > 2})
    chosen = {str(row) for row in (rows[0], rows[len(rows) // 2], rows[-1])} if rows else set()
    shown = {'.'.join(parts) for parts in law if len(parts) == 2 or parts[2] in chosen}
    last, arclength = fit.parameters.pressure.size - 1, fit.parameters.arclength
    knots = [int(np.argmin(np.abs(arclength - station))) for station in STATIONS]
    return shown | {f'intrinsic_curvature.curvature.{last}.{knot}' for knot in knots}


def direction_notes(arm: Arm, effects: Sequence[NamedEffect]) -> tuple[str, ...]:
    """Describe the direction of gravity that explains the line load equally well; empty: none.

    A line load no larger than the weight of the arm may be this weight, if the direction of
    gravity in the model is wrong. arm: without the effect.
    """
    per_length = arm.weight / arm.length
    for effect in effects:
        if effect.name != Gravity.name:
            continue
        found = [effect.parameters[name] for name in ('weight_x', 'weight_y')]
        known = arm.gravity.x, arm.gravity.y
        x, y = (one.value / per_length + there for one, there in zip(found, known, strict=True))
        std = math.hypot(*(one.std / per_length for one in found))
        if math.hypot(x, y) > 1.0 + SURE * std:
            return ()
        longer = max(math.hypot(x, y), 1.0)
        x, y = x / longer, y / longer
        return (
            f'the line load equals the weight of the arm if gravity points along [{x:.2f}, '
            f'{y:.2f}] ± {std:.1g} instead of [{known[0]:.2f}, {known[1]:.2f}]: is the base '
            f'tilted? Try --gravity={x:.3f},{y:.3f}',
        )
    return ()
