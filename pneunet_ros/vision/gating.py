"""Frame-to-frame gating of a row of targets: predictions and acceptance.

Positions are in the working plane, in any unit that preserves shapes; NaN for a target that is not
seen. All functions are pure and process the whole row.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, kernel, not_literal
from pneunet_ros.core.settings import tuning

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class GatingSettings:
    """Settings for gating blobs as targets of a row."""

    largest_loss: float = tuning(
        0.87, 'smallest ratio of area to the usual one, compared with neighbors', source='sweep'
    )
    largest_growth: float = tuning(
        1.2, 'largest ratio of area to the usual one, compared with neighbors', source='sweep'
    )
    longer: float = tuning(
        1.35, 'largest ratio of elongation to that of neighbors', source='sweep'
    )
    first_growth: float = tuning(
        1.1, 'largest ratio of area to neighbors for a target not seen before', source='sweep'
    )
    alone_between: float = tuning(
        0.04,
        'largest motion of a target relative to its neighbors',
        unit='spacing',
        source='sweep',
    )


GATING = GatingSettings()
COMPARED = 3  # neighbors on each side in the check of distances
OFF_CURVE = 0.09  # spacings from the curve through the neighbors
# Last visible target: allowed motion relative to its neighbors, in spacings, and as a multiple of
# the difference between them.
ALONE_BEYOND, STEPS = 0.15, 2.0
FARTHEST = 2.5  # spacings from an end of a newly found row to the next target
NOTHING_BEFORE = not_literal(0)
BEYOND = math.sqrt(1.0 + 9.0 + 9.0 + 1.0)  # error of a place on an arc through three, over theirs


@kernel
def consistent_spacing(
    x: Array, y: Array, arclength: Array, farthest: float, longest: float
) -> Mask:
    """Return the targets that lie on a smooth row with the right spacings (targets,).

    First removes targets at a wrong distance from most of their neighbors, then targets off a
    smooth curve through the others (an arm with three targets has no such curve), until the
    remaining ones fit. Targets are removed one at a time, each time the one without which the
    others fit best, because a wrong target distorts the curve of its neighbors. x, y are in m, or
    scaled so that the arm has about its length. A target at either end of the row is rejected if
    it is `farthest` spacings or more from the next; `longest`: largest distance of neighbors,
    relative to that along the arm.
    """
    places, rest = np.empty(x.size, np.int64), np.empty(x.size, np.int64)
    others, count = np.empty(x.size, np.int64), NOTHING_BEFORE
    for target in range(x.size):
        if math.isfinite(x[target]) and math.isfinite(y[target]):
            places[count] = target
            count += 1
    smooth = False
    while True:
        worst, least = -1, math.inf
        for place in range(count):
            now = places[:count]
            if _misfit(x, y, arclength, now, place, smooth, farthest, others, longest) <= 1.0:
                continue
            left = 0.0
            _without(now, place, rest)
            for other in range(count - 1):
                left += _misfit(
                    x, y, arclength, rest[: count - 1], other, smooth, farthest, others, longest
                )
            if left < least:
                worst, least = place, left
        if worst >= 0:
            _without(places[:count], worst, places)
            count -= 1
        elif smooth or x.size < 4:
            break
        else:
            smooth = True
    seen = np.zeros(x.size, np.bool_)
    for place in range(count):
        seen[places[place]] = True
    return seen


@inlined
def _without(places: Indices, here: int, rest: Indices) -> None:
    """Copy all places except one to the front of `rest`, which may be the same array."""
    for place in range(places.size - 1):
        rest[place] = places[place + (place >= here)]


@inlined
def _misfit(
    x: Array,
    y: Array,
    arclength: Array,
    places: Indices,
    here: int,
    smooth: bool,
    farthest: float,
    scratch: Indices,
    longest: float,
) -> float:
    """Return the misfit of a target with the others; above 1 it is rejected."""
    if smooth:
        return _off_the_curve(x, y, arclength, places, here, farthest, scratch)
    return _wrong_distances(x, y, arclength, places, here, longest)


@inlined
def _wrong_distances(
    x: Array, y: Array, arclength: Array, places: Indices, here: int, longest: float
) -> float:
    """Return twice the fraction of neighbors at a wrong distance; 2 without neighbors."""
    target = places[here]
    wrong = known = 0
    for place in range(max(here - COMPARED, 0), min(here + COMPARED + 1, places.size)):
        other = places[place]
        if other == target:
            continue
        along = abs(arclength[target] - arclength[other])
        distance = math.hypot(x[target] - x[other], y[target] - y[other])
        known += 1
        wrong += distance > longest * along
    return 2.0 if known == 0 else 2.0 * wrong / known


@inlined
def _off_the_curve(
    x: Array,
    y: Array,
    arclength: Array,
    places: Indices,
    here: int,
    farthest: float,
    scratch: Indices,
) -> float:
    """Return the distance of a target from the curve of its neighbors; rejected above 1."""
    target, others = places[here], scratch[: places.size - 1]
    if others.size < 2:
        return 2.0
    _without(places, here, scratch)
    between = 0 < here < others.size
    spacing = arclength[max(target, 1)] - arclength[max(target, 1) - 1]
    next_to = others[min(here, others.size - 1)]
    if not between and abs(arclength[target] - arclength[next_to]) >= farthest * spacing:
        return 2.0
    at_x, at_y, spread = _from_others(x, y, arclength, others, here, target)
    off: float = math.hypot(x[target] - at_x, y[target] - at_y) / spacing
    return off / (OFF_CURVE * spread)


@kernel
def expected_points(x: Array, y: Array, arclength: Array) -> tuple[Array, Array]:
    """Return the predicted positions of all targets (targets,) from those seen.

    Between two seen targets: a cubic with their tangents. Beyond the last target on either side:
    an arc through the last three, or a line.
    """
    count = x.size
    at_x, at_y, places = np.empty(count), np.empty(count), np.empty(count, np.int64)
    known = NOTHING_BEFORE
    for target in range(count):
        at_x[target], at_y[target] = x[target], y[target]
        if math.isfinite(x[target]) and math.isfinite(y[target]):
            places[known] = target
            known += 1
    places = places[:known]
    if places.size < 2:
        return at_x, at_y
    after = NOTHING_BEFORE
    for target in range(count):
        if math.isfinite(x[target]) and math.isfinite(y[target]):
            after += 1
            continue
        at_x[target], at_y[target], _ = _from_others(x, y, arclength, places, after, target)
    return at_x, at_y


@inlined
def _from_others(
    x: Array, y: Array, arclength: Array, places: Indices, after: int, target: int
) -> tuple[float, float, float]:
    """Return the position of a target predicted from the others; after: number of them before it.

    The third value is the error of the distance from the prediction, if all positions have an
    error of 1.
    """
    if after == 0:
        third = places[2] if places.size > 2 else -1
        at_x, at_y = _along_arc(x, y, arclength, places[0], places[1], third, target)
        return at_x, at_y, BEYOND
    if after == places.size:
        third = places[-3] if places.size > 2 else -1
        at_x, at_y = _along_arc(x, y, arclength, places[-1], places[-2], third, target)
        return at_x, at_y, BEYOND
    low = max(0, min(after - 2, places.size - 4))
    near = places[low : low + 4]
    at_x = at_y = 0.0
    square = 1.0
    for place in near:
        weight = 1.0
        for other in near:
            if other != place:
                weight *= arclength[target] - arclength[other]
                weight /= arclength[place] - arclength[other]
        at_x += weight * x[place]
        at_y += weight * y[place]
        square += weight * weight
    return at_x, at_y, math.sqrt(square)


@inlined
def _along_arc(
    x: Array, y: Array, arclength: Array, end: int, before: int, first: int, target: int
) -> tuple[float, float]:
    """Extrapolate the arc through the nearest seen targets; first: -1 if there is none."""
    step_x, step_y = x[end] - x[before], y[end] - y[before]
    along = abs(arclength[end] - arclength[before])
    heading = math.atan2(step_y, step_x)
    scale = math.hypot(step_x, step_y) / along
    bending = 0.0
    if first >= 0:
        earlier = math.atan2(y[before] - y[first], x[before] - x[first])
        turn = heading - earlier
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        bending = 2.0 * turn / abs(arclength[end] - arclength[first])
    ahead = abs(arclength[target] - arclength[end])
    middle = heading + 0.5 * bending * (along + ahead)
    at_x = x[end] + scale * ahead * math.cos(middle)
    at_y = y[end] + scale * ahead * math.sin(middle)
    return at_x, at_y


def consistent_motion(
    off: Array, spacing: float, gating: GatingSettings = GATING
) -> tuple[Mask, Mask]:
    """Return the targets that deviate from predictions as their neighbors do, and the others.

    off (targets, 2): offset of each from its prediction, in the unit of `spacing`; NaN for targets
    that are not seen or have no prediction of their own; these are not tested. A glint next to a
    target, or a partial cover, moves only the center of this target.
    """
    known = np.isfinite(off[:, 0]) & np.isfinite(off[:, 1])
    places = np.flatnonzero(known)
    near = min(4, places.size - 1)
    if near < 2:
        return known, np.zeros_like(known)
    # The nearest along the arm, on either or both sides.
    away = places - places[:, None]
    nearest = np.argsort(2 * np.abs(away) + (away > 0), axis=1)[:, 1 : near + 1]
    of_near = np.sort(off[places[nearest]], axis=1)
    lower, upper = of_near[:, (near - 1) // 2], of_near[:, near // 2]
    alone = np.hypot(*(off[places] - 0.5 * (lower + upper)).T)
    # At an end, unexpected motion increases along the arm.
    at_end = ALONE_BEYOND * spacing + STEPS * np.hypot(*(upper - lower).T)
    before = np.count_nonzero(nearest < np.arange(places.size)[:, None], axis=1)
    between = (before == 2) & (near == 4)
    fits = alone <= np.where(between, gating.alone_between * spacing, at_end)
    together = np.zeros_like(known)
    together[places] = fits
    return together, known & ~together


def consistent_size(
    area: Array, usual: Array, elongation: Array, gating: GatingSettings = GATING
) -> Mask:
    """Return the blobs of plausible area, relative to the usual one and to neighbors (targets,).

    usual: area of each so far; elongation: largest axis over smallest. A partly covered blob is
    smaller, a blob merged with a glint is larger or longer, and the center of either is not that
    of the target. Light and motion change neighboring blobs in the same way.
    """
    size = area / usual
    one = np.ones_like(area)
    relative, longer = size / local_median(size, one), elongation / local_median(elongation, one)
    return np.asarray(
        (relative >= gating.largest_loss)
        & (relative <= gating.largest_growth)
        & (longer <= gating.longer)
    )


@kernel
def local_median(values: Array, of_few: Array) -> Array:
    """Return the median of each value and its three neighbors on either side, (n,), without NaN.

    of_few (n,): returned where fewer than three are known.
    """
    medians, near = of_few.copy(), np.empty(7)
    for target in range(values.size):
        count = NOTHING_BEFORE
        for other in range(max(target - 3, 0), min(target + 4, values.size)):
            value = values[other]
            if not math.isfinite(value):
                continue
            at = count
            while at > 0 and near[at - 1] > value:
                near[at] = near[at - 1]
                at -= 1
            near[at] = value
            count += 1
        if count > 2:
            medians[target] = 0.5 * (near[(count - 1) // 2] + near[count // 2])
    return medians


def initial_area(area: Array, whole: Mask, gating: GatingSettings = GATING) -> Array:
    """Return the expected areas of targets after they are found (targets,).

    area: NaN for a target that is not seen; whole: seen with its whole edge. A whole target keeps
    its area, because dots painted by hand differ. The area of any other target starts no smaller
    than that of its neighbors, because the target may be partly covered, and hardly larger,
    because it may be merged with a glint.
    """
    known = np.isfinite(area)
    of_few = np.full(area.size, np.median(area[known]) if known.any() else math.nan)
    middle = local_median(area, of_few)
    first: Array = np.clip(area, middle / gating.largest_growth, gating.first_growth * middle)
    first = np.where(whole, area, first)
    return np.where(known, first, middle)
