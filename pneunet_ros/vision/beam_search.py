"""Grow rows of blobs, target by target: the kernels of `association`.

The next target is expected on the arc through the last targets, at the known spacing. Only the few
best rows are kept at each step.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel
from pneunet_ros.core.settings import numbers_type, tuning

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

NOTHING = -1
KEPT = 12  # rows kept at each step; half as many give the same result
BEND = 0.08  # spacings x (gap^2 - 1), additional deviation of a target after a gap
LONGEST_GAP = 7  # targets from one visible target to the next; a longer gap starts a new row
FIRST_GAP = 2  # the same, where the scale is not known
STRETCH = 0.25  # of an arm, either way, within a row
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
ALONG_STD = 0.12  # spacings, deviation of a target along the row, one sigma
# Sigma of size, shape or blur at which the cost of a difference saturates: convention, 5 % of
# normal differences. Up to two are cheaper than a missing target.
ODD = 2.0
# Rotation (rad) of an arm that has its largest curvature from end to end; measured: 6.2 between
# two pins of a public photograph of a pneu-net.
CURL = 7.0

# State of a growing row. SIZE to BLUR: appearance of its blobs, as in the columns of
# `BlobColumns`; NaN while unknown.
COST, X, Y, HEADING, BENDING, SCALE, SIZE, SHAPE_X, SHAPE_Y, BLUR, LAST = range(11)
LOOKS = 4
OWN_COST = 2 + LOOKS
BLOB_ROWS = OWN_COST + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamSearchSettings:
    """Criteria for a row of targets."""

    farthest: float = tuning(
        3.0,
        'distance from the prediction beyond which a blob is not a target; cost of a '
        'missing target',
        unit='sigma',
        source='convention: three sigma',
    )
    across_std: float = tuning(
        0.12,
        'sigma of the distance from the prediction, across',
        unit='spacing',
        source='measured: acceptance/painted_dots.py finds more dots than by 0.15',
    )
    size_std: float = tuning(
        0.35, 'difference of logarithmic areas in a row, one sigma', source='sweep'
    )
    look_std: float = tuning(
        0.1,
        'difference of logarithmic elongations, and of logarithmic blurs, in a row, one sigma',
        source='sweep',
    )
    memory: float = tuning(
        0.7,
        'weight of the previous targets of a row in its spacing and size, and of the previous '
        'areas of a target',
        source='sweep',
    )
    continues: float = tuning(
        1.5,
        'cost of a blob beyond the end below which a row continues regardless of its fit',
        source='invented: without it, acceptance/painted_dots.py finds more of films 1 and 15, '
        'and nothing of a third',
    )
    least_share: float = tuning(0.4, 'smallest share of seen targets of a row', source='sweep')
    seen: float = tuning(
        0.8, 'smallest share of seen targets in a row found anywhere', source='sweep'
    )

    @property
    def missing(self) -> float:
        """Cost of a target that is not seen."""
        return self.farthest**2

    def dearest(self, targets: int) -> float:
        """Return the largest cost of a row of targets found anywhere."""
        return targets * ((1.0 - self.seen) * self.missing + ODD**2)


BEAM_SEARCH = BeamSearchSettings()
BeamSearchNumbers = numbers_type(BeamSearchSettings, 'BeamSearchNumbers')


@functools.lru_cache
def search_numbers(settings: BeamSearchSettings) -> Any:
    """Return settings in the form that kernels take."""
    return BeamSearchNumbers(*astuple(settings))


class BlobColumns(NamedTuple):
    """Blobs in the working plane: x, y (blobs,), looks (LOOKS, blobs), and costs (blobs,).

    looks: logarithms of the size, of the elongation (two: along and diagonal to the image axes)
    and of the blur; 0 if unknown for all blobs. costs: of a blob in a row, in addition to the
    costs of its position and appearance.
    """

    x: Array
    y: Array
    looks: Array
    costs: Array

    @property
    def table(self) -> Array:
        """Return the blobs in the form that kernels take, (BLOB_ROWS, blobs)."""
        return np.vstack([self.x, self.y, self.looks, self.costs])


def grow_rows(
    blobs: BlobColumns,
    arclength: Array,
    starts: Array,
    chosen: Indices,
    whole: bool,
    search: BeamSearchSettings,
    limits: Array | None = None,
    least: int | None = None,
) -> tuple[Indices, Array]:
    """Grow a row from each start; `chosen` (starts, targets): its targets so far.

    starts (starts, LAST + 1): the beginnings of the rows, all up to the same target; whole:
    whether the first three targets and the last must be seen, and as many of all targets as in a
    row found anywhere; limits (targets,): largest cost of the seen targets up to each target;
    least: the fewest targets of a whole row, None for all targets: a row that cannot be continued
    ends there. Returns the best row of each start, and the costs (starts,), infinite if there is
    none.
    """
    if limits is None:
        limits = np.full(arclength.size, math.inf)
    best, costs = np.array(chosen, np.int64), np.full(len(starts), math.inf)
    if not len(blobs.x) and whole:
        return best, costs
    # Sorted along the axis with the larger extent.
    sides = (1, 0) if len(blobs.x) and np.ptp(blobs.y) > np.ptp(blobs.x) else (0, 1)
    order = np.argsort(blobs[sides[0]], kind='stable')
    grow_all(
        np.vstack([blobs[sides[0]], blobs[sides[1]], blobs.looks, blobs.costs]).take(
            order, axis=1
        ),
        order,
        np.array(sides),
        np.array(arclength),
        np.array(starts),
        whole,
        search.dearest(arclength.size) if whole else math.inf,
        arclength.size if least is None else least,
        limits,
        search_numbers(search),
        best,
        costs,
    )
    return best, costs


@kernel
def grow_all(
    blobs: Array,
    order: Indices,
    sides: Indices,
    arclength: Array,
    starts: Array,
    whole: bool,
    dearest: float,
    least: int,
    limits: Array,
    search: BeamSearchSettings,
    best: Indices,
    costs: Array,
) -> None:
    """Grow a row from each start; fills best (starts, targets) and costs, as `grow_rows`.

    blobs (BLOB_ROWS, blobs): position along two sides, looks and costs, sorted by the first; order
    (blobs,): their indices; sides (2,): 0 if a side is x, 1 if it is y; dearest: largest cost of
    all targets of a row.
    """
    targets, kept = arclength.size, KEPT
    open_end = least < targets
    known, grown = np.empty((kept, LAST + 1)), np.empty((kept, LAST + 1))
    rows, longer = np.empty((kept, targets), np.int64), np.empty((kept, targets), np.int64)
    ways, ways_cost = np.empty((kept, 2), np.int64), np.empty(kept)
    for number in range(starts.shape[0]):
        known[0], rows[0] = starts[number], best[number]
        count, target = 1, int(starts[number, LAST]) + 1
        while target < targets:
            many = _extend_rows(
                blobs, sides, arclength, known, rows, count, target, whole, open_end,
                limits[target], dearest, search, ways, ways_cost,
            )  # fmt: skip
            if many == 0:
                count = count if target >= least else 0
                break
            for place in range(many):
                row, blob = ways[place, 0], ways[place, 1]
                grown[place], longer[place] = known[row], rows[row]
                grown[place, COST], longer[place, target] = ways_cost[place], NOTHING
                if blob >= 0:
                    longer[place, target] = order[blob]
                    _take(
                        grown[place], blobs, blob, sides, arclength, target,
                        starts[number, SCALE], search,
                    )  # fmt: skip
            known[:many], rows[:many] = grown[:many], longer[:many]
            count, target = many, target + 1
        if count > 0:
            best[number], costs[number] = rows[0], known[0, COST]
            if whole:
                costs[number] -= search.farthest**2 * (target - 1 - known[0, LAST])


@inner
def _extend_rows(
    blobs: Array,
    sides: Indices,
    arclength: Array,
    known: Array,
    rows: Indices,
    count: int,
    target: int,
    whole: bool,
    open_end: bool,
    limit: float,
    dearest: float,
    search: BeamSearchSettings,
    ways: Indices,
    costs: Array,
) -> int:
    """Find the best continuations of rows to a target: with a nearby blob, and without.

    known, rows: of `count` rows; limit: largest cost of the seen targets of a row; dearest:
    largest cost of all targets. Fills ways (kept, 2): row and blob, or NOTHING, and their costs
    (kept,), cheapest first; returns their number.
    """
    targets, missing = arclength.size, search.farthest**2
    longest_gap = FIRST_GAP if whole else LONGEST_GAP
    spacing = arclength[max(target, 1)] - arclength[max(target, 1) - 1]
    # An arm turns more between distant targets than between close ones.
    loose = 1.0
    if not whole:
        turn = CURL * spacing / (arclength[-1] - arclength[0])
        loose = max(1.0, 0.5 * turn / (search.farthest * search.across_std))
    most = math.floor((1.0 - search.seen) * targets + 1e-9)
    many = 0
    for row in range(count):
        one = known[row]
        last = int(one[LAST])
        gap = target - last
        lost = 0
        for before in range(target):
            lost += rows[row, before] == NOTHING
        allowed = min(limit + lost * missing, dearest)
        may_miss = 2 < target < targets - 1 + open_end and gap < longest_gap and lost < most
        if (not whole or may_miss) and one[COST] + missing <= dearest:
            many = _insert(row, NOTHING, one[COST] + missing, ways, costs, many)
        if gap > longest_gap or one[COST] > allowed:
            continue
        ahead = arclength[target] - (arclength[last] if last >= 0 else 0.0)
        unit = one[SCALE] * spacing
        bend = BEND * (gap * gap - 1)
        middle = one[HEADING] + 0.5 * one[BENDING] * ahead
        length = one[SCALE] * ahead
        toward_x, toward_y = math.cos(middle), math.sin(middle)
        at_x, at_y = one[X] + length * toward_x, one[Y] + length * toward_y
        # Largest distance, and smallest cosine of the angle to it, allowed by misfit and cost.
        sigmas = math.sqrt(allowed - one[COST])
        most_along = unit * min(search.farthest, sigmas) * ALONG_STD
        most_across = (
            unit
            * loose
            * min(search.farthest * search.across_std + bend, sigmas * (search.across_std + bend))
        )
        reach = most_along + most_across
        longest, within = math.inf, -2.0
        if ahead > 0.0:
            longest = length + most_along
            angle = most_across / length
            within = math.cos(min(angle, math.pi))
        at, aside = (at_x, at_y) if sides[0] == 0 else (at_y, at_x)
        for blob in range(np.searchsorted(blobs[0], at - reach), blobs.shape[1]):
            if blobs[0, blob] > at + reach:
                break
            if abs(blobs[1, blob] - aside) > reach:
                continue
            x, y = blobs[sides[0], blob], blobs[sides[1], blob]
            step_x, step_y = x - one[X], y - one[Y]
            chord = math.hypot(step_x, step_y)
            if chord > longest or step_x * toward_x + step_y * toward_y < chord * within:
                continue  # as for most candidates, and cheaper than computing the arc to each
            along, across = off_arc(x, y, one, ahead)
            cost = one[COST] + misfit(along / unit, across / (loose * unit), bend, search)
            if cost < math.inf and (many < costs.size or cost < costs[-1]):
                cost += look_cost(blobs, blob, one, search)
                if cost <= allowed:
                    many = _insert(row, blob, cost, ways, costs, many)
    return many


@inner
def _insert(row: int, blob: int, cost: float, ways: Indices, costs: Array, many: int) -> int:
    """Insert a continuation among the cheapest ones; returns their number."""
    place = many
    while place > 0 and costs[place - 1] > cost:
        place -= 1
    if place == costs.size:
        return many
    many = min(many + 1, costs.size)
    for at in range(many - 1, place, -1):
        ways[at, 0], ways[at, 1], costs[at] = ways[at - 1, 0], ways[at - 1, 1], costs[at - 1]
    ways[place, 0], ways[place, 1], costs[place] = row, blob, cost
    return many


@inner
def _take(
    row: Array,
    blobs: Array,
    blob: int,
    sides: Indices,
    arclength: Array,
    target: int,
    first_scale: float,
    search: BeamSearchSettings,
) -> None:
    """Extend a row (LAST + 1,) by a blob; first_scale: its initial scale."""
    last = int(row[LAST])
    ahead = arclength[target] - (arclength[last] if last >= 0 else 0.0)
    x, y = blobs[sides[0], blob], blobs[sides[1], blob]
    step_x, step_y = x - row[X], y - row[Y]
    chord = math.hypot(step_x, step_y)
    if ahead > 0.0 and chord > 0.0:
        # Heading of an arc: the heading of the chord in its middle, plus half of a new bend.
        turn = _wrapped(math.atan2(step_y, step_x) - row[HEADING])
        bending = 0.5 * (row[BENDING] + 2.0 * turn / ahead)
        row[HEADING] += turn + 0.5 * bending * ahead
        row[BENDING] = bending
        scale = search.memory * row[SCALE]
        scale += (1.0 - search.memory) * chord * _longer_arc(turn) / ahead
        least, most = first_scale * (1.0 - STRETCH), first_scale * (1.0 + STRETCH)
        row[SCALE] = min(max(scale, least), most)
    row[X], row[Y], row[LAST] = x, y, target
    differences = look_differences(blobs, blob, row, search)
    for look in range(LOOKS):
        # The following blobs show which of two different ones is the outlier.
        odd = differences[(look + 1) // 2] > ODD
        before, now = row[SIZE + look], blobs[2 + look, blob]
        if odd or math.isnan(before):
            row[SIZE + look] = now
        else:
            row[SIZE + look] = search.memory * before + (1.0 - search.memory) * now


@inlined
def _wrapped(angle: float) -> float:
    """Wrap an angle to (-pi, pi]."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@inlined
