"""The contract of a block: one cause of error, as unknowns with a prior.

A block owns the unknowns of its cause and implements the interface of `measurement/inference`:

=========== ================================ =================================================
question    answer                           it is
=========== ================================ =================================================
how much    std, prior                       one sigma of each unknown, before any frame
how it      times, move, white               a correlation time each (constant: infinite), or
moves                                        moves of its own; new in every reading
where it    on_rod, on_rod_as_read           causes of the rod: F1, F2, M, pressure, and
acts                                         columns of the law (`law_columns`, `law_errors`)
            on_camera                        place (x, y) and turn of the camera
            on_dots                          where dots are painted, along and across the arm
            on_wrench                        what a force sensor reads
            as_pressure                      the error of the pressure that looks like it
=========== ================================ =================================================

Methods that a block does not override keep the neutral result of `Block`. A new cause is one file
here and one line in `fusion/unknowns.py`.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.effects.effect import History

CAMERA_CAUSES = 3  # x, y (m) and turn (rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameInputs:
    """Inputs of the arm at a frame, as read.

    chamber, chamber_std: pressure in the chamber and its white noise (Pa); history: of the
    effects; moment, moment_std (N m): at the tip; by_column (columns,): change of the pressure by
    one sigma of each column of the law, through sensing effects; lag_offsets (memory,) Pa:
    deviation of the lagging pressures, and of the one behind a play, from the chamber pressure;
    gravity: along x and y, in g; None: as in the model; pressure_rate (Pa/s): how fast the
    pressure changes there, 0 at a reading of the pressure itself.
    """

    chamber: float
    chamber_std: float
    history: tuple[History, ...] | None
    moment: float
    moment_std: float
    by_column: Array
    lag_offsets: Array
    gravity: tuple[float, float] | None = None
    pressure_rate: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchSeen:
    """The prediction for a wrench reading.

    force (2,) N: the mean of the tip force; by_column (columns, 2): change of the force reading by
    one sigma of each column of the law, through sensing effects.
    """

    force: Array
    by_column: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """The interval between two stamps.

    seconds: duration; pressure_change (Pa); size of the model error, relative to the effect of the
    pressure range; walk (N/sqrt(s)): random walk of the tip force; steady: factor by which the
    variance of the force grows faster than that of a random walk.
    """

    seconds: float
    pressure_change: float
    size: float
    walk: float
    steady: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """Process model of a block: factors and one sigma of process noise, (moving,) each.

    held: whether the mean stays unchanged.
    """

    decay: Array
    noise: Array
    held: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Prior of a block: mean and one sigma (k,) of its unknowns.

    shared: another block, and the effect of one sigma of each of its first unknowns on these (k,
    m).
    """

    mean: Array
    std: Array
    shared: tuple[type[Block], Array] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Block(abc.ABC):
    """A cause of error: some unknowns with a prior; see `pneunet_ros.measurement.blocks.block`."""

    white: ClassVar[bool] = False  # new in every reading, with the noise that it is read with

    @property
    @abc.abstractmethod
    def std(self) -> Array:
        """One sigma (k,) of each unknown before any frame, SI; k is their number."""

    @property
    def times(self) -> Array:
        """Correlation time (s) of each unknown, which is an Ornstein-Uhlenbeck process."""
        return np.full(self.std.size, math.inf)

    @property
    def prior(self) -> Prior:
        """The prior before any frame."""
        std = self.std
        return Prior(mean=np.zeros(std.size), std=std)

    @property
    def law_columns(self) -> int:
        """Number of columns of the law after these unknowns."""
        return len(self.law_errors)

    @property
    def law_errors(self) -> tuple[Mapping[str, float], ...]:
        """Changes of the model file per column, besides those of the covariance, by path."""
        return ()

    @property
    def sized(self) -> tuple[int, ...]:
        """Unknowns that scale with the size of the model error; their std is for a size of 1."""
        return ()

    def growth(self, seconds: float, pressure_change: float) -> list[float]:
        """Return the process noise (one sigma), relative to std, for a model error of size 1."""
        return []

    def move(self, passage: Passage, by_times: Move) -> Move:
        """Return the process model; by_times: that of Ornstein-Uhlenbeck processes (`times`)."""
        return by_times

    def on_rod(self, causes: Array, columns: slice) -> None:
        """Write the constant derivatives of every cause of the rod by each unknown.

        By default the first unknowns are the columns of the law of this block. causes (causes, k):
        zeros, a row for F1, F2, M, pressure and each column of the law; columns: the rows of this
        block.
        """
        causes[columns] = np.eye(self.law_columns, causes.shape[1])

    def on_rod_as_read(  # noqa: B027
        self, causes: Array, columns: slice, inputs: FrameInputs
    ) -> None:
        """Write the derivatives that depend on the readings."""

    def on_camera(self) -> Array | None:
        """Return the derivatives of the camera's x, y and rotation by the unknowns, (3, k)."""
        return None

    def on_dots(self, unknowns: Array) -> Array | None:
        """Return the displacement of the dots by their own unknowns (k, ..), (2, dots, ..)."""
        return None

    def on_wrench(self, seen: WrenchSeen) -> Array | None:
        """Return the derivatives of the force reading (F1, F2) by the unknowns, (2, k)."""
        return None

    def as_pressure(self, inputs: FrameInputs) -> Array | None:
        """Return each unknown as an equivalent pressure error, (k,) Pa."""
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class SizedBlock(Block):
    """A block of errors that scale with the model error, with time and with the pressure.

    range (Pa) of the pressure; a change by the whole range changes an error by its full size.
    """

    range: float
    correlation_time: float = tuning(
        20.0, 'correlation time of the model error', unit='s', source='sweep'
    )

    def growth(self, seconds: float, pressure_change: float) -> list[float]:
        """Return one sigma of the process noise of the sized unknowns, for a size of 1."""
        time = self.correlation_time
        by_time = math.sqrt(-math.expm1(-2.0 * seconds / time))
        return [math.hypot(by_time, pressure_change / self.range)] * len(self.sized)
