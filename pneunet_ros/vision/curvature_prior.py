"""The prior of the curvature of an arm: a Gaussian process.

Curvature is smooth along the arm, except for a break at l1 if the model has one and the arm is
pulled. l1 depends on pressure, which the camera does not measure, so the covariance is averaged
over the positions of l1 in the model. Size and smoothness of the curvature are learned once, by
maximizing the marginal likelihood of shapes predicted by the model. The profile along the arm is
not learned, because measured centerlines are meant to test the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.settings import tuning
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import solve
import scipy

FINE_STATIONS = 449
# Of std, length_scale and break_std in the search (length or 1/length).
BOUNDS = ((0.3, 100.0), (0.1, 3.0), (0.01, 10.0))
START = (1.5, 0.4, 0.15)  # the same, first tried
DIGITS = 2  # of the logarithm of the learned values: unaffected by rounding
SPLITS = 5  # places of l1 over which the covariance is averaged


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorSettings:
    """Settings of the shapes from which a prior is learned."""

    smoother: float = tuning(
        1.75, 'length scale of the smoother shapes', unit='learned', source='sweep'
    )
    learning_std: float = tuning(2e-4, 'noise: a tenth of a pixel', unit='length', source='sweep')
    pressures: int = tuning(6, 'number of pressures over the calibrated range', source='sweep')
    pull: float = tuning(
        2.0, 'end force, as in Table 1', unit='weight', source='literature: paper'
    )
    turns: tuple[float, ...] = tuning(
        (0.0, 0.25, 0.5), 'direction of the pull', unit='angle of the unloaded tip', source='sweep'
    )


PRIOR = PriorSettings()

# Learned values, and the power of the arm's length in their unit.
_LEARNT = ('std', 'length_scale', 'break_std')
_POWERS = np.array([-1.0, 1.0, -1.0])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvaturePrior:
    """Gaussian process of curvature: `std` (1/m), correlated over `length_scale` (m), mean zero.

    On the clamp side of a break there is an additional part, `break_std` (1/m), correlated over
    the same length; the break is at one of `splits` (m) with equal probability; without splits
    there is no break.
    """

    std: float
    length_scale: float
    break_std: float = 0.0
    splits: Array

    def __post_init__(self) -> None:
        """Copy the splits."""
        object.__setattr__(self, 'splits', frozen_array(np.sort(self.splits)))

    def covariance(self, first: Array, second: Array) -> Array:
        """Return the covariance (1/m^2) of curvature at arclengths (n,) and (m,) in m; (n, m)."""
        correlation = np.exp(-0.5 * ((first[:, None] - second) / self.length_scale) ** 2)
        if not self.splits.size:
            return np.asarray(self.std**2 * correlation)
        further = np.maximum(first[:, None], second)
        before = 1.0 - np.searchsorted(self.splits, further, side='right') / self.splits.size
        return np.asarray((self.std**2 + before * self.break_std**2) * correlation)

    def nodes(self, places: Array) -> tuple[Array, Array]:
        """Return nodes (m) and weights (m) for integration over arclength between these places."""
        edges = np.unique(np.concatenate([places, self.splits]))
        half = 0.5 * np.diff(edges)
        middle = 0.5 * (edges[1:] + edges[:-1])
        return (middle[:, None] + half[:, None] * _NODES).ravel(), np.outer(half, _WEIGHTS).ravel()


def twice_integrated(places: Array, nodes: Array, weights: Array) -> Array:
    """Return weights (places, nodes) of the double integral from the first node's cell on."""
    return np.asarray(np.maximum(places[:, None] - nodes, 0.0) * weights)


def gauss_integrals(places: Array, nodes: Array, weights: Array) -> Array:
    """Return weights (places, nodes) of the integral from the first node's cell on."""
    return np.asarray((places[:, None] > nodes) * weights)


def without_line(arclength: Array) -> Array:
    """Return orthonormal combinations (targets, targets - 2) that vanish on straight lines."""
    line = np.column_stack([np.ones_like(arclength), arclength])
    return np.asarray(np.linalg.qr(line, mode='complete')[0][:, 2:])


