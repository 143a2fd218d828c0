"""Inputs of the lab arm over time: pressure and end load, joined by straight lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import itertools
from typing import NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import RequestError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timeline:
    """Corner points (k,) of time (s from 0), true pressure (Pa) and force (k, 2) N.

    `loaded`: whether a load is attached at some time, so that the force is measured.
    """

    time: Array
    pressure: Array
    force: Array
    loaded: bool

    def __post_init__(self) -> None:
        """Check the sizes."""
        count = (len(self.time),)
        for name, size in (('time', count), ('pressure', count), ('force', (*count, 2))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), size))

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1])

    def pressure_at(self, time: Array) -> Array:
        """Return the pressure (Pa) at times (n,) s."""
        return freeze(np.interp(time, self.time, self.pressure))

    def force_at(self, time: Array) -> Array:
        """Return the force (n, 2) N at times (n,) s."""
        columns = [np.interp(time, self.time, self.force[:, i]) for i in (0, 1)]
        return freeze(np.column_stack(columns))


class Leg(NamedTuple):
    """A part of a protocol: a ramp of this duration (s) to a pressure (Pa) and force (N)."""

    seconds: float
    pressure: float
    force: tuple[float, float] = (0.0, 0.0)


REST = Leg(0.0, 0.0)


def timeline(legs: Iterable[Leg], *, loaded: bool, start: Leg = REST) -> Timeline:
    """Join legs, beginning where `start` ends."""
    legs = [start, *legs]
    return Timeline(
        time=np.array(list(itertools.accumulate(leg.seconds for leg in legs))),
        pressure=np.array([leg.pressure for leg in legs]),
        force=np.array([leg.force for leg in legs]),
        loaded=loaded,
    )


def share_of_time(remaining: float, parts: int, shortest: float, name: str) -> float:
    """Return the length (s) of equal parts; RequestError if they are too short."""
    part = remaining / parts
    if part < shortest:
        raise RequestError(
            f'protocol: each of the {name} would last {part:.2f} s, but at least {shortest:g} s '
            'is needed: increase the duration or simplify the protocol',
            reason='too_short',
        )
    return part
