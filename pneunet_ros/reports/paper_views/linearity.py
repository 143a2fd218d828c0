"""Linearity in pressure: kappa_p0 and kappa - kappa0 at four positions (Figure 11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.reports.paper_views.moment_curvature import curvature_weights, MomentView

PLACES = (0.2, 0.4, 0.6, 0.8)  # s / l, as in the paper
FEWEST = 3  # values, for a straight line that can be wrong
NUGGET = 1e-9  # of the largest variance, so that it can be inverted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearity:
    """Values (n,) over pressure (n,) Pa at s / l = place, and the straight line through them.

    value, std, departure (from the line) and departure_std in 1/m; the line is intercept (1/m) +
    slope (1/(m Pa)) p.
    """

    place: float
    pressure: Array
    value: Array
    std: Array
    intercept: float
    slope: float
    departure: Array
    departure_std: Array

    @property
    def largest(self) -> int:
        """The largest departure relative to its standard error."""
        return int(np.argmax(np.abs(self.departure) / self.departure_std))

    @property
    def sigmas(self) -> float:
        """The largest departure in units of its standard error."""
        return float(abs(self.departure[self.largest]) / self.departure_std[self.largest])


def fit_straight_line(
    place: float, pressure: Array, value: Array, covariance: Array
) -> Linearity | None:
    """Fit a straight line to values with a covariance; None for few values or one pressure."""
    if pressure.size < FEWEST or np.ptp(pressure) == 0.0:
        return None
    regular = covariance + NUGGET * np.max(np.diag(covariance)) * np.eye(pressure.size)
    middle, half = pressure.mean(), 0.5 * np.ptp(pressure)
    design = np.column_stack([np.ones(pressure.size), (pressure - middle) / half])
    weighted = np.linalg.solve(regular, design)
    fitter = np.linalg.solve(design.T @ weighted, weighted.T)
    level, trend = (fitter @ value).tolist()
    residual_maker = np.eye(pressure.size) - design @ fitter
    variance = np.diag(residual_maker @ regular @ residual_maker.T)
    return Linearity(
        place=place,
        pressure=pressure,
        value=value,
        std=np.sqrt(np.diag(covariance)),
        intercept=level - trend * middle / half,
        slope=trend / half,
        departure=residual_maker @ value,
        departure_std=np.sqrt(np.maximum(variance, NUGGET * np.max(np.diag(regular)))),
    )


def intrinsic_linearity(fit: Fit) -> tuple[Linearity, ...]:
    """Return kappa_p0 over the rows of its table, at all places."""
    rows = fit.parameters.pressure
    weights = curvature_weights(fit, rows, np.array(PLACES))
    table = fit.arm.intrinsic_curvature
    values = np.array([table.at(float(row), PLACES) for row in rows])
    found = [
        fit_straight_line(
            place, rows, values[:, at], weights[:, at] @ fit.covariance @ weights[:, at].T
        )
        for at, place in enumerate(PLACES)
    ]
    return tuple(item for item in found if item is not None)


def change_linearity(views: Sequence[MomentView], length: float) -> tuple[Linearity, ...]:
    """Return measured kappa - kappa0 over the pressures of one recording, at all places seen.

    The load changes with pressure as in the recording. The error of kappa0 is assumed to be
    independent between pressures.
    """
    found = []
    for place in PLACES:
        at = place * length
        seen = [view for view in views if view.arclength[0] <= at <= view.arclength[-1]]
        pressure = np.array([view.steady_state.pressure for view in seen])
        value = np.array([np.interp(at, view.arclength, view.change) for view in seen])
        std = np.array([np.interp(at, view.arclength, view.std) for view in seen])
        found.append(fit_straight_line(place, pressure, value, np.diag(std**2)))
    return tuple(item for item in found if item is not None)
