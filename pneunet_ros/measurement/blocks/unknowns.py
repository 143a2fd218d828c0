"""Blocks stacked into one vector of unknowns; constant matrices are built once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.measurement.blocks.block import (
    Block,
    CAMERA_CAUSES,
    FrameInputs,
    Move,
    Passage,
    WrenchSeen,
)
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.inference.gaussian import Gaussian, Known, with_columns

LAW = PRESSURE + 1  # rows of causes: F1, F2, M, pressure, then columns of the law
Kind = TypeVar('Kind', bound=Block)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """A block in the state vector: the slices of its unknowns and of its columns."""

    block: Block
    where: slice
    columns: slice


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknowns:
    """The unknowns of some blocks; `Unknowns.of(block, block, ...)`, at most one of each kind.

    std (n,): before any frame; for errors of unknown size, those of a size of 1; sized: indices of
    these; moving (m,): indices of the unknowns that change, with moving_times and moving_std (m,);
    causes (causes, n): constant derivatives of every cause of the rod, `LAW` and the columns;
    camera (3, n): derivatives of the camera's x, y and rotation.
    """

    placed: tuple[Placed, ...]
    places: dict[type[Block], Placed] = field(init=False, repr=False)
    std: Array = field(init=False, repr=False)
    sized: npt.NDArray[np.intp] = field(init=False, repr=False)
    moving: npt.NDArray[np.intp] = field(init=False, repr=False)
    moving_times: Array = field(init=False, repr=False)
    moving_std: Array = field(init=False, repr=False)
    movers: tuple[tuple[Block, slice], ...] = field(init=False, repr=False)
    white: npt.NDArray[np.intp] = field(init=False, repr=False)
    causes: Array = field(init=False, repr=False)
    camera: Array = field(init=False, repr=False)
    as_read: tuple[Placed, ...] = field(init=False, repr=False)
    dots: tuple[Placed, ...] = field(init=False, repr=False)
    of_wrench: tuple[Placed, ...] = field(init=False, repr=False)
    of_pressure: tuple[Placed, ...] = field(init=False, repr=False)
    of_growth: tuple[Placed, ...] = field(init=False, repr=False)

    @classmethod
    def of(cls, *blocks: Block) -> Unknowns:
        """Stack blocks in this order."""
        placed, start, column = [], 0, LAW
        for block in blocks:
            stop, end = start + block.std.size, column + block.law_columns
            where, columns = slice(start, stop), slice(column, end)
            placed.append(Placed(block=block, where=where, columns=columns))
            start, column = stop, end
        return cls(placed=tuple(placed))

    def __post_init__(self) -> None:
        """Compute constants once."""
        placed = self.placed
        std = np.concatenate([one.block.std for one in placed])
        times = np.concatenate([one.block.times for one in placed])
        moving = np.flatnonzero(np.isfinite(times))
        causes = np.zeros((placed[-1].columns.stop, std.size))
        camera = np.zeros((CAMERA_CAUSES, std.size))
        movers, sized = [], []
        white: list[int] = []
        for one in placed:
            start = one.where.start
            one.block.on_rod(causes[:, one.where], one.columns)
            of_camera = one.block.on_camera()
            if of_camera is not None:
                camera[:, one.where] = of_camera
            sized += [start + which for which in one.block.sized]
            white += range(start, one.where.stop) if one.block.white else []
            if type(one.block).move is not Block.move:
                ends = np.searchsorted(moving, [start, one.where.stop]).tolist()
                movers.append((one.block, slice(*ends)))
        for name, value in (
            ('places', {type(one.block): one for one in placed}),
            ('std', freeze(std)),
            ('sized', np.array(sized, dtype=np.intp)),
            ('moving', moving),
            ('moving_times', freeze(times[moving])),
            ('moving_std', freeze(std[moving])),
            ('movers', tuple(movers)),
            ('white', np.array(white, dtype=np.intp)),
            ('causes', freeze(causes)),
            ('camera', freeze(camera)),
            ('as_read', self._that('on_rod_as_read')),
            ('dots', self._that('on_dots')),
            ('of_wrench', self._that('on_wrench')),
            ('of_pressure', self._that('as_pressure')),
            ('of_growth', self._that('growth')),
        ):
            object.__setattr__(self, name, value)

    def _that(self, method: str) -> tuple[Placed, ...]:
        """Return the blocks that override this method."""
        neutral = getattr(Block, method)
        return tuple(one for one in self.placed if getattr(type(one.block), method) is not neutral)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The blocks in their order."""
        return tuple(one.block for one in self.placed)

    def block(self, kind: type[Kind]) -> Kind:
        """Return the block of a kind."""
        block = self.places[kind].block
        assert isinstance(block, kind)
        return block

    def at(self, kind: type[Block], part: slice = slice(None)) -> slice:
        """Return the slice of a block in the unknowns, or of a part of the block."""
        where = self.places[kind].where
        if part.start is None:
            return where
        return slice(where.start + part.start, where.start + part.stop)

    def changed(self, block: Block) -> Unknowns:
        """Return the unknowns with one block replaced by another of the same type."""
        blocks = (block if type(one) is type(block) else one for one in self.blocks)
        return Unknowns.of(*blocks)

    @property
    def law_errors(self) -> tuple[dict[str, float], ...]:
        """Columns of the law besides the covariance, in the form for `PerturbationTable`."""
        return tuple(dict(error) for one in self.blocks for error in one.law_errors)

    @property
    def law_columns(self) -> int:
        """The number of columns of the law."""
        return len(self.causes) - LAW

    def prior(self, size: float) -> Gaussian:
        """Return the initial prior for a size of the model error."""
        priors = [one.block.prior for one in self.placed]
        mean = np.concatenate([prior.mean for prior in priors])
        std = np.concatenate([prior.std for prior in priors])
        std[self.sized] *= size
        root = np.diag(std)
        for one, prior in zip(self.placed, priors, strict=True):
            if prior.shared is not None:
                other, factor = prior.shared
                start = self.places[other].where.start
                root[one.where, start : start + factor.shape[1]] = factor
        return Gaussian(mean=freeze(mean), root=freeze(root))

    def scaled_std(self, size: float) -> Array:
        """Return one sigma (n,) before any frame, for a size of the model error."""
        std = self.std.copy()
        std[self.sized] *= size
        return freeze(std)

    def growth(self, seconds: float, pressure_change: float) -> Array:
        """Return one sigma of the process noise of errors of unknown size, for a size of 1."""
        return np.array(
            [
                std
                for placed in self.of_growth
                for std in placed.block.growth(seconds, pressure_change)
            ]
        )

    def move(
        self, known: Known, passage: Passage, noise: tuple[float, ...] | None = None
    ) -> tuple[Array, Array]:
        """Return mean and square root after the process noise, forward or backward in time.

        noise: one sigma of the unknowns that are new in every reading; None: unchanged. The root
        gets one column for every unknown that changes, then those of the noise.
        """
        moving, before = self.moving, known.root.shape[1]
        decay = np.exp(-passage.seconds / self.moving_times)
        grown = np.sqrt(1.0 - decay**2) * self.moving_std
        fixed_means = []
        for block, where in self.movers:
            move = block.move(passage, Move(decay=decay[where], noise=grown[where]))
            decay[where], grown[where] = move.decay, move.noise
            fixed_means += [where] if move.held else []
        of_mean = decay.copy()
        for where in fixed_means:
            of_mean[where] = 1.0
        count = moving.size
        mean = known.mean.copy()
        root = with_columns(known.root, count + (0 if noise is None else self.white.size))
        mean[moving] *= of_mean
        root[moving, :before] *= decay[:, None]
        root[moving, np.arange(before, before + count)] = grown
        if noise is not None:
            mean[self.white], root[self.white] = 0.0, 0.0
            root[self.white, np.arange(before + count, root.shape[1])] = noise
        return freeze(mean), freeze(root)

    def causes_at(self, inputs: FrameInputs) -> Array:
        """Return the derivatives of the rod's causes by the unknowns at a frame, (causes, n)."""
        causes = self.causes.copy()
        for one in self.as_read:
            one.block.on_rod_as_read(causes[:, one.where], one.columns, inputs)
        return causes

    def dots_moved(self, unknowns: Array) -> Array:
        """Return the displacement of the dots by their own unknowns (n, ..), (2, dots, ..)."""
        total: Array | None = None
        for one in self.dots:
            moves = one.block.on_dots(unknowns[one.where])
            total = moves if total is None or moves is None else total + moves
        assert total is not None
        return total

    def wrench_response(self, seen: WrenchSeen) -> Array:
        """Return the derivatives of the force reading (F1, F2) by the unknowns, (2, n)."""
        response = np.zeros((2, self.std.size))
        for one in self.of_wrench:
            read = one.block.on_wrench(seen)
            if read is not None:
                response[:, one.where] = read
        return response

    def as_pressure(self, inputs: FrameInputs) -> Array:
        """Return each unknown as an equivalent pressure error, (n,) Pa."""
        row = np.zeros(self.std.size)
        for one in self.of_pressure:
            pressures = one.block.as_pressure(inputs)
            if pressures is not None:
                row[one.where] = pressures
        return row
