"""Grow rows among bright areas target by target: the compiled part of `row_search`.

The next target is expected where an arc through the last ones leads, at the known spacing. The few
best rows so far are kept at each step.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import inlined, kernel

Indices = npt.NDArray[np.int64]

# Of the spacing of targets: how far from its place a target is looked for, along and across.
ALONG, ACROSS = 0.35, 0.35
SPREAD_ALONG, SPREAD_ACROSS = 0.12, 0.15  # of the spacing: what costs as much as one sigma
BEND = 0.08  # of the spacing and the square of the gap: how much more a gap can bend
STRETCH = 0.25  # longest and shortest spacing of a stretched arm
LARGER, SIZE_SPREAD = 0.9, 0.35  # largest difference of logarithmic areas in a row; its sigma
MISSING = 9.0  # cost of a target that is not seen
ALIKE_COST = 1.5  # of an area beyond the end of a row, below which the row goes on
GAP_MISFIT = 0.35  # of the spacing: beyond it a gap may hide another number of targets
LONGEST_GAP = 7  # in targets, from one that is seen to the next
KEPT = 12  # rows kept at each step
NEIGHBORS = 6  # of an area, where the scale is not known: one of them is the next target
NOTHING = -1

# What is known of a row while it grows.
COST, X, Y, HEADING, BENDING, SCALE, SIZE, LAST = range(8)


@inlined
def _expected(row: Array, ahead: float) -> tuple[float, float, float, float]:
    """Return where an arc leads (x, y), and the cosine and sine of its chord; ahead: m."""
    middle = row[HEADING] + 0.5 * row[BENDING] * ahead
    cosine, sine = math.cos(middle), math.sin(middle)
    length = row[SCALE] * ahead
    return row[X] + length * cosine, row[Y] + length * sine, cosine, sine


@inlined
def _misfit(
    off_x: float, off_y: float, cosine: float, sine: float, bend: float, larger: float
) -> float:
    """Cost of an area that is off by so much (spacings) and larger in logarithm; inf if too far.

    bend: how much further across the gap it may be.
    """
    along = abs(off_x * cosine + off_y * sine)
    across = abs(off_y * cosine - off_x * sine)
    if along > ALONG + 0.1 * bend or across > ACROSS + bend or abs(larger) > LARGER:
        return math.inf
    return (
        (along / SPREAD_ALONG) ** 2
        + (across / (SPREAD_ACROSS + bend)) ** 2
        + (larger / SIZE_SPREAD) ** 2
    )


@inlined
def _lengthen(row: Array, x: float, y: float, size: float, ahead: float, first: float) -> None:
    """Put a target at the end of a row; first: the scale the row began with."""
    step_x, step_y = x - row[X], y - row[Y]
    chord = math.hypot(step_x, step_y)
    if ahead > 0.0 and chord > 0.0:
        # Heading of an arc: that of the chord in its middle; half of a new bend is believed.
        turn = _turned(math.atan2(step_y, step_x) - row[HEADING])
        bending = 2.0 * turn / ahead
        row[BENDING] = 0.5 * (row[BENDING] + bending)
        row[HEADING] += turn + 0.5 * row[BENDING] * ahead
        scale = 0.7 * row[SCALE] + 0.3 * chord / ahead
        row[SCALE] = min(max(scale, first * (1.0 - STRETCH)), first * (1.0 + STRETCH))
    row[X], row[Y] = x, y
    row[SIZE] = size if math.isnan(row[SIZE]) else 0.7 * row[SIZE] + 0.3 * size


@kernel
def grow(
    x: Array,
    y: Array,
    sizes: Array,
    arclength: Array,
    start: Array,
    longest_gap: int,
    dearest: float,
    chosen: Indices,
) -> float:
    """Grow a row from its start, which `chosen` (targets,) holds so far; return its cost.

    start: what is known of the row, as named above. `chosen` becomes the best row; the cost is
    infinite where it would be above `dearest`.
    """
    targets = arclength.size
    rows = np.zeros((KEPT, LAST + 1))
    paths = np.full((KEPT, targets), NOTHING)
    next_rows = np.zeros((KEPT + 1, LAST + 1))
    next_paths = np.full((KEPT + 1, targets), NOTHING)
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
            bend = BEND * (gap * gap - 1)
            at_x, at_y, cosine, sine = _expected(row, ahead)
            reach = unit * (ALONG + ACROSS + bend)
            for area in range(-1, x.size if gap <= longest_gap else 0):
                cost = MISSING
                if area >= 0:
                    off_x, off_y = x[area] - at_x, y[area] - at_y
                    if abs(off_x) > reach or abs(off_y) > reach:
                        continue
                    larger = 0.0 if math.isnan(row[SIZE]) else sizes[area] - row[SIZE]
                    cost = _misfit(off_x / unit, off_y / unit, cosine, sine, bend, larger)
                cost += row[COST]
                if found == KEPT and cost >= next_rows[KEPT - 1, COST]:
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
                if area >= 0:
                    _lengthen(next_rows[slot], x[area], y[area], sizes[area], ahead, start[SCALE])
                    next_rows[slot, LAST] = target
                    next_paths[slot, target] = area
                found = min(found + 1, KEPT)
        if next_rows[0, COST] > dearest:
            return math.inf
        kept = found
        rows[:kept] = next_rows[:kept]
        paths[:kept] = next_paths[:kept]
    chosen[:] = paths[0]
    return float(rows[0, COST])


@kernel
def cut(x: Array, y: Array, arclength: Array, clamp_angle: float, chosen: Indices) -> None:
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
        a, b = _turned(heading - chord), _turned(onward - chord)
        longer = 1.0 + (2.0 * a * a + 2.0 * b * b - a * b) / 30.0
        length = longer * math.hypot(chord_x, chord_y)
        spacing = arclength[max(target, 1)] - arclength[max(target, 1) - 1]
        if abs(length / scale - (arclength[target] - passed)) > GAP_MISFIT * spacing:
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
    turn = _turned(math.atan2(y[c] - y[b], x[c] - x[b]) - heading)
    share = abs(arclength[second] - arclength[first]) / abs(arclength[third] - arclength[first])
    at_end: float = heading - turn * share
    return at_end


@inlined
def _turned(angle: float) -> float:
    """Bring an angle into (-pi, pi]."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def goes_on(x: Array, y: Array, sizes: Array, arclength: Array, chosen: Indices) -> bool:
    """Whether another area alike stands a spacing beyond the last target of a row."""
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
    for area in range(x.size):
        off_x, off_y = (x[area] - at_x) / unit, (y[area] - at_y) / unit
        larger = sizes[area] - sizes[b]
        if area != b and _misfit(off_x, off_y, cosine, sine, 0.0, larger) < ALIKE_COST:
            return True
    return False


