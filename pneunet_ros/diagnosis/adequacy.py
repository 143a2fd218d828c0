"""Is anything left? Omnibus score tests on generic fields, in training and held-out recordings.

A statistic is z^T C^-1 z of a group of fields (linear.py). What clean data reach is simulated:
normal scores of the linearized refit, with standard deviations of placement and camera that are
themselves known from few values only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pneunet_ros.diagnosis.design import Design
from pneunet_ros.diagnosis.linear import Linear, SEEN
from pneunet_ros.shape import Array
from scipy.stats import gamma

WINDOW_FIELD = 0.01  # 1/m and, moved, of a millimeter: about what is seen
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
    freedom: int
    mean: float
    std: float

    @property
    def p_value(self) -> float:
        """How often clean data reach this much, by a gamma law of the same mean and deviation."""
        if self.freedom == 0:
            return 1.0
        shape = (self.mean / self.std) ** 2
        return float(gamma.sf(self.statistic, shape, scale=self.std**2 / self.mean))

    def threshold(self, level: float) -> float:
        """Return what clean data exceed with a probability of `level`."""
        if self.freedom == 0:
            return np.inf
        shape = (self.mean / self.std) ** 2
        return float(gamma.isf(level, shape, scale=self.std**2 / self.mean))

    @property
    def excess(self) -> float:
        """How much more there is than in clean data."""
        return max(self.statistic - self.mean, 0.0)


def groups_of(design: Design, linear: Linear, seed: int) -> tuple[Group, ...]:
    """Test all groups; linear: of all runs of the design."""
    random = np.random.default_rng([seed, 11])
    disturbed = [block.base[:, design.size :] for block in design.blocks]
    training = range(design.training)
    held_out = range(design.training, len(design.blocks))
    found = []
    for label, runs in (('training', training), ('held out', held_out)):
        if not runs:
            continue
        generic = [design.blocks[which].fields.generic * design.tolerance for which in runs]
        found.append(
            group(f'{label}: smooth fields', design, linear, runs, generic, disturbed, random)
        )
        single = [design.blocks[which].fields.single * SINGLE_FIELD for which in runs]
        found.append(
            group(f'{label}: single targets', design, linear, runs, single, disturbed, random)
        )
        apart = []
        for which in runs:
            fields = design.blocks[which].fields.windows.copy()
            rms = np.sqrt(np.mean(fields**2, axis=(0, 1)))
            fields *= SINGLE_FIELD / np.maximum(rms, 1e-12)
            only = range(which, which + 1)
            apart.append(group('', design, linear, only, [fields], disturbed, random))
        found.append(
            Group(
                name=f'{label}: windows of time',
                statistic=sum(item.statistic for item in apart),
                freedom=sum(item.freedom for item in apart),
                mean=sum(item.mean for item in apart),
                std=float(np.sqrt(sum(item.std**2 for item in apart))) or 1.0,
            )
        )
    return tuple(found)


def group(
    name: str,
    design: Design,
    linear: Linear,
    runs: range,
    fields: Sequence[Array],
    disturbed: Sequence[Array],
    random: np.random.Generator,
) -> Group:
    """Test one group of fields (frames, 2 targets, n) m, given for some of the runs."""
    white = [design.blocks[which].white(item) for which, item in zip(runs, fields, strict=True)]
    own = [linear.columns[which] for which in runs]
    residual = linear.best_residuals()
    score = sum(item.T @ residual[which] for which, item in zip(runs, white, strict=True))
    across = sum(x.T @ item for x, item in zip(own, white, strict=True))
    solved = linear.solved(np.asarray(across))
    covariance = sum(item.T @ item for item in white) - np.asarray(across).T @ solved
    sizes, turned = np.linalg.eigh(covariance)
    seen = sizes > SEEN
    basis = turned[:, seen] / np.sqrt(sizes[seen])
    along = basis.T @ np.asarray(score)
    count = int(seen.sum())
    if count == 0:
        return Group(name=name, statistic=0.0, freedom=0, mean=0.0, std=1.0)
    # What more placement and camera would do than is expected: their part of the score.
    placed = sum(
        item.T @ disturbed[which] for which, item in zip(runs, white, strict=True)
    ) - solved.T @ sum(x.T @ d for x, d in zip(linear.columns, disturbed, strict=True))
    draws = random.standard_normal((DRAWS, count))
    draws *= 1.0 + WHITE_ERROR * random.standard_normal((DRAWS, 1))
    draws += inflation(random, PLACEMENT_FREEDOM) * (
        random.standard_normal((DRAWS, np.asarray(placed).shape[1])) @ (basis.T @ placed).T
    )
    for which, item in zip(runs, white, strict=True):
        block = design.blocks[which]
        path = item.T @ block.filtered(block.path) - solved.T @ (
            linear.columns[which].T @ block.filtered(block.path)
        )
        draws += inflation(random, CAMERA_FREEDOM) * (
            random.standard_normal((DRAWS, path.shape[1])) @ (basis.T @ path).T
        )
    clean = np.sum(draws**2, axis=1)
    return Group(
        name=name,
        statistic=float(np.sum(along**2)),
        freedom=count,
        mean=float(clean.mean()),
        std=float(clean.std()),
    )


def inflation(random: np.random.Generator, freedom: int) -> Array:
    """Return by how much more (DRAWS, 1) a deviation may be than it was found to be."""
    factor = freedom / random.chisquare(freedom, (DRAWS, 1))
    more: Array = np.sqrt(np.maximum(factor - 1.0, 0.0))
    return more