def _longer_arc(turn: float) -> float:
    """Return arc length over chord, for a chord at an angle from the initial tangent."""
    share = 1.0 if abs(turn) < 1e-6 else math.sin(turn) / turn
    return 1.0 / max(share, 1e-3)


@inner
def off_arc(x: float, y: float, row: Array, ahead: float) -> tuple[float, float]:
    """Return the distance of a blob from the extrapolated arc, along and across it, in x units.

    row (LAST + 1,); ahead m. The arc from the last blob, tangent to the row, ends at this blob;
    its turn gives the distance across. The distance along is between the lengths of chord and arc,
    because the heading is not known exactly. At the clamp itself, where no arc is known, along and
    across refer to the heading.
    """
    step_x, step_y = x - row[X], y - row[Y]
    if ahead <= 0.0:
        cosine, sine = math.cos(row[HEADING]), math.sin(row[HEADING])
        return abs(step_x * cosine + step_y * sine), abs(step_y * cosine - step_x * sine)
    length, chord = row[SCALE] * ahead, math.hypot(step_x, step_y)
    turned = _wrapped(math.atan2(step_y, step_x) - row[HEADING])
    along = max(chord - length, length - chord * _longer_arc(turned), 0.0)
    return along, abs(_wrapped(turned - 0.5 * row[BENDING] * ahead)) * length


