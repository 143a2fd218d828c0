"""Scale and base frame from the arm at rest, as in the paper if it is straight.

Several frames are averaged, in any order and possibly with missing targets. The search uses only
the number and spacing of the targets, because position and scale are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.vision.association import (
    COMMON_SHARE,
    ENOUGH,
    find_unplaced_rows,
    share_of_blobs,
    TargetRow,
)
from pneunet_ros.vision.camera.camera_settings import CurvedRestPlane, PlaneMethod
from pneunet_ros.vision.camera.working_plane import Plane, plane_from_rest
from pneunet_ros.vision.dots.blobs import Blobs
from pneunet_ros.vision.gating import consistent_spacing, FARTHEST
from pneunet_ros.vision.settings import VISION, VisionSettings

HEADING_CHORDS, HEADING_SHARE = 5, 0.4  # chords from the clamp that determine the heading there
TURN = 4.0  # rad per bow: an even arc is kL/2 off its chord at the end, kL/8 of it in the middle
UPRIGHT = 'upright'  # reason: the end with the clamp is unknown
NO_ROW = 'no_row', 'no_areas'  # reasons that may change with more expensive rows
STILL = 0.1  # spacings, distance of a target at rest from its average so far
PLACES = 4  # remembered positions in which an arm may be at rest
NEAR_CLAMP = 1.5  # spacings from clamp_pixel, which was selected by hand, to the first target
UPRIGHT_SHARE = math.sin(math.radians(15.0))  # sideways share of a row without a left end
RESTING = 'resting'  # reason of a frame that is averaged, without a problem
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
# Cost above the best row from which a row counts as accidental; measured: 0.1 on arms, 53 in
# grass.
CHANCE = 20.0
CROWD = 10  # rows of other areas from which they count as accidental; measured: 50 in printed text
ODDS = 0.01  # accidental rows that fit as well as a distinct one; convention
# Costs of successive searches for rows. With each of them, all rows that are not accidental are
# found.
LIMITS: tuple[float, ...] = 0.5 * CHANCE, CHANCE, 2.0 * CHANCE

Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestAverage:
    """Average of the targets at rest, and its number of frames.

    points (targets, 2) normalized, NaN for a target never seen; seen (targets,): number of frames
    that show each.
    """

    frames: int
    points: Array
    seen: Counts

    def off(self, points: Array) -> float:
        """Return the largest distance of targets (targets, 2) of a frame from their average."""
        apart = np.hypot(*(points - self.points).T)
        return math.inf if np.isnan(apart).all() else float(np.nanmax(apart))

    def with_frame(self, points: Array) -> RestAverage:
        """Return the average with one more frame (targets, 2), NaN where a target is not seen."""
        found = np.isfinite(points[:, 0])
        seen = self.seen + found
        before = np.where(self.seen[:, None] > 0, self.points, points)
        moved = np.where(found[:, None], points - before, 0.0)
        average = before + moved / np.maximum(seen, 1)[:, None]
        return RestAverage(frames=self.frames + 1, points=freeze(average), seen=seen)

    def missing_frames(self, wanted: int) -> str:
        """Describe why an average of this many frames is not usable; empty if it is."""
        if self.frames >= wanted:
            return ''
        words = [f'{self.frames} of {wanted} frames of the arm at rest']
        words += [f'target {target} never seen' for target in np.flatnonzero(self.seen == 0)]
        return ', '.join(words)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestSearch:
    """Rest positions of the arm, most recently updated first.

    A frame that fits no known position starts a new one.
    """

    places: tuple[RestAverage, ...] = ()

    @property
    def frames(self) -> int:
        """The number of frames of the most frequent position."""
        return max((place.frames for place in self.places), default=0)

    @property
    def bow(self) -> float:
        """Bow of the row at the latest position, relative to its length; NaN if there is none."""
        points = self.places[0].points if self.places else np.empty((0, 2))
        seen = np.isfinite(points[:, 0])
        return bow(points[seen]) if seen.any() else math.nan

    def missing_frames(self, wanted: int) -> str:
        """Describe why the latest position is not usable; empty if it is, or if there is none."""
        return self.places[0].missing_frames(wanted) if self.places else ''

    def with_frame(self, points: Array, spacing: float) -> RestSearch:
        """Return the search updated by a frame (targets, 2), with its position first.

        spacing: distance of neighboring targets, in the unit of the points.
        """
        off = [place.off(points) for place in self.places]
        others = list(self.places)
        here = RestAverage(
            frames=0, points=np.full_like(points, np.nan), seen=np.zeros(len(points), np.int64)
        )
        if off and min(off) <= STILL * spacing:
            here = others.pop(int(np.argmin(off)))
        elif len(others) == PLACES:
            others.pop(int(np.argmin([place.frames for place in others])))
        return RestSearch(places=(here.with_frame(points), *others))

    def recognize(
        self, points: Array, arclength: Array, vision: VisionSettings = VISION
    ) -> Array | None:
        """Return the targets (targets, 2) of a known rest position among points (n, 2).

        NaN for missing targets; None if every position has too few.
        """
        for place in sorted(self.places, key=lambda place: -place.frames):
            reach = STILL * spacing_of(place.points, arclength)
            apart = np.hypot(*(place.points[:, None] - points).transpose(2, 0, 1))
            apart = np.where(np.isnan(apart), math.inf, apart)
            near = np.asarray(apart.min(axis=1) <= reach)
            if np.count_nonzero(near) >= vision.beam_search.seen * len(near):
                found: Array = np.where(near[:, None], points[apart.argmin(axis=1)], np.nan)
                return found
        return None


def plane_at_rest(
    points: Array, arclength: Array, method: PlaneMethod, clamp_angle: float
) -> Plane:
    """Return the working plane of an arm at rest: targets (n, 2) normalized, arclength (n,) m.

    The plane of a straight arm follows from the outermost seen targets; that of an arm bent at
    rest, from the arc length between them and the heading at the clamp. clamp_angle: this heading
    in the base frame, rad.
    """
    seen = np.flatnonzero(np.isfinite(points[:, 0]))
    points, arclength = points[seen], arclength[seen]
    if isinstance(method, CurvedRestPlane):
        first, last = _unrolled(points, arclength)
        return plane_from_rest(first, last, 0.0, float(arclength[-1]), clamp_angle)
    first_arclength, last_arclength = arclength[[0, -1]].tolist()
    return plane_from_rest(points[0], points[-1], first_arclength, last_arclength, clamp_angle)


def _unrolled(points: Array, arclength: Array) -> tuple[Array, Array]:
    """Return clamp (2,) and last target (2,) of an arm extended straight from its clamp.

    The length is that of the arcs between neighbors. The heading at the clamp is extrapolated by a
    parabola from the headings of the first chords, each equal to that of the arm at its middle;
    along it the arm goes from the clamp to the first target.
    """
    steps, places = np.diff(points, axis=0), arclength
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    middle = 0.5 * (places[1:] + places[:-1])
    turn = np.gradient(heading, middle) * np.diff(places)
    length = float(np.sum(np.hypot(*steps.T) * (1.0 + turn**2 / 24.0)))
    near = max(HEADING_CHORDS, round(HEADING_SHARE * heading.size))
    degree = min(2, heading.size - 1)
    course = np.polynomial.Polynomial.fit(middle[:near], heading[:near], degree)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    way = course(0.5 * places[0] * (nodes + 1.0))
    to_first = 0.5 * places[0] * (np.stack([np.cos(way), np.sin(way)]) @ weights)
    scale, at_clamp = length / (places[-1] - places[0]), float(course(0.0))
    clamp = points[0] - scale * to_first
    ahead = np.array([math.cos(at_clamp), math.sin(at_clamp)])
    return clamp, clamp + scale * places[-1] * ahead


def spacing_of(points: Array, arclength: Array) -> float:
    """Return the smallest spacing of neighbors, in the unit of points (targets, 2)."""
    seen = np.flatnonzero(np.isfinite(points[:, 0]))
    steps = np.hypot(*np.diff(points[seen], axis=0).T)
    return float(np.median(steps / np.diff(arclength[seen])) * np.diff(arclength).min())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Failure:
    """Reason for which no arm was found in a frame: a key for counting, a sentence for users.

    seen: number of targets in the best partial row; found (areas, 2) px: the candidate areas, and
    blobs: their measurements, if made.
    """

    reason: str
    sentence: str
    seen: int = 0
    found: Array = field(default_factory=lambda: np.empty((0, 2)))
    blobs: Blobs | None = None


def row_at_rest(
    points: Array,
    pixels: Array,
    areas: Array,
    arclength: Array,
    clamp_pixel: tuple[float, float] | None,
    straightness: float,
    vision: VisionSettings = VISION,
    shapes: Array | None = None,
    costs: Array | None = None,
    limits: tuple[float, ...] = (math.inf,),
) -> TargetRow | Failure:
    """Find the row of targets at rest among blobs, starting with the target at the clamp.

    points (blobs, 2) normalized; pixels (blobs, 2); areas (blobs,) px^2; arclength (targets,) m;
    clamp_pixel: (u, v) of the first target, None for the left end; straightness: largest distance
    from the line between the ends, relative to its length; infinite for a bent arm; shapes (blobs,
    3), as in `Blobs`, None if unknown; costs (blobs,): as in `find_unplaced_rows`; limits: largest
    cost of a row in successive searches, which end when the rows found are decisive.
    """
    count = arclength.size
    found: TargetRow | Failure = no_row(count, len(points))
    for limit in limits:
        rows = find_unplaced_rows(
            points, areas, arclength, vision.beam_search, shapes, costs, limit
        )
        most = len(rows) >= ENOUGH
        rows = [row for row in rows if _is_regular(row_points(row, points), arclength, vision)]
        if rows and clamp_pixel is not None:
            rows = _rows_from(clamp_pixel, rows, pixels, vision)
            if not rows:
                sentence = f'no row of {count} targets begins at clamp_pixel {list(clamp_pixel)}'
                found = Failure(reason='wrong_clamp', sentence=sentence)
        if rows:
            found = _best_row(rows, points, pixels, clamp_pixel, straightness, vision)
            if most or limit >= _decided_within(rows, vision):
                break
    return found


def _decided_within(rows: list[TargetRow], vision: VisionSettings) -> float:
    """Return the cost limit within which all rows must be known to select one (best first)."""
    best = rows[0]
    least = _cost_of_seen(best, vision)
    others = [row for row in rows if share_of_blobs(row, best) < COMMON_SHARE]
    nearest = min((_cost_of_seen(row, vision) for row in others), default=math.inf)
    if nearest <= least + 0.5 * CHANCE:
        return least  # several rows exist, whatever else is found
    if nearest <= least + CHANCE:
        return math.inf  # unless the best one stands out from a crowd
    return max(best.cost, least + CHANCE)


def _best_row(
    rows: list[TargetRow],
    points: Array,
    pixels: Array,
    clamp_pixel: tuple[float, float] | None,
    straightness: float,
    vision: VisionSettings,
) -> TargetRow | Failure:
    """Return the row of the arm among rows (best first); other arguments as in `row_at_rest`."""
    count, best = rows[0].chosen.size, rows[0]
    rows = _rivals(best, rows, vision)
    if any(share_of_blobs(row, best) < COMMON_SHARE for row in rows):
        return Failure(
            reason='several_rows',
            sentence=f'there is more than one row of {count} targets: move the arm, so that it '
            'differs from the background, give clamp_pixel, or remove the other rows '
            'from the view',
        )
    if clamp_pixel is None:
        best = min(rows, key=lambda row: float(pixels[row.chosen[0], 0]))
        at = [[round(float(it)) for it in pixels[end]] for end in best.chosen[[0, -1]]]
        if _is_upright(best, rows, pixels, vision):
            return Failure(
                reason=UPRIGHT,
                sentence=f'the row of {count} targets is upright, so its left end is ambiguous: '
                f'set clamp_pixel in the camera file to {at[0]} or {at[1]}',
            )
        if at[1][0] < at[0][0]:
            return Failure(
                reason='wrong_clamp',
                sentence=f'the distances of the {count} targets match target_arclength only if '
                f'counted from the right end {at[0]}, but the clamp is assumed to be at '
                f'the left: set clamp_pixel in the camera file to {at[0]} if the clamp '
                'is there',
            )
    off = bow(points[best.chosen[best.chosen >= 0]])
    if off > straightness:
        return Failure(
            reason='not_straight',
            sentence=f'the arm is not straight: a target is {off:.1%} of the length off the line '
            f'between the ends, but {straightness:.1%} is allowed (rest_straightness). '
            'Scale and base frame are measured on the arm at rest; if it is bent even '
            f'at rest, set plane.method: {CurvedRestPlane.method}',
        )
    return best


def no_row(targets: int, areas: int) -> Failure:
    """Return the failure of finding a row of this many targets among this many areas."""
    return Failure(
        reason='no_row',
        sentence=f'no row of {targets} targets with the distances of target_arclength among '
        f'{areas} areas. Is the whole arm in view, and are target_arclength, '
        'grey_band and area right?',
    )


def _is_upright(
    best: TargetRow, rows: list[TargetRow], pixels: Array, vision: VisionSettings
) -> bool:
    """Whether a row can be read from either end, and neither end is clearly the left one."""
    first, last = best.chosen[[0, -1]].tolist()
    across, down = np.abs(pixels[last] - pixels[first]).tolist()
    turned = any(row.chosen[0] == last for row in rows)
    return turned and across < UPRIGHT_SHARE * math.hypot(across, down)


def bow(points: Array) -> float:
    """Return the largest distance of points (n, 2) from their chord, relative to its length."""
    way = points[-1] - points[0]
    off = (points - points[0]) @ np.array([-way[1], way[0]])
    return float(np.abs(off).max() / (way @ way))


def row_points(row: TargetRow, points: Array) -> Array:
    """Return the points of a row (targets, 2), NaN where a target is missing."""
    found = np.where(row.chosen[:, None] >= 0, points[row.chosen], np.nan)
    return np.asarray(found)


def _is_regular(points: Array, arclength: Array, vision: VisionSettings) -> bool:
    """Whether enough targets (targets, 2) of a row, including both ends, lie on a smooth line."""
    spacing = spacing_of(points, arclength)
    if not spacing > 0.0:
        return False
    x, y = np.ascontiguousarray(points.T) * (np.diff(arclength).min() / spacing)
    seen = consistent_spacing(x, y, arclength, FARTHEST, DOMAIN.stretch)
    least = vision.beam_search.seen * arclength.size
    return bool(seen[0] and seen[-1] and np.count_nonzero(seen) >= least)


def _rivals(best: TargetRow, rows: list[TargetRow], vision: VisionSettings) -> list[TargetRow]:
    """Return the rows (best first) that may also be an arm, excluding those due to chance.

    Rows are attributed to chance if their targets fit much worse than those of the best row; half
    of this difference suffices if the best row stands out from many rows, as in printed text. The
    number of such rows below a cost is modeled as a power of the cost, fitted to these rows.
    """
    least, worse = _cost_of_seen(best, vision), CHANCE
    others = [row for row in rows if share_of_blobs(row, best) < COMMON_SHARE]
    if len(others) >= CROWD:
        costs = np.maximum([row.cost for row in others], 1e-9)
        falling = np.log(costs.max() / costs).sum()
        power = len(others) / falling if falling > 0.0 else math.inf
        expected = len(others) * (np.append(best.cost, costs.min()) / costs.max()) ** power
        if expected[0] < ODDS <= expected[1]:
            worse *= 0.5
    return [row for row in rows if _cost_of_seen(row, vision) <= least + worse]


def _cost_of_seen(row: TargetRow, vision: VisionSettings) -> float:
    """Return the cost of the seen targets of a row."""
    return row.cost - vision.beam_search.missing * (row.chosen.size - row.seen)


def _rows_from(
    clamp_pixel: tuple[float, float], rows: list[TargetRow], pixels: Array, vision: VisionSettings
) -> list[TargetRow]:
    """Return the rows whose first target is nearest to the clamp; none if all are too far away."""
    there = []
    for row in rows:
        at = row_points(row, pixels)
        away = math.hypot(*(at[0] - np.array(clamp_pixel)))
        if away <= NEAR_CLAMP * np.nanmedian(np.hypot(*np.diff(at, axis=0).T)):
            there.append((away, row))
    nearest = min((away for away, _ in there), default=math.inf)
    return [row for away, row in there if away == nearest]
