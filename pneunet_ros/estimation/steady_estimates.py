"""Holds of a recording: stretches in which pressure and end load stand still."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import seconds_between
from pneunet_ros.estimation.estimate import ShapeEstimate

SHORTEST_HOLD = 1.5  # s


def held_estimates(
    estimates: Iterable[ShapeEstimate], shortest: float = SHORTEST_HOLD
) -> list[ShapeEstimate]:
    """Return the last estimate of every stretch of at least `shortest` s of constant load."""
    holds: list[ShapeEstimate] = []
    first: ShapeEstimate | None = None
    last: ShapeEstimate | None = None

    def close() -> None:
        if first and last and seconds_between(first.stamp_ns, last.stamp_ns) >= shortest:
            holds.append(last)

    for estimate in estimates:
        if first is None or load_of(first) != load_of(estimate):
            close()
            first = estimate
        last = estimate
    close()
    return holds


def load_of(estimate: ShapeEstimate) -> tuple[float, float, float, float]:
    """Pressure (Pa), force (N) and moment (N m) of an estimate."""
    shape = estimate.shape
    return shape.pressure, *shape.force, shape.end_moment


def held_spans(
    stamp_ns: npt.NDArray[np.int64],
    values: Array,
    still: Array,
    shortest: float = SHORTEST_HOLD,
) -> list[tuple[int, int]]:
    """Return first and last index of stretches of at least `shortest` s in which readings rest.

    values (readings, quantities) of noisy sensors rest while each of them stays within `still`
    (quantities,) from its largest to its smallest. Stretches do not overlap.
    """
    spans: list[tuple[int, int]] = []
    first = 0
    if not len(values):
        return spans
    lowest = highest = values[0]
    for index in range(len(values) + 1):
        if index < len(values):
            low = np.minimum(lowest, values[index])
            high = np.maximum(highest, values[index])
            if np.all(high - low <= still):
                lowest, highest = low, high
                continue
        if seconds_between(int(stamp_ns[first]), int(stamp_ns[index - 1])) >= shortest:
            spans.append((first, index - 1))
        if index < len(values):
            first, lowest, highest = index, values[index], values[index]
    return spans
