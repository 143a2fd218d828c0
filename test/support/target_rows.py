"""Rows of targets on bent arms, and bright areas that are none, for tests of who is who."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import freeze

ARCLENGTH = freeze(0.005 * np.arange(23))  # as that of a model
SPACING = 0.005


def arc(first: float, last: float, arclength: np.ndarray = ARCLENGTH) -> np.ndarray:
    """Return points (targets, 2) m of an arm whose curvature goes from first to last, 1/m."""
    s = np.linspace(0.0, arclength[-1], 4001)
    theta = first * s + (last - first) * s**2 / (2.0 * arclength[-1])
    middle = 0.5 * (theta[1:] + theta[:-1])
    way = np.cumsum(
        np.diff(s)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0
    )
    way = np.vstack([np.zeros(2), way])
    return np.column_stack([np.interp(arclength, s, way[:, i]) for i in range(2)])


def away_from(points: np.ndarray, others: np.ndarray, distance: float) -> np.ndarray:
    """Return those of the others that are further away from all points."""
    apart = np.hypot(*(others[:, None] - points[None]).transpose(2, 0, 1)).min(axis=1)
    return others[apart > distance]


class Mixture:
    """A row, some of it missing, shuffled among areas that are no targets.

    points (areas, 2), areas (areas,) and who (areas,): the index of the target, -1 for none.
    """

    def __init__(self, rng, row, visible, others, noise=2e-5):
        points = [row[visible] + rng.normal(0.0, noise, (visible.sum(), 2)), others]
        areas = [rng.uniform(72.0, 88.0, visible.sum()), rng.uniform(15.0, 400.0, len(others))]
        who = [np.flatnonzero(visible), np.full(len(others), -1)]
        order = rng.permutation(visible.sum() + len(others))
        self.points = np.concatenate(points)[order]
        self.areas = np.concatenate(areas)[order]
        self.who = np.concatenate(who)[order]

    def named(self, chosen: np.ndarray) -> np.ndarray:
        """Return who the chosen areas are: -1 for none chosen, -2 for one that is no target."""
        who = np.where(self.who >= 0, self.who, -2)
        return np.where(chosen >= 0, who[chosen], -1)
