"""The way out of a convex hull, against non-negative least squares of scipy."""

from __future__ import annotations

import numpy as np
from pneunet_ros.solver.branches.convex_hull import way_from_hull
import pytest
from scipy.optimize import nnls


def way_by_least_squares(points, at):
    """Return the way by weights that are not negative and have the sum one."""
    offsets = at - points
    furthest = max(np.abs(offsets).max(), 1e-300)
    system = np.vstack([offsets.T / furthest, np.ones(len(points))])
    weights, _ = nnls(system, np.eye(at.size + 1)[-1])
    return weights @ offsets / weights.sum()


def way(points, at):
    found = np.empty(at.size)
    way_from_hull(np.array(points, dtype=float), at, found)
    return found


@pytest.mark.parametrize('flat', range(5))
def test_it_is_the_shortest_also_of_flat_hulls_on_a_grid(flat):
    """On a grid points repeat and lie on lines, so that vertices have no weight at all."""
    rng = np.random.default_rng(flat)
    for trial in range(120):
        points = np.zeros((rng.integers(1, 30), 4))
        points[:, :flat] = rng.normal(size=(len(points), flat)) * 10.0 ** rng.integers(-3, 4)
        at = rng.normal(size=4) * 10.0 ** rng.integers(-3, 4)
        if trial % 3 == 0:
            at = points.T @ rng.dirichlet(np.ones(len(points)))
        elif trial % 3 == 1:
            points, at = np.round(rng.normal(size=points.shape) * (points != 0.0)), np.round(at)
        scale = max(np.abs(points).max(), np.abs(at).max(), 1e-300)
        difference = way(points, at) - way_by_least_squares(points, at)
        assert np.abs(difference).max() <= 1e-12 * scale


def test_of_one_point_it_is_the_offset():
    at = np.array([1.0, -2.0, 3.0, 0.5])
    assert np.array_equal(way(np.zeros((3, 4)), at), at)
    assert np.array_equal(way([at, at], at), np.zeros(4))