def learn_priors(arm: Arm, settings: PriorSettings = PRIOR) -> tuple[CurvaturePrior, ...]:
    """Learn a prior of curvature at the targets of the arm; deterministic.

    One prior without a break is for the free arm, one with a break for the pulled arm; a single
    prior serves for both if the moment law has no break. Each prior is repeated for smoother
    shapes, so that shapes are not assumed to be as uneven as the worst one of the model.
    """
    splits = splits_of(arm)
    free, pulled = family(arm, settings)
    if splits.size:
        learned = [
            learn_prior(arm, free, splits[:0], settings),
            learn_prior(arm, pulled, splits, settings),
        ]
    else:
        learned = [learn_prior(arm, free + pulled, splits, settings)]
    smoother = [
        replace(prior, length_scale=settings.smoother * prior.length_scale) for prior in learned
    ]
    return *learned, *smoother


def learn_prior(
    arm: Arm, angles: list[Array], splits: Array, settings: PriorSettings
) -> CurvaturePrior:
    """Return the prior with the largest likelihood for these shapes, given as in `family`.

    The end of the search depends on rounding errors, and thus on the number of threads and on
    compiled kernels. The result is rounded, so that the measured curve does not depend on them.
    """
    targets, length = arm.target_arclength, arm.reach
    line_free = without_line(targets)
    bent = [bent_line(theta, length, targets) @ line_free for theta in angles]
    seen = np.array(bent).reshape(len(bent), -1)
    noise = (settings.learning_std * length) ** 2

    def prior_of(logarithms: Array) -> CurvaturePrior:
        values = np.exp(logarithms) * length ** _POWERS[: logarithms.size]
        named = dict(zip(_LEARNT, values.tolist(), strict=False))
        return CurvaturePrior(**named, splits=splits)

    fitted = 3 if splits.size else 2
    start, bounds = np.log(START), np.log(BOUNDS)
    if not bent:
        return prior_of(start[:fitted])
    nodes, weights = prior_of(start).nodes(targets)
    integral = line_free.T @ twice_integrated(targets, nodes, weights)

    def misfit(logarithms: Array) -> float:
        covariance = integral @ prior_of(logarithms).covariance(nodes, nodes) @ integral.T
        values, vectors = np.linalg.eigh(covariance)
        variance = np.maximum(values, 0.0) + noise
        squares = (seen @ vectors) ** 2
        return float(np.sum(squares / variance) + len(seen) * np.sum(np.log(variance)))

    found = scipy.optimize.minimize(
        misfit, start[:fitted], method='L-BFGS-B', jac='3-point', bounds=bounds[:fitted]
    )
    return prior_of(np.round(found.x, DIGITS))


def splits_of(arm: Arm) -> Array:
    """Return the positions (m) of the break of the moment law; none if there is no break."""
    law = arm.moment_law
    starts = law.sections(law.table_pressures, arm.length, arm.weight)[:, 1:, 0]
    if not starts.size:
        return np.zeros(0)
    return np.unique(np.linspace(starts.min(), starts.max(), SPLITS))


def family(arm: Arm, settings: PriorSettings) -> tuple[list[Array], list[Array]]:
    """Return angles (rad) at FINE_STATIONS of free and pulled shapes over calibrated pressures."""
    weakest, strongest = sorted(arm.pressure_range, key=abs)  # a vacuum is negative
    free, pulled = [], []
    for pressure in np.linspace(weakest, strongest, settings.pressures + 1)[1:].tolist():
        shape = solve(arm, pressure, stations=FINE_STATIONS)
        if not shape.converged:
            continue
        free.append(shape.theta)
        for turn in settings.turns:
            angle = float(shape.theta[0] + turn * (shape.theta[-1] - shape.theta[0]))
            force = (
                settings.pull * arm.weight * math.cos(angle),
                settings.pull * arm.weight * math.sin(angle),
            )
            shape_pulled = solve(arm, pressure, force, stations=FINE_STATIONS)
            if shape_pulled.converged:
                pulled.append(shape_pulled.theta)
    return free, pulled


def bent_line(theta: Array, length: float, arclength: Array) -> Array:
    """Return the integral (m) of the angle along the arm, at arclengths (n,) m."""
    step = length / (theta.size - 1)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * step * (theta[1:] + theta[:-1]))])
    return np.asarray(np.interp(arclength, np.linspace(0.0, length, theta.size), integral))
