"""Lack-of-fit tests: score tests on generic fields, in training and held-out recordings.

A statistic is z^T C^-1 z of a group of fields (measurement/errors/gaussian_model.py). Its
distribution in clean data is simulated: normal scores of the linearized refit, with the standard
deviations of placement and camera drawn too, because they are estimated from few values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import math
from operator import attrgetter
import zlib

import numpy as np
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoreStatistic:
    """A statistic without its distribution in clean data.

    disturbances: response of its normal scores (dof, n) to each disturbance whose standard
    deviation is estimated from few values, and the number of these values.
    """

    name: str
    statistic: float
    dof: int
    disturbances: tuple[tuple[int, Array], ...]
    seed: int


MapFunction = Callable[
    [Callable[[ScoreStatistic], LackOfFit], Sequence[ScoreStatistic]], Iterable[LackOfFit]
]


def lack_of_fit_tests(
    linearization: Linearization,
    gaussian: GaussianModel,
    seed: int,
    map_function: MapFunction = map,
) -> tuple[LackOfFit, ...]:
    """Return all tests; gaussian: the linear problem of all runs of the linearization.

    map_function: runs the simulations, like `map`.
    """
    tested = TestedProblem.of(gaussian, linearization.blocks, linearization.size)
    statistics = [
        tested.statistic(
            name,
            runs,
            [
                linearization.blocks[which].white(item)
                for which, item in zip(runs, fields, strict=True)
            ],
            seed,
        )
        for name, runs, fields in tested_fields(linearization)
    ]
    tests: dict[str, LackOfFit] = {}
    for item in map_function(compare_with_clean, statistics):
        known = tests.get(item.name)
        tests[item.name] = item if known is None else known.together(item)
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

    def statistic(
        self, name: str, runs: Sequence[int], white: Sequence[Array], seed: int
    ) -> ScoreStatistic:
        """Return the statistic of whitened columns (rows, n) in some of the runs."""
        gaussian, pairs = self.gaussian, list(zip(runs, white, strict=True))
        score = sum(item.T @ self.residuals[which] for which, item in pairs)
        cross = np.asarray(sum(gaussian.columns[which].T @ item for which, item in pairs))
        solved = gaussian.solved(cross)
        covariance = sum(item.T @ item for _, item in pairs) - cross.T @ solved
        variances, axes = np.linalg.eigh(covariance)
        seen = variances > LACK_OF_FIT.least_seen
        basis = axes[:, seen] / np.sqrt(variances[seen])
        # What more placement and camera would do than is expected: their part of the score.
        placement = sum(item.T @ self.placement[which] for which, item in pairs)
        moved = basis.T @ (placement - solved.T @ self.placement_shared)
        disturbances = [(LACK_OF_FIT.placement_dof, moved)]
        for which, item in pairs:
            camera = item.T @ self.camera[which] - solved.T @ self.camera_shared[which]
            disturbances.append((LACK_OF_FIT.camera_dof, basis.T @ camera))
        return ScoreStatistic(
            name=name,
            statistic=float(np.sum((basis.T @ np.asarray(score)) ** 2)),
            dof=int(seen.sum()),
            disturbances=tuple(disturbances),
            seed=seed,
        )


def compare_with_clean(statistic: ScoreStatistic) -> LackOfFit:
    """Return the test of a statistic, with its moments in simulated clean data."""
    test = LackOfFit(
        name=statistic.name, statistic=statistic.statistic, dof=statistic.dof, mean=0.0, std=0.0
    )
    if statistic.dof == 0:
        return test
    random = np.random.default_rng([statistic.seed, zlib.crc32(statistic.name.encode())])
    count = DRAWS
    draws = random.standard_normal((count, statistic.dof))
    draws *= 1.0 + LACK_OF_FIT.white_error * random.standard_normal((count, 1))
    for dof, response in statistic.disturbances:
        factor = dof / random.chisquare(dof, (count, 1))
        std = np.sqrt(np.maximum(factor - 1.0, 0.0))
        draws += std * (random.standard_normal((count, response.shape[1])) @ response.T)
    clean = np.sum(draws**2, axis=1)
    return replace(test, mean=float(clean.mean()), std=float(clean.std()))
