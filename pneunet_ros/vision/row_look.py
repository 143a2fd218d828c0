"""How a target looks by its neighbors in the row: size, shape and blur change little along it.

A target of which only a part is seen (cut off by the end of the arm, behind a finger, before a
background of its own grey) is where an outline like those of its neighbors fits that part.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.vision.centroid import (
    AREA,
    axes_of,
    BEYOND,
    BLUR,
    CONTRAST,
    EXACT,
    FILLED,
    Integers,
    LEVEL,
    Mask,
    outlines,
    SEEN,
    SMEAR,
    STD,
)
from pneunet_ros.vision.ellipse_fit import AXIS_XX, AXIS_XY, AXIS_YY, BEHIND, PLATEAU, PLATEAU_STD


@dataclass(frozen=True, slots=True, kw_only=True)
class RowLookSettings:
    """When a target is looked at as its neighbors look, and how well these tell."""

    neighbors: int = tuning(6, 'the nearest, by which a target is known')
    fewest: int = tuning(3, 'of them')
    exact: float = tuning(
        0.94, 'share of the edge on the outline, of a whole blob', source='measured'
    )
    least_area: float = tuning(
        0.985, 'of a whole blob, over that by its neighbors', source='measured'
    )
    least_std: float = tuning(0.0015, 'one sigma of size and shape, at least', unit='radius')
    blur_std: float = tuning(0.1, 'one sigma of the blur', unit='px')
    smear_std: float = tuning(0.15, 'of the way during an exposure, one sigma at least', unit='px')
    level_std: float = tuning(0.03, 'of the plateau, one sigma at least', unit='contrast')
    whole: float = tuning(0.87, 'area of a target seen in great part, over that by its neighbors')
    seen: float = tuning(
        0.6, 'share of the visible edge that shows a target of which less is seen'
    )
    appeared: float = tuning(
        0.25, 'the same, off where the row is, of a doubtful one', unit='radius'
    )
    size: float = tuning(0.8, 'area of an outline fitted to a part, over that by its neighbors')
    worse: float = tuning(5.0, 'error of a doubtful part, over that of the others')
    beyond: float = tuning(0.15, 'share of the edge that lies outside of the outline, at most')
    part_error: float = tuning(
        0.05, 'of a part that moves along what covers it', unit='radius', source='measured'
    )
    filled: float = tuning(0.65, 'share of the inside that must be seen', source='measured')
    level: float = tuning(0.15, 'a target brighter or darker than neighbors', unit='contrast')
    level_moved: float = tuning(0.1, 'the same, added where it moves by a radius', unit='contrast')
    moved: float = tuning(0.5, 'a target by a part of it, off where it was seen', unit='radius')


ROW_LOOK = RowLookSettings()


def looks_of_neighbors(table: Array, places: Array, settings: RowLookSettings = ROW_LOOK) -> Array:
    """Return how targets look by their neighbors, as `outlines` at places (targets, 2) px.

    table (targets, COLUMNS), NaN where one is not seen. Axes, smear and plateau are on a
    line over the nearest neighbors whose edges are whole; how far these are off it is how well it
    tells. NaN for a target that has too few.
    """
    whole = np.flatnonzero(table[:, EXACT] >= settings.exact)
    radius = np.sqrt(table[:, AREA] / math.pi)
    looks = np.column_stack([
        axes_of(table), table[:, SMEAR], table[:, LEVEL],
        radius, table[:, BLUR], table[:, CONTRAST],
    ])  # fmt: skip
    count = len(table)
    expected, smear = np.full((count, 3), np.nan), np.full((count, 2), np.nan)
    std, level, level_std, smear_std = np.full((4, count), np.nan)
    middle = np.full((count, 3), np.nan)
    for target in range(count):
        others = whole[whole != target]
        near = others[np.argsort(np.abs(others - target), kind='stable')[: settings.neighbors]]
        if len(near) >= settings.fewest:
            line, off = _line_at(target, near, looks)
            expected[target], smear[target], level[target] = line[:3], line[3:5], line[5]
            middle[target] = np.sort(looks[near, 6:], axis=0)[len(near) // 2]
            std[target] = np.sqrt(np.mean(off[:3])) / middle[target, 0]
            smear_std[target], level_std[target] = np.sqrt([np.mean(off[3:5]), off[5]])
    blur, contrast = middle[:, 1:].T
    std = np.maximum(std, settings.least_std)
    stds = (std, settings.blur_std, np.maximum(smear_std, settings.smear_std))
    starts = outlines(places, expected, blur, smear, stds)
    starts[:, PLATEAU], starts[:, BEHIND] = level, level - contrast
    starts[:, PLATEAU_STD] = np.maximum(level_std, settings.level_std * contrast)
    return starts


def _line_at(target: int, near: Integers, values: Array) -> tuple[Array, Array]:
    """Return values (k,) of a line over neighbors at a target, and their variances."""
    away = (near - target).astype(np.float64)
    middle = away.mean()
    square = float(np.sum((away - middle) ** 2))
    at_middle = values[near].mean(axis=0)
    slope = (away - middle) @ values[near] / square
    off = values[near] - at_middle - np.outer(away - middle, slope)
    larger = 1.0 + 1.0 / len(near) + middle**2 / square
    line = at_middle - middle * slope
    return line, larger * np.sum(off * off, axis=0) / max(len(near) - 2, 1)


def share_of_area(table: Array, expected: Array) -> Array:
    """Return how large targets are over how large their neighbors say they are (targets,).

    expected: as `looks_of_neighbors`.
    """
    size = expected[:, AXIS_XX] * expected[:, AXIS_YY] - expected[:, AXIS_XY] ** 2
    return np.asarray(table[:, AREA] / (math.pi * size))


def believable_parts(
    found: Array, expected: Array, share: Array, settings: RowLookSettings = ROW_LOOK
) -> Mask:
    """Whether targets of which a part was found (targets, COLUMNS) are what their neighbors are.

    expected: as `looks_of_neighbors`; share: as `share_of_area`. What covers a target is of
    another grey, and has an edge of its own; it takes from the target, and never adds to it.
    """
    off = np.abs(found[:, LEVEL] - expected[:, PLATEAU])
    allowed = settings.level + settings.level_moved * _moved(found)
    alike = off <= allowed * (expected[:, PLATEAU] - expected[:, BEHIND])
    edge = (share >= settings.whole) | (found[:, SEEN] >= settings.seen)
    within = found[:, BEYOND] <= settings.beyond
    size = share_of_area(found, expected)
    sized = (size >= settings.size) & (size <= 1.0 / settings.size)
    return np.asarray(alike & edge & within & sized & (found[:, FILLED] >= settings.filled))


def part_stds(found: Array, settings: RowLookSettings = ROW_LOOK) -> Array:
    """Return the standard errors of the centers of targets of which a part was found, px.

    found (targets, COLUMNS). Where a target moves along the edge that covers it while the shutter
    is open, its own edge and that one look alike, and the outline fits between them.
    """
    radius = np.sqrt(found[:, AREA] / math.pi)
    return np.asarray(np.hypot(found[:, STD], settings.part_error * radius * _moved(found)))


def _moved(table: Array) -> Array:
    """Return the square of the way of targets over their radius, one at most (targets,)."""
    square = np.sum(table[:, SMEAR] ** 2, axis=1)
    return np.asarray(np.minimum(square / (table[:, AREA] / math.pi), 1.0))
