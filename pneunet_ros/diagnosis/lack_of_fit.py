"""Is anything left? Omnibus score tests on generic fields, in training and held-out recordings.

A statistic is z^T C^-1 z of a group of fields (linear.py). What clean data reach is simulated:
normal scores of the linearized refit, with standard deviations of placement and camera that are
themselves known from few values only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import zlib

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.gaussian_model import GaussianModel, SEEN
from pneunet_ros.diagnosis.linearization import Linearization
from scipy.stats import gamma

SINGLE_FIELD = 1e-4  # m
DRAWS = 2000
PLACEMENT_FREEDOM = 20  # values that the standard deviation of placement is known from
CAMERA_FREEDOM = 8
WHITE_ERROR = 0.01  # of the standard deviation of white noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """One test: its name, statistic, and the mean and deviation that clean data have."""

    name: str
    statistic: float
    dof: int
    mean: float
    std: float

    @property
    def p_value(self) -> float:
        """How often clean data reach this much, by a gamma law of the same mean and deviation."""
        if self.dof == 0:
            return 1.0
        shape = (self.mean / self.std) ** 2
        return float(gamma.sf(self.statistic, shape, scale=self.std**2 / self.mean))

    def threshold(self, level: float) -> float:
        """Return what clean data exceed with a probability of `level`."""
        if self.dof == 0:
            return np.inf
        shape = (self.mean / self.std) ** 2
        return float(gamma.isf(level, shape, scale=self.std**2 / self.mean))

    @property
    def excess(self) -> float:
        """How much more there is than in clean data."""
        return max(self.statistic - self.mean, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tested:
    """A test before it is known what clean data reach.

    disturbed: how its normal scores (freedom, n) answer to each disturbance of which the standard
    deviation is known from few values only, and from how many.
    """

    name: str
    statistic: float
    dof: int
    disturbed: tuple[tuple[int, Array], ...]
    seed: int


Mapped = Callable[
    [Callable[[Tested], tuple[float, float]], Sequence[Tested]], Iterable[tuple[float, float]]
]


def groups_of(
    design: Linearization, linear: GaussianModel, seed: int, mapped: Mapped = map
) -> tuple[Group, ...]:
    """Test all groups; linear: of all runs of the design. mapped: runs the simulations."""
    training = range(design.training)
    held_out = range(design.training, len(design.blocks))
    tests = []
    for label, runs in (('training', training), ('held out', held_out)):
        if not runs:
            continue
        blocks = [design.blocks[which] for which in runs]
        smooth = [block.fields.generic * design.tolerance for block in blocks]
        tests.append(test_of(f'{label}: smooth fields', design, linear, runs, smooth, seed))
        single = [block.fields.single() * SINGLE_FIELD for block in blocks]
        tests.append(test_of(f'{label}: single targets', design, linear, runs, single, seed))
        for which in runs:
            fields = design.blocks[which].fields.windows()
            rms = np.sqrt(np.mean(fields**2, axis=(0, 1)))
            fields = fields * (SINGLE_FIELD / np.maximum(rms, 1e-12))
            only = range(which, which + 1)
            tests.append(
                test_of(f'{label}: windows of time', design, linear, only, [fields], seed)
            )
    moments = mapped(clean_moments, tests)
    groups: dict[str, Group] = {}
    for item, (mean, variance) in zip(tests, moments, strict=True):
        known = groups.get(item.name)
        groups[item.name] = Group(
            name=item.name,
            statistic=item.statistic + (known.statistic if known else 0.0),
            dof=item.dof + (known.dof if known else 0),
            mean=mean + (known.mean if known else 0.0),
            std=float(np.hypot(np.sqrt(variance), known.std if known else 0.0)),
        )
    return tuple(groups.values())


def test_of(
    name: str,
    design: Linearization,
    linear: GaussianModel,
    runs: range,
    fields: Sequence[Array],
    seed: int,
) -> Tested:
    """Set up the test of fields (frames, 2 targets, n) m, given for some of the runs."""
    white = [design.blocks[which].white(item) for which, item in zip(runs, fields, strict=True)]
    residual = linear.best_residuals()
    score = sum(item.T @ residual[which] for which, item in zip(runs, white, strict=True))
    across = sum(linear.columns[which].T @ item for which, item in zip(runs, white, strict=True))
    solved = linear.solved(np.asarray(across))
    covariance = sum(item.T @ item for item in white) - np.asarray(across).T @ solved
    sizes, turned = np.linalg.eigh(covariance)
    seen = sizes > SEEN
    basis = turned[:, seen] / np.sqrt(sizes[seen])
    # What more placement and camera would do than is expected: their part of the score.
    size = design.size
    placed = sum(
        item.T @ design.blocks[which].base[:, size:]
        for which, item in zip(runs, white, strict=True)
    ) - solved.T @ sum(
        x.T @ block.base[:, size:] for x, block in zip(linear.columns, design.blocks, strict=True)
    )
    disturbed = [(PLACEMENT_FREEDOM, basis.T @ placed)]
    for which, item in zip(runs, white, strict=True):
        block = design.blocks[which]
        path = block.path_filter(block.path)
        path = item.T @ path - solved.T @ (linear.columns[which].T @ path)
        disturbed.append((CAMERA_FREEDOM, basis.T @ path))
    return Tested(
        name=name,
        statistic=float(np.sum((basis.T @ np.asarray(score)) ** 2)),
        dof=int(seen.sum()),
        disturbed=tuple(disturbed),
        seed=seed,
    )


def clean_moments(test: Tested) -> tuple[float, float]:
    """Return mean and variance of a statistic over simulated clean data."""
    if test.dof == 0:
        return 0.0, 0.0
    random = np.random.default_rng([test.seed, zlib.crc32(test.name.encode())])
    draws = random.standard_normal((DRAWS, test.dof))
    draws *= 1.0 + WHITE_ERROR * random.standard_normal((DRAWS, 1))
    for dof, answer in test.disturbed:
        factor = dof / random.chisquare(dof, (DRAWS, 1))
        more = np.sqrt(np.maximum(factor - 1.0, 0.0))
        draws += more * (random.standard_normal((DRAWS, answer.shape[1])) @ answer.T)
    clean = np.sum(draws**2, axis=1)
    return float(clean.mean()), float(clean.var())
