"""The fitted parameters as one vector: kappa_p0, elongation, and moment law."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from pneunet_ros.calibration import elongation
from pneunet_ros.calibration.moment_law_parameters import MomentLawParameters
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.measurement.forward_model import Columns
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.solver.columns import REST_STRAIN
import scipy

NUGGET = 3e-9  # added to the variance of the prior, relative, so that it can be inverted


@dataclass(frozen=True, slots=True, kw_only=True)
class Hyperparameters:
    """The prior of kappa_p0: a Gaussian process over p and s.

    amplitude (1/m) of the part proportional to pressure, at the highest pressure; std (1/m) of
    the remaining part; both are smooth in s over `length_scale` (relative to the length).
    """

    amplitude: float
    std: float
    length_scale: float


def reference_of(arm: Arm) -> Array:
    """Return the length (m), weight (N) and targets (m) to which the parameters of a fit refer."""
    return np.array([arm.length, arm.weight, *arm.target_arclength])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosteriorState:
    """Mean and covariance of all parameters of a fit: the prior of the next one.

    values (n,) and placement (2 targets,) m, tangents then normals; covariance (n + 2 targets, n +
    2 targets) of both, in this order. Placement is included because the dots stay in place on the
    arm; otherwise, an earlier error of the curvature would count twice.

    pressure (rows,) Pa and arclength (knots,) s / l of the table of kappa_p0; kind and stiffness
    (N m^2) of the moment law's parameters over low to high (Pa), kind '' if none was fitted.
    shapes, elongates: as in `Parameters`, 0 for as many as there are knots. information (n, n):
    information of all recordings so far on the values, without the prior. arm (2 + targets,):
    length (m), weight (N) and places of the targets (m) of the arm, to which values and placement
    refer; None if unknown.
    """

    values: Array
    placement: Array
    covariance: Array
    pressure: Array
    arclength: Array
    kind: str
    stiffness: float
    low: float
    high: float
    information: Array
    shapes: int = 0
    elongates: bool | None = None
    arm: Array | None = None

    def __post_init__(self) -> None:
        """Check that the shapes of the arrays agree."""
        for name in ('pressure', 'arclength', 'values', 'placement'):
            values = getattr(self, name)
            object.__setattr__(self, name, frozen_array(values, (np.size(values),)))
        if self.arm is not None:
            object.__setattr__(self, 'arm', frozen_array(self.arm))
        shape = (self.values.size,) * 2
        object.__setattr__(self, 'information', frozen_array(self.information, shape))
        size = self.values.size + self.placement.size
        object.__setattr__(self, 'covariance', frozen_array(self.covariance, (size, size)))

    def is_of(self, arm: Arm) -> bool:
        """Whether it is of an arm of this length, weight and targets; True if unknown."""
        return self.arm is None or np.array_equal(self.arm, reference_of(arm))

    def has_tip(self, painted: int) -> bool:
        """Whether the last target is the measured tip, added to this many targets."""
        return self.placement.size == 2 * (painted + 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parameters:
    """Curvature at `pressure` (rows,) Pa x `arclength` (knots,) s / l, elongation, moment law.

    `frame` is an arm with everything else; without `law` the arm keeps its own. earlier: mean and
    covariance of the first parameters from an earlier fit, used as the prior. shapes: number of
    values that describe kappa_p0 along the arm at one pressure, 1 for a constant curvature; the
    prior derives the knots from them. None: as many as there are knots. elongates: whether the arm
    lengthens under pressure; if not, the prior fixes the elongation parameters at zero. None:
    there are no such parameters.
    """

    frame: Arm
    pressure: Array
    arclength: Array
    hyperparameters: Hyperparameters
    law: MomentLawParameters | None
    earlier: PosteriorState | None = None
    shapes: int | None = None
    elongates: bool | None = None
    mean: Array = field(init=False)
    prior: Array = field(init=False)

    def __post_init__(self) -> None:
        """Assemble the prior."""
        field_prior = np.kron(self.over_pressure, self.along_arm)
        field_prior += NUGGET * self.hyperparameters.amplitude**2 * np.eye(field_prior.shape[0])
        prior = scipy.linalg.block_diag(field_prior, np.diag(self.over_elongation))
        mean = np.zeros(len(prior))
        if self.law is not None:
            mean = np.concatenate([mean, self.law.mean])
            prior = scipy.linalg.block_diag(prior, self.law.prior)
        if self.earlier is not None:
            size = self.earlier.values.size
            mean[:size] = self.earlier.values
            prior[:size, :] = prior[:, :size] = 0.0
            prior[:size, :size] = self.earlier.covariance[:size, :size]
        object.__setattr__(self, 'mean', frozen_array(mean))
        object.__setattr__(self, 'prior', frozen_array(prior))

    @property
    def over_pressure(self) -> Array:
        """Prior covariance of kappa_p0 at one place, (rows, rows)."""
        rows, prior = self.pressure, self.hyperparameters
        if rows.size == 1:
            return np.full((1, 1), prior.std**2)
        distance = np.subtract.outer(rows, rows) / (0.5 * np.ptp(rows))
        rising = prior.amplitude**2 * np.outer(rows, rows) / np.max(np.abs(rows)) ** 2
        return np.asarray(rising + prior.std**2 * np.exp(-0.5 * distance**2))

    @property
    def along_arm(self) -> Array:
        """Prior correlation of kappa_p0 at one pressure, (knots, knots)."""
        if self.shapes is None:
            return correlation(self.arclength, self.hyperparameters.length_scale)
        places, basis = shape_basis(self.arclength, self.shapes)
        return basis @ correlation(places, self.hyperparameters.length_scale) @ basis.T

    @property
    def over_elongation(self) -> Array:
        """Prior variances of the elongation parameters; empty without them."""
        if self.elongates is None:
            return np.zeros(0)
        std = elongation.prior_std(float(np.max(np.abs(self.pressure))))
        return std**2 * (1.0 if self.elongates else NUGGET)

    @property
    def cells(self) -> int:
        """Number of parameters in the table of curvature."""
        return self.pressure.size * self.arclength.size

    @property
    def before_law(self) -> int:
        """Number of parameters before those of the law."""
        return self.cells + (0 if self.elongates is None else elongation.SIZE)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest values of the parameters, (n,) each."""
        low, high = np.full(self.cells, -np.inf), np.full(self.cells, np.inf)
        if self.elongates is not None:
            shortest, longest = elongation.limits()
            low, high = np.append(low, shortest), np.append(high, longest)
        if self.law is None:
            return low, high
        return np.append(low, self.law.limits[0]), np.append(high, self.law.limits[1])

    def nearest(self, values: Array) -> Array:
        """Return the admissible curvature parameters closest to these (n,)."""
        if self.shapes is None:
            return values
        _, basis = shape_basis(self.arclength, self.shapes)
        table = values[: self.cells].reshape(self.pressure.size, -1)
        table = np.linalg.lstsq(basis, table.T)[0].T @ basis.T
        lengthening = values[self.cells : self.before_law] * bool(self.elongates)
        return np.append(table.ravel(), lengthening)

    def arm(self, values: Array) -> Arm:
        """Return the arm with these values; ModelError if they are invalid."""
        table = self.nearest(values)[: self.cells]  # the nugget of the prior allows other values
        table = table.reshape(self.pressure.size, self.arclength.size)
        curvature = IntrinsicCurvature(
            pressure=self.pressure, arclength=self.arclength, curvature=table
        )
        law = (
            self.frame.moment_law if self.law is None else self.law.law(values[self.before_law :])
        )
        arm = replace(self.frame, intrinsic_curvature=curvature, moment_law=law, covariance=None)
        if not self.elongates:
            return arm
        return elongation.with_elongation(arm, values[self.cells : self.before_law])

    @property
    def columns(self) -> Columns:
        """Columns of the sections that depend on the law, then those of elongation, (k, 2)."""
        columns = [] if self.law is None else list(self.law.columns)
        if self.elongates:
            columns += [(section, REST_STRAIN) for section in range(self.sections)]
        return np.array(columns, dtype=np.int64).reshape(-1, 2)

    @property
    def sections(self) -> int:
        """Number of sections of the moment law."""
        if self.law is not None:
            return self.law.sections
        frame = self.frame
        return int(
            frame.moment_law.sections(self.pressure[:1], frame.length, frame.weight).shape[1]
        )

    def input_jacobian(self, values: Array, inputs: Inputs) -> Array:
        """Return the Jacobian of the rod's inputs, (frames, inputs, parameters).

        Inputs: F1, F2, M, knots, then the columns; see `ForwardModel.jacobian`.
        """
        frames, knots = inputs.pressure.size, self.arclength.size
        columns = self.columns.tolist()
        jacobian = np.zeros((frames, 3 + knots + len(columns), values.size))
        arm = self.arm(values)
        weights = inputs.row_weights(arm)
        for knot in range(knots):
            jacobian[:, 3 + knot, knot : self.cells : knots] = weights
        lengthening = 3 + knots
        if self.law is not None:
            pressure = np.clip(inputs.pressure, *arm.moment_law.pressure_range)
            lengthening += len(self.law.columns)
            jacobian[:, 3 + knots : lengthening, self.before_law :] = self.law.slopes(pressure)
        if self.elongates:
            slopes = elongation.slopes(inputs.pressure)
            jacobian[:, lengthening:, self.cells : self.before_law] = slopes[:, None]
        return jacobian

    def quantities(self) -> tuple[tuple[str, ...], Array]:
        """Return dotted names of the model's numbers and their change per parameter."""
        names = [
            f'intrinsic_curvature.curvature.{row}.{knot}'
            for row in range(self.pressure.size)
            for knot in range(self.arclength.size)
        ]
        changes = [np.eye(self.cells)]
        if self.elongates is not None:
            names += elongation.NAMES if self.elongates else ()
            changes.append(np.eye(elongation.SIZE)[: elongation.SIZE * self.elongates])
        if self.law is not None:
            more, change = self.law.quantities()
            names += more
            changes.append(change)
        return tuple(names), scipy.linalg.block_diag(*changes)


def correlation(places: Array, length_scale: float) -> Array:
    """Return the correlation matrix (n, n) of a smooth process with this length scale."""
    distance = np.subtract.outer(places, places) / length_scale
    return np.asarray(np.exp(-0.5 * distance**2))


def shape_basis(knots: Array, shapes: int) -> tuple[Array, Array]:
    """Return positions s / l (n,) of shapes and their interpolation to the knots, (knots, n)."""
    if shapes == 1:
        return np.array([0.5]), np.ones((knots.size, 1))
    places = np.linspace(0.0, 1.0, shapes)
    return places, np.asarray(scipy.interpolate.CubicSpline(places, np.eye(shapes))(knots))
