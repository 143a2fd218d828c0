"""Law errors of effects: errors of their sizes, independent in every frame and along the arm.

No law is exact: a line may fill faster than it empties, an elongation may be uneven. The law error
of a strong effect may resemble another effect, far above the noise. Every effect therefore has a
relative error of its size, independent in every frame and along the arm. These errors are
marginalized run by run, like the path of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizedRun
from pneunet_ros.diagnosis.fit.refit import Refit, split_numbers
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.measurement.errors.covariance import Whitening
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel

DIFFERENCE = 0.1  # of a size: step of the derivative with respect to it
LEAST_VARIANCE = 1e-6  # of a column that is kept, in units of noise
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
SIZE = 0.3  # independent error of a size in every frame, relative to the size
MAY_LEAVE = 0.2  # largest excess with the law of an effect, relative to that of the base


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawErrors:
    """Errors of the laws of effects in every run, (frames, 2 targets, errors) m.

    Each is one standard deviation; there are none without an effect.
    """

    fields: tuple[Array, ...]

    @classmethod
    def of(cls, linearization: Linearization, fit: Refit) -> LawErrors:
        """Return the law errors of all effects of a fit in all runs of a linearization."""
        if not fit.hypotheses:
            return cls(fields=())
        arclength = linearization.point.arm.target_arclength / linearization.length
        shapes = np.asarray(
            legendre.legvander(2.0 * arclength - 1.0, LINEARIZATION.modes - 1), np.float64
        )
        runs = range(len(linearization.blocks))
        before = linearization.points(fit.point.arm, runs)
        parts: list[list[Array]] = [[] for _ in runs]
        for which in range(len(fit.hypotheses)):
            smaller = replace(fit, numbers=reduce_sizes(fit, which, DIFFERENCE))
            after = linearization.points(smaller.point.arm, runs)
            if before is None or after is None:
                continue
            for part, point, moved in zip(parts, before, after, strict=True):
                unit = np.nan_to_num(point - moved) / DIFFERENCE
                errors = SIZE * along_arm(unit, shapes)
                part.append(errors.reshape(len(unit), -1, LINEARIZATION.modes))
        fields = tuple(np.concatenate(part, axis=2) for part in parts if part)
        return cls(fields=fields)


def reduce_sizes(fit: Refit, which: int, share: float) -> Array:
    """Return the parameters of a fit with the sizes of one effect reduced by a share."""
    parts = split_numbers(fit.hypotheses, fit.numbers.copy())
    parts[which][fit.hypotheses[which].sizes] *= 1.0 - share
    return np.concatenate(parts)


def along_arm(field: Array, shapes: Array) -> Array:
    """Return a field (frames, 2, targets) that grows along the arm, times shapes.

    shapes (targets, n): factors of its growth from target to target; (frames, 2, targets, n).
    """
    growth = np.diff(field, axis=2, prepend=0.0)
    grown: Array = np.cumsum(growth[:, :, :, None] * shapes, axis=2)
    return grown


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenLaws:
    """Linear problem of a fit with the law errors marginalized, run by run."""

    gaussian: GaussianModel
    filters: tuple[Whitening, ...] = ()

    @classmethod
    def of(
        cls, known: GaussianModel, blocks: Sequence[LinearizedRun], errors: LawErrors
    ) -> OpenLaws:
        """Return the problem of a fit; blocks: the linearized runs; errors: of effects in them."""
        pairs = zip(blocks, errors.fields, strict=False)
        filters = tuple(
            Whitening(1.0, orthogonal_columns(block.white_by_frame(field)))
            for block, field in pairs
        )
        filters = filters[: len(known.columns)]
        if not filters:
            return cls(gaussian=known)
        columns = [white(item) for white, item in zip(filters, known.columns, strict=True)]
        rest = zip(filters, known.residuals, strict=True)
        volumes = zip(filters, known.log_volumes, strict=True)
        opened = GaussianModel.of(
            columns,
            [white(item[:, None])[:, 0] for white, item in rest],
            known.position,
            log_volumes=[white.log_volume + volume for white, volume in volumes],
        )
        return cls(gaussian=opened, filters=filters)

    def white(self, direction: Sequence[Array]) -> tuple[Array, ...]:
        """Return whitened directions (rows,) per run in the coordinates of this problem."""
        return tuple(
            self.columns(which, item[:, None])[:, 0] for which, item in enumerate(direction)
        )

    def columns(self, run: int, white: Array) -> Array:
        """Return whitened columns (rows, n) of a run in the coordinates of this problem."""
        return self.filters[run](white) if self.filters else white

    @property
    def cost(self) -> float:
        """Half of chi squared and prior at the optimal step, plus the log volume of the errors."""
        return self.gaussian.cost


def orthogonal_columns(columns: Array) -> Array:
    """Return nonzero orthogonal columns (rows, n) with the same covariance.

    An SVD would be ill-conditioned for frames in which an effect is inactive.
    """
    variances, axes = np.linalg.eigh(columns.T @ columns)
    kept: Array = columns @ axes[:, variances > LEAST_VARIANCE]
    return kept
