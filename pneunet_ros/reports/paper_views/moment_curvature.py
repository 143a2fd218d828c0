"""The paper's analysis: Eqs 9 and 10 from measured shapes, and the fitted law.

M_est(s) comes from measured targets and the load, kappa from the smoothed targets, and straight
lines through M_est over kappa - kappa0 give alpha1,2 and the intercepts M_O1,2. These values are
for illustration only, because differentiated curvature is correlated and smooth across l1, and M_O
cannot be distinguished from kappa0. The numbers in the model file are fitted to the targets
themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import itertools

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.reports.paper_views.steady_states import SteadyState
from pneunet_ros.solver.columns import LOADS, RIGIDITY, START
from pneunet_ros.vision.smoother import Smoother
import scipy

LEAST_TARGETS = 3  # in a section, for a line through it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """M = offset + rigidity (kappa - kappa0) on a section: N m and N m^2, with standard errors.

    start, stop: the section (m).
    """

    start: float
    stop: float
    offset: float
    offset_std: float
    rigidity: float
    rigidity_std: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MomentView:
    """Eq 9 for one steady state, along stations (m) between its first and last seen target.

    The rigid cap is left out. moment: M_est (N m), NaN if the last target was not seen; curvature,
    intrinsic: measured kappa, and kappa0 of the model (1/m, per unstretched length); std: that of
    their difference. lines: Eq 10, one line per section of the fitted law; a section with too few
    targets has none.
    """

    steady_state: SteadyState
    arclength: Array
    moment: Array
    curvature: Array
    intrinsic: Array
    std: Array
    lines: tuple[Line | None, ...]

    @property
    def change(self) -> Array:
        """Measured kappa - kappa0 (1/m)."""
        return np.asarray(self.curvature - self.intrinsic)

    @property
    def has_moment(self) -> bool:
        """Whether M_est is known."""
        return bool(np.isfinite(self.moment[0]))


def moment_view(fit: Fit, smoother: Smoother, steady_state: SteadyState) -> MomentView | None:
    """Return the view of one steady state; None if too few targets were seen for a curve."""
    arm = fit.arm
    curve = smoother.smooth(steady_state.sightings(arm.sensors.target_std))
    if curve is None or curve.arclength.size < 2:
        return None
    s = curve.arclength
    # Straight on from the last target to the free end.
    left = arm.reach - arm.target_arclength[-1]
    tip = (
        steady_state.x[-1] + left * np.cos(curve.theta[-1]),
        steady_state.y[-1] + left * np.sin(curve.theta[-1]),
    )
    f1, f2, moment = steady_state.inputs.loads[0].tolist()
    chamber = float(steady_state.inputs.pressure[0])
    stretch = np.hypot(np.gradient(curve.x, s), np.gradient(curve.y, s))
    intrinsic = arm.intrinsic_curvature.at(chamber, s / arm.length)
    model_std = curvature_std(fit, np.array([chamber]), s / arm.length)[0]
    view = MomentView(
        steady_state=steady_state,
        arclength=s,
        moment=(tip[0] - curve.x) * f2 - (tip[1] - curve.y) * f1 + moment,
        curvature=curve.curvature * stretch,
        intrinsic=intrinsic,
        std=np.hypot(curve.std_curvature, model_std),
        lines=(),
    )
    places = arm.target_arclength[np.isfinite(steady_state.x)]
    return with_lines(view, law_starts(arm, chamber), places)


def law_starts(arm: Arm, pressure: float) -> list[float]:
    """Return the boundaries (m) of the sections of the moment law."""
    known = np.clip([pressure], *arm.pressure_range)
    sections = arm.moment_law.sections(known, arm.length, arm.weight)[0]
    return [*sections[:, START].tolist(), arm.length]


def with_lines(view: MomentView, starts: Sequence[float], targets: Array) -> MomentView:
    """Return a view with a line through each section; targets (m): the seen targets."""
    lines = []
    for start, stop in itertools.pairwise(starts):
        inside = (view.arclength >= start) & (view.arclength < stop)
        count = np.count_nonzero((targets >= start) & (targets < stop))
        lines.append(line(view, inside, int(count), start, stop))
    return replace(view, lines=tuple(lines))


def line(
    view: MomentView, inside: npt.NDArray[np.bool_], targets: int, start: float, stop: float
) -> Line | None:
    """Fit the line through some stations of a view; None with too few targets or no moment.

    The error is in kappa, not in M_est, so kappa - kappa0 is regressed on the moment; the reverse
    would underestimate the rigidity. Standard errors are based on the number of targets, because
    stations between targets add no information.
    """
    if min(targets, int(np.count_nonzero(inside))) < LEAST_TARGETS or not view.has_moment:
        return None
    moment, change = view.moment[inside], view.change[inside]
    weight = targets / np.count_nonzero(inside) / view.std[inside] ** 2
    design = np.column_stack([np.ones_like(moment), moment])
    normal = design.T @ (weight[:, None] * design)
    # Scaled, because a moment is small compared to 1.
    size = np.sqrt(np.diag(normal))
    if size[1] == 0.0 or np.linalg.cond(normal / np.outer(size, size)) > 1e10:
        return None
    covariance = np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)
    shift, compliance = (covariance @ (design.T @ (weight * change))).tolist()
    if compliance == 0.0:
        return None
    slope = np.array([[-1.0 / compliance, shift / compliance**2], [0.0, -1.0 / compliance**2]])
    errors = np.sqrt(np.diag(slope @ covariance @ slope.T))
    return Line(
        start=start,
        stop=stop,
        offset=-shift / compliance,
        offset_std=float(errors[0]),
        rigidity=1.0 / compliance,
        rigidity_std=float(errors[1]),
    )


def curvature_std(fit: Fit, pressure: Array, share: Array) -> Array:
    """Return the standard deviation (n, m) of kappa_p0 (1/m), pressures (n,) Pa x s / l (m,)."""
    covariance = curvature_covariance(fit, pressure, share)
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))


def curvature_weights(fit: Fit, pressure: Array, share: Array) -> Array:
    """Return the derivatives of kappa_p0 at pressures (n,) Pa x s / l (m,), (n, m, parameters)."""
    knots, cells = fit.parameters.arclength, fit.parameters.cells
    rows = unloaded_inputs(pressure).row_weights(fit.arm)
    basis = scipy.interpolate.CubicSpline(knots, np.eye(knots.size))(share)
    out = np.zeros((pressure.size, share.size, fit.values.size))
    out[:, :, :cells] = np.einsum('pr,sk->psrk', rows, basis).reshape(*out.shape[:2], cells)
    return out


def curvature_covariance(fit: Fit, pressure: Array, share: Array) -> Array:
    """Return the covariance (1/m^2) of kappa_p0 along s / l (m,), one per pressure: (n, m, m)."""
    weights = curvature_weights(fit, pressure, share)
    return np.asarray(weights @ fit.covariance @ weights.transpose(0, 2, 1))


def unloaded_inputs(pressure: Array) -> Inputs:
    """Return inputs without load."""
    return Inputs(pressure=pressure, loads=np.zeros((pressure.size, 3)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawView:
    """The fitted moment law over pressure (n,) Pa, dimensionless, with standard deviations.

    rigidity (n, sections): alpha; split (n,): l1 / l, None for a law of one section.
    """

    pressure: Array
    rigidity: Array
    rigidity_std: Array
    split: Array | None
    split_std: Array | None


def law_view(fit: Fit, pressure: Array) -> LawView:
    """Return the moment law of a fit at these pressures."""
    arm, parameters = fit.arm, fit.parameters
    sections = arm.moment_law.sections(pressure, arm.length, arm.weight)
    std = np.zeros(sections.shape)
    jacobian = parameters.input_jacobian(fit.values, unloaded_inputs(pressure))
    by_column = jacobian[:, LOADS + parameters.arclength.size :]
    variance = np.einsum('pcu,uv,pcv->pc', by_column, fit.covariance, by_column)
    for place, (section, column) in enumerate(parameters.law.columns if parameters.law else ()):
        std[:, section, column] = np.sqrt(np.maximum(variance[:, place], 0.0))
    scale = arm.weight * arm.length**2
    two = sections.shape[1] > 1
    return LawView(
        pressure=pressure,
        rigidity=sections[:, :, RIGIDITY] / scale,
        rigidity_std=std[:, :, RIGIDITY] / scale,
        split=sections[:, 1, START] / arm.length if two else None,
        split_std=std[:, 1, START] / arm.length if two else None,
    )
