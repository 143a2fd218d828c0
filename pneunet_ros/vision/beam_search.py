"""Grow rows among blobs target by target: the compiled part of `association`.

The next target is expected where an arc through the last ones leads, at the known spacing. The few
best rows so far are kept at each step.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import inlined, kernel
from pneunet_ros.core.settings import numbers_type, tuning

Indices = npt.NDArray[np.int64]

NOTHING = -1

# What is known of a row while it grows.
COST, X, Y, HEADING, BENDING, SCALE, SIZE, LAST = range(8)


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamSearchSettings:
    """What a row of targets looks like, and how many rows are tried."""

    along: float = tuning(0.35, 'a target off its place along the row, at most', unit='spacing')
    across: float = tuning(0.35, 'the same, across', unit='spacing')
    along_std: float = tuning(0.12, 'one sigma of that along the row', unit='spacing')
    across_std: float = tuning(0.15, 'the same, across', unit='spacing')
    gap_along: float = tuning(0.1, 'of what a gap bends: further off along the row')
    bend: float = tuning(0.08, 'further off after a gap', unit='spacing x (gap^2 - 1)')
    stretch: float = tuning(0.25, 'longest and shortest spacing of a stretched arm, off 1')
    larger: float = tuning(0.9, 'difference of logarithmic areas in a row, at most')
    size_std: float = tuning(0.35, 'one sigma of that')
    memory: float = tuning(0.7, 'weight of the row so far in its spacing and its size')
    missing: float = tuning(9.0, 'cost of a target that is not seen')
    dearest: float = tuning(0.2, 'share of targets missing in a row found anywhere, at most')
    alike: float = tuning(1.5, 'cost of a blob beyond the end, below which the row goes on')
    gap_misfit: float = tuning(0.35, 'length of a gap against its targets', unit='spacing')
    longest_gap: int = tuning(7, 'from one target that is seen to the next')
    first_gap: int = tuning(2, 'the same, where the scale is not known')
    kept: int = tuning(12, 'rows kept at each step')
    neighbors: int = tuning(6, 'of a blob, one of which is the next target')
    seen: float = tuning(0.8, 'share of the targets seen in a row found anywhere, at least')


BeamSearchNumbers = numbers_type(BeamSearchSettings, 'BeamSearchNumbers')
BEAM_SEARCH = BeamSearchSettings()


@functools.lru_cache
def beam_search_numbers(settings: BeamSearchSettings) -> Any:
    """Return settings as kernels take them."""
    return BeamSearchNumbers(*astuple(settings))


@inlined
def _expected(row: Array, ahead: float) -> tuple[float, float, float, float]:
    """Return where an arc leads (x, y), and the cosine and sine of its chord; ahead: m."""
    middle = row[HEADING] + 0.5 * row[BENDING] * ahead
    cosine, sine = math.cos(middle), math.sin(middle)
    length = row[SCALE] * ahead
    return row[X] + length * cosine, row[Y] + length * sine, cosine, sine


@inlined
def _misfit(
    off_x: float,
    off_y: float,
    cosine: float,
    sine: float,
    bend: float,
    larger: float,
    search: BeamSearchSettings,
) -> float:
    """Cost of a blob that is off by so much (spacings) and larger in logarithm; inf if too far.

    bend: how much further across the gap it may be.
    """
    along = abs(off_x * cosine + off_y * sine)
    across = abs(off_y * cosine - off_x * sine)
    if (
        along > search.along + search.gap_along * bend
        or across > search.across + bend
        or abs(larger) > search.larger
    ):
        return math.inf
    return (
        (along / search.along_std) ** 2
        + (across / (search.across_std + bend)) ** 2
        + (larger / search.size_std) ** 2
    )


@inlined
def _lengthen(
    row: Array,
    x: float,
    y: float,
    size: float,
    ahead: float,
    first: float,
    search: BeamSearchSettings,
) -> None:
    """Put a target at the end of a row; first: the scale the row began with."""
    step_x, step_y = x - row[X], y - row[Y]
    chord = math.hypot(step_x, step_y)
    if ahead > 0.0 and chord > 0.0:
        # Heading of an arc: that of the chord in its middle; half of a new bend is believed.
        turn = _wrap_angle(math.atan2(step_y, step_x) - row[HEADING])
        bending = 2.0 * turn / ahead
        row[BENDING] = 0.5 * (row[BENDING] + bending)
        row[HEADING] += turn + 0.5 * row[BENDING] * ahead
        scale = search.memory * row[SCALE] + (1.0 - search.memory) * chord / ahead
        row[SCALE] = min(
            max(scale, first * (1.0 - search.stretch)), first * (1.0 + search.stretch)
        )
    row[X], row[Y] = x, y
    row[SIZE] = (
        size if math.isnan(row[SIZE]) else search.memory * row[SIZE] + (1.0 - search.memory) * size
    )


class BlobColumns(NamedTuple):
    """Blobs in the working plane: x, y and logarithm of the size, (blobs,) each."""

    x: Array
    y: Array
    sizes: Array


@kernel
def grow_row(
    blobs: BlobColumns,
    arclength: Array,
    start: Array,
    longest_gap: int,
    dearest: float,
    chosen: Indices,
    search: BeamSearchSettings,
) -> float:
    """Grow a row from its start, which `chosen` (targets,) holds so far; return its cost.

    start: what is known of the row, as named above. `chosen` becomes the best row; the cost is
    infinite where it would be above `dearest`.
    """
    x, y, sizes = blobs
    targets = arclength.size
    rows = np.zeros((search.kept, LAST + 1))
    paths = np.full((search.kept, targets), NOTHING)
    next_rows = np.zeros((search.kept + 1, LAST + 1))
    next_paths = np.full((search.kept + 1, targets), NOTHING)
    rows[0], paths[0] = start, chosen
    kept = 1
    for target in range(int(start[LAST]) + 1, targets):
        found = 0
        for place in range(kept):
            row = rows[place]
            last = int(row[LAST])
            gap = target - last
            ahead = arclength[target] - (arclength[last] if last >= 0 else 0.0)
            unit = row[SCALE] * (arclength[max(target, 1)] - arclength[max(target, 1) - 1])
            bend = search.bend * (gap * gap - 1)
            at_x, at_y, cosine, sine = _expected(row, ahead)
            reach = unit * (search.along + search.across + bend)
            for blob in range(-1, x.size if gap <= longest_gap else 0):
                cost = search.missing
                if blob >= 0:
                    off_x, off_y = x[blob] - at_x, y[blob] - at_y
                    if abs(off_x) > reach or abs(off_y) > reach:
                        continue
                    larger = 0.0 if math.isnan(row[SIZE]) else sizes[blob] - row[SIZE]
                    cost = _misfit(off_x / unit, off_y / unit, cosine, sine, bend, larger, search)
                cost += row[COST]
                if found == search.kept and cost >= next_rows[search.kept - 1, COST]:
                    continue
                if not cost < math.inf:
                    continue
                # Into the place by its cost, after equals.
                slot = found
                while slot > 0 and next_rows[slot - 1, COST] > cost:
                    next_rows[slot] = next_rows[slot - 1]
                    next_paths[slot] = next_paths[slot - 1]
                    slot -= 1
                next_rows[slot], next_paths[slot] = row, paths[place]
                next_rows[slot, COST] = cost
                if blob >= 0:
                    _lengthen(
                        next_rows[slot], x[blob], y[blob], sizes[blob], ahead, start[SCALE], search
                    )
                    next_rows[slot, LAST] = target
                    next_paths[slot, target] = blob
                found = min(found + 1, search.kept)
        if next_rows[0, COST] > dearest:
            return math.inf
        kept = found
        rows[:kept] = next_rows[:kept]
        paths[:kept] = next_paths[:kept]
    chosen[:] = paths[0]
    return float(rows[0, COST])


@kernel
def truncate_row(
    x: Array,
    y: Array,
    arclength: Array,
    clamp_angle: float,
    chosen: Indices,
    search: BeamSearchSettings,
) -> None:
    """End a row at the first gap that is not as long as the targets missing in it.

    Beyond such a gap the row may be a target off. A gap is as long as a curve with the headings at
    its ends; the targets next to it tell how far the arm is stretched.
    """
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < 3:
        return
    steps = np.hypot(np.diff(x[chosen[seen]]), np.diff(y[chosen[seen]]))
    scale = np.median(steps / np.diff(arclength[seen]))
    for place in range(seen.size):
        target = seen[place]
        before = seen[place - 1] if place > 0 else -1
        if target - before <= 1:
            continue
        from_x = from_y = passed = 0.0
        heading = clamp_angle
        if place > 0:
            from_x, from_y = x[chosen[before]], y[chosen[before]]
            passed = arclength[before]
            if place > 1:
                heading = _end_heading(x, y, arclength, chosen, seen[:place][::-1][:3]) + math.pi
        onward = heading
        if place + 1 < seen.size:
            onward = _end_heading(x, y, arclength, chosen, seen[place:][:3])
        chord_x, chord_y = x[chosen[target]] - from_x, y[chosen[target]] - from_y
        chord = math.atan2(chord_y, chord_x)
        a, b = _wrap_angle(heading - chord), _wrap_angle(onward - chord)
        longer = 1.0 + (2.0 * a * a + 2.0 * b * b - a * b) / 30.0
        length = longer * math.hypot(chord_x, chord_y)
        spacing = arclength[max(target, 1)] - arclength[max(target, 1) - 1]
        if abs(length / scale - (arclength[target] - passed)) > search.gap_misfit * spacing:
            chosen[target:] = NOTHING
            return


@inlined
def _end_heading(x: Array, y: Array, arclength: Array, chosen: Indices, places: Indices) -> float:
    """Heading at the first of two or three targets, towards the next, on an arc through them."""
    first, second = places[0], places[1]
    a, b = chosen[first], chosen[second]
    heading = math.atan2(y[b] - y[a], x[b] - x[a])
    if places.size < 3:
        return heading
    third = places[2]
    c = chosen[third]
    turn = _wrap_angle(math.atan2(y[c] - y[b], x[c] - x[b]) - heading)
    share = abs(arclength[second] - arclength[first]) / abs(arclength[third] - arclength[first])
    at_end: float = heading - turn * share
    return at_end


@inlined
def _wrap_angle(angle: float) -> float:
    """Bring an angle into (-pi, pi]."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def continues_beyond(
    x: Array, y: Array, sizes: Array, arclength: Array, chosen: Indices, search: BeamSearchSettings
) -> bool:
    """Whether another blob alike stands a spacing beyond the last target of a row."""
    last = arclength.size - 1
    row = np.zeros(LAST + 1)
    before = last - 1
    while before >= 0 and chosen[before] < 0:
        before -= 1
    if before < 0:
        return False
    ahead = arclength[last] - arclength[before]
    a, b = chosen[before], chosen[last]
    row[X], row[Y] = x[b], y[b]
    row[HEADING] = math.atan2(y[b] - y[a], x[b] - x[a])
    row[SCALE] = math.hypot(x[b] - x[a], y[b] - y[a]) / ahead
    spacing = arclength[last] - arclength[last - 1]
    at_x, at_y, cosine, sine = _expected(row, spacing)
    unit = row[SCALE] * spacing
    for blob in range(x.size):
        off_x, off_y = (x[blob] - at_x) / unit, (y[blob] - at_y) / unit
        larger = sizes[blob] - sizes[b]
        if blob != b and _misfit(off_x, off_y, cosine, sine, 0.0, larger, search) < search.alike:
            return True
    return False


