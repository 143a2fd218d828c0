"""Score test of a stiffness that varies along the arm beyond the moment law.

If EI is larger by a share m(s), the curvature changes by -m (kappa - kappa0) under any load: to
first order this equals a change of the intrinsic curvature. The Jacobian of the curvature table
therefore also gives the effect of a variation of ln EI (a few Legendre polynomials along the arm)
on the targets. The score is that of the linearized fit, with all parameters refitted.

Chi squared over all coordinates is insensitive to a variation of stiffness: a variation that moves
the tip out of its confidence ellipse may move each target by less than its noise, and change chi
squared by only two percent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.calibration.map_estimation import posterior_at
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import STIFFNESS_VARIATION
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.linearization import RunLinearization
from pneunet_ros.measurement.tip_frame import TIP_FRAME
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import CURVATURE, INTRINSIC_CURVATURE

STATIONS = 21  # places along the arm at which a variation is evaluated
HALVINGS = 30  # halvings of an interval: 30 give nine digits
# Of a variation in the NEES of the tip, of 2 coordinates: half of what the mean of tips that are
# covered well enough, 2.6, is beyond 2.
MOST_NEES = 0.3
MOST_ERROR = 0.5  # largest sigma of ln EI by which a law is widened


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipErrors:
    """Displacement of the last target under load by a variation of stiffness, and its error.

    shift (frames, 2) m, with all parameters refitted; jacobian (frames, 2, parameters); covariance
    (frames, 2, 2) m^2 of the model; readings (frames, 2, 2) m^2, the covariance due to their
    noise.
    """

    shift: Array
    jacobian: Array
    covariance: Array
    readings: Array

    def nees(self, added: Array | float = 0.0) -> float:
        """Return the NEES of the tip; added: further covariance (frames, 2, 2) m^2."""
        covariance = self.covariance + self.readings + added
        solved = np.linalg.solve(covariance, self.shift[:, :, None])
        return float(np.mean(np.sum(self.shift[:, :, None] * solved, axis=1)))

    @property
    def rms(self) -> float:
        """Root mean square distance (m)."""
        return float(np.sqrt(np.mean(np.sum(self.shift**2, axis=1))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StiffnessVariation:
    """Test whether the stiffness EI varies along the arm, from loaded frames.

    statistic: reduction of chi squared by `dof` coefficients; coefficients (dof,) of ln EI in
    Legendre polynomials along the arm, from the first degree on; tips: the effect on the tip.
    """

    statistic: float
    dof: int
    coefficients: Array
    tips: TipErrors

    @property
    def matters(self) -> bool:
        """Whether the variation is significant and moves tips out of their confidence ellipses."""
        return self.statistic > STIFFNESS_VARIATION.significant and self.tips.nees() > MOST_NEES

    @property
    def factors(self) -> Array:
        """EI relative to the fitted law (stations,), evenly spaced along the arm."""
        position = np.linspace(-1.0, 1.0, STATIONS)
        return np.exp(legendre.legvander(position, self.dof)[:, 1:] @ self.coefficients)


def stiffness_variation(fit: Fit, noise: SensorNoise) -> StiffnessVariation | None:
    """Test whether EI varies along the arm of a fit; None if the recordings cannot show it."""
    law, loaded = fit.parameters.law, [item.run.loaded for item in fit.runs]
    if law is None or not any(loaded) or not fit.converged or fit.parameters.shapes is not None:
        return None
    posterior, linear = posterior_at(fit, noise)
    prior, modes = posterior.prior, STIFFNESS_VARIATION.modes
    places = np.concatenate([np.arange(prior.size), prior.size + np.arange(fit.disturbance.size)])
    inner, cross = np.zeros((modes, modes)), np.zeros((places.size, modes))
    score = np.zeros(modes)
    for which in np.flatnonzero(loaded):
        run = linear.runs[which]
        run_unknowns = prior.disturbances.of_run(int(which))
        columns = np.concatenate([np.arange(prior.size), prior.size + run_unknowns])
        white = run.whitening(mode_jacobian(fit, run, modes)).reshape(-1, modes)
        fitted = run.whitening(run.jacobian).reshape(len(white), -1)
        inner += white.T @ white
        score += white.T @ run.white_residual.ravel()
        cross[columns] += fitted.T @ white
    cross = prior.scale.T @ cross
    hessian = linear.normal + np.eye(linear.scaled.size)
    solved = np.linalg.solve(hessian, np.column_stack([cross, linear.gradient - linear.scaled]))
    score -= cross.T @ solved[:, -1]
    information = inner - cross.T @ solved[:, :-1]
    known = information + np.eye(modes) / TIP_FRAME.nonuniformity**2
    coefficients = frozen_array(np.linalg.solve(known, score))
    refitted = np.asarray(-prior.scale @ (solved[:, :-1] @ coefficients), np.float64)
    return StiffnessVariation(
        # with the prior of EI, because an unobservable direction has no score
        statistic=float(score @ coefficients),
        dof=modes,
        coefficients=coefficients,
        tips=tip_errors(
            fit,
            [linear.runs[which] for which in np.flatnonzero(loaded)],
            coefficients,
            refitted[: prior.size],
        ),
    )


def mode_jacobian(fit: Fit, run: RunLinearization, modes: int) -> Array:
    """Return the Jacobian of coordinates by Legendre modes of ln EI, (frames, coordinates, modes).

    The modes start at the first degree, since the law fits a uniform change of stiffness.
    """
    parameters, knots = fit.parameters, fit.parameters.arclength
    by_cell = run.jacobian[:, :, : parameters.cells]
    by_knot = by_cell.reshape(*by_cell.shape[:2], -1, knots.size).sum(axis=2)
    places = fit.arm.target_arclength / fit.arm.length
    elastic = run.fields[:, CURVATURE] - run.fields[:, INTRINSIC_CURVATURE]
    elastic_at_knots = np.array(
        [np.interp(knots, places, frame) for frame in np.nan_to_num(elastic)]
    )
    shapes = legendre.legvander(2.0 * knots - 1.0, modes)[:, 1:]
    return np.asarray(-np.einsum('fck,fk,km->fcm', by_knot, elastic_at_knots, shapes))


def tip_errors(
    fit: Fit, runs: list[RunLinearization], coefficients: Array, refitted: Array
) -> TipErrors:
    """Return the displacement of the last target by a variation of ln EI, parameters refitted."""
    size, last = fit.values.size, fit.arm.target_arclength.size - 1
    parts: list[tuple[Array, ...]] = []
    for run in runs:
        tip = np.array([last, 2 * last + 1])
        solved = np.flatnonzero(run.fitted.solved)
        by_mode = mode_jacobian(fit, run, coefficients.size)[np.ix_(solved, tip)]
        jacobian = run.jacobian[np.ix_(solved, tip)][:, :, :size]
        errors = run.errors[np.ix_(solved, tip)]
        shift = by_mode @ coefficients + jacobian @ refitted
        covariance = jacobian @ fit.covariance @ jacobian.transpose(0, 2, 1)
        parts.append((shift, jacobian, covariance, errors @ errors.transpose(0, 2, 1)))
    shift, jacobian, covariance, readings = map(np.concatenate, zip(*parts, strict=True))
    return TipErrors(shift=shift, jacobian=jacobian, covariance=covariance, readings=readings)


def guessed_columns(fit: Fit, variation: StiffnessVariation | None) -> Array:
    """Return error columns (parameters, errors) that cover the tip error of a varying stiffness.

    No parameter of the law can describe such an arm. The stiffness of each section therefore gets
    an independent error, large enough for the tips of the loaded frames to lie in their ellipses,
    and balanced so that the sections together move the tip equally in all possible directions.
    There are no columns if the effect of the variation is negligible.
    """
    if variation is None or not variation.matters:
        return np.zeros((fit.values.size, 0))
    tips, law = variation.tips, fit.parameters.law
    assert law is not None
    scalings = np.zeros((fit.values.size, law.sections))
    law_values = slice(fit.parameters.before_law, None)
    scalings[law_values] = law.scalings(fit.values[law_values])
    by_section = tips.jacobian @ scalings
    mean_square = np.mean(by_section.transpose(0, 2, 1) @ by_section, axis=0)
    sizes, axes = np.linalg.eigh(mean_square)
    per_meter = axes / np.sqrt(np.maximum(sizes, 1e-12 * sizes.max()))
    most = MOST_ERROR / np.abs(per_meter).max(axis=0)
    by_meter = by_section @ per_meter
    low, high = 0.0, float(most.max())
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        moved_by = by_meter * np.minimum(middle, most)
        if tips.nees(moved_by @ moved_by.transpose(0, 2, 1)) > MOST_NEES:
            low = middle
        else:
            high = middle
    return frozen_array(scalings @ per_meter * np.minimum(high, most))


def describe_variation(
    fit: Fit, variation: StiffnessVariation | None, *, law_given: bool
) -> list[Note]:
    """Describe a stiffness that varies along the arm; empty if its effect is negligible.

    law_given: whether the law was requested, so that no other one is suggested.
    """
    if variation is None or not variation.matters:
        return []
    law, factors = fit.parameters.law, variation.factors
    assert law is not None
    ends = sorted((int(np.argmin(factors)), int(np.argmax(factors))))
    first, second = (
        f'{factors[station]:.2f} times the fitted value at s / l = {station / (STATIONS - 1):.2g}'
        for station in ends
    )
    other = ' Try --law piecewise_linear.' if law.sections == 1 and not law_given else ''
    return [
        Note(
            f'the stiffness seems to vary along the arm in a way that the law {law.kind} does '
            f'not allow: as if EI were {first} and {second}. This would lower chi squared by '
            f'{variation.statistic:.0f} (noise alone: by less than '
            f'{STIFFNESS_VARIATION.significant:.0f}) and move the tip of loaded frames by '
            f'{millimeters(variation.tips.rms):.2g} mm rms. A missing effect may look the same: '
            f'see `pneunet diagnose`.{other} The standard errors of the stiffness were widened '
            'to cover the tips under these loads; for other loads this is a guess',
            reason='uneven_stiffness',
        )
    ]
