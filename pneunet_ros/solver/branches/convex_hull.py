"""The nearest point of the convex hull of a few points in a few dimensions."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inner, kernel

TINY = 1e-300  # no weight at all
ROUNDING = 1e-13  # of the largest offset: rounding of a length of zero


@kernel
def way_from_hull(points: Array, at: Array, way: Array) -> None:
    """Compute the vector (n,) from the nearest point of a hull to a point; tiny inside.

    points (vertices, n) and at (n,), in the same units in all directions. Source: Wolfe, Finding
    the nearest point in a polytope, Mathematical Programming 11 (1976).
    """
    vertices, size = points.shape
    offsets, furthest, nearest, first = np.empty((vertices, size)), 0.0, math.inf, 0
    for vertex in range(vertices):
        square = 0.0
        for i in range(size):
            offsets[vertex, i] = at[i] - points[vertex, i]
            square += offsets[vertex, i] ** 2
        furthest = max(furthest, math.sqrt(square))
        if square < nearest:
            nearest, first = square, vertex
    chosen, count = np.zeros(size + 2, np.int64), 1  # vertices that span the nearest point
    weights, wanted = np.zeros(size + 2), np.zeros(size + 2)
    chosen[0], weights[0] = first, 1.0
    for _ in range(4 * vertices):
        square = 0.0
        for i in range(size):
            way[i] = 0.0
            for k in range(count):
                way[i] += weights[k] * offsets[chosen[k], i]
            square += way[i] ** 2
        least, best = square - ROUNDING * furthest * math.sqrt(square), -1
        for vertex in range(vertices):
            along = 0.0
            for i in range(size):
                along += offsets[vertex, i] * way[i]
            if along < least:
                least, best = along, vertex
        if best < 0 or count > size:
            return
        chosen[count], weights[count] = best, 0.0
        count += 1
        while count > 1:
            if not nearest_in_plane(offsets, chosen[:count], ROUNDING * furthest, wanted):
                return  # it looks nearer only because of rounding
            share, out = 1.0, -1
            for k in range(count):
                if wanted[k] <= 0.0 and weights[k] <= share * (weights[k] - wanted[k]):
                    share, out = weights[k] / max(weights[k] - wanted[k], TINY), k
            for k in range(count):
                weights[k] += share * (wanted[k] - weights[k])
            if out < 0:
                break
            count -= 1
            for k in range(out, count):
                chosen[k], weights[k] = chosen[k + 1], weights[k + 1]


@inner
def nearest_in_plane(
    points: Array, chosen: npt.NDArray[np.int64], rounding: float, weights: Array
) -> bool:
    """Compute the weights (chosen,), of sum one, of the point of a plane nearest to zero.

    points (n, dimensions): the plane goes through those chosen. Returns False where they lie
    closer than rounding to a plane of fewer dimensions.
    """
    count, size = chosen.size, points.shape[1]
    base = points[chosen[0]]
    axes, triangle = np.empty((count, size)), np.zeros((count, count))
    for k in range(1, count):
        for i in range(size):
            axes[k, i] = points[chosen[k], i] - base[i]
        for turn in range(2 * (k - 1)):  # Gram-Schmidt, twice
            m = 1 + turn % (k - 1)
            part = 0.0
            for i in range(size):
                part += axes[m, i] * axes[k, i]
            triangle[m, k] += part
            for i in range(size):
                axes[k, i] -= part * axes[m, i]
        square = 0.0
        for i in range(size):
            square += axes[k, i] ** 2
        triangle[k, k] = math.sqrt(square)
        if triangle[k, k] <= rounding:
            return False
        for i in range(size):
            axes[k, i] /= triangle[k, k]
    weights[0] = 1.0
    for k in range(count - 1, 0, -1):
        weights[k] = 0.0
        for i in range(size):
            weights[k] -= axes[k, i] * base[i]
        for m in range(k + 1, count):
            weights[k] -= triangle[k, m] * weights[m]
        weights[k] /= triangle[k, k]
        weights[0] -= weights[k]
    return True
