"""The parameters of the moment laws as vectors of numbers, one class per law."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
import functools
from typing import ClassVar

import numpy as np
from pneunet_ros.calibration.settings import MOMENT_LAW
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.model.moment_law import LinearLaw, MajidiLaw, MomentLaw, PiecewiseLinearLaw
from pneunet_ros.solver.columns import RIGIDITY, START
import scipy

SPLIT_ROWS = 14
KEPT = 64  # Jacobians of laws
ALPHAS = 6  # parameters of both rigidities
LEAST_SPLIT = 0.02  # l1 / l: a bound that no fit of acceptance/sweep.py reaches
MOST_SPLIT = 0.9  # l1 / l, also a bound


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MomentLawParameters(abc.ABC):
    """Parameters of one kind of moment law, with a weak prior.

    mean (n,) and prior (n, n) covariance; stiffness is a first guess of EI (N m^2). given: the law
    of the arm file, for constants that are not fitted.
    """

    kind: ClassVar[str]
    columns: ClassVar[tuple[tuple[int, int], ...]]  # of the sections changed by the parameters
    stiffness: float
    low: float
    high: float
    length: float
    weight: float
    given: MomentLaw | None = None

    mean: Array = field(init=False)
    prior: Array = field(init=False)

    @abc.abstractmethod
    def law(self, values: Array) -> MomentLaw:
        """Return the law with these constants; ModelError if they are invalid."""

    def slopes(self, pressure: Array) -> Array:
        """Return the derivatives of the columns that depend on the law, (n, columns, parameters).

        All of these laws are linear in their parameters, so the derivatives do not depend on their
        values; pressure (n,) Pa. The last results are cached, because recordings are evaluated
        repeatedly.
        """
        return slopes_at(self, pressure.tobytes())

    @property
    def sections(self) -> int:
        """The number of sections, each with its own stiffness."""
        return 1

    def scalings(self, values: Array) -> Array:
        """Return the derivatives of parameters (n,) by ln EI of each section, (n, sections).

        For a law with a given part of EI, such as Majidi's, the derivatives are by the fitted
        part.
        """
        return values[:, None]

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest values of the parameters, (n,) each."""
        return np.full(self.mean.size, -np.inf), np.full(self.mean.size, np.inf)

    @abc.abstractmethod
    def quantities(self) -> tuple[tuple[str, ...], Array]:
        """Return the numbers of the model file that change, and their change per parameter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseParameters(MomentLawParameters):
    """Eq 10: a line in pressure and a small bow for alpha1 and for alpha2; l1 / l in rows.

    The paper regresses the rigidities linearly in pressure; the bow avoids overconfident errors of
    that line. Unknowns per section: alpha at the lower and upper end of the range, and its excess
    over the line in the middle. The split may have kinks. M_O is zero, because it cannot be
    distinguished from kappa0.
    """

    kind: ClassVar[str] = PiecewiseLinearLaw.kind
    columns: ClassVar[tuple[tuple[int, int], ...]] = ((0, RIGIDITY), (1, RIGIDITY), (1, START))
    rows: Array = field(init=False)

    def __post_init__(self) -> None:
        """Set up rows and prior."""
        rows = np.linspace(self.low, self.high, SPLIT_ROWS)
        alpha = self.stiffness / (self.weight * self.length**2)
        trend = (rows - rows.mean()) / (self.high - self.low)
        wave = np.exp(-np.abs(np.subtract.outer(trend, trend)) / MOMENT_LAW.split_scale)
        split = (
            MOMENT_LAW.split_std**2 * (1.0 + np.outer(trend, trend))
            + MOMENT_LAW.split_wave_std**2 * wave
        )
        prior = np.zeros((ALPHAS + SPLIT_ROWS,) * 2)
        # alpha at either end of the range: an unknown size, and an unknown change over the range
        ends = 1.0 + 0.25 * np.array([[1, -1], [-1, 1]])
        section = alpha**2 * scipy.linalg.block_diag(ends, MOMENT_LAW.bow_std**2)
        prior[:ALPHAS, :ALPHAS] = np.kron(np.eye(2), section)
        prior[ALPHAS:, ALPHAS:] = split
        mean = np.array([alpha, alpha, 0.0] * 2 + [MOMENT_LAW.split] * SPLIT_ROWS)
        object.__setattr__(self, 'rows', frozen_array(rows))
        object.__setattr__(self, 'mean', frozen_array(mean))
        object.__setattr__(self, 'prior', frozen_array(prior))

    @property
    def weights(self) -> Array:
        """Weights of the parameters of a section in the rows, (rows, 3)."""
        upper = (self.rows - self.low) / (self.high - self.low)
        return np.column_stack([1.0 - upper, upper, 4.0 * upper * (1.0 - upper)])

    @property
    def sections(self) -> int:
        """The number of sections: one on each side of the split."""
        return 2

    def scalings(self, values: Array) -> Array:
        """Return the derivatives of parameters (n,) by ln EI of each section, (n, sections)."""
        scalings = np.zeros((values.size, 2))
        for section in range(2):
            rows = slice(3 * section, 3 * section + 3)
            scalings[rows, section] = values[rows]
        return scalings

    @property
    def limits(self) -> tuple[Array, Array]:
        """Limits of the parameters, including those of the split."""
        low, high = np.full(self.mean.size, -np.inf), np.full(self.mean.size, np.inf)
        low[ALPHAS:], high[ALPHAS:] = LEAST_SPLIT, MOST_SPLIT
        return low, high

    def law(self, values: Array) -> PiecewiseLinearLaw:
        """Return Eq 10 with these constants."""
        return PiecewiseLinearLaw(
            pressure=self.rows,
            split=np.clip(values[ALPHAS:], LEAST_SPLIT, MOST_SPLIT),
            rigidity=self.weights @ values[:ALPHAS].reshape(2, 3).T,
            moment_offset=np.zeros((SPLIT_ROWS, 2)),
        )

    def quantities(self) -> tuple[tuple[str, ...], Array]:
        """Rigidities and splits of all rows."""
        names = [f'moment_law.rigidity.{row}.{i}' for row in range(SPLIT_ROWS) for i in range(2)]
        names += [f'moment_law.split.{row}' for row in range(SPLIT_ROWS)]
        change = np.zeros((3 * SPLIT_ROWS, ALPHAS + SPLIT_ROWS))
        for i in range(2):
            change[i : 2 * SPLIT_ROWS : 2, 3 * i : 3 * i + 3] = self.weights
        change[2 * SPLIT_ROWS :, ALPHAS:] = np.eye(SPLIT_ROWS)
        return tuple(names), change


LEAST_SHARE = 1e-3  # of the initial stiffness: a lower bound for soft arms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OneConstantParameters(MomentLawParameters):
    """A law with one fitted constant, which is positive."""

    columns: ClassVar[tuple[tuple[int, int], ...]] = ((0, RIGIDITY),)
    constant: ClassVar[str]  # as in the model file

    def __post_init__(self) -> None:
        """Set up the prior."""
        object.__setattr__(self, 'mean', frozen_array([self.guess]))
        object.__setattr__(self, 'prior', frozen_array([[self.guess**2]]))

    @property
    @abc.abstractmethod
    def guess(self) -> float:
        """The constant that gives the guessed stiffness at zero pressure."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """Limits of the constant, which is positive."""
        return LEAST_SHARE * self.mean, np.array([np.inf])

    def quantities(self) -> tuple[tuple[str, ...], Array]:
        """Return the constant."""
        return (f'moment_law.{self.constant}',), np.eye(1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearParameters(OneConstantParameters):
    """M = EI (kappa - kappa0): one stiffness."""

    kind: ClassVar[str] = LinearLaw.kind
    constant: ClassVar[str] = 'bending_stiffness'

    @property
    def guess(self) -> float:
        """The guessed stiffness."""
        return self.stiffness

    def law(self, values: Array) -> LinearLaw:
        """Return the law with this stiffness."""
        return LinearLaw(bending_stiffness=float(values[0]))


# For an arm file without a cross-section, m
PAPER_SECTION = {'width': 0.015, 'thickness': 0.003, 'height': 0.012, 't1': 0.002, 't2': 0.008}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MajidiParameters(OneConstantParameters):
    """Eq 11: one elastic modulus; kappa0 is fitted as with the other laws.

    The cross-section is that of the law of the given arm, if it has one, or that of Figure 1 of
    the paper.
    """

    kind: ClassVar[str] = MajidiLaw.kind
    constant: ClassVar[str] = 'modulus'

    @property
    def guess(self) -> float:
        """The modulus that gives the guessed stiffness at zero pressure."""
        section = self.section
        return 12.0 * self.stiffness / (section['thickness'] ** 3 * section['width'])

    @property
    def assumed(self) -> bool:
        """Whether the cross-section is the paper's, because the arm has none."""
        return not isinstance(self.given, MajidiLaw)

    @property
    def section(self) -> dict[str, float]:
        """Dimensions of the cross-section (m) by name."""
        if self.assumed:
            return PAPER_SECTION
        return {name: float(getattr(self.given, name)) for name in PAPER_SECTION}

    def law(self, values: Array) -> MajidiLaw:
        """Return the law with this modulus."""
        return MajidiLaw(modulus=float(values[0]), **self.section)


@functools.lru_cache(maxsize=KEPT)
def slopes_at(parameters: MomentLawParameters, pressures: bytes) -> Array:
    """Return `MomentLawParameters.slopes` at pressures given as the bytes of an array."""
    pressure = np.frombuffer(pressures)
    sections, columns = (list(item) for item in zip(*parameters.columns, strict=True))
    slopes = np.empty((pressure.size, len(columns), parameters.mean.size))
    for index in range(parameters.mean.size):
        step = 1e-3 * np.sqrt(parameters.prior[index, index])
        sides = []
        for sign in (-1.0, 1.0):
            shifted = parameters.mean.copy()
            shifted[index] += sign * step
            law = parameters.law(shifted)
            sides.append(law.sections(pressure, parameters.length, parameters.weight))
        slope = (sides[1] - sides[0]) / (2.0 * step)
        slopes[:, :, index] = slope[:, sections, columns]
    return frozen_array(slopes)


MOMENT_LAW_PARAMETERS: dict[str, type[MomentLawParameters]] = {
    law.kind: law for law in (PiecewiseParameters, LinearParameters, MajidiParameters)
}
