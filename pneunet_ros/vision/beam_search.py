"""Grow rows among blobs target by target: the arithmetic of `association`.

The next target is expected where an arc through the last ones leads, at the known spacing. The few
best rows so far are kept at each step. All rows grow side by side, as columns of numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

NOTHING = -1
TOGETHER = 512  # starts whose rows grow side by side

# What is known of a row while it grows.
COST, X, Y, HEADING, BENDING, SCALE, SIZE, LAST = range(8)


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamSearchSettings:
    """What a row of targets looks like, and how many rows are tried."""

    along: float = tuning(0.35, 'a target off its place along the row, at most', unit='spacing')
    across: float = tuning(0.35, 'the same, across', unit='spacing')
    along_std: float = tuning(0.12, 'one sigma of that along the row', unit='spacing')
    across_std: float = tuning(0.15, 'the same, across', unit='spacing')
    bend: float = tuning(0.08, 'further off after a gap', unit='spacing x (gap^2 - 1)')
    stretch: float = tuning(0.25, 'longest and shortest spacing of a stretched arm, off 1')
    size_std: float = tuning(0.35, 'difference of logarithmic areas in a row, one sigma')
    odd: float = tuning(
        2.0, 'the same, beyond which it costs no more', unit='sigma',
        source='convention: 5 % of what is normal; cheaper than a target that is missing',
    )  # fmt: skip
    memory: float = tuning(0.7, 'weight of the row so far in its spacing and its size')
    missing: float = tuning(9.0, 'cost of a target that is not seen')
    dearest: float = tuning(0.2, 'share of targets missing in a row found anywhere, at most')
    alike: float = tuning(1.5, 'cost of a blob beyond the end, below which the row goes on')
    curl: float = tuning(
        7.0, 'turn of an arm where it bends most, as if it did so from end to end', unit='rad',
        source='measured: 6.2 between two pins of a public photograph of a pneu-net',
    )  # fmt: skip
    gap_misfit: float = tuning(0.35, 'length of a gap against its targets', unit='spacing')
    longest_gap: int = tuning(7, 'from one target that is seen to the next')
    first_gap: int = tuning(2, 'the same, where the scale is not known')
    kept: int = tuning(12, 'rows kept at each step')
    neighbors: int = tuning(6, 'of a blob, one of which is the next target')
    seen: float = tuning(0.8, 'share of the targets seen in a row found anywhere, at least')


BEAM_SEARCH = BeamSearchSettings()


class BlobColumns(NamedTuple):
    """Blobs in the working plane: x, y and logarithm of the size, (blobs,) each."""

    x: Array
    y: Array
    sizes: Array


class Rows(NamedTuple):
    """Rows as they grow, those of a start together, the best first.

    known (rows, LAST + 1): what is known of each, as named above; chosen (rows, targets): its
    blobs; start (rows,): from which start it grows.
    """

    known: Array
    chosen: Indices
    start: Indices


class Candidates(NamedTuple):
    """Ways in which rows may go on: which row, with which blob (NOTHING: none), at which cost."""

    row: Indices
    blob: Indices
    cost: Array

    def only(self, which: Indices) -> Candidates:
        """Return some of them."""
        return Candidates(self.row[which], self.blob[which], self.cost[which])


def grow_rows(
    blobs: BlobColumns,
    arclength: Array,
    starts: Array,
    chosen: Indices,
    whole: bool,
    search: BeamSearchSettings,
) -> tuple[Indices, Array]:
    """Grow a row from each start, whose targets so far `chosen` (starts, targets) holds.

    starts (starts, LAST + 1): what is known of the rows, all up to the same target; whole: the
    first three targets and the last must be seen, and as many of all as of a row found anywhere.
    Returns the best row of each start, and the costs (starts,), infinite where there is none.
    """
    targets = arclength.size
    dearest = targets * (search.dearest * search.missing + 1.0) if whole else math.inf
    best, costs = chosen.copy(), np.full(len(starts), math.inf)
    rows = Rows(starts, chosen, np.arange(len(starts)))
    for target in range(int(starts[0, LAST]) + 1, arclength.size):
        ways = _ways_on(blobs, arclength, rows, target, whole, search)
        ways = _best_of_each(ways, rows.start, dearest, search)
        rows = _taken(blobs, arclength, rows, ways, target, starts[:, SCALE], search)
    first = np.flatnonzero(np.diff(rows.start, prepend=-1))
    best[rows.start[first]], costs[rows.start[first]] = rows.chosen[first], rows.known[first, COST]
    return best, costs


def _ways_on(
    blobs: BlobColumns,
    arclength: Array,
    rows: Rows,
    target: int,
    whole: bool,
    search: BeamSearchSettings,
) -> Candidates:
    """Return how rows may go on to a target: with every blob near its place, and without it."""
    longest_gap = search.first_gap if whole else search.longest_gap
    known = rows.known
    last = known[:, LAST].astype(np.int64)
    gap = target - last
    ahead = arclength[target] - np.where(last >= 0, arclength[last], 0.0)
    unit = known[:, SCALE] * _spacing_at(arclength, target)
    bend = np.asarray(search.bend * (gap * gap - 1), np.float64)
    # Between targets far apart an arm turns by more than it does between near ones.
    loose = 1.0 if whole else _looser(arclength, target, search)
    at_x, at_y = _expected(known.T, ahead)
    reach = unit * (search.along + loose * search.across + bend)
    row, blob = _near(blobs, at_x, at_y, np.where(gap <= longest_gap, reach, -1.0))
    along, across = _off_arc(blobs.x[blob], blobs.y[blob], known[row].T, ahead[row])
    cost = _misfit(
        along / unit[row],
        across / (loose * unit[row]),
        bend[row],
        _size_difference(blobs.sizes[blob], known[row, SIZE], search),
        search,
    )
    fits = np.flatnonzero(cost < math.inf)
    row, blob, cost = row[fits], blob[fits], cost[fits]
    without = np.arange(len(known))
    if whole:
        lost = np.count_nonzero(rows.chosen[:, :target] == NOTHING, axis=1)
        most = math.floor((1.0 - search.seen) * arclength.size + 1e-9)
        inner = 2 < target < arclength.size - 1
        without = np.flatnonzero(inner & (gap < longest_gap) & (lost < most))
    return Candidates(
        row=np.concatenate([without, row]),
        blob=np.concatenate([np.full(len(without), NOTHING), blob]),
        cost=np.concatenate([known[without, COST] + search.missing, known[row, COST] + cost]),
    )


def _looser(arclength: Array, target: int, search: BeamSearchSettings) -> float:
    """Return how many times further across a target may be, as the arm turns before it."""
    turn = search.curl * _spacing_at(arclength, target) / (arclength[-1] - arclength[0])
    return max(1.0, float(0.5 * turn / search.across))


def _spacing_at(arclength: Array, target: int) -> float:
    """Return the distance along the arm from the neighbor before, m."""
    return float(arclength[max(target, 1)] - arclength[max(target, 1) - 1])


def _near(blobs: BlobColumns, at_x: Array, at_y: Array, reach: Array) -> tuple[Indices, Indices]:
    """Return pairs of a place (places,) and a blob that is no further off in x and in y."""
    x, y = blobs.x, blobs.y
    if x.size and np.ptp(y) > np.ptp(x):  # sorted along the side on which they are further apart
        x, y, at_x, at_y = y, x, at_y, at_x
    order = np.argsort(x, kind='stable')
    first = np.searchsorted(x[order], at_x - reach)
    count = np.maximum(np.searchsorted(x[order], at_x + reach, side='right') - first, 0)
    place = np.repeat(np.arange(len(at_x)), count)
    blob = order[np.arange(len(place)) + np.repeat(first - np.cumsum(count) + count, count)]
    near = np.abs(y[blob] - at_y[place]) <= reach[place]
    return place[near], blob[near]


def _best_of_each(
    ways: Candidates, start: Indices, dearest: float, search: BeamSearchSettings
) -> Candidates:
    """Return the few best ways of each start, in order; none of one whose best is too dear."""
    whose = start[ways.row]
    order = np.lexsort((ways.blob, ways.row, ways.cost, whose))
    first = np.flatnonzero(np.diff(whose[order], prepend=-1))
    count = np.diff(first, append=len(order))
    rank = np.arange(len(order)) - np.repeat(first, count)
    cheap = np.repeat(ways.cost[order[first]] <= dearest, count)
    kept = order[(rank < search.kept) & cheap]
    return ways.only(kept)


def _taken(
    blobs: BlobColumns,
    arclength: Array,
    rows: Rows,
    ways: Candidates,
    target: int,
    first_scale: Array,
    search: BeamSearchSettings,
) -> Rows:
    """Return the rows that went on in these ways; first_scale (starts,): what they began with."""
    known, chosen, start = rows.known[ways.row], rows.chosen[ways.row], rows.start[ways.row]
    known[:, COST], chosen[:, target] = ways.cost, ways.blob
    seen = np.flatnonzero(ways.blob >= 0)
    blob, row = ways.blob[seen], known[seen].T
    last = row[LAST].astype(np.int64)
    ahead = arclength[target] - np.where(last >= 0, arclength[last], 0.0)
    x, y, size = blobs.x[blob], blobs.y[blob], blobs.sizes[blob]
    step_x, step_y = x - row[X], y - row[Y]
    chord = np.hypot(step_x, step_y)
    goes = (ahead > 0.0) & (chord > 0.0)
    over = np.where(goes, ahead, 1.0)
    # Heading of an arc: that of the chord in its middle; half of a new bend is believed.
    turn = _wrap_angle(np.arctan2(step_y, step_x) - row[HEADING])
    bending = 0.5 * (row[BENDING] + 2.0 * turn / over)
    length = chord / np.maximum(np.sinc(turn / math.pi), 1e-3)  # of the arc
    scale = search.memory * row[SCALE] + (1.0 - search.memory) * length / over
    began = first_scale[start[seen]]
    scale = np.clip(scale, began * (1.0 - search.stretch), began * (1.0 + search.stretch))
    row[HEADING] += np.where(goes, turn + 0.5 * bending * ahead, 0.0)
    row[BENDING] = np.where(goes, bending, row[BENDING])
    row[SCALE] = np.where(goes, scale, row[SCALE])
    sized = search.memory * row[SIZE] + (1.0 - search.memory) * size
    row[X], row[Y], row[LAST] = x, y, target
    # Which of two that differ is the odd one shows from there on.
    anew = np.isnan(row[SIZE]) | (_size_difference(size, row[SIZE], search) > search.odd)
    row[SIZE] = np.where(anew, size, sized)
    known[seen] = row.T
    return Rows(known, chosen, start)


def _expected(row: Array, ahead: Array) -> tuple[Array, Array]:
    """Return where an arc leads (x, y).

    row (LAST + 1, rows); ahead (rows,) m.
    """
    middle = row[HEADING] + 0.5 * row[BENDING] * ahead
    length = row[SCALE] * ahead
    return row[X] + length * np.cos(middle), row[Y] + length * np.sin(middle)


def _off_arc(x: Array, y: Array, row: Array, ahead: Array) -> tuple[Array, Array]:
    """Return how far blobs are off the arc that goes on, along and across it, in the unit of x.

    x, y (blobs,); row (LAST + 1, blobs); ahead (blobs,) m. An arc with the heading of the row leads
    to each: its turn tells how far across it is. How far along tells a length from that of the
    chord to that of the arc, as the heading is not known exactly. At the clamp itself, from where
    no arc leads on, along and across are those of the heading.
    """
    step_x, step_y = x - row[X], y - row[Y]
    length = row[SCALE] * ahead
    turned = _wrap_angle(np.arctan2(step_y, step_x) - row[HEADING])
    chord = np.hypot(step_x, step_y)
    longest = chord / np.maximum(np.sinc(turned / math.pi), 1e-3)
    cosine, sine = np.cos(row[HEADING]), np.sin(row[HEADING])
    arc = ahead > 0.0
    along = np.where(
        arc, length - np.clip(length, chord, longest), step_x * cosine + step_y * sine
    )
    across = np.where(
        arc,
        _wrap_angle(turned - 0.5 * row[BENDING] * ahead) * length,
        step_y * cosine - step_x * sine,
    )
    return np.abs(along), np.abs(across)


def _misfit(
    along: Array, across: Array, bend: Array, differs: Array, search: BeamSearchSettings
) -> Array:
    """Cost of blobs that are off by so much (spacings) and in size (sigma); inf if too far.

    bend: how much further across the gap they may be. A difference in size costs no more than
    `odd` sigma do, as one target may be far larger (a truncated square).
    """
    far = (along > search.along) | (across > search.across + bend)
    cost = (
        (along / search.along_std) ** 2
        + (across / (search.across_std + bend)) ** 2
        + np.minimum(differs, search.odd) ** 2
    )
    return np.where(far, math.inf, cost)


def _size_difference(size: Array, usual: Array, search: BeamSearchSettings) -> Array:
    """Return how far logarithmic areas are off the usual one, sigma; 0 where none is known."""
    return np.asarray(np.where(np.isnan(usual), 0.0, np.abs(size - usual) / search.size_std))


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
    scale = float(np.median(steps / np.diff(arclength[seen])))
    for place in np.flatnonzero(np.diff(seen, prepend=-1) > 1).tolist():
        target = seen[place]
        from_x = from_y = passed = 0.0
        heading = clamp_angle
        if place > 0:
            before = seen[place - 1]
            from_x, from_y = x[chosen[before]], y[chosen[before]]
            passed = arclength[before]
            if place > 1:
                heading = _end_heading(x, y, arclength, chosen, seen[:place][::-1][:3]) + math.pi
        onward = heading
        if place + 1 < seen.size:
            onward = _end_heading(x, y, arclength, chosen, seen[place:][:3])
        chord_x, chord_y = x[chosen[target]] - from_x, y[chosen[target]] - from_y
        chord = math.atan2(chord_y, chord_x)
        a, b = _wrap_angle(np.array([heading - chord, onward - chord])).tolist()
        longer = 1.0 + (2.0 * a * a + 2.0 * b * b - a * b) / 30.0
        length = longer * math.hypot(chord_x, chord_y)
        allowed = search.gap_misfit * _spacing_at(arclength, target)
        if abs(length / scale - (arclength[target] - passed)) > allowed:
            chosen[target:] = NOTHING
            return


def _end_heading(x: Array, y: Array, arclength: Array, chosen: Indices, places: Indices) -> float:
    """Heading at the first of two or three targets, towards the next, on an arc through them."""
    at = chosen[places]
    headings = np.arctan2(np.diff(y[at]), np.diff(x[at]))
    if places.size < 3:
        return float(headings[0])
    steps = np.abs(np.diff(arclength[places]))
    turn = _wrap_angle(headings[1:] - headings[0])[0]
    return float(headings[0] - turn * steps[0] / steps.sum())


def _wrap_angle(angle: Array) -> Array:
    """Bring angles into (-pi, pi]."""
    return np.asarray(angle - 2.0 * math.pi * np.floor(angle / (2.0 * math.pi) + 0.5))


def continues_beyond(
    blobs: BlobColumns, arclength: Array, chosen: Indices, search: BeamSearchSettings
) -> bool:
    """Whether another blob alike stands a spacing beyond the last target of a row."""
    x, y, sizes = blobs
    seen = np.flatnonzero(chosen >= 0)
    if seen.size < 2:
        return False
    a, b = chosen[seen[-2:]]
    step_x, step_y = x[b] - x[a], y[b] - y[a]
    row = np.zeros((LAST + 1, 1))
    row[X], row[Y], row[HEADING] = x[b], y[b], math.atan2(step_y, step_x)
    row[SCALE] = math.hypot(step_x, step_y) / (arclength[-1] - arclength[seen[-2]])
    spacing = _spacing_at(arclength, arclength.size - 1)
    along, across = _off_arc(x, y, row, np.array([spacing]))
    unit = float(row[SCALE, 0]) * spacing
    differs = np.abs(sizes - sizes[b]) / search.size_std
    cost = _misfit(along / unit, across / unit, np.zeros(1), differs, search)
    cost[b] = math.inf
    return bool((cost < search.alike).any())


def grow_seeded_rows(
    blobs: BlobColumns, arclength: Array, search: BeamSearchSettings
) -> tuple[Indices, Array]:
    """Grow a row from every blob and each of its neighbors; rows (seeds, targets) and costs."""
    x, y, sizes = blobs
    targets = arclength.size
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(apart, math.inf)
    neighbors = np.argsort(apart, axis=1, kind='stable')[:, : min(search.neighbors, x.size - 1)]
    first, second = np.repeat(np.arange(x.size), neighbors.shape[1]), neighbors.ravel()
    distinct = apart[first, second] > 0.0
    first, second = first[distinct], second[distinct]
    starts = np.zeros((len(first), LAST + 1))
    starts[:, LAST], starts[:, X], starts[:, Y] = 1.0, x[second], y[second]
    starts[:, HEADING] = np.arctan2(y[second] - y[first], x[second] - x[first])
    starts[:, SCALE] = apart[first, second] / (arclength[1] - arclength[0])
    starts[:, SIZE] = 0.5 * (sizes[first] + sizes[second])
    rows = np.full((len(first), targets), NOTHING)
    rows[:, 0], rows[:, 1] = first, second
    costs = np.full(len(first), math.inf)
    for begin in range(0, len(first), TOGETHER):
        some = slice(begin, begin + TOGETHER)
        rows[some], costs[some] = grow_rows(
            blobs, arclength, starts[some], rows[some], True, search
        )
    seen = np.count_nonzero(rows >= 0, axis=1)
    reverse = arclength[-1] - arclength[::-1]
    for seed in np.flatnonzero(costs < math.inf).tolist():
        row = rows[seed]
        if (
            np.unique(row[row >= 0]).size < seen[seed]  # a row that bites its tail
            or continues_beyond(blobs, arclength, row, search)
            or continues_beyond(blobs, reverse, row[::-1], search)
        ):
            costs[seed] = math.inf
    return rows, costs
