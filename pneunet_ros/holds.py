"""Holds of a recording: stretches in which pressure and end load stand still."""

from __future__ import annotations

from collections.abc import Iterable

from pneunet_ros.shape import ShapeEstimate
from pneunet_ros.units import seconds_between

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
