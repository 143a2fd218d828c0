"""Areas that do not move; areas that stay while the arm moves are background.

In a single frame, background may look like targets, but only the arm first rests and then moves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.vision.association import ENOUGH
from pneunet_ros.vision.beam_search import BEAM_SEARCH
from pneunet_ros.vision.dots.blobs import Blobs
from pneunet_ros.vision.gating import Mask
import scipy

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillAreas:
    """Areas at constant positions in successive frames, with counts and the time since last seen.

    centers (areas, 2) px: averages over the frames in which each was seen; std (areas,) px: of a
    single frame; area (areas,) px^2 and shapes (areas, 3): as in `Blobs`; seen (areas,): number of
    frames; unseen (areas,): number of frames since.
    """

    centers: Array = field(default_factory=lambda: np.empty((0, 2)))
    std: Array = field(default_factory=lambda: np.empty(0))
    area: Array = field(default_factory=lambda: np.empty(0))
    shapes: Array = field(default_factory=lambda: np.empty((0, 3)))
    seen: Counts = field(default_factory=lambda: np.empty(0, np.int64))
    unseen: Counts = field(default_factory=lambda: np.empty(0, np.int64))

    def with_frame(self, blobs: Blobs, wanted: int) -> StillAreas:
        """Return the areas after one more frame, without those that moved after too few frames."""
        new, seen, unseen, centers = (
            np.ones(len(blobs), np.bool_),
            self.seen,
            self.unseen,
            self.centers,
        )
        if len(seen) and len(blobs):
            away, nearest = scipy.spatial.cKDTree(blobs.centers).query(centers)
            there = away <= BEAM_SEARCH.farthest * np.hypot(self.std, blobs.std[nearest])
            seen, unseen = seen + there, np.where(there, 0, unseen + 1)
            step = (blobs.centers[nearest] - centers) / seen[:, None]
            centers = np.where(there[:, None], centers + step, centers)
            new[nearest[there]] = False
        with_new = StillAreas(
            centers=np.concatenate([centers, blobs.centers[new]]),
            std=np.concatenate([self.std, blobs.std[new]]),
            area=np.concatenate([self.area, blobs.area[new]]),
            shapes=np.concatenate([self.shapes, blobs.shapes[new]]),
            seen=np.concatenate([seen, np.ones(np.count_nonzero(new), np.int64)]),
            unseen=np.concatenate([unseen, np.zeros(np.count_nonzero(new), np.int64)]),
        )
        return with_new.only((with_new.seen >= wanted) | (with_new.unseen < wanted))

    def only(self, which: Mask) -> StillAreas:
        """Return some of the areas."""
        return StillAreas(
            centers=self.centers[which], std=self.std[which], area=self.area[which],
            shapes=self.shapes[which], seen=self.seen[which], unseen=self.unseen[which],
        )  # fmt: skip


def is_moved(vanished: Mask, row: Counts, odds: float) -> bool:
    """Whether a row of areas (indices) disappeared because it moved, rather than by chance.

    vanished (areas,): mask of areas that disappeared. Fisher's exact test for the best of ENOUGH
    rows; odds: of chance.
    """
    return (
        ENOUGH
        * _chance_of_more(len(vanished), int(vanished.sum()), len(row), int(vanished[row].sum()))
        < odds
    )


def _chance_of_more(areas: int, vanished: int, row: int, vanished_of_row: int) -> float:
    """Return the chance that at least as many of a row disappeared (hypergeometric)."""
    ways = sum(
        math.comb(vanished, many) * math.comb(areas - vanished, row - many)
        for many in range(vanished_of_row, min(row, vanished) + 1)
    )
    return ways / math.comb(areas, row)