@kernel
def seeded(
    x: Array, y: Array, sizes: Array, arclength: Array
) -> tuple[npt.NDArray[np.int64], Array]:
    """Grow a row from every area and each of its neighbors; rows (seeds, targets) and costs."""
    targets = arclength.size
    seeds = x.size * NEIGHBORS
    rows = np.full((seeds, targets), NOTHING)
    costs = np.full(seeds, math.inf)
    reverse = arclength[-1] - arclength[::-1]
    start = np.zeros(LAST + 1)
    dearest = targets * (0.2 * MISSING + 1.0)
    for area in range(x.size):
        distances = np.hypot(x - x[area], y - y[area])
        distances[area] = math.inf
        for place in range(min(NEIGHBORS, x.size - 1)):
            neighbor = int(np.argmin(distances))
            chord = distances[neighbor]
            distances[neighbor] = math.inf
            if not chord > 0.0:
                continue
            seed = area * NEIGHBORS + place
            rows[seed, 0], rows[seed, 1] = area, neighbor
            start[COST], start[BENDING], start[LAST] = 0.0, 0.0, 1.0
            start[X], start[Y] = x[neighbor], y[neighbor]
            start[HEADING] = math.atan2(y[neighbor] - y[area], x[neighbor] - x[area])
            start[SCALE] = chord / (arclength[1] - arclength[0])
            start[SIZE] = 0.5 * (sizes[area] + sizes[neighbor])
            cost = grow(x, y, sizes, arclength, start, 2, dearest, rows[seed])
            seen = np.sum(rows[seed] >= 0)
            if rows[seed, -1] < 0 or rows[seed, 2] < 0 or 5 * seen < 4 * targets:
                continue
            if np.unique(rows[seed][rows[seed] >= 0]).size < seen:
                continue  # a row that bites its tail
            if goes_on(x, y, sizes, arclength, rows[seed]):
                continue
            if goes_on(x, y, sizes, reverse, rows[seed][::-1].copy()):
                continue
            costs[seed] = cost
    return rows, costs
