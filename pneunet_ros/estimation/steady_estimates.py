"""Estimates for intervals of constant pressure and end load."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.measurement.steady_states import hold_intervals


def steady_estimates(estimates: Iterable[ShapeEstimate]) -> list[ShapeEstimate]:
    """Return the last estimate of every interval of constant load that lasts long enough."""
    kept = list(estimates)
    stamps = np.array([estimate.stamp_ns for estimate in kept], dtype=np.int64)
    shapes = [estimate.shape for estimate in kept]
    loads = np.array([(shape.pressure, *shape.force, shape.end_moment) for shape in shapes])
    return [kept[last] for _, last in hold_intervals(stamps, loads, 0.0)]
