"""Lack-of-fit tests: score tests on generic fields, in training and held-out recordings.

A statistic is z^T C^-1 z of a group of fields (measurement/errors/gaussian_model.py). Its
distribution in clean data is simulated: normal scores of the linearized refit, with the standard
deviations of placement and camera drawn too, because they are estimated from few values.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
import math
from operator import attrgetter
import zlib

import numpy as np
from pneunet_ros.calibration.noise_estimate import placement_freedom
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizedRun
from pneunet_ros.diagnosis.settings import LACK_OF_FIT, LINEARIZATION
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import scipy

DRAWS = 2000  # simulations of clean data


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LackOfFit:
    """A test: name and statistic, and its mean and standard deviation in clean data.

    The distribution in clean data is approximated by a gamma law with these moments.
    """

    name: str
    statistic: float
    dof: int
    mean: float
    std: float

    @property
    def p_value(self) -> float:
        """Probability that data without model error reach the statistic."""
        return float(scipy.stats.gamma.sf(self.statistic, **self.gamma_law)) if self.dof else 1.0

    def threshold(self, level: float) -> float:
        """Return the critical value at significance `level`, for data without model error."""
        return float(scipy.stats.gamma.isf(level, **self.gamma_law)) if self.dof else np.inf

    @property
    def gamma_law(self) -> dict[str, float]:
        """Shape and scale of the gamma law of clean data."""
        return {'a': (self.mean / self.std) ** 2, 'scale': self.std**2 / self.mean}

    @property
    def excess(self) -> float:
        """Excess of the statistic over its mean without model error."""
        return max(self.statistic - self.mean, 0.0)

    def together(self, other: LackOfFit) -> LackOfFit:
        """Return the sum of two independent tests."""
        return replace(
            self,
            statistic=self.statistic + other.statistic,
            dof=self.dof + other.dof,
            mean=self.mean + other.mean,
            std=math.hypot(self.std, other.std),
        )


def lack_of_fit_tests(
    linearization: Linearization, gaussian: GaussianModel, seed: int
) -> tuple[LackOfFit, ...]:
    """Return all tests; gaussian: the linear problem of all runs of the linearization."""
    tested = TestedProblem.of(gaussian, linearization.blocks, linearization.size)
    tests: dict[str, LackOfFit] = {}
    for name, runs, fields in tested_fields(linearization):
        pairs = zip(runs, fields, strict=True)
        white = [linearization.blocks[which].white(item) for which, item in pairs]
        found = tested.test(name, runs, white, seed)
        tests[name] = tests[name].together(found) if name in tests else found
    return tuple(tests.values())


def worst_test(tests: Sequence[LackOfFit]) -> LackOfFit:
    """Return the test with the smallest p-value."""
    return min(tests, key=attrgetter('p_value'))


def worst_p_value(tests: Sequence[LackOfFit]) -> float:
    """Return the smallest p-value of tests, corrected for their number."""
    return min(1.0, worst_test(tests).p_value * len(tests))


def is_adequate(tests: Sequence[LackOfFit], allowed: float = 0.0) -> bool:
    """Whether the residuals are consistent with clean data, or with an acceptable excess."""
    level = LACK_OF_FIT.level / max(len(tests), 1)
    return bool(tests) and all(item.p_value > level or item.excess < allowed for item in tests)


def tested_fields(linearization: Linearization) -> Iterable[tuple[str, range, list[Array]]]:
    """Yield the name of each test, its runs, and their fields (frames, 2 targets, n) m."""
    count = len(linearization.blocks)
    size = LINEARIZATION.tolerance * linearization.length
    training, held_out = range(linearization.training), range(linearization.training, count)
    for label, runs in (('training', training), ('held out', held_out)):
        if not runs:
            continue
        fields = [linearization.blocks[which].fields for which in runs]
        smooth = [item.generic * linearization.tolerance for item in fields]
        yield f'{label}: smooth fields', runs, smooth
        yield f'{label}: single targets', runs, [item.single() * size for item in fields]
        for which, item in zip(runs, fields, strict=True):
            windows = item.windows()
            rms = np.sqrt(np.mean(windows**2, axis=(0, 1)))
            scaled = windows * (size / np.maximum(rms, 1e-12))
            yield f'{label}: windows of time', range(which, which + 1), [scaled]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TestedProblem:
    """A linear problem with its disturbances.

    residuals (rows,) of each run after the best step; placement (rows, n) and camera (rows, k):
    their effect in each run, and for both the part shared with the columns of the problem.
    """

    gaussian: GaussianModel
    residuals: tuple[Array, ...]
    placement: list[Array]
    placement_shared: Array
    camera: list[Array]
    camera_shared: list[Array]

    @classmethod
    def of(
        cls, gaussian: GaussianModel, blocks: Sequence[LinearizedRun], size: int
    ) -> TestedProblem:
        """Return the tested problem of some runs; size: number of unknowns of the base model."""
        columns = gaussian.columns
        placement = [block.base[:, size:] for block in blocks]
        camera = [block.path_filter(block.path) for block in blocks]
        shared = [x.T @ item for x, item in zip(columns, placement, strict=True)]
        return cls(
            gaussian=gaussian,
            residuals=gaussian.best_residuals(),
            placement=placement,
            placement_shared=np.sum(shared, axis=0),
            camera=camera,
            camera_shared=[x.T @ item for x, item in zip(columns, camera, strict=True)],
        )

    def test(self, name: str, runs: Sequence[int], white: Sequence[Array], seed: int) -> LackOfFit:
        """Return the test of whitened columns (rows, n) in some of the runs."""
        gaussian, pairs = self.gaussian, list(zip(runs, white, strict=True))
        score = sum(item.T @ self.residuals[which] for which, item in pairs)
        cross = np.asarray(sum(gaussian.columns[which].T @ item for which, item in pairs))
        solved = gaussian.solved(cross)
        covariance = sum(item.T @ item for _, item in pairs) - cross.T @ solved
        variances, axes = np.linalg.eigh(covariance)
        seen = variances > LACK_OF_FIT.least_seen
        basis = axes[:, seen] / np.sqrt(variances[seen])
        # The part of the score due to larger errors of placement and camera than expected.
        placement = sum(item.T @ self.placement[which] for which, item in pairs)
        moved = basis.T @ (placement - solved.T @ self.placement_shared)
        disturbances = [(placement_freedom(self.placement[0].shape[1] // 2), moved)]
        for which, item in pairs:
            camera = item.T @ self.camera[which] - solved.T @ self.camera_shared[which]
            disturbances.append((LACK_OF_FIT.camera_dof, basis.T @ camera))
        dof = int(seen.sum())
        mean, std = clean_moments(name, dof, disturbances, seed)
        statistic = float(np.sum((basis.T @ np.asarray(score)) ** 2))
        return LackOfFit(name=name, statistic=statistic, dof=dof, mean=mean, std=std)


def clean_moments(
    name: str, dof: int, disturbances: Sequence[tuple[int, Array]], seed: int
) -> tuple[float, float]:
    """Return mean and standard deviation of a statistic in simulated clean data.

    disturbances: number of values from which the standard deviation of each is estimated, and the
    response of the normal scores (dof, n) to it.
    """
    if dof == 0:
        return 0.0, 0.0
    random = np.random.default_rng([seed, zlib.crc32(name.encode())])
    draws = random.standard_normal((DRAWS, dof))
    for values, response in disturbances:
        factor = values / random.chisquare(values, (DRAWS, 1))
        std = np.sqrt(np.maximum(factor - 1.0, 0.0))
        draws += std * (random.standard_normal((DRAWS, response.shape[1])) @ response.T)
    clean = np.sum(draws**2, axis=1)
    return float(clean.mean()), float(clean.std())
