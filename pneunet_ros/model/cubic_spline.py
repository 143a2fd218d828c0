"""Cubic spline interpolation of a table (C2).

Replaces scipy's implementation, whose import takes a quarter of a second at every start.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array


def cubic_spline(knots: Array, values: Array) -> Array:
    """Return the pieces of the cubic spline through values at knots, not-a-knot at both ends.

    knots (n,) increase, n >= 2; values (..., n). Returns (..., n - 1, 4): ascending powers of the
    distance from the start of each piece. Two knots give a line, three a parabola.

    Source: de Boor, A Practical Guide to Splines, Springer 1978, chapter IV.
    """
    width = np.diff(knots)
    slope = np.diff(values) / width
    bend = second_derivatives(width, slope)
    start, end = bend[..., :-1], bend[..., 1:]
    rise = slope - width * (2.0 * start + end) / 6.0
    return np.stack([values[..., :-1], rise, 0.5 * start, (end - start) / (6.0 * width)], axis=-1)


def second_derivatives(width: Array, slope: Array) -> Array:
    """Return second derivatives at the knots (..., n); width (n - 1,), mean slope (..., n - 1)."""
    count = width.size + 1
    if count == 2:
        return np.zeros((*slope.shape[:-1], 2))
    system, right = np.zeros((count, count)), np.zeros((*slope.shape[:-1], count))
    inner, outer = np.arange(1, count - 1), np.array([0, count - 1])
    system[inner, inner - 1], system[inner, inner + 1] = width[:-1], width[1:]
    system[inner, inner] = 2.0 * (width[:-1] + width[1:])
    right[..., inner] = 6.0 * np.diff(slope)
    if count == 3:  # one parabola
        system[0, :2] = system[2, 1:] = -1.0, 1.0
    else:  # the first two pieces are one cubic, and so are the last two
        for end, (first, second) in zip(outer, (width[:2], width[:-3:-1]), strict=True):
            inward = end + np.arange(3) * (1 if end == 0 else -1)
            system[end, inward] = second, -(first + second), first
    return np.asarray(np.linalg.solve(system, right[..., None])[..., 0])
