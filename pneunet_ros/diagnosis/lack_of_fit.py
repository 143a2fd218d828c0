"""Lack-of-fit tests: score tests on generic fields, in training and held-out recordings.

A statistic is z^T C^-1 z of a group of fields (measurement/errors/gaussian_model.py). What clean
data reach is simulated: normal scores of the linearized refit, with standard deviations of
placement and camera that are themselves known from few values only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import zlib

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.law_errors import OpenLaws
from pneunet_ros.diagnosis.linearization import Linearization, LinearizedRun
from pneunet_ros.diagnosis.settings import DEFAULTS, LackOfFitSettings
import scipy

DRAWS = 2000  # simulations of clean data


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LackOfFit:
    """A test: its name and statistic, and the mean and standard deviation that clean data have.

    Clean data are taken to follow a gamma law of these.
    """

    name: str
    statistic: float
    dof: int
    mean: float
    std: float

    @property
    def p_value(self) -> float:
        """How often clean data reach this much."""
        return float(scipy.stats.gamma.sf(self.statistic, **self.gamma_law)) if self.dof else 1.0

    def threshold(self, level: float) -> float:
        """Return what clean data exceed with a probability of `level`."""
        return float(scipy.stats.gamma.isf(level, **self.gamma_law)) if self.dof else np.inf

    @property
    def gamma_law(self) -> dict[str, float]:
        """Shape and scale of the law of clean data."""
        return {'a': (self.mean / self.std) ** 2, 'scale': self.std**2 / self.mean}

    @property
    def excess(self) -> float:
        """By how much the statistic is above the mean of clean data."""
        return max(self.statistic - self.mean, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoreStatistic:
    """A statistic before it is known what clean data reach.

    disturbances: how its normal scores (dof, n) answer to each disturbance of which the standard
    deviation is known from few values only, and from how many.
    """

    name: str
    statistic: float
    dof: int
    disturbances: tuple[tuple[int, Array], ...]
    seed: int
    settings: LackOfFitSettings = DEFAULTS.lack_of_fit


Moments = tuple[float, float]
MapFunction = Callable[
    [Callable[[ScoreStatistic], Moments], Sequence[ScoreStatistic]], Iterable[Moments]
]


def lack_of_fit_tests(
    linearization: Linearization,
    problem: OpenLaws,
    seed: int,
    map_function: MapFunction = map,
    settings: LackOfFitSettings = DEFAULTS.lack_of_fit,
) -> tuple[LackOfFit, ...]:
    """Make all tests; problem: of all runs of the linearization.

    map_function: runs the simulations, as `map` does.
    """
    statistics = [
        score_statistic(name, linearization, problem, runs, fields, seed, settings)
        for name, runs, fields in tested_fields(linearization)
    ]
    moments = map_function(clean_moments, statistics)
    tests: dict[str, LackOfFit] = {}
    for item, (mean, variance) in zip(statistics, moments, strict=True):
        sum_so_far = tests.get(item.name, LackOfFit(name='', statistic=0, dof=0, mean=0, std=0))
        tests[item.name] = LackOfFit(
            name=item.name,
            statistic=item.statistic + sum_so_far.statistic,
            dof=item.dof + sum_so_far.dof,
            mean=mean + sum_so_far.mean,
            std=float(np.hypot(np.sqrt(variance), sum_so_far.std)),
        )
    return tuple(tests.values())


def tested_fields(
    linearization: Linearization,
) -> Iterable[tuple[str, range, list[Array]]]:
    """Yield the name of each test, its runs, and their fields (frames, 2 targets, n) m."""
    count = len(linearization.blocks)
    size = linearization.settings.tolerance * linearization.length
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


def score_statistic(
    name: str,
    linearization: Linearization,
    problem: OpenLaws,
    runs: range,
    fields: Sequence[Array],
    seed: int,
    settings: LackOfFitSettings,
) -> ScoreStatistic:
    """Return the statistic of fields (frames, 2 targets, n) m in some of the runs."""
    pairs = zip(runs, fields, strict=True)
    white = [linearization.blocks[which].white(item) for which, item in pairs]
    blocks, size = linearization.blocks, linearization.size
    return white_statistic(name, blocks, size, problem, runs, white, seed, settings)


def white_statistic(
    name: str,
    all_blocks: Sequence[LinearizedRun],
    size: int,
    problem: OpenLaws,
    runs: Sequence[int],
    white: Sequence[Array],
    seed: int,
    settings: LackOfFitSettings = DEFAULTS.lack_of_fit,
) -> ScoreStatistic:
    """Return the statistic of whitened columns (rows, n) in some of the runs.

    all_blocks: those of the problem, run by run; size: unknowns of the base model alone.
    """
    gaussian = problem.gaussian
    white = [problem.columns(which, item) for which, item in zip(runs, white, strict=True)]
    columns = [gaussian.columns[which] for which in runs]
    residuals = gaussian.best_residuals()
    score = sum(item.T @ residuals[which] for which, item in zip(runs, white, strict=True))
    cross = np.asarray(sum(x.T @ item for x, item in zip(columns, white, strict=True)))
    solved = gaussian.solved(cross)
    covariance = sum(item.T @ item for item in white) - cross.T @ solved
    variances, axes = np.linalg.eigh(covariance)
    seen = variances > settings.least_seen
    basis = axes[:, seen] / np.sqrt(variances[seen])
    # What more placement and camera would do than is expected: their part of the score.
    moved = [
        problem.columns(which, block.base[:, size:]) for which, block in enumerate(all_blocks)
    ]
    placement = sum(
        item.T @ moved[which] for which, item in zip(runs, white, strict=True)
    ) - solved.T @ sum(x.T @ item for x, item in zip(gaussian.columns, moved, strict=True))
    disturbances = [(settings.placement_dof, basis.T @ placement)]
    for which, x, item in zip(runs, columns, white, strict=True):
        block = all_blocks[which]
        path = problem.columns(which, block.path_filter(block.path))
        camera = item.T @ path - solved.T @ (x.T @ path)
        disturbances.append((settings.camera_dof, basis.T @ camera))
    return ScoreStatistic(
        name=name,
        statistic=float(np.sum((basis.T @ np.asarray(score)) ** 2)),
        dof=int(seen.sum()),
        disturbances=tuple(disturbances),
        seed=seed,
        settings=settings,
    )


def clean_moments(statistic: ScoreStatistic) -> Moments:
    """Return mean and variance of a statistic over simulated clean data."""
    if statistic.dof == 0:
        return 0.0, 0.0
    random = np.random.default_rng([statistic.seed, zlib.crc32(statistic.name.encode())])
    count = DRAWS
    draws = random.standard_normal((count, statistic.dof))
    draws *= 1.0 + statistic.settings.white_error * random.standard_normal((count, 1))
    for dof, response in statistic.disturbances:
        factor = dof / random.chisquare(dof, (count, 1))
        std = np.sqrt(np.maximum(factor - 1.0, 0.0))
        draws += std * (random.standard_normal((count, response.shape[1])) @ response.T)
    clean = np.sum(draws**2, axis=1)
    return float(clean.mean()), float(clean.var())