@kernel
def grow_seeded_rows(
    x: Array, y: Array, sizes: Array, arclength: Array, search: BeamSearchSettings
) -> tuple[npt.NDArray[np.int64], Array]:
    """Grow a row from every blob and each of its neighbors; rows (seeds, targets) and costs."""
    targets, blobs = arclength.size, BlobColumns(x, y, sizes)
    seeds = x.size * search.neighbors
    rows = np.full((seeds, targets), NOTHING)
    costs = np.full(seeds, math.inf)
    reverse = arclength[-1] - arclength[::-1]
    start = np.zeros(LAST + 1)
    dearest = targets * (search.dearest * search.missing + 1.0)
    for blob in range(x.size):
        distances = np.hypot(x - x[blob], y - y[blob])
        distances[blob] = math.inf
        for place in range(min(search.neighbors, x.size - 1)):
            neighbor = int(np.argmin(distances))
            chord = distances[neighbor]
            distances[neighbor] = math.inf
            if not chord > 0.0:
                continue
            seed = blob * search.neighbors + place
            rows[seed, 0], rows[seed, 1] = blob, neighbor
            start[COST], start[BENDING], start[LAST] = 0.0, 0.0, 1.0
            start[X], start[Y] = x[neighbor], y[neighbor]
            start[HEADING] = math.atan2(y[neighbor] - y[blob], x[neighbor] - x[blob])
            start[SCALE] = chord / (arclength[1] - arclength[0])
            start[SIZE] = 0.5 * (sizes[blob] + sizes[neighbor])
            cost = grow_row(blobs, arclength, start, search.first_gap, dearest, rows[seed], search)
            seen = np.sum(rows[seed] >= 0)
            if rows[seed, -1] < 0 or rows[seed, 2] < 0 or seen < search.seen * targets:
                continue
            if np.unique(rows[seed][rows[seed] >= 0]).size < seen:
                continue  # a row that bites its tail
            if continues_beyond(x, y, sizes, arclength, rows[seed], search):
                continue
            if continues_beyond(x, y, sizes, reverse, rows[seed][::-1].copy(), search):
                continue
            costs[seed] = cost
    return rows, costs