@inlined
def misfit(along: float, across: float, bend: float, search: BeamSearchSettings) -> float:
    """Return the cost of a blob at a distance (spacings) from its prediction; infinite far away.

    bend: additional tolerance across the row for a gap.
    """
    if along > search.farthest * ALONG_STD or across > search.farthest * search.across_std + bend:
        return math.inf
    off_along, off_across = along / ALONG_STD, across / (search.across_std + bend)
    return off_along * off_along + off_across * off_across


@inlined
def look_differences(
    blobs: Array, blob: int, row: Array, search: BeamSearchSettings
) -> tuple[float, float, float]:
    """Return the differences in size, shape and blur of a blob from a row, sigma.

    The differences are 0 if the appearance of the row is unknown.
    """
    if math.isnan(row[SIZE]):
        return 0.0, 0.0, 0.0
    return (
        abs(blobs[2, blob] - row[SIZE]) / search.size_std,
        math.hypot(blobs[3, blob] - row[SHAPE_X], blobs[4, blob] - row[SHAPE_Y]) / search.look_std,
        abs(blobs[5, blob] - row[BLUR]) / search.look_std,
    )


@inlined
def look_cost(blobs: Array, blob: int, row: Array, search: BeamSearchSettings) -> float:
    """Return the cost of a blob that looks different from a row.

    The cost is limited to that of `ODD` sigma, because a target may be far larger (a truncated
    square), cut off or touched by a glint. The cost of this blob in any row is added.
    """
    size, shape, blur = look_differences(blobs, blob, row, search)
    odd, own = ODD, float(blobs[OWN_COST, blob])
    return own + min(size, odd) ** 2 + min(shape, odd) ** 2 + min(blur, odd) ** 2
