"""The model with what was missing: base refitted with the effects, its covariance with theirs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.low_rank import low_rank
from pneunet_ros.calibration.map_estimation import fit
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import MapEstimationSettings
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.refit import Refit, split
from pneunet_ros.diagnosis.result import Estimated, NamedEffect, Shift
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import ModelCovariance, MOST_COLUMNS

LAW_WORTH = 0.05  # of a size: what the plain law of an effect is worth; invented
SETTLED = 0.3  # standard deviations of all: it starts where the joint fit has ended
STATIONS = (0.2, 0.5, 0.8)  # s / l, where shifts of kappa_p0 are shown


def fitted(refit: Refit) -> Fit:
    """Return the base fitted with the effects held at what was found."""
    design, point = refit.design, refit.point
    training = design.runs[: design.training]
    arclength = point.arm.target_arclength
    settings = MapEstimationSettings(small_step=SETTLED)
    parameters = point.with_effects()
    return fit(parameters, training, design.noise, arclength, point.values, settings=settings)


def augmented(refit: Refit, found: Fit) -> Arm:
    """Return the arm, with a covariance of base and effects together."""
    arm, count = found.arm, len(refit.numbers)
    covariance, _ = low_rank(found, MOST_COLUMNS - count)
    if not count:
        return replace(arm, covariance=covariance)
    names, change = found.parameters.quantities()
    design, linear = refit.design, refit.linear
    width = design.scale[: design.size, : design.size]
    whole = linear.covariance
    own = whole[-count:, -count:]
    along = np.linalg.cholesky(own + 1e-12 * np.diag(np.diag(own)))
    across = change @ width @ whole[: design.size, -count:] @ np.linalg.inv(own) @ along
    slopes = slopes_of(refit)
    stds = np.sqrt(np.diag(refit.covariance))
    sizes = (slopes * stds / np.sqrt(np.diag(own)))[:, None] * along
    factor = np.zeros((len(names) + count, covariance.factor.shape[1] + count))
    factor[: len(names), :-count] = covariance.factor
    factor[: len(names), -count:] = across
    factor[len(names) :, -count:] = sizes
    quantities = (*names, *(f'effects.{name}' for name in parameter_names(refit)))
    rounded = np.array([[float(f'{value:.6g}') for value in row] for row in factor])
    finite = [
        place for place, name in enumerate(quantities) if np.all(np.isfinite(rounded[place]))
    ]
    return replace(
        arm,
        covariance=ModelCovariance(
            quantities=tuple(quantities[place] for place in finite), factor=rounded[finite]
        ),
    )


def parameter_names(refit: Refit) -> list[str]:
    """Return dotted names of all numbers of the effects."""
    return [
        f'{item.name}.{coordinate.parameter}'
        for item in refit.hypotheses
        for coordinate in item.coordinates
    ]


def slopes_of(refit: Refit) -> Array:
    """Return how much each parameter changes with its number."""
    parts = split(refit.hypotheses, refit.numbers)
    return np.array(
        [
            coordinate.slope(float(number))
            for item, numbers in zip(refit.hypotheses, parts, strict=True)
            for coordinate, number in zip(item.coordinates, numbers, strict=True)
        ]
    )


def named(refit: Refit, probability: Mapping[str, float]) -> tuple[NamedEffect, ...]:
    """Return the effects with their parameters and errors, the most probable first."""
    stds = np.sqrt(np.diag(refit.covariance)) * np.abs(slopes_of(refit))
    found, place = [], 0
    for item, effect in zip(refit.hypotheses, refit.effects, strict=True):
        parameters = {}
        for coordinate in item.coordinates:
            value = float(getattr(effect, coordinate.parameter))
            size = value - (0.0 if coordinate.reciprocal else coordinate.neutral)
            parameters[coordinate.parameter] = Estimated(
                value=value,
                std=float(np.hypot(stds[place], LAW_WORTH * size)),
                unit=coordinate.unit,
            )
            place += 1
        found.append(
            NamedEffect(
                name=item.name, parameters=parameters, probability=probability.get(item.name, 0.0)
            )
        )
    return tuple(sorted(found, key=lambda one: -one.probability))


def shifts(before: Fit, after: Fit) -> dict[str, Shift]:
    """Return how the base has moved: rigidities, split and kappa_p0 at some stations."""
    names, change = after.parameters.quantities()
    errors = np.sqrt(np.einsum('ij,jk,ik->i', change, after.covariance, change))
    place = {name: which for which, name in enumerate(names)}
    chosen = []
    law = [name for name in names if name.startswith('moment_law.')]
    rows = sorted({int(name.split('.')[2]) for name in law if name.count('.') >= 2})
    for row in {rows[0], rows[len(rows) // 2], rows[-1]} if rows else ():
        chosen += [name for name in law if name.split('.')[2] == str(row)]
    chosen += [name for name in law if name.count('.') == 1]
    parameters = after.parameters
    last = parameters.pressure.size - 1
    for share in STATIONS:
        knot = int(np.argmin(np.abs(parameters.arclength - share)))
        chosen.append(f'intrinsic_curvature.curvature.{last}.{knot}')
    _, same = before.parameters.quantities()
    old = same @ before.values if same.shape == change.shape else np.full(len(names), np.nan)
    new = change @ after.values
    return {
        name: Shift(
            before=float(old[place[name]]),
            after=float(new[place[name]]),
            std=float(errors[place[name]]),
            unit='1/m' if name.startswith('intrinsic') else '-',
        )
        for name in sorted(chosen)
        if name in place
    }
